//! Holding the response in its gauge.
//!
//! Radiance, exposure, white balance and response explain a picture together: radiance times
//! `k` and exposure over `k` form the same picture, and a response that is bent as a whole can
//! hide behind a change of both. Frame 0's exposure and the green gain are fixed outright; the
//! response has only CRF(0) = 0 and CRF(1) = 1, so that its overall level is tied weakly to that
//! of its start curve:
//!
//! ```text
//! E = Σ_curves (m - m_start)²,   m = mean over inner nodes of ln(CRF(node) + ε),   ε = 1e-3
//! ```
//!
//! Only the mean is tied: the shape of the curve stays the pictures' business.

use crate::tone::{CameraResponse, CurveGradient, ResponseCurve};
use i2slam_geometry::Real;

/// Keeps the logarithm of the darkest nodes from ruling the mean: a quarter of an 8-bit step.
const EPSILON: f64 = 1e-3;

/// A weak prior on the level of a response, in log space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResponsePrior {
    mean_log_of_start: f64,
}

impl ResponsePrior {
    /// The prior that ties `response` to the curve it was started from.
    pub fn new<T: Real>(response: &CameraResponse<T>) -> Self {
        Self { mean_log_of_start: mean_log(response.initial()) }
    }

    /// `weight · E`; its gradient with respect to the curve is added to `d_curve`, to travel on
    /// to the nodes with the pixels' ([`CameraResponse::pull_back`]).
    pub fn value_and_gradient<T: Real>(
        &self,
        curve: &ResponseCurve<T>,
        weight: T,
        d_curve: &mut CurveGradient<T>,
    ) -> T {
        let mut sum = 0.0;
        for (index, d_values) in d_curve.values.iter_mut().enumerate().take(curve.curves()) {
            let values = curve.values(index);
            let apart = mean_log(values) - self.mean_log_of_start;
            sum += apart * apart;
            let inner = 1..values.len() - 1;
            let factor = 2.0 * weight.to_f64() * apart / inner.len() as f64;
            for i in inner {
                d_values[i] += T::of(factor / (values[i].to_f64() + EPSILON));
            }
        }
        weight * T::of(sum)
    }
}

fn mean_log<T: Real>(values: &[T]) -> f64 {
    let inner = &values[1..values.len() - 1];
    inner.iter().map(|&v| (v.to_f64() + EPSILON).ln()).sum::<f64>() / inner.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tone::{NodeSpacing, StartCurve};
    use i2slam_check::{assert_gradient, noise};

    fn response(curves: usize, x: &[f64]) -> CameraResponse<f64> {
        let mut response = CameraResponse::new(curves, StartCurve::Srgb, NodeSpacing::Uniform);
        for (node, d) in response.nodes.iter_mut().flatten().zip(x) {
            *node += d;
        }
        response
    }

    #[test]
    fn nothing_is_asked_of_the_start_curve() {
        let response = response(3, &[0.0; 768]);
        let mut d_curve = CurveGradient::zero(&response.curve());
        let prior = ResponsePrior::new(&response);
        assert!(prior.value_and_gradient(&response.curve(), 1.0, &mut d_curve) < 1e-20);
        let identity = CameraResponse::<f64>::new(3, StartCurve::Identity, NodeSpacing::Uniform);
        assert!(prior.value_and_gradient(&identity.curve(), 1.0, &mut d_curve) > 0.1);
    }

    #[test]
    fn gradient_agrees_with_differences() {
        // Small enough that every step still rises but the smallest, which stays the smallest.
        let mut x: Vec<f64> = noise(3, 512).iter().map(|v| 1e-4 * v).collect();
        x[100] -= 0.1;
        let prior = ResponsePrior::new(&response(2, &x));
        let mut d_curve = CurveGradient::zero(&response(2, &x).curve());
        prior.value_and_gradient(&response(2, &x).curve(), 3.0, &mut d_curve);
        let gradient = response(2, &x).pull_back(&d_curve).concat();
        assert_gradient("response prior", &x, &gradient, 1e-5, 1e-6, |x| {
            let curve = response(2, x).curve();
            prior.value_and_gradient(&curve, 3.0, &mut CurveGradient::zero(&curve))
        });
    }
}
