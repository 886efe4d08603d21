//! Pictures that are to be shown turned or mirrored, as the EXIF data of telephones and cameras
//! ask.

use crate::calibration::Calibration;
use crate::distortion::Distortion;
use i2slam_geometry::Image;

/// How a picture is shown: where its columns and rows go. Every one of the eight ways is a change
/// of places of columns and rows, then a reflection of either.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Orientation {
    /// Rows become columns.
    swaps: bool,
    /// Columns are then read from the right, rows from below.
    mirrors: [bool; 2],
}

impl Orientation {
    /// By the number of the EXIF tag; `None` for one that does not exist.
    pub(crate) fn of_exif(number: u32) -> Option<Self> {
        let (swaps, mirrors) = match number {
            1 => (false, [false, false]),
            2 => (false, [true, false]),
            3 => (false, [true, true]),
            4 => (false, [false, true]),
            5 => (true, [false, false]),
            6 => (true, [true, false]),
            7 => (true, [true, true]),
            8 => (true, [false, true]),
            _ => return None,
        };
        Some(Self { swaps, mirrors })
    }

    /// Whether pictures are shown as they are stored.
    pub(crate) fn is_none(self) -> bool {
        self == Self::default()
    }

    /// Whether pictures are shown as in a mirror, turned or not.
    pub(crate) fn is_mirrored(self) -> bool {
        self.swaps ^ self.mirrors[0] ^ self.mirrors[1]
    }

    /// What is done to pictures, in words.
    pub(crate) fn words(self) -> &'static str {
        match (self.swaps, self.mirrors) {
            (false, [false, false]) => "left as they are",
            (false, [true, true]) => "turned by 180 degrees",
            (true, [true, false]) => "turned by 90 degrees",
            (true, [false, true]) => "turned by 270 degrees",
            (false, _) => "mirrored",
            (true, _) => "mirrored and turned",
        }
    }

    /// Width and height as shown [px].
    pub(crate) fn size(self, (width, height): (usize, usize)) -> (usize, usize) {
        if self.swaps { (height, width) } else { (width, height) }
    }

    /// A picture as shown.
    pub(crate) fn shown(self, stored: Image<f32>) -> Image<f32> {
        if self.is_none() {
            return stored;
        }
        let (width, height) = self.size((stored.width, stored.height));
        let mut out = Image::new(width, height, stored.channels);
        for channel in 0..stored.channels {
            let from = stored.plane(channel);
            for (place, value) in out.plane_mut(channel).iter_mut().enumerate() {
                let (mut column, mut row) = (place % width, place / width);
                column = if self.mirrors[0] { width - 1 - column } else { column };
                row = if self.mirrors[1] { height - 1 - row } else { row };
                let (column, row) = if self.swaps { (row, column) } else { (column, row) };
                *value = from[row * stored.width + column];
            }
        }
        out
    }

    /// The calibration of pictures as shown. One that tells the size of pictures as they are
    /// stored, and no others, is of those and is turned with them; others are of pictures as shown,
    /// as OpenCV reads them.
    pub(crate) fn calibration(self, found: Calibration, stored: (usize, usize)) -> Calibration {
        let shown = self.size(stored);
        if found.size != Some(stored) || stored == shown || found.field_of_view.is_some() {
            return found;
        }
        let [fx, fy, cx, cy] = found.intrinsics;
        let mirrored = |at: f64, side: usize, is: bool| if is { side as f64 - at } else { at };
        let intrinsics = [
            fy,
            fx,
            mirrored(cy, shown.0, self.mirrors[0]),
            mirrored(cx, shown.1, self.mirrors[1]),
        ];
        let distortion = self.lens(found.distortion);
        Calibration { intrinsics, distortion, size: Some(shown), ..found }
    }

    /// The lens as shown. The tangential part is a direction of the picture, `(p2, p1)`.
    fn lens(self, lens: Distortion) -> Distortion {
        let [p1, p2] = lens.tangential;
        let (x, y) = if self.swaps { (p1, p2) } else { (p2, p1) };
        let sign = |mirrored: bool| if mirrored { -1.0 } else { 1.0 };
        let tangential = [sign(self.mirrors[1]) * y, sign(self.mirrors[0]) * x];
        Distortion { tangential, ..lens }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::Traits;

    /// The stored picture 1 2 3 / 4 5 6, shown in the eight ways of the EXIF standard.
    #[test]
    fn every_number_shows_the_picture_as_the_standard_says() {
        let stored =
            Image { width: 3, height: 2, channels: 1, data: (1..7).map(|v| v as f32).collect() };
        let rows: [(u32, &[f32]); 8] = [
            (1, &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]),
            (2, &[3.0, 2.0, 1.0, 6.0, 5.0, 4.0]),
            (3, &[6.0, 5.0, 4.0, 3.0, 2.0, 1.0]),
            (4, &[4.0, 5.0, 6.0, 1.0, 2.0, 3.0]),
            (5, &[1.0, 4.0, 2.0, 5.0, 3.0, 6.0]),
            (6, &[4.0, 1.0, 5.0, 2.0, 6.0, 3.0]),
            (7, &[6.0, 3.0, 5.0, 2.0, 4.0, 1.0]),
            (8, &[3.0, 6.0, 2.0, 5.0, 1.0, 4.0]),
        ];
        for (number, due) in rows {
            let orientation = Orientation::of_exif(number).expect("a number of the standard");
            let shown = orientation.shown(stored.clone());
            assert_eq!(shown.data, due, "{number}");
            assert_eq!((shown.width, shown.height), orientation.size((3, 2)), "{number}");
        }
        assert_eq!(Orientation::of_exif(0), None);
        assert_eq!(Orientation::of_exif(9), None);
    }

    /// A ray through the turned lens meets the turned place.
    #[test]
    fn a_calibration_of_stored_pictures_is_turned_with_them() {
        let lens = Distortion::from_opencv(&[0.1, -0.05, 0.02, -0.03, 0.01]).expect("a lens");
        let found =
            Calibration::from_opencv([50.0, 52.0, 30.0, 21.0], lens, "a file", Traits::default());
        let found = Calibration { size: Some((64, 48)), ..found };
        let at = |c: &Calibration, x: f64, y: f64| {
            let (x, y) = c.distortion.distort(x, y);
            (c.intrinsics[0] * x + c.intrinsics[2], c.intrinsics[1] * y + c.intrinsics[3])
        };
        for number in 5..9 {
            let orientation = Orientation::of_exif(number).expect("a number of the standard");
            let turned = orientation.calibration(found.clone(), (64, 48));
            assert_eq!(turned.size, Some((48, 64)));
            let side = |v: f64, is: bool| if is { -v } else { v };
            let (x, y) = (0.21, -0.13);
            let (u, v) = at(&found, x, y);
            let ray = (side(y, orientation.mirrors[0]), side(x, orientation.mirrors[1]));
            let due = (
                if orientation.mirrors[0] { 48.0 - v } else { v },
                if orientation.mirrors[1] { 64.0 - u } else { u },
            );
            let (a, b) = at(&turned, ray.0, ray.1);
            assert!(
                (a - due.0).abs() < 1e-9 && (b - due.1).abs() < 1e-9,
                "{number}: {a} {b} {due:?}"
            );
        }
        // Of pictures as shown, or of no size: as it is.
        let turn = Orientation::of_exif(6).expect("a quarter");
        for size in [None, Some((48, 64))] {
            let other = Calibration { size, ..found.clone() };
            assert_eq!(turn.calibration(other.clone(), (64, 48)), other);
        }
    }
}
