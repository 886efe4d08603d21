//! Derivatives with respect to the map.

use super::Gaussian;
use super::map::retain_by;
use i2slam_geometry::Real;

/// `∂L/∂parameter` for each parameter of a [`GaussianMap`](super::GaussianMap), summed over all
/// calls of `pull_back` since the last [`reset`](Self::reset).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MapGradient<T = f32> {
    /// With respect to the centres.
    pub means: Vec<[T; 3]>,
    /// With respect to the logarithms of the standard deviations; isotropic has entry 0 only,
    /// the others stay zero.
    pub log_scales: Vec<[T; 3]>,
    /// With respect to the quaternions as stored (before normalising); zero when isotropic.
    pub rotations: Vec<[T; 4]>,
    /// With respect to the logits of the opacities.
    pub opacity_logits: Vec<T>,
    /// With respect to the colours as stored (before the activation).
    pub colours: Vec<[T; 3]>,
    /// Gaussians that contributed to a pixel whose cotangent was not zero.
    pub seen: Vec<bool>,
}

impl<T: Real> MapGradient<T> {
    /// Zeros for a map of `count` Gaussians.
    pub fn new(count: usize) -> Self {
        let mut gradient = Self::default();
        gradient.reset(count);
        gradient
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// Set all to zero, for a map of `count` Gaussians, keeping the allocation.
    pub fn reset(&mut self, count: usize) {
        refill(&mut self.means, count, [T::zero(); 3]);
        refill(&mut self.log_scales, count, [T::zero(); 3]);
        refill(&mut self.rotations, count, [T::zero(); 4]);
        refill(&mut self.opacity_logits, count, T::zero());
        refill(&mut self.colours, count, [T::zero(); 3]);
        refill(&mut self.seen, count, false);
    }

    /// Keep the rows whose entry in `keep` is true, as
    /// [`GaussianMap::retain`](super::GaussianMap::retain) does.
    pub fn retain(&mut self, keep: &[bool]) {
        retain_by(&mut self.means, keep);
        retain_by(&mut self.log_scales, keep);
        retain_by(&mut self.rotations, keep);
        retain_by(&mut self.opacity_logits, keep);
        retain_by(&mut self.colours, keep);
        retain_by(&mut self.seen, keep);
    }

    /// All rows, to write.
    pub(crate) fn rows(&mut self) -> GradientRows<'_, T> {
        GradientRows {
            means: &mut self.means,
            log_scales: &mut self.log_scales,
            rotations: &mut self.rotations,
            opacity_logits: &mut self.opacity_logits,
            colours: &mut self.colours,
            seen: &mut self.seen,
        }
    }
}

fn refill<V: Copy>(values: &mut Vec<V>, count: usize, value: V) {
    values.clear();
    values.resize(count, value);
}

/// A range of rows of a [`MapGradient`], to write.
pub(crate) struct GradientRows<'a, T> {
    pub(crate) means: &'a mut [[T; 3]],
    pub(crate) log_scales: &'a mut [[T; 3]],
    pub(crate) rotations: &'a mut [[T; 4]],
    pub(crate) opacity_logits: &'a mut [T],
    pub(crate) colours: &'a mut [[T; 3]],
    pub(crate) seen: &'a mut [bool],
}

impl<T: Real> GradientRows<'_, T> {
    /// Add to one row.
    pub(crate) fn add(&mut self, row: usize, g: &Gaussian<T>, seen: bool) {
        (0..3).for_each(|k| self.means[row][k] += g.mean[k]);
        (0..3).for_each(|k| self.log_scales[row][k] += g.log_scale[k]);
        (0..4).for_each(|k| self.rotations[row][k] += g.rotation[k]);
        (0..3).for_each(|k| self.colours[row][k] += g.colour[k]);
        self.opacity_logits[row] += g.opacity_logit;
        self.seen[row] |= seen;
    }

    /// The first `middle` rows and the rest.
    pub(crate) fn split_at(self, middle: usize) -> (Self, Self) {
        let (means, means_rest) = self.means.split_at_mut(middle);
        let (log_scales, log_scales_rest) = self.log_scales.split_at_mut(middle);
        let (rotations, rotations_rest) = self.rotations.split_at_mut(middle);
        let (opacity_logits, opacity_logits_rest) = self.opacity_logits.split_at_mut(middle);
        let (colours, colours_rest) = self.colours.split_at_mut(middle);
        let (seen, seen_rest) = self.seen.split_at_mut(middle);
        (
            Self { means, log_scales, rotations, opacity_logits, colours, seen },
            Self {
                means: means_rest,
                log_scales: log_scales_rest,
                rotations: rotations_rest,
                opacity_logits: opacity_logits_rest,
                colours: colours_rest,
                seen: seen_rest,
            },
        )
    }
}
