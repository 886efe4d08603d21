//! Resampling from recorded to delivered images: undistortion, crop, scale.
//!
//! Colour: lens removed by bilinear sampling at full resolution, then averaged over the area of
//! each delivered pixel. The average is taken of the values as recorded (display space), as the
//! systems compared with do; averaging light would need the camera response, which is unknown
//! here. Depth: each delivered pixel takes the recorded pixel its centre falls into, as a piece of a
//! plane, so that no surface is invented between two depths.
//!
//! Colour and depth may have been recorded by cameras of different size and focal length at one
//! place; frames are delivered on the grid of one of them.

use super::area_resampling::AreaResampler;
use super::depth_interpolation::depth_near;
use crate::camera::Distortion;
use i2slam_geometry::{Camera, Image};

/// Marks pixels of the depth lookup that were not recorded.
const OUTSIDE: u32 = u32::MAX;

/// Bilinear sampling of four neighbours, the top left one at `index`.
#[derive(Clone, Copy, Debug)]
struct Tap {
    index: u32,
    /// Weight of the right column, of the lower row, in `[0, 1]`.
    right: f32,
    lower: f32,
}

/// Pinhole cameras of recorded images, sizes at least 2x2.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RecordingCameras {
    pub(crate) colour: Camera<f64>,
    pub(crate) depth: Camera<f64>,
    /// The one whose grid is delivered, after crop and scale.
    pub(crate) grid: Camera<f64>,
}

impl RecordingCameras {
    /// Scales all cameras to images of another size [px].
    pub(crate) fn resized(&self, (width, height): (usize, usize)) -> Self {
        let resized = |camera: &Camera<f64>| camera.resized(width, height);
        Self {
            colour: resized(&self.colour),
            depth: resized(&self.depth),
            grid: resized(&self.grid),
        }
    }
}

/// Precomputed lookup tables from recorded to delivered images.
#[derive(Clone, Debug)]
pub(crate) struct Resampler {
    colour_size: (usize, usize),
    depth_size: (usize, usize),
    border: usize,
    /// Bilinear taps per cropped pixel; `None` for a lens without distortion.
    taps: Option<Vec<Tap>>,
    /// Area resampling straight to the delivered image, if colour has another grid.
    areas: Option<AreaResampler>,
    /// Index of the recorded pixel per delivered pixel, or [`OUTSIDE`].
    depth_lookup: Vec<u32>,
    /// Offset from its centre per delivered pixel [px recorded]; `None` where all are zero.
    depth_offsets: Option<Vec<[f32; 2]>>,
    cropped: (usize, usize),
    /// Pinhole camera of the delivered frames.
    pub(crate) camera: Camera<f64>,
    /// 1 plane, true where the recorded image covers the delivered pixel; `None` if everywhere.
    pub(crate) valid_mask: Option<Image<bool>>,
    /// Smallest border that removes all unrecorded pixels [px recorded].
    pub(crate) full_coverage_border: usize,
}

impl Resampler {
    /// Builds the tables for the recording cameras, their lens, a border [px of the grid] and a
    /// delivered size [px].
    pub(crate) fn new(
        recorded: &RecordingCameras,
        lens: &Distortion,
        border: usize,
        delivered: (usize, usize),
    ) -> Self {
        let cropped = recorded.grid.cropped(border);
        let size = |camera: &Camera<f64>| (camera.width, camera.height);
        let (depth_lookup, depth_offsets) = depth_map(recorded, lens, border, delivered);
        let mut resampler = Self {
            colour_size: size(&recorded.colour),
            depth_size: size(&recorded.depth),
            border,
            taps: None,
            areas: None,
            depth_lookup,
            depth_offsets,
            cropped: (cropped.width, cropped.height),
            camera: cropped.resized(delivered.0, delivered.1),
            valid_mask: None,
            full_coverage_border: border,
        };
        if !lens.is_zero() {
            resampler.taps = Some(resampler.colour_map(recorded, lens));
        } else if recorded.colour != recorded.grid {
            resampler.areas = Some(resampler.area_map(recorded));
        }
        resampler
    }

