//! Depth of a few points: those of a sparse reconstruction that a keyframe sees.

use super::keyframe::{KeyframePose, measured};
use i2slam_geometry::{Camera, Image, Vec3};

/// A point with its uncertainty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SparsePoint {
    /// Its place in the world [unit of the poses].
    pub(super) position: Vec3<f64>,
    /// Covariance of that, its upper triangle `[xx, xy, xz, yy, yz, zz]`.
    pub(super) covariance: [f64; 6],
}

/// The points that each record of the files sees.
#[derive(Clone, Debug, Default)]
pub(super) struct SparseDepth {
    pub(super) points: Vec<SparsePoint>,
    /// Places in `points`, for every record.
    pub(super) seen: Vec<Vec<usize>>,
    /// Depth beyond this is none.
    pub(super) max_depth: f64,
}

impl SparseDepth {
    /// Depth and its variance in the pixels that the points fall into, 0 elsewhere; of points in
    /// one pixel the nearest counts. The variance is that of the point along the optical axis
    /// `r`: `rᵀ Σ r`. A point that is not known better than to its whole depth counts as none: it
    /// has no parallax.
    pub(super) fn at(&self, pose: &KeyframePose, camera: &Camera<f64>) -> (Image<f32>, Image<f32>) {
        let mut depth = Image::new(camera.width, camera.height, 1);
        let mut variance = depth.clone();
        let camera_from_world = pose.world_from_camera.inverse();
        let axis = pose.world_from_camera.rotation.rotate(Vec3::new(0.0, 0.0, 1.0));
        for &place in &self.seen[pose.record] {
            let point = &self.points[place];
            let p = camera_from_world * point.position;
            if !(p.z > 0.0 && p.z <= self.max_depth) {
                continue;
            }
            let (u, v) = camera.project(p);
            if !camera.contains(u, v, 0.0) {
                continue;
            }
            let spread = along(&point.covariance, axis);
            if !(spread > 0.0 && spread < p.z * p.z) {
                continue;
            }
            let Some((z, Some(spread))) = measured(p.z, Some(spread)) else { continue };
            let at = v as usize * camera.width + u as usize;
            if depth.data[at] == 0.0 || z < depth.data[at] {
                (depth.data[at], variance.data[at]) = (z, spread);
            }
        }
        (depth, variance)
    }
}

fn along(&[xx, xy, xz, yy, yz, zz]: &[f64; 6], r: Vec3<f64>) -> f64 {
    r.x * (xx * r.x + 2.0 * (xy * r.y + xz * r.z))
        + r.y * (yy * r.y + 2.0 * yz * r.z)
        + zz * r.z * r.z
}
