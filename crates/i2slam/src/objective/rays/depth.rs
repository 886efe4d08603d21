//! The depth term of a batch of rays.

use super::{RayObjective, RayView};
use crate::objective::Evaluation;
use i2slam_compute::median;
use i2slam_geometry::Real;
use std::ops::Range;

/// Opacity from which on a ray has a depth.
const SOLID: f32 = 0.5;

/// Value and slope by the residual `r` of an estimated depth of variance `v`, both in the unit of
/// the depth: `r² / v` (Rosinol et al. 2023, eq. 4) or, for `c` outlier deviations above 0,
/// `c² ln(1 + r² / (c² v))`, Cauchy's, which lets go of a depth that is wrong: its slope is largest
/// at `c` deviations, half of that of the square there, and falls beyond.
fn estimated<T: Real>(r: T, v: T, c: T) -> (T, T) {
    let (square, slope) = (r * r / v, T::of(2.0) * r / v);
    if c > T::zero() {
        let rise = T::one() + square / (c * c);
        (c * c * rise.ln(), slope / rise)
    } else {
        (square, slope)
    }
}

/// Value and slope of a measured one: `|r|` (eq. 14).
fn measured(r: f32) -> (f32, f32) {
    (r.abs(), if r == 0.0 { 0.0 } else { 1.0_f32.copysign(r) })
}

impl RayObjective {
    /// Depth is that of the last ray of a pixel.
    pub(super) fn compare_depth(
        &mut self,
        view: &RayView<'_>,
        part: &Range<usize>,
        weight: f32,
        evaluation: &mut Evaluation,
    ) {
        let observation = view.observation;
        let observed = &observation.depth.data;
        let count = view.pixels.iter().filter(|&&p| observed[p] > 0.0).count().max(1);
        let last = view.rays_per_pixel() - 1;
        let scale = weight / count as f32;
        let (mut error, mut sum) = (0.0, 0.0);
        for (i, &pixel) in view.pixels.iter().enumerate().filter(|(_, p)| observed[**p] > 0.0) {
            let ray = part.start + i * (last + 1) + last;
            let difference = self.renders[ray].depth - observed[pixel];
            let (loss, slope) = match &observation.depth_variance {
                Some(variance) => estimated(difference, variance.data[pixel], self.depth_outlier),
                None => measured(difference),
            };
            error += f64::from(difference.abs());
            sum += f64::from(loss);
            self.cotangents[ray].depth = scale * slope;
        }
        evaluation.depth = error / count as f64;
        evaluation.total += f64::from(weight) * sum / count as f64;
    }

    /// Median depth that the rays of a view of the last [`map`](Self::map) saw; none if they saw
    /// nothing solid.
    pub fn seen_depth(&self, view: usize) -> Option<f64> {
        let solid =
            self.renders[self.parts.get(view)?.clone()].iter().filter(|r| r.opacity > SOLID);
        median(&mut solid.map(|r| f64::from(r.depth / r.opacity)).collect::<Vec<_>>())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::assert_gradient;

    #[test]
    fn the_slope_of_an_estimated_depth_is_its_derivative() {
        for (r, outlier) in [(0.3_f64, 0.0), (-0.3, 0.0), (0.05, 3.0), (0.7, 3.0), (-0.7, 3.0)] {
            let value = |x: &[f64]| estimated(x[0], 0.01, outlier).0;
            let slope = estimated(r, 0.01, outlier).1;
            assert_gradient("depth", &[r], &[slope], 1e-4, 1e-6, value);
        }
        assert!((estimated(0.2_f64, 0.04, 0.0).0 - 1.0).abs() < 1e-12);
        assert!(
            (estimated(1e-4_f64, 0.04, 3.0).0 / estimated(1e-4, 0.04, 0.0).0 - 1.0).abs() < 1e-6
        );
    }

    #[test]
    fn a_wrong_depth_pulls_most_at_the_outlier_and_is_let_go_beyond() {
        let slope = |deviations: f64| estimated(0.1 * deviations, 0.01, 3.0).1;
        assert!((slope(3.0) - 30.0).abs() < 1e-9);
        assert!(slope(2.9) < slope(3.0) && slope(3.1) < slope(3.0) && slope(30.0) < 6.0);
    }
}