    /// Pixels removed on every side [px of the grid].
    pub(crate) fn border(&self) -> usize {
        self.border
    }

    /// As [`new`](Self::new) without a border, for colour images that have the delivered size already;
    /// depth as it was recorded.
    pub(crate) fn of_scaled_colour(
        recorded: &RecordingCameras,
        lens: &Distortion,
        delivered: (usize, usize),
    ) -> Self {
        let (depth_lookup, depth_offsets) = depth_map(recorded, lens, 0, delivered);
        Self {
            depth_size: (recorded.depth.width, recorded.depth.height),
            depth_lookup,
            depth_offsets,
            ..Self::new(&recorded.resized(delivered), lens, 0, delivered)
        }
    }

    /// Rebuilds the tables for other cameras of the same sizes.
    pub(crate) fn with_camera(&self, recorded: &RecordingCameras, lens: &Distortion) -> Self {
        let delivered = (self.camera.width, self.camera.height);
        match self.colour_size == (recorded.colour.width, recorded.colour.height) {
            true => Self::new(recorded, lens, self.border, delivered),
            false => Self::of_scaled_colour(recorded, lens, delivered),
        }
    }

    fn area_map(&mut self, recorded: &RecordingCameras) -> AreaResampler {
        let map = AreaResampler::new(&recorded.colour, &self.camera);
        self.valid_mask = map.valid_mask();
        let step = self.cropped.0 as f64 / self.camera.width as f64;
        self.full_coverage_border += (map.uncovered_border() as f64 * step).ceil() as usize;
        map
    }

    fn colour_map(&mut self, recorded: &RecordingCameras, lens: &Distortion) -> Vec<Tap> {
        let (width, height) = self.cropped;
        let (grid, colour) = (&recorded.grid, &recorded.colour);
        let mut outside = Image::<f32>::new(width, height, 1);
        let mut taps = Vec::with_capacity(width * height);
        for row in 0..height {
            for column in 0..width {
                let (i, j) = (column + self.border, row + self.border);
                let (u, v) = distort_pixel(grid, lens, colour, i as f64 + 0.5, j as f64 + 0.5);
                if pixel_index(colour, u, v) == OUTSIDE {
                    outside.data[row * width + column] = 1.0;
                    let edge = i.min(j).min(grid.width - 1 - i).min(grid.height - 1 - j);
                    self.full_coverage_border = self.full_coverage_border.max(edge + 1);
                }
                taps.push(tap_at(colour, u, v));
            }
        }
        if outside.data.contains(&1.0) {
            let share = outside.resized_by_area(self.camera.width, self.camera.height);
            self.valid_mask = Some(Image {
                width: share.width,
                height: share.height,
                channels: 1,
                data: share.data.iter().map(|&s| s == 0.0).collect(),
            });
        }
        taps
    }

    /// Resamples a recorded colour image. Beyond its edge the edge is repeated.
    pub(crate) fn colour(&self, recorded: &Image<f32>) -> Image<f32> {
        if let Some(areas) = &self.areas {
            return areas.apply(recorded);
        }
        let cropped = match &self.taps {
            Some(taps) => sample(recorded, taps, self.cropped),
            None if self.border > 0 => crop(recorded, self.border, self.cropped),
            None => recorded.clone(),
        };
        let (width, height) = (self.camera.width, self.camera.height);
        if (width, height) == self.cropped {
            cropped
        } else if (2 * width, 2 * height) == self.cropped {
            halved(&cropped)
        } else {
            cropped.resized_by_area(width, height)
        }
    }

    /// Resamples a depth image to metres: values over `scale`, 0 where invalid, not recorded, or
    /// beyond `max_depth`.
    pub(crate) fn depth(&self, recorded: &Image<u16>, scale: f64, max_depth: f64) -> Image<f32> {
        let metres = |raw: u16| {
            let z = f64::from(raw) / scale;
            // Its inverse has to be finite.
            if z <= max_depth && z >= f64::from(f32::MIN_POSITIVE) { z as f32 } else { 0.0 }
        };
        let Some(offsets) = &self.depth_offsets else {
            return self.depth_values(recorded, metres);
        };
        let data = recorded.data.iter().map(|raw| metres(*raw)).collect();
        let recorded = Image { width: recorded.width, height: recorded.height, channels: 1, data };
        let near = |(index, offset): (&u32, &[f32; 2])| match *index {
            OUTSIDE => 0.0,
            index => depth_near(&recorded, index as usize, *offset),
        };
        self.delivered(self.depth_lookup.iter().zip(offsets).map(near).collect())
    }

