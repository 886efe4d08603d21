//! Vignetting from surface points that two pictures show at different distances from the centre.
//!
//! With `x` the inverse response of a picture value, a point of one colour seen in two pictures has
//!
//! ```text
//! ln x₁ - ln x₂ = ln v(r₁) - ln v(r₂) + g
//! ```
//!
//! where `g` is the difference of the gains of the two pictures, one unknown for each pair, so that
//! errors of exposure are not read as vignetting. The gains are eliminated, and `a`, `b` and `c` found
//! by Gauss-Newton with Cauchy's weights: gloss, moved edges and shadows are outliers.

use super::Vignetting;
use i2slam_compute::{SIGMA_PER_MEDIAN, median, solve_positive_definite};

/// Steps of Gauss-Newton; four reach the optimum.
const STEPS: usize = 6;
/// Smallest scale of the residuals: the steps of 8-bit pictures.
const MIN_SCALE: f64 = 0.003;
/// Added to the diagonal of the normal equations, over its largest entry: keeps terms small that no
/// point tells apart.
const RIDGE: f64 = 1e-5;
/// Fewest points and pairs.
const MIN_POINTS: usize = 200;
const MIN_PAIRS: usize = 3;

/// One surface point in two pictures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RadiancePair {
    /// `ln x₁ - ln x₂`, without the gains of the pictures as far as they are known.
    pub log_ratio: f64,
    /// `r²` in both pictures.
    pub squared_radii: [f64; 2],
    /// Standard deviation of `log_ratio` by what is known of its noise.
    pub deviation: f64,
}

/// Vignetting found from pictures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VignettingEstimate {
    /// The vignetting.
    pub vignetting: Vignetting<f64>,
    /// Standard deviation of its value at half a diagonal, from the scatter between pairs of pictures.
    pub corner_deviation: f64,
}

impl VignettingEstimate {
    /// True if the corner is darker by a share of at least `least`, and by more than three of its
    /// deviations.
    pub fn is_significant(&self, least: f64) -> bool {
        let loss = 1.0 - self.vignetting.corner();
        loss >= least && loss > 3.0 * self.corner_deviation
    }
}

/// The vignetting that explains the points of pairs of pictures best; `None` of too few, or of points
/// that show nothing of it.
pub fn estimate(pairs: &[Vec<RadiancePair>]) -> Option<VignettingEstimate> {
    let points = pairs.iter().map(Vec::len).sum::<usize>();
    if pairs.iter().filter(|pair| !pair.is_empty()).count() < MIN_PAIRS || points < MIN_POINTS {
        return None;
    }
    let mut vignetting = Vignetting::default();
    let mut weights: Vec<Vec<f64>> = Vec::new();
    for _ in 0..STEPS {
        let residuals = centred_residuals(pairs, &vignetting);
        weights = cauchy_weights(pairs, &residuals);
        let step = Normal::new(pairs, &weights, &vignetting).step(&vignetting)?;
        for (value, step) in vignetting.coefficients.iter_mut().zip(step) {
            *value += step;
        }
    }
    let end = Normal::new(pairs, &weights, &vignetting);
    let corner_deviation = end.corner_deviation()?;
    let is_finite = vignetting.coefficients.iter().all(|c| c.is_finite());
    is_finite.then_some(VignettingEstimate { vignetting, corner_deviation })
}

/// Residuals of all points, less the median of their pair.
fn centred_residuals(pairs: &[Vec<RadiancePair>], vignetting: &Vignetting<f64>) -> Vec<Vec<f64>> {
    let of_pair = |pair: &Vec<RadiancePair>| {
        let mut residuals: Vec<f64> =
            pair.iter().map(|point| residual(point, vignetting)).collect();
        let gain = median(&mut residuals.clone()).unwrap_or(0.0);
        residuals.iter_mut().for_each(|r| *r -= gain);
        residuals
    };
    pairs.iter().map(of_pair).collect()
}

/// Cauchy's weights `1 / (s² + r²)`, with `s` the deviation of a point, scaled to what residuals show.
fn cauchy_weights(pairs: &[Vec<RadiancePair>], residuals: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let all = pairs.iter().flatten().zip(residuals.iter().flatten());
    let mut ratios: Vec<f64> = all.map(|(point, r)| r.abs() / point.deviation).collect();
    let scale = SIGMA_PER_MEDIAN * median(&mut ratios).unwrap_or(1.0);
    let weight = |(point, residual): (&RadiancePair, &f64)| {
        let deviation = (scale * point.deviation).max(MIN_SCALE);
        1.0 / (deviation * deviation + residual * residual)
    };
    let of_pair = |(pair, residuals): (&Vec<RadiancePair>, &Vec<f64>)| {
        pair.iter().zip(residuals).map(weight).collect()
    };
    pairs.iter().zip(residuals).map(of_pair).collect()
}

