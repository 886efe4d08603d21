//! What the mean cost of robust residuals says about their noise.

use super::residual::FREEDOM;

/// Samples of the normal density, over [`WIDTH`] standard deviations on either side.
const SAMPLES: usize = 64;
const WIDTH: f64 = 6.0;
/// Bounds of the spread, and halvings of the way between them (on a logarithmic scale).
const SPREADS: (f64, f64) = (1e-3, 1e3);
const HALVINGS: usize = 40;

/// Normal residuals under the t-distribution's cost, against the sum of weights `E[w]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Noise {
    /// `E[ρ''(z)/2] / E[w(z)]`.
    pub(super) curvature: f64,
    /// `E[w(z)² z²] / E[w(z)]`.
    pub(super) spread: f64,
}

impl Noise {
    /// Of residuals whose mean of `ρ(z) = (ν+1) ln(1 + z²/ν)` is `cost`.
    pub(super) fn of_mean_cost(cost: f64) -> Self {
        let freedom = f64::from(FREEDOM);
        let rho = |z: f64| (freedom + 1.0) * (z * z / freedom).ln_1p();
        let (mut low, mut high) = (SPREADS.0.ln(), SPREADS.1.ln());
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            match expected(middle.exp(), rho) < cost {
                true => low = middle,
                false => high = middle,
            }
        }
        Self::of_spread(low.exp())
    }

    /// Of residuals with `spread` times their scale as standard deviation.
    fn of_spread(spread: f64) -> Self {
        let freedom = f64::from(FREEDOM);
        let weight = |z: f64| (freedom + 1.0) / (freedom + z * z);
        let bend = |z: f64| weight(z) * (freedom - z * z) / (freedom + z * z);
        let sum = expected(spread, weight);
        // Beyond the turning point of the cost outliers would make its curvature negative.
        let curvature = (expected(spread, bend) / sum).max(0.05);
        Self { curvature, spread: expected(spread, |z| (weight(z) * z).powi(2)) / sum }
    }
}

/// `E[f(z)]` for `z ~ N(0, spread²)`.
fn expected(spread: f64, f: impl Fn(f64) -> f64) -> f64 {
    let place = |i: usize| WIDTH * ((2 * i + 1) as f64 / SAMPLES as f64 - 1.0);
    let (mut sum, mut total) = (0.0, 0.0);
    for x in (0..SAMPLES).map(place) {
        let density = (-0.5 * x * x).exp();
        sum += density * f(spread * x);
        total += density;
    }
    sum / total
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_residuals_are_least_squares() {
        let noise = Noise::of_mean_cost(1.2 * 0.01 * 0.01);
        assert!((noise.curvature - 1.0).abs() < 1e-3, "{noise:?}");
        assert!((noise.spread / (1.2 * 1e-4) - 1.0).abs() < 1e-3, "{noise:?}");
    }

    #[test]
    fn the_cost_of_a_spread_leads_back_to_it() {
        let rho = |z: f64| 6.0 * (z * z / 5.0).ln_1p();
        for spread in [0.05, 0.4, 1.0, 3.0] {
            let cost = expected(spread, rho);
            let (found, expected) = (Noise::of_mean_cost(cost), Noise::of_spread(spread));
            assert!((found.spread / expected.spread - 1.0).abs() < 1e-6, "{spread}");
        }
        let odd = [0.0, f64::NAN, f64::INFINITY].map(Noise::of_mean_cost);
        assert!(odd.iter().all(|n| n.spread.is_finite() && n.curvature > 0.0));
    }

    #[test]
    fn weights_and_curvature_of_unit_noise() {
        // By independent summation of E[36 z²/(5+z²)²], E[6 (5-z²)/(5+z²)²] and E[6/(5+z²)].
        let (mut a, mut b, mut e) = (0.0, 0.0, 0.0);
        for i in -8000..=8000_i32 {
            let z = f64::from(i) * 1e-3;
            let p = (-0.5 * z * z).exp();
            let d = 5.0 + z * z;
            a += p * 36.0 * z * z / (d * d);
            b += p * 6.0 * (5.0 - z * z) / (d * d);
            e += p * 6.0 / d;
        }
        let noise = Noise::of_spread(1.0);
        assert!((noise.spread - a / e).abs() < 1e-6 && (noise.curvature - b / e).abs() < 1e-6);
    }
}
