//! How many frames see each Gaussian.

use i2slam::geometry::{Camera, Image, Pose, Vec3};
use i2slam::{FrameEstimate, Reconstruction};

/// A Gaussian that is farther than the surface of its pixel by more than this share is hidden.
const MAX_BEHIND: f64 = 0.05;

/// Number of frames that see each of `points`: within the picture, and not behind the surface that the
/// map shows there.
pub(super) fn views(
    reconstruction: &Reconstruction,
    frames: &[FrameEstimate],
    points: &[[f32; 3]],
) -> Vec<usize> {
    let mut viewer = reconstruction.viewer();
    let mut counts = vec![0; points.len()];
    for frame in frames {
        let depth = viewer.depth(frame.middle());
        let camera_from_world = frame.middle().inverse();
        for (count, point) in counts.iter_mut().zip(points) {
            let point = Vec3::from_array(point.map(f64::from));
            *count += usize::from(sees(&reconstruction.camera, camera_from_world, &depth, point));
        }
    }
    counts
}

fn sees(
    camera: &Camera<f64>,
    camera_from_world: Pose<f64>,
    depth: &Image<f32>,
    point: Vec3<f64>,
) -> bool {
    let point = camera_from_world * point;
    if point.z <= 0.0 {
        return false;
    }
    let (u, v) = camera.project(point);
    if !camera.contains(u, v, 0.0) {
        return false;
    }
    let surface = f64::from(depth.at(0, u as usize, v as usize));
    surface > 0.0 && point.z <= surface * (1.0 + MAX_BEHIND)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_behind_a_surface_or_outside_are_not_seen() {
        let camera = Camera { width: 5, height: 5, fx: 5.0, fy: 5.0, cx: 2.5, cy: 2.5 };
        let mut depth = Image::new(5, 5, 1);
        depth.data.fill(2.0);
        depth.data[12 + 1] = 0.0;
        let seen = |x, y, z| sees(&camera, Pose::identity(), &depth, Vec3::new(x, y, z));
        assert!(seen(0.0, 0.0, 2.0) && seen(0.0, 0.0, 1.0) && seen(0.0, 0.0, 2.09));
        assert!(!seen(0.0, 0.0, 2.2) && !seen(0.0, 0.0, -1.0) && !seen(3.0, 0.0, 2.0));
        // Nothing was seen in the pixel to the right, from 0.1 to 0.3 at this depth.
        assert!(seen(0.09, 0.0, 1.0) && !seen(0.11, 0.0, 1.0) && !seen(0.29, 0.0, 1.0));
        assert!(seen(0.31, 0.0, 1.0));
    }
}
