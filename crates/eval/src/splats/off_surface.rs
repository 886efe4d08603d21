//! Distance of Gaussians from the surface that frames have seen.
//!
//! The centre of a Gaussian has the depth `z` in a frame, where the surface has the depth `d`, the
//! nearest of the 3 × 3 pixels around it. Its distance is `|z − d| / d` in the frame where that is
//! least: a Gaussian that one frame hides may lie on the surface that another one sees.

use super::Splat;
use i2slam_geometry::{Camera, Image, Pose};

/// Least relative distance of each Gaussian from the surface, over the frames so far.
#[derive(Clone, Debug)]
pub struct SurfaceDistance {
    /// Infinite where no frame with depth has shown the place.
    least: Vec<f64>,
}

impl SurfaceDistance {
    /// Distances of `count` Gaussians, before the first frame.
    pub fn new(count: usize) -> Self {
        Self { least: vec![f64::INFINITY; count] }
    }

    /// Compares with a frame: its camera, pose, and true depth in the unit of the map, 0 where it
    /// is unknown.
    ///
    /// # Panics
    ///
    /// If there are not as many Gaussians as in [`Self::new`].
    pub fn add_frame(
        &mut self,
        splats: &[Splat],
        camera: &Camera<f64>,
        world_from_camera: Pose<f64>,
        depth: &Image<f32>,
    ) {
        assert_eq!(splats.len(), self.least.len(), "one distance for each Gaussian");
        let camera_from_world = world_from_camera.inverse();
        for (splat, least) in splats.iter().zip(&mut self.least) {
            let point = camera_from_world * splat.mean;
            if point.z > 0.0 {
                let (u, v) = camera.project(point);
                *least = least.min(distance(depth, (u, v), point.z));
            }
        }
    }

    /// Share of the Gaussians farther from the surface than `limit`, of those whose place a frame
    /// with depth has shown; `None` without any.
    pub fn share_beyond(&self, limit: f64) -> Option<f64> {
        let seen = self.least.iter().filter(|distance| distance.is_finite());
        let count = seen.clone().count();
        let beyond = seen.filter(|distance| **distance > limit).count();
        (count > 0).then(|| beyond as f64 / count as f64)
    }
}

/// Least relative distance from the surface at the 3 × 3 pixels around a place; infinite where there
/// is none.
fn distance(depth: &Image<f32>, (u, v): (f64, f64), z: f64) -> f64 {
    let mut least = f64::INFINITY;
    for (x, y) in (-1..=1).flat_map(|y| (-1..=1).map(move |x| (x, y))) {
        let (column, row) = (u.floor() + f64::from(x), v.floor() + f64::from(y));
        let is_inside = (0.0..depth.width as f64).contains(&column)
            && (0.0..depth.height as f64).contains(&row);
        if !is_inside {
            continue;
        }
        let surface = f64::from(depth.data[row as usize * depth.width + column as usize]);
        if surface > 0.0 {
            least = least.min((z - surface).abs() / surface);
        }
    }
    least
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_geometry::{Rotation, Vec3};

    const CAMERA: Camera<f64> =
        Camera { width: 24, height: 16, fx: 20.0, fy: 20.0, cx: 12.0, cy: 8.0 };

    fn splat(mean: [f64; 3]) -> Splat {
        let (mean, rotation) = (Vec3::from_array(mean), Rotation::identity());
        Splat { mean, scale: [0.01; 3], rotation, opacity: 0.9 }
    }

    /// A wall at 2 m, unknown in its right half.
    fn wall() -> Image<f32> {
        let data = (0..24 * 16).map(|p| if p % 24 < 12 { 2.0 } else { 0.0 }).collect();
        Image { data, ..Image::new(24, 16, 1) }
    }

    #[test]
    fn the_frame_that_sees_the_surface_decides() {
        let splats = [
            splat([-0.5, 0.0, 2.0]),
            splat([-0.5, 0.0, 2.03]),
            // In front of the wall, behind it, where nothing is known, behind the camera.
            splat([-0.5, 0.0, 1.9]),
            splat([-0.5, 0.0, 2.4]),
            splat([0.8, 0.0, 1.0]),
            splat([0.0, 0.0, -2.0]),
        ];
        let mut distance = SurfaceDistance::new(splats.len());
        assert_eq!(distance.share_beyond(0.02), None);
        distance.add_frame(&splats, &CAMERA, Pose::identity(), &wall());
        assert_eq!(distance.share_beyond(0.02), Some(0.5));
        // A frame from farther back, which sees another surface behind the wall.
        let behind = Pose::new(Rotation::identity(), Vec3::new(0.0, 0.0, 0.4));
        distance.add_frame(&splats, &CAMERA, behind, &wall());
        assert_eq!(distance.share_beyond(0.02), Some(0.25));
    }
}
