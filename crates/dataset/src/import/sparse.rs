//! Depth of a few points: those of a sparse reconstruction that a keyframe sees.

use super::keyframe::KeyframePose;
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
    /// `r`: `rᵀ Σ r`.
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
            let at = v as usize * camera.width + u as usize;
            let known = f64::from(depth.data[at]);
            if known == 0.0 || p.z < known {
                depth.data[at] = p.z as f32;
                variance.data[at] = along(&point.covariance, axis) as f32;
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
