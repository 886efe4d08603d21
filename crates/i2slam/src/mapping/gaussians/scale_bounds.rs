//! Bounds of the standard deviations of flat Gaussians.

use i2slam_radiance::gaussian::GaussianMap;

/// Least standard deviation along any axis, in pixels of the frame that brought the Gaussian: a nearer
/// camera sees no gaps in between.
const MIN_DEVIATION: f32 = 0.3;
/// Largest growth of the standard deviation that a Gaussian came with. Where few views look, or all
/// are blurred, nothing else keeps it from spreading over its neighbours.
const MAX_GROWTH: f32 = 1.5;

/// Least and largest logarithm of the standard deviations of every Gaussian [ln m]; none of balls.
#[derive(Clone, Debug, Default)]
pub(super) struct ScaleBounds(Vec<[f32; 2]>);

impl ScaleBounds {
    /// Adds those of a new Gaussian of some standard deviation, where a pixel is so wide [m].
    pub(super) fn push(&mut self, pixel: f32, deviation: f32) {
        let least = MIN_DEVIATION * pixel;
        self.0.push([least.ln(), (MAX_GROWTH * deviation).max(least).ln()]);
    }

    /// Adds those of a part of a Gaussian, whose largest deviation is a share of the whole's; the whole
    /// becomes a part likewise.
    pub(super) fn split(&mut self, index: usize, share: f32) {
        let [least, most] = self.0[index];
        self.0[index] = [least, (most + share.ln()).max(least)];
        self.0.push(self.0[index]);
    }

    /// Drops those of removed Gaussians.
    pub(super) fn retain(&mut self, keep: &[bool]) {
        let mut kept = keep.iter();
        self.0.retain(|_| kept.next().is_none_or(|kept| *kept));
    }

    /// Widens the bounds to what the map has, after Gaussians were merged.
    pub(super) fn include(&mut self, map: &GaussianMap) {
        for ([_, most], scale) in self.0.iter_mut().zip(&map.log_scales) {
            *most = scale.iter().fold(*most, |most, s| most.max(*s));
        }
    }

    /// Moves the scales of a map within their bounds.
    pub(super) fn clamp(&self, map: &mut GaussianMap) {
        for (scale, [least, most]) in map.log_scales.iter_mut().zip(&self.0) {
            *scale = scale.map(|s| s.clamp(*least, *most));
        }
    }
}
