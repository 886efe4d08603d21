//! Depth term of a batch of rays.

use super::{MIN_OPACITY, PixelBatch, RayObjective};
use crate::objective::Evaluation;
use i2slam_compute::median;
use i2slam_geometry::Real;
use std::ops::Range;

/// Loss of an estimated depth with residual `r` and variance `v`, and its derivative by `r`: `r² /
/// v` (Rosinol et al. 2023, eq. 4) or, for an outlier threshold `c` > 0 in standard deviations,
/// Cauchy's `c² ln(1 + r² / (c² v))`, whose derivative falls beyond `c` deviations.
fn estimated_loss<T: Real>(r: T, v: T, c: T) -> (T, T) {
    let (square, slope) = (r * r / v, T::of(2.0) * r / v);
    if c > T::zero() {
        let rise = T::one() + square / (c * c);
        (c * c * rise.ln(), slope / rise)
    } else {
        (square, slope)
    }
}

/// Loss of a measured depth, `|r|` (eq. 14), and its derivative by `r`.
fn measured_loss(r: f32) -> (f32, f32) {
    (r.abs(), if r == 0.0 { 0.0 } else { 1.0_f32.copysign(r) })
}

impl RayObjective {
    /// Compares the depth of the last ray of each pixel of a batch, and writes its cotangents.
    pub(super) fn compare_depth(
        &mut self,
        batch: &PixelBatch<'_>,
        range: &Range<usize>,
        weight: f32,
        evaluation: &mut Evaluation,
    ) {
        let observation = batch.observation;
        let observed = &observation.depth.data;
        let count = batch.pixels.iter().filter(|&&p| observed[p] > 0.0).count().max(1);
        let last = batch.rays_per_pixel() - 1;
        let scale = weight / count as f32;
        let (mut error, mut sum) = (0.0, 0.0);
        for (i, &pixel) in batch.pixels.iter().enumerate().filter(|(_, p)| observed[**p] > 0.0) {
            let ray = range.start + i * (last + 1) + last;
            let difference = self.renders[ray].depth - observed[pixel];
            let (loss, slope) = match &observation.depth_variance {
                Some(variance) => {
                    estimated_loss(difference, variance.data[pixel], self.depth_outlier)
                }
                None => measured_loss(difference),
            };
            error += f64::from(difference.abs());
            sum += f64::from(loss);
            self.cotangents[ray].depth = scale * slope;
        }
        evaluation.depth = error / count as f64;
        evaluation.total += f64::from(weight) * sum / count as f64;
    }

    /// Median depth of the rays of a batch in the last call of [`map`](Self::map); `None` if they
    /// met no surface.
    pub fn median_depth(&self, batch: usize) -> Option<f64> {
        let solid = self.renders[self.ranges.get(batch)?.clone()]
            .iter()
            .filter(|r| r.opacity > MIN_OPACITY);
        median(&mut solid.map(|r| f64::from(r.depth / r.opacity)).collect::<Vec<_>>())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::assert_gradient;

    #[test]
    fn the_slope_of_the_loss_is_its_derivative() {
        for (r, outlier) in [(0.3_f64, 0.0), (-0.3, 0.0), (0.05, 3.0), (0.7, 3.0), (-0.7, 3.0)] {
            let value = |x: &[f64]| estimated_loss(x[0], 0.01, outlier).0;
            let slope = estimated_loss(r, 0.01, outlier).1;
            assert_gradient("depth", &[r], &[slope], 1e-4, 1e-6, value);
        }
        assert!((estimated_loss(0.2_f64, 0.04, 0.0).0 - 1.0).abs() < 1e-12);
        assert!(
            (estimated_loss(1e-4_f64, 0.04, 3.0).0 / estimated_loss(1e-4, 0.04, 0.0).0 - 1.0).abs()
                < 1e-6
        );
    }

    #[test]
    fn the_slope_falls_beyond_the_outlier_threshold() {
        let slope = |deviations: f64| estimated_loss(0.1 * deviations, 0.01, 3.0).1;
        assert!((slope(3.0) - 30.0).abs() < 1e-9);
        assert!(slope(2.9) < slope(3.0) && slope(3.1) < slope(3.0) && slope(30.0) < 6.0);
    }
}
