//! Depth of a few points: those of a sparse reconstruction that a keyframe sees.

use super::keyframe::{KeyframePose, measured};
use i2slam_geometry::{Camera, Image, Vec3};
use std::cmp::Reverse;
use std::collections::HashSet;

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

    /// The place in `records` of the one that sees most of the points that the one at `place` sees,
    /// the first of several; `None` if no other sees any.
    pub(super) fn shares_most(&self, records: &[usize], place: usize) -> Option<usize> {
        let known: HashSet<usize> = self.seen[records[place]].iter().copied().collect();
        let shared =
            |other: usize| self.seen[records[other]].iter().filter(|at| known.contains(at)).count();
        let others = (0..records.len()).filter(|&other| other != place);
        let (count, other) = others.map(|other| (shared(other), Reverse(other))).max()?;
        (count > 0).then_some(other.0)
    }
}

fn along(&[xx, xy, xz, yy, yz, zz]: &[f64; 6], r: Vec3<f64>) -> f64 {
    r.x * (xx * r.x + 2.0 * (xy * r.y + xz * r.z))
        + r.y * (yy * r.y + 2.0 * yz * r.z)
        + zz * r.z * r.z
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn partners_share_most_points() {
        let seen = vec![vec![1, 2, 3], vec![7], vec![3, 9], vec![2, 3, 8], vec![3, 1]];
        let depth = SparseDepth { seen, ..SparseDepth::default() };
        let records = [4, 3, 2, 1, 0];
        assert_eq!(depth.shares_most(&records, 4), Some(0));
        assert_eq!(depth.shares_most(&records, 1), Some(4));
        assert_eq!(depth.shares_most(&records, 3), None);
        assert_eq!(depth.shares_most(&records[..1], 0), None);
    }
}
