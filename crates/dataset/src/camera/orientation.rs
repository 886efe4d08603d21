//! Rotation and reflection of images by their EXIF orientation.

use super::{Calibration, Distortion};
use i2slam_geometry::Image;

/// One of the eight EXIF orientations: an optional transposition, then optional reflections.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Orientation {
    /// Whether rows become columns.
    transposes: bool,
    /// Whether columns are then read from the right, rows from below.
    mirrors: [bool; 2],
}

impl Orientation {
    /// From the value of the EXIF tag, 1 to 8.
    pub(crate) fn from_exif(number: u32) -> Option<Self> {
        let (transposes, mirrors) = match number {
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
        Some(Self { transposes, mirrors })
    }

    /// Whether images are shown as stored.
    pub(crate) fn is_identity(self) -> bool {
        self == Self::default()
    }

    /// Whether the orientation includes a reflection.
    pub(crate) fn is_mirrored(self) -> bool {
        self.transposes ^ self.mirrors[0] ^ self.mirrors[1]
    }

    /// Description for messages: "images are left as they are".
    pub(crate) fn description(self) -> &'static str {
        match (self.transposes, self.mirrors) {
            (false, [false, false]) => "left as they are",
            (false, [true, true]) => "turned by 180 degrees",
            (true, [true, false]) => "turned by 90 degrees",
            (true, [false, true]) => "turned by 270 degrees",
            (false, _) => "mirrored",
            (true, _) => "mirrored and turned",
        }
    }

    /// Width and height after the transformation [px].
    pub(crate) fn apply_to_size(self, (width, height): (usize, usize)) -> (usize, usize) {
        if self.transposes { (height, width) } else { (width, height) }
    }

    /// Transforms a stored image.
    pub(crate) fn apply(self, stored: Image<f32>) -> Image<f32> {
        if self.is_identity() {
            return stored;
        }
        let (width, height) = self.apply_to_size((stored.width, stored.height));
        Image::from_fn(width, height, stored.channels, |channel, column, row| {
            let column = if self.mirrors[0] { width - 1 - column } else { column };
            let row = if self.mirrors[1] { height - 1 - row } else { row };
            let (column, row) = if self.transposes { (row, column) } else { (column, row) };
            stored.at(channel, column, row)
        })
    }

    /// Transforms a calibration if its image size is that of stored images only; any other is taken
    /// to be of transformed images, as OpenCV reads them.
    pub(crate) fn apply_to_calibration(
        self,
        found: Calibration,
        stored: (usize, usize),
    ) -> Calibration {
        let shown = self.apply_to_size(stored);
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
        let distortion = self.apply_to_lens(found.distortion);
        Calibration { intrinsics, distortion, size: Some(shown), ..found }
    }

    /// Transforms a lens. The tangential part is a direction in the image, `(p2, p1)`.
    fn apply_to_lens(self, lens: Distortion) -> Distortion {
        let [p1, p2] = lens.tangential;
        let (x, y) = if self.transposes { (p1, p2) } else { (p2, p1) };
        let sign = |mirrored: bool| if mirrored { -1.0 } else { 1.0 };
        let tangential = [sign(self.mirrors[1]) * y, sign(self.mirrors[0]) * x];
        Distortion { tangential, ..lens }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::FormatDefaults;

    /// The stored image 1 2 3 / 4 5 6 in the eight orientations of the EXIF standard.
    #[test]
    fn all_eight_orientations_follow_the_standard() {
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
            let orientation = Orientation::from_exif(number).expect("a number of the standard");
            let shown = orientation.apply(stored.clone());
            assert_eq!(shown.data, due, "{number}");
            assert_eq!((shown.width, shown.height), orientation.apply_to_size((3, 2)), "{number}");
        }
        assert_eq!(Orientation::from_exif(0), None);
        assert_eq!(Orientation::from_exif(9), None);
    }

    /// A transformed ray projects to the transformed pixel.
    #[test]
    fn a_calibration_of_stored_images_is_transformed_with_them() {
        let lens = Distortion::from_opencv(&[0.1, -0.05, 0.02, -0.03, 0.01]).expect("a lens");
        let found =
            Calibration::from_opencv([50.0, 52.0, 30.0, 21.0], lens, "a file", FormatDefaults::TUM);
        let found = Calibration { size: Some((64, 48)), ..found };
        let at = |c: &Calibration, x: f64, y: f64| {
            let (x, y) = c.distortion.distort(x, y);
            (c.intrinsics[0] * x + c.intrinsics[2], c.intrinsics[1] * y + c.intrinsics[3])
        };
        for number in 5..9 {
            let orientation = Orientation::from_exif(number).expect("a number of the standard");
            let turned = orientation.apply_to_calibration(found.clone(), (64, 48));
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
        let turn = Orientation::from_exif(6).expect("a quarter");
        for size in [None, Some((48, 64))] {
            let other = Calibration { size, ..found.clone() };
            assert_eq!(turn.apply_to_calibration(other.clone(), (64, 48)), other);
        }
    }
}
