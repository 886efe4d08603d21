//! Rectification of rolling shutter pictures to the exposure of their middle row.

use i2slam_compute::median;
use i2slam_geometry::{Camera, Image, Pose, Tangent, Vec3};
use i2slam_odometry::{Keyframe, Reconstruction};

/// Fixed-point iterations that find the row which saw a point; each multiplies the error by the
/// share of the picture's height by which the point moves during readout.
const ROW_ITERATIONS: usize = 3;

/// Projection \[px\] by a rolling shutter with a readout \[exposures\] of a point, given in the
/// camera of the middle row; `velocity` is the camera motion over the exposure.
pub(crate) fn project_rolling(
    camera: &Camera<f64>,
    velocity: Tangent<f64>,
    readout: f64,
    point: Vec3<f64>,
) -> Option<(f64, f64)> {
    let mut seen = point;
    let steps = if readout == 0.0 { 0 } else { ROW_ITERATIONS };
    for _ in 0..steps {
        let (_, v) = (seen.z > 0.0).then(|| camera.project(seen))?;
        let time = readout * (v / camera.height as f64 - 0.5);
        seen = Pose::identity().retract(velocity.scaled(time)).inverse() * point;
    }
    (seen.z > 0.0).then(|| camera.project(seen))
}

/// Camera motion during the readout of a picture.
#[derive(Clone, Copy, Debug)]
pub(super) struct ReadoutMotion {
    /// Motion from the first to the last row, in the camera's frame.
    pub(super) motion: Tangent<f64>,
    /// Assumed depth of all pixels; rotation does not depend on it.
    pub(super) depth: f64,
}

impl ReadoutMotion {
    /// Readout motion between the neighbours of a keyframe; `None` for a global shutter.
    pub(super) fn of_keyframe(found: &Reconstruction, keyframe: &Keyframe) -> Option<Self> {
        let known =
            |frame: usize| Some((*found.timestamps.get(frame)?, (*found.poses.get(frame)?)?));
        let here = (keyframe.timestamp, keyframe.world_from_camera);
        let before = keyframe.index.checked_sub(1).and_then(known).unwrap_or(here);
        let after = known(keyframe.index + 1).unwrap_or(here);
        let (time, motion) = (after.0 - before.0, before.1.local(after.1));
        let turn = before.1.rotation.inverse() * here.1.rotation;
        let motion = Tangent { translation: turn.inverse().rotate(motion.translation), ..motion };
        let motion = motion.scaled(found.rolling_shutter_readout / time);
        let mut depths: Vec<f64> = keyframe.depths.iter().map(|d| d.depth).collect();
        let depth = median(&mut depths).filter(|d| *d > 0.0).unwrap_or(1.0);
        (found.rolling_shutter_readout != 0.0 && time > 0.0).then_some(Self { motion, depth })
    }

    /// `picture` as exposed with the middle row throughout; border values are repeated.
    pub(super) fn rectified(&self, camera: &Camera<f64>, picture: &Image<f32>) -> Image<f32> {
        let (width, height) = (picture.width, picture.height);
        let inside = |x: f64, size: usize| x.clamp(0.5, size as f64 - 0.5001) as f32;
        let mut out = picture.clone();
        for pixel in 0..width * height {
            let (u, v) = Camera::<f64>::pixel_centre(pixel % width, pixel / width);
            let point = camera.unproject(u, v, self.depth);
            let at = project_rolling(camera, self.motion, 1.0, point).unwrap_or((u, v));
            let Some(tap) = picture.tap(inside(at.0, width), inside(at.1, height)) else {
                continue;
            };
            for channel in 0..picture.channels {
                out.plane_mut(channel)[pixel] = tap.sample(picture.plane(channel)).0;
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rolling_projection_agrees_with_the_row_that_saw_the_point() {
        let camera = Camera { width: 64, height: 48, fx: 60.0, fy: 60.0, cx: 32.0, cy: 24.0 };
        let velocity = Tangent::from_array([0.01, -0.02, 0.01, 0.03, 0.05, -0.02]);
        let point = camera.unproject(20.3, 8.7, 1.8);
        let (u, v) = project_rolling(&camera, velocity, 1.5, point).expect("in front");
        let time = 1.5 * (v / 48.0 - 0.5);
        let seen = Pose::identity().retract(velocity.scaled(time)).inverse() * point;
        let (x, y) = camera.project(seen);
        assert!((u - x).hypot(v - y) < 1e-3, "{u} {v} {x} {y}");
        assert!((u - 20.3).hypot(v - 8.7) > 0.5, "{u} {v}");
        let (u, v) = project_rolling(&camera, velocity, 0.0, point).expect("in front");
        assert!((u - 20.3).hypot(v - 8.7) < 1e-9);
    }

    #[test]
    fn a_rolling_picture_is_rectified() {
        let camera = Camera { width: 64, height: 48, fx: 60.0, fy: 60.0, cx: 32.0, cy: 24.0 };
        let motion = Tangent::from_array([0.02, 0.01, 0.0, 0.03, 0.08, -0.05]);
        let scene = |point: Vec3<f64>| (5.0 * point.x).sin() * (4.0 * point.y).cos();
        let picture = |moves: bool| {
            let mut out = Image::new(64, 48, 1);
            for pixel in 0..64 * 48 {
                let (u, v) = Camera::<f64>::pixel_centre(pixel % 64, pixel / 64);
                let share = if moves { v / 48.0 - 0.5 } else { 0.0 };
                let pose = Pose::identity().retract(motion.scaled(share));
                let ray = pose.rotation.rotate(camera.unproject(u, v, 1.0));
                let reach = (2.0 - pose.translation.z) / ray.z;
                out.data[pixel] = scene(pose.translation + ray * reach) as f32;
            }
            out
        };
        let (rolling, still) = (picture(true), picture(false));
        let rectified = ReadoutMotion { motion, depth: 2.0 }.rectified(&camera, &rolling);
        let worst = |a: &Image<f32>| {
            let inner =
                (0..64 * 48).filter(|p| (6..58).contains(&(p % 64)) && (6..42).contains(&(p / 64)));
            inner.map(|p| (a.data[p] - still.data[p]).abs()).fold(0.0, f32::max)
        };
        assert!(
            worst(&rectified) < 0.02 && worst(&rolling) > 0.1,
            "{} {}",
            worst(&rectified),
            worst(&rolling)
        );
    }
}