    /// Resamples an image with the pixels of depth by nearest neighbour and maps its values by `of`;
    /// 0 where nothing was recorded.
    pub(crate) fn depth_values<T: Copy>(
        &self,
        recorded: &Image<T>,
        of: impl Fn(T) -> f32,
    ) -> Image<f32> {
        let value = |&index: &u32| match index {
            OUTSIDE => 0.0,
            index => of(recorded.data[index as usize]),
        };
        self.delivered(self.depth_lookup.iter().map(value).collect())
    }

    /// A delivered image of one plane.
    fn delivered(&self, data: Vec<f32>) -> Image<f32> {
        Image { width: self.camera.width, height: self.camera.height, channels: 1, data }
    }

    /// Width and height of the recorded colour and depth images [px].
    pub(crate) fn recorded_sizes(&self) -> ((usize, usize), (usize, usize)) {
        (self.colour_size, self.depth_size)
    }
}

/// Index of the recorded depth pixel per delivered pixel, or [`OUTSIDE`], and the offset from its centre, unless
/// all are zero.
fn depth_map(
    recorded: &RecordingCameras,
    lens: &Distortion,
    border: usize,
    (width, height): (usize, usize),
) -> (Vec<u32>, Option<Vec<[f32; 2]>>) {
    let cropped = recorded.grid.cropped(border);
    let step_x = cropped.width as f64 / width as f64;
    let step_y = cropped.height as f64 / height as f64;
    let border = border as f64;
    let (mut lookup, mut offsets) = (Vec::with_capacity(width * height), Vec::new());
    for row in 0..height {
        for column in 0..width {
            let u = (column as f64 + 0.5) * step_x + border;
            let v = (row as f64 + 0.5) * step_y + border;
            let (u, v) = distort_pixel(&recorded.grid, lens, &recorded.depth, u, v);
            lookup.push(pixel_index(&recorded.depth, u, v));
            offsets.push([u, v].map(|at| (at - at.floor() - 0.5) as f32));
        }
    }
    let is_between = offsets.iter().any(|offset| *offset != [0.0; 2]);
    (lookup, is_between.then_some(offsets))
}

/// Maps pixel `(u, v)` of the pinhole `from` to the distorted image of camera `to`.
fn distort_pixel(
    from: &Camera<f64>,
    lens: &Distortion,
    to: &Camera<f64>,
    u: f64,
    v: f64,
) -> (f64, f64) {
    if lens.is_zero() && from == to {
        return (u, v);
    }
    let (x, y) = lens.distort((u - from.cx) / from.fx, (v - from.cy) / from.fy);
    (to.fx * x + to.cx, to.fy * y + to.cy)
}

/// Index of the pixel that contains `(u, v)`.
fn pixel_index(camera: &Camera<f64>, u: f64, v: f64) -> u32 {
    if camera.contains(u, v, 0.0) {
        (v as usize * camera.width + u as usize) as u32
    } else {
        OUTSIDE
    }
}

/// Bilinear weights at `(u, v)`, clamped to the image.
fn tap_at(camera: &Camera<f64>, u: f64, v: f64) -> Tap {
    let split = |position: f64, size: usize| {
        let centred = (position - 0.5).clamp(0.0, (size - 1) as f64);
        let first = (centred as usize).min(size - 2);
        (first, (centred - first as f64) as f32)
    };
    let ((column, right), (row, lower)) = (split(u, camera.width), split(v, camera.height));
    Tap { index: (row * camera.width + column) as u32, right, lower }
}

