//! Depth seen from a camera that has moved a little: of another moment, or another place, than
//! the picture that it belongs to.

use super::residual::is_one_surface;
use i2slam_geometry::{Camera, Image, Pose};

/// Steps to the reading that a pixel shows: each divides the error by the share by which the motion
/// in the picture changes from pixel to pixel.
const STEPS: usize = 4;
/// Distance from the pixel at which the reading is accepted [px].
const MAX_DISTANCE: f64 = 0.25;

/// The depth [m] that a camera at `target_from_source` sees of the surfaces that `depth` shows, 0
/// where that is not known. Readings are found by fixed-point iteration, and interpolated in
/// inverse depth where four pixels lie on one surface.
///
/// For a depth picture taken `t` later than its colour picture under the velocity `v`, the pose is
/// that of the depth picture in the camera of the colour picture,
/// `Pose::identity().retract(v.scaled(t))`.
pub fn moved_depth(
    depth: &Image<f32>,
    camera: &Camera<f64>,
    target_from_source: Pose<f64>,
) -> Image<f32> {
    let source_from_target = target_from_source.inverse();
    Image::from_fn(depth.width, depth.height, 1, |_, column, row| {
        let at = Camera::<f64>::pixel_centre(column, row);
        let ray = camera.unproject(at.0, at.1, 1.0);
        let mut z = match f64::from(depth.at(0, column, row)) {
            read if read > 0.0 => read,
            // Far away: only the rotation counts until a reading is met.
            _ => FAR,
        };
        let mut distance = f64::INFINITY;
        for _ in 0..STEPS {
            let point = source_from_target * (ray * z);
            if point.z <= 0.0 {
                return 0.0;
            }
            let (u, v) = camera.project(point);
            let Some(read) = inverse_depth_at(depth, (u, v)) else { return 0.0 };
            let seen = target_from_source * camera.unproject(u, v, 1.0 / read);
            if seen.z <= 0.0 {
                return 0.0;
            }
            let (x, y) = camera.project(seen);
            distance = (x - at.0).hypot(y - at.1);
            z = seen.z;
        }
        if distance < MAX_DISTANCE { z as f32 } else { 0.0 }
    })
}

/// Depth in place of a missing one [m].
const FAR: f64 = 10.0;

/// Inverse depth between four pixels of one surface [1/m].
fn inverse_depth_at(depth: &Image<f32>, (u, v): (f64, f64)) -> Option<f64> {
    let tap = depth.tap(u as f32, v as f32)?;
    let values = tap.values(&depth.data);
    is_one_surface(values).then(|| f64::from(tap.interpolate(values.map(|d| 1.0 / d)).0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_geometry::{Tangent, Vec3};

    const CAMERA: Camera<f64> =
        Camera { width: 80, height: 60, fx: 70.0, fy: 70.0, cx: 40.0, cy: 30.0 };

    /// Depth of an inclined wall seen from a pose.
    fn wall(pose: Pose<f64>) -> Image<f32> {
        let normal = Vec3::new(0.2, -0.3, 1.0);
        Image::from_fn(CAMERA.width, CAMERA.height, 1, |_, column, row| {
            let (u, v) = Camera::<f64>::pixel_centre(column, row);
            let ray = pose.rotation.rotate(CAMERA.unproject(u, v, 1.0));
            ((2.0 - normal.dot(pose.translation)) / normal.dot(ray)) as f32
        })
    }

    #[test]
    fn a_wall_is_seen_from_the_other_pose() {
        let pose =
            Pose::identity().retract(Tangent::from_array([0.05, 0.02, -0.06, 0.03, 0.04, 0.02]));
        let moved = moved_depth(&wall(pose), &CAMERA, pose);
        let expected = wall(Pose::identity());
        let pairs = moved.data.iter().zip(&expected.data).filter(|(m, _)| **m > 0.0);
        let errors: Vec<f32> = pairs.map(|(m, e)| (m - e).abs()).collect();
        assert!(errors.len() > 80 * 60 * 3 / 4, "{}", errors.len());
        assert!(errors.iter().all(|e| *e < 1e-5));
        let same = moved_depth(&expected, &CAMERA, Pose::identity());
        let kept = same.data.iter().zip(&expected.data).filter(|(s, _)| **s > 0.0);
        assert!(
            kept.clone().count() > 79 * 59 - 1 && kept.clone().all(|(s, e)| (s - e).abs() < 1e-5)
        );
        let none = Image::new(80, 60, 1);
        assert!(moved_depth(&none, &CAMERA, pose).data.iter().all(|z| *z == 0.0));
    }
}