fn residual(point: &RadiancePair, vignetting: &Vignetting<f64>) -> f64 {
    let [first, second] = point.squared_radii.map(|r2| vignetting.at(r2).ln());
    point.log_ratio - (first - second)
}

/// Derivative of `ln v(r₁) - ln v(r₂)` by `a`, `b` and `c`.
fn slopes(point: &RadiancePair, vignetting: &Vignetting<f64>) -> [f64; 3] {
    let [first, second] = point.squared_radii;
    let [v, w] = [first, second].map(|r2| vignetting.at(r2));
    std::array::from_fn(|k| {
        let power = k as i32 + 1;
        first.powi(power) / v - second.powi(power) / w
    })
}

/// Normal equations without the gains of the pairs.
struct Normal {
    hessian: [[f64; 3]; 3],
    gradient: [f64; 3],
    /// `Σ s sᵀ` with `s` a pair's share of the gradient.
    scatter: [[f64; 3]; 3],
}

impl Normal {
    fn new(
        pairs: &[Vec<RadiancePair>],
        weights: &[Vec<f64>],
        vignetting: &Vignetting<f64>,
    ) -> Self {
        let mut normal =
            Self { hessian: [[0.0; 3]; 3], gradient: [0.0; 3], scatter: [[0.0; 3]; 3] };
        for (pair, weights) in pairs.iter().zip(weights) {
            normal.add(pair, weights, vignetting);
        }
        normal
    }

    /// Adds a pair, whose gain is that of the weighted mean residual.
    fn add(&mut self, pair: &[RadiancePair], weights: &[f64], vignetting: &Vignetting<f64>) {
        let total: f64 = weights.iter().sum();
        if total <= 0.0 {
            return;
        }
        let (mut mean_slope, mut mean_residual) = ([0.0; 3], 0.0);
        for (point, w) in pair.iter().zip(weights) {
            let slope = slopes(point, vignetting);
            (0..3).for_each(|k| mean_slope[k] += w * slope[k] / total);
            mean_residual += w * residual(point, vignetting) / total;
        }
        let mut share = [0.0; 3];
        for (point, w) in pair.iter().zip(weights) {
            let slope = slopes(point, vignetting);
            let j: [f64; 3] = std::array::from_fn(|k| slope[k] - mean_slope[k]);
            let e = residual(point, vignetting) - mean_residual;
            for a in 0..3 {
                share[a] += w * j[a] * e;
                (0..3).for_each(|b| self.hessian[a][b] += w * j[a] * j[b]);
            }
        }
        for a in 0..3 {
            self.gradient[a] += share[a];
            (0..3).for_each(|b| self.scatter[a][b] += share[a] * share[b]);
        }
    }

    /// `H` with its ridge, row by row.
    fn regularized(&self) -> ([f64; 9], f64) {
        let ridge = RIDGE * (0..3).map(|k| self.hessian[k][k]).fold(0.0, f64::max);
        let with_ridge =
            |i: usize| self.hessian[i / 3][i % 3] + if i.is_multiple_of(4) { ridge } else { 0.0 };
        (std::array::from_fn(with_ridge), ridge)
    }

    fn step(&self, vignetting: &Vignetting<f64>) -> Option<[f64; 3]> {
        let (mut matrix, ridge) = self.regularized();
        let mut step: [f64; 3] =
            std::array::from_fn(|k| self.gradient[k] - ridge * vignetting.coefficients[k]);
        solve_positive_definite(&mut matrix, &mut step).then_some(step)
    }

    /// Standard deviation of `a + b + c` by the covariance `H⁻¹ (Σ s sᵀ) H⁻¹`.
    fn corner_deviation(&self) -> Option<f64> {
        let (mut matrix, _) = self.regularized();
        let mut row = [1.0; 3];
        if !solve_positive_definite(&mut matrix, &mut row) {
            return None;
        }
        let of = |a: usize| (0..3).map(|b| row[a] * self.scatter[a][b] * row[b]).sum::<f64>();
        Some((0..3).map(of).sum::<f64>().max(0.0).sqrt())
    }
}