fn sample(image: &Image<f32>, taps: &[Tap], size: (usize, usize)) -> Image<f32> {
    let mut out = Image::new(size.0, size.1, image.channels);
    for channel in 0..image.channels {
        let plane = image.plane(channel);
        for (value, tap) in out.plane_mut(channel).iter_mut().zip(taps) {
            let i = tap.index as usize;
            let (upper, lower) = (&plane[i..i + 2], &plane[i + image.width..i + image.width + 2]);
            let a = upper[0] + tap.right * (upper[1] - upper[0]);
            let b = lower[0] + tap.right * (lower[1] - lower[0]);
            *value = a + tap.lower * (b - a);
        }
    }
    out
}

fn crop(image: &Image<f32>, border: usize, size: (usize, usize)) -> Image<f32> {
    let mut data = Vec::with_capacity(size.0 * size.1 * image.channels);
    for channel in 0..image.channels {
        let rows = image.plane(channel).chunks_exact(image.width);
        for row in rows.skip(border).take(size.1) {
            data.extend_from_slice(&row[border..border + size.0]);
        }
    }
    Image { width: size.0, height: size.1, channels: image.channels, data }
}

/// Area average at exactly half the size.
fn halved(image: &Image<f32>) -> Image<f32> {
    let mut out = Image::new(image.width / 2, image.height / 2, image.channels);
    let rows = image.data.chunks_exact(2 * image.width);
    for (out, rows) in out.data.chunks_exact_mut(image.width / 2).zip(rows) {
        let (upper, lower) = rows.split_at(image.width);
        let pairs = upper.chunks_exact(2).zip(lower.chunks_exact(2));
        for (value, (a, b)) in out.iter_mut().zip(pairs) {
            *value = 0.25 * ((a[0] + a[1]) + (b[0] + b[1]));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_geometry::Vec3;

    fn camera() -> Camera<f64> {
        Camera { width: 64, height: 48, fx: 50.0, fy: 52.0, cx: 33.0, cy: 23.0 }
    }

    /// One camera for colour and depth.
    fn single(camera: Camera<f64>) -> RecordingCameras {
        RecordingCameras { colour: camera, depth: camera, grid: camera }
    }

    fn lens() -> Distortion {
        Distortion {
            radial: [-0.2, 0.05, 0.0],
            tangential: [0.01, -0.004],
            ..Distortion::default()
        }
    }

    /// A distorted image of a linear function of the ray.
    fn recorded_ramp(lens: &Distortion) -> Image<f32> {
        let mut image = Image::new(64, 48, 3);
        for row in 0..48 {
            for column in 0..64 {
                let (x, y) = undistort(lens, column as f64 + 0.5, row as f64 + 0.5);
                for channel in 0..3 {
                    image.data[(channel * 48 + row) * 64 + column] = ramp(channel, x, y);
                }
            }
        }
        image
    }

    fn ramp(channel: usize, x: f64, y: f64) -> f32 {
        (0.5 + [0.4, -0.3, 0.2][channel] * x + [0.1, 0.3, -0.4][channel] * y) as f32
    }

    /// Inverse distortion by fixed-point iteration.
    fn undistort(lens: &Distortion, u: f64, v: f64) -> (f64, f64) {
        let target = ((u - camera().cx) / camera().fx, (v - camera().cy) / camera().fy);
        let (mut x, mut y) = target;
        for _ in 0..200 {
            let (dx, dy) = lens.distort(x, y);
            (x, y) = (x + target.0 - dx, y + target.1 - dy);
        }
        (x, y)
    }

    #[test]
    fn undistortion_gives_the_pinhole_image() {
        for delivered in [(56, 40), (28, 20), (19, 13)] {
            let resampler = Resampler::new(&single(camera()), &lens(), 4, delivered);
            assert!(resampler.valid_mask.is_none());
            let out = resampler.colour(&recorded_ramp(&lens()));
            for row in 0..delivered.1 {
                for column in 0..delivered.0 {
                    let ray =
                        resampler.camera.unproject(column as f64 + 0.5, row as f64 + 0.5, 1.0);
                    for channel in 0..3 {
                        let expected = ramp(channel, ray.x, ray.y);
                        assert!((out.at(channel, column, row) - expected).abs() < 2e-4);
                    }
                }
            }
        }
    }

    #[test]
    fn depth_comes_from_the_pixel_the_ray_was_recorded_in() {
        let resampler = Resampler::new(&single(camera()), &lens(), 4, (28, 20));
        let point = resampler.camera.unproject(10.5, 4.5, 2.0);
        let (x, y) = lens().distort(point.x / point.z, point.y / point.z);
        let (u, v) = camera().project(Vec3::new(x, y, 1.0));
        let mut recorded = Image::<u16>::new(64, 48, 1);
        recorded.data[v as usize * 64 + u as usize] = 10_000;
        assert_eq!(resampler.depth(&recorded, 5000.0, 10.0).at(0, 10, 4), 2.0);
        assert_eq!(resampler.depth(&recorded, 5000.0, 1.9).at(0, 10, 4), 0.0);
        let valid =
            resampler.depth(&recorded, 5000.0, 10.0).data.iter().filter(|&&z| z > 0.0).count();
        assert_eq!(valid, 1);
    }

    #[test]
    fn without_distortion_colour_is_averaged_over_areas() {
        let image = recorded_ramp(&Distortion::default());
        let whole = Resampler::new(&single(camera()), &Distortion::default(), 0, (64, 48));
        assert_eq!(whole.colour(&image), image);
        let half = Resampler::new(&single(camera()), &Distortion::default(), 0, (32, 24));
        let expected = image.resized_by_area(32, 24);
        for (a, b) in half.colour(&image).data.iter().zip(&expected.data) {
            assert!((a - b).abs() < 1e-6);
        }
    }

    #[test]
    fn depth_of_a_plane_is_that_of_the_plane_through_any_lens_and_at_any_size() {
        let inverse = |x: f64, y: f64| 0.5 + 0.2 * x - 0.1 * y;
        for lens in [Distortion::default(), lens()] {
            let recorded = |i: usize| {
                let (x, y) = undistort(&lens, (i % 64) as f64 + 0.5, (i / 64) as f64 + 0.5);
                (20_000.0 / inverse(x, y)).round() as u16
            };
            let data = (0..64 * 48).map(recorded).collect();
            let recorded = Image { width: 64, height: 48, channels: 1, data };
            for delivered in [(56, 40), (28, 20), (19, 13), (90, 70)] {
                let resampler = Resampler::new(&single(camera()), &lens, 4, delivered);
                let depth = resampler.depth(&recorded, 20_000.0, 10.0);
                for (i, z) in depth.data.iter().enumerate() {
                    let (u, v) = ((i % delivered.0) as f64 + 0.5, (i / delivered.0) as f64 + 0.5);
                    let ray = resampler.camera.unproject(u, v, 1.0);
                    let due = inverse(ray.x, ray.y).recip();
                    assert!((f64::from(*z) - due).abs() < 1.5e-3, "{z} for {due}, {delivered:?}");
                }
            }
        }
    }

    #[test]
    fn unrecorded_pixels_are_marked() {
        let outward = Distortion { radial: [0.3, 0.0, 0.0], ..Distortion::default() };
        let resampler = Resampler::new(&single(camera()), &outward, 0, (64, 48));
        let valid_mask = resampler.valid_mask.clone().expect("the corners are outside");
        assert!(!valid_mask.at(0, 0, 0) && valid_mask.at(0, 32, 24));
        let depth = Image { width: 64, height: 48, channels: 1, data: vec![1000; 64 * 48] };
        let depth = resampler.depth(&depth, 1000.0, 10.0);
        for (z, is_valid) in depth.data.iter().zip(&valid_mask.data) {
            assert_eq!(*z > 0.0, *is_valid);
        }
        let border = resampler.full_coverage_border;
        let size = (64 - 2 * border, 48 - 2 * border);
        assert!(Resampler::new(&single(camera()), &outward, border, size).valid_mask.is_none());
        let size = (size.0 + 2, size.1 + 2);
        assert!(Resampler::new(&single(camera()), &outward, border - 1, size).valid_mask.is_some());
    }
}
