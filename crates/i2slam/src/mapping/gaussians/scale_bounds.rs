//! Bounds of the standard deviations of flat Gaussians.

use i2slam_radiance::gaussian::GaussianMap;

/// Least standard deviation along any axis, in pixels of the frame that brought the Gaussian: a nearer
/// camera sees no gaps in between.
const MIN_DEVIATION: f32 = 0.3;
/// Largest growth of the standard deviation that a Gaussian came with. Where few views look, or all
/// are blurred, nothing else keeps it from spreading over its neighbours.
const MAX_GROWTH: f32 = 1.5;

/// Logarithms of the least standard deviation of a Gaussian, and of the largest along each axis
/// [ln m].
#[derive(Clone, Copy, Debug)]
struct Bounds {
    least: f32,
    most: [f32; 3],
}

/// Bounds of the standard deviations of every Gaussian; none of balls.
#[derive(Clone, Debug, Default)]
pub(super) struct ScaleBounds(Vec<Bounds>);

impl ScaleBounds {
    /// Adds those of a new Gaussian with such log deviations, where a pixel is so wide [m].
    pub(super) fn push(&mut self, pixel: f32, log_scale: [f32; 3]) {
        let least = (MIN_DEVIATION * pixel).ln();
        let most = log_scale.map(|scale| (scale + MAX_GROWTH.ln()).max(least));
        self.0.push(Bounds { least, most });
    }

    /// Adds those of a part of a Gaussian, whose deviation along an axis is a share of the whole's; the
    /// whole becomes a part likewise.
    pub(super) fn split(&mut self, index: usize, axis: usize, share: f32) {
        let Bounds { least, most } = &mut self.0[index];
        most[axis] = (most[axis] + share.ln()).max(*least);
        self.0.push(self.0[index]);
    }

    /// Drops those of removed Gaussians.
    pub(super) fn retain(&mut self, keep: &[bool]) {
        let mut kept = keep.iter();
        self.0.retain(|_| kept.next().is_none_or(|kept| *kept));
    }

    /// Widens the bounds to what the map has, after Gaussians were merged.
    pub(super) fn include(&mut self, map: &GaussianMap) {
        for (Bounds { most, .. }, scale) in self.0.iter_mut().zip(&map.log_scales) {
            (0..3).for_each(|axis| most[axis] = most[axis].max(scale[axis]));
        }
    }

    /// Moves the scales of a map within their bounds.
    pub(super) fn clamp(&self, map: &mut GaussianMap) {
        for (scale, Bounds { least, most }) in map.log_scales.iter_mut().zip(&self.0) {
            (0..3).for_each(|axis| scale[axis] = scale[axis].clamp(*least, most[axis]));
        }
    }
}
