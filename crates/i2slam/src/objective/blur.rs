//! How long the streaks are that a moving camera draws.

use i2slam_compute::median;
use i2slam_formation::ShutterPoses;
use i2slam_geometry::{Camera, Image};

/// Pixels between two samples of the depth picture.
const STEP: usize = 8;

/// Median over a grid of pixels with depth of the distance between a point's projections at
/// shutter open and shutter close [px]; 0 without depth.
pub fn blur_length(camera: &Camera<f64>, shutter: &ShutterPoses<f64>, depth: &Image<f32>) -> f64 {
    blur_length_at(camera, shutter, |column, row| f64::from(depth.at(0, column, row)))
}

/// The same by the depth of a pixel in `column` and `row`.
pub fn blur_length_at(
    camera: &Camera<f64>,
    shutter: &ShutterPoses<f64>,
    depth: impl Fn(usize, usize) -> f64,
) -> f64 {
    let middle = shutter.middle();
    let open_from_middle = shutter.start.inverse() * middle;
    let close_from_middle = shutter.end.inverse() * middle;
    let mut lengths = Vec::new();
    for row in (STEP / 2..camera.height).step_by(STEP) {
        for column in (STEP / 2..camera.width).step_by(STEP) {
            let z = depth(column, row);
            if z <= 0.0 {
                continue;
            }
            let (u, v) = Camera::<f64>::pixel_centre(column, row);
            let point = camera.unproject(u, v, z);
            let (open, close) = (open_from_middle * point, close_from_middle * point);
            if open.z > 1e-3 && close.z > 1e-3 {
                let (a, b) = (camera.project(open), camera.project(close));
                lengths.push((a.0 - b.0).hypot(a.1 - b.1));
            }
        }
    }
    median(&mut lengths).unwrap_or(0.0)
}

/// Virtual cameras for a blur of `length` pixels: one while the streak stays under half a pixel,
/// then about one for every `per_camera` pixels, at most `most`. The number is odd, so that one
/// camera stands at mid-exposure, where depth is mostly taken. Zero `per_camera` gives `most`.
pub fn virtual_camera_count(length: f64, per_camera: f64, most: usize) -> usize {
    if per_camera <= 0.0 {
        return most;
    }
    if length < 0.5 {
        return 1;
    }
    (1 + 2 * (0.5 * length / per_camera).ceil() as usize).min(most)
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_geometry::{Pose, Rotation, Vec3};

    #[test]
    fn a_turning_camera_draws_focal_length_times_angle() {
        let camera = Camera { width: 64, height: 48, fx: 200.0, fy: 200.0, cx: 32.0, cy: 24.0 };
        let turned = |a: f64| Pose::new(Rotation::exp(Vec3::new(0.0, a, 0.0)), Vec3::zero());
        let shutter = ShutterPoses { start: turned(-0.005), end: turned(0.005) };
        let mut depth = Image::new(64, 48, 1);
        depth.data.fill(2.0);
        assert!((blur_length(&camera, &shutter, &depth) - 2.0).abs() < 0.05);
        assert_eq!(blur_length(&camera, &shutter, &Image::new(64, 48, 1)), 0.0);
    }

    #[test]
    fn a_still_frame_needs_one_camera() {
        assert_eq!(virtual_camera_count(0.2, 1.5, 5), 1);
        assert_eq!(virtual_camera_count(1.4, 1.5, 5), 3);
        assert_eq!(virtual_camera_count(3.1, 1.5, 9), 5);
        assert_eq!(virtual_camera_count(40.0, 1.5, 5), 5);
        assert_eq!(virtual_camera_count(0.0, 0.0, 5), 5);
    }
}
