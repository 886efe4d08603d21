//! The response of a camera from surface points that several pictures show.
//!
//! A point has the picture values `y₁` and `y₂` in two pictures, and a response with `ln x = h(y)`
//!
//! ```text
//! h(y₁) - h(y₂) = ln v(r₁) - ln v(r₂) + g
//! ```
//!
//! where `v` is the vignetting and `g` the difference of the logarithmic gains of the two pictures, one
//! unknown for each pair and channel (Mitsunaga and Nayar 1999, Grossberg and Nayar 2003). Pictures of
//! different exposure tell the shape of `h`; its scale, a power of linear values, they do not: the start
//! curve gives it, until blur tells it ([`estimate_power`](crate::blur_estimate::estimate_power)).
//!
//! Residuals count in the noise of the picture values, `ε = (h(y₁) - h(y₂) - g) / D` with
//! `D² = (h'σ)₁² + (h'σ)₂²`: compared in `h`, a flat curve would explain everything. The density of
//! `y₂` given `y₁` has the factor `h'₂ / D`, so that the cost of a point is
//!
//! ```text
//! ε² + ln(D² / ((h'σ)₁ (h'σ)₂))
//! ```
//!
//! without whose second term curves that grow exponentially would explain everything, too. The loss of
//! `ε` is `ε²/(1 + ε²/c²)` (Geman and McClure 1985), which is bounded: under one that is not, outliers
//! bend the curve until they cost less. Gauss-Newton with Levenberg's damping on the offsets `d` of the
//! logarithmic slope at the knots ([`LogResponse`]), which are a random walk from knot to knot.

mod log_response;
#[cfg(test)]
mod tests;

pub use log_response::LogResponse;

use crate::tone::{ResponseCurve, StartCurve};
use i2slam_compute::{SIGMA_PER_MEDIAN, median, solve_positive_definite};
use log_response::{COUNT, KNOTS, log_slopes};
use rayon::prelude::*;

/// Steps of Gauss-Newton at most, weights renewed with each, and dampings that each tries.
const STEPS: usize = 20;
const TRIES: usize = 6;
/// Change of every `d` below which a step is the last, and damping beyond which none is tried.
const MIN_STEP: f64 = 1e-3;
const MAX_DAMPING: f64 = 1e3;
/// Standard deviation of the change of `d` from one knot to the next: of the order of what tells
/// published responses apart.
const WALK_DEVIATION: f64 = 0.3;
/// Picture values between which the mean of `d` is that of the start curve, and with it the power of
/// linear values.
pub const TIED: [f64; 2] = [0.1, 0.6];
/// Weight of that, which decides nothing else.
const TIE_WEIGHT: f64 = 1e4;
/// Scale `c` of Geman and McClure's loss, in robust deviations of the residuals.
const LOSS_SCALE: f64 = 3.0;
/// Fewest points.
const MIN_POINTS: usize = 500;

/// One surface point in two pictures, in one channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ValuePair {
    /// Picture values in [0, 1].
    pub values: [f64; 2],
    /// Their standard deviations.
    pub deviations: [f64; 2],
    /// `ln v(r₁) - ln v(r₂)`.
    pub log_vignetting: f64,
}

/// Robust deviation of the residuals of groups of points that share a gain, by a curve `y ↦ (h, h')`
/// with `h' = d h / d ln y`, times the root of the mean of `D² / ((h'σ)₁ (h'σ)₂)`; `None` without points.
fn robust_deviation(
    groups: &[Vec<ValuePair>],
    curve: impl Fn(f64) -> (f64, f64) + Sync,
) -> Option<f64> {
    let of_group = |group: &Vec<ValuePair>| {
        let residuals = group.iter().map(|point| {
            let [(h1, s1), (h2, s2)] = point.values.map(&curve);
            let by_log = |k: usize, s: f64| s * point.deviations[k] / point.values[k];
            let (a, b) = (by_log(0, s1), by_log(1, s2));
            (h1 - h2 - point.log_vignetting, a.hypot(b), ((a * a + b * b) / (a * b)).ln())
        });
        let residuals: Vec<(f64, f64, f64)> = residuals.collect();
        let mut differences: Vec<f64> = residuals.iter().map(|(r, _, _)| *r).collect();
        let gain = median(&mut differences).unwrap_or(0.0);
        let points = residuals.into_iter().map(move |(r, d, log)| (((r - gain) / d).abs(), log));
        points.collect::<Vec<(f64, f64)>>()
    };
    let all: Vec<(f64, f64)> = groups.par_iter().flat_map_iter(of_group).collect();
    let log = all.iter().map(|(_, log)| log).sum::<f64>() / all.len() as f64;
    let median = median(&mut all.into_iter().map(|(residual, _)| residual).collect::<Vec<f64>>());
    median.map(|median| SIGMA_PER_MEDIAN * median * (0.5 * log).exp())
}

/// Robust deviation of the residuals by the curve that channel `channel` of a response has.
pub fn deviation_by_response(
    groups: &[Vec<ValuePair>],
    (response, channel): (&ResponseCurve<f32>, usize),
) -> Option<f64> {
    // Over several nodes: neighbouring ones are not smooth.
    const HALF: f64 = 0.02;
    let log = |y: f64| f64::from(response.inverse(channel, y as f32)).max(1e-12).ln();
    let curve = |y: f64| {
        let (left, right) = ((y - HALF).max(1e-3), (y + HALF).min(1.0));
        (log(y), ((log(right) - log(left)) / (right.ln() - left.ln())).max(1e-3))
    };
    robust_deviation(groups, curve)
}

/// Robust deviation of the residuals by a curve.
#[cfg(test)]
fn deviation_by_curve(groups: &[Vec<ValuePair>], response: &LogResponse) -> Option<f64> {
    robust_deviation(groups, |y| (response.log_linear(y), response.slope(y)))
}

/// The response that explains the points of all groups best, each group with a gain of its own; `None`
/// of too few. `repeats` says how often each point is compared, with the error that it has: so many
/// comparisons count as one.
pub fn estimate(groups: &[Vec<ValuePair>], repeats: f64, start: StartCurve) -> Option<LogResponse> {
    let groups: Vec<&Vec<ValuePair>> = groups.iter().filter(|group| group.len() > 1).collect();
    if groups.iter().map(|group| group.len()).sum::<usize>() < MIN_POINTS {
        return None;
    }
    let start = log_slopes(start);
    let mut best = LogResponse::new(&start, [0.0; COUNT]);
    let mut damping = 1e-3;
    for _ in 0..STEPS {
        let scale = robust_scale(&groups, &best)?;
        let weights = robust_weights(&groups, &best, scale);
        let share = 1.0 / repeats.max(1.0);
        let objective = Objective { groups: &groups, weights, scale, share };
        let system = objective.normal_equations(&best);
        let cost = objective.cost(&best);
        let mut change = None;
        for _ in 0..TRIES {
            let offsets = system.step(best.offsets(), damping)?;
            let next = LogResponse::new(&start, offsets);
            if objective.cost(&next) <= cost {
                let changes = best.offsets().iter().zip(next.offsets()).map(|(a, b)| (a - b).abs());
                change = Some(changes.fold(0.0, f64::max));
                best = next;
                damping *= 0.3;
                break;
            }
            damping *= 10.0;
        }
        // A short step under strong damping says nothing.
        let is_converged = match change {
            Some(change) => change < MIN_STEP && damping < 1.0,
            None => damping > MAX_DAMPING,
        };
        if is_converged {
            break;
        }
    }
    best.offsets().iter().all(|d| d.is_finite()).then_some(best)
}

fn robust_scale(groups: &[&Vec<ValuePair>], curve: &LogResponse) -> Option<f64> {
    let residuals = |group: &&Vec<ValuePair>| {
        let residuals = Residuals::new(group, curve);
        residuals.points.into_iter().map(|point| point.residual.abs()).collect::<Vec<f64>>()
    };
    let mut all: Vec<f64> = groups.par_iter().flat_map_iter(residuals).collect();
    let scale = SIGMA_PER_MEDIAN * median(&mut all)?;
    (scale > 0.0 && scale.is_finite()).then_some(scale)
}

/// `1/(1 + ε²/(c s)²)²` of all points.
fn robust_weights(groups: &[&Vec<ValuePair>], curve: &LogResponse, scale: f64) -> Vec<Vec<f64>> {
    let weight =
        |point: &PointResidual| (1.0 + (point.residual / (LOSS_SCALE * scale)).powi(2)).powi(-2);
    let of_group =
        |group: &&Vec<ValuePair>| Residuals::new(group, curve).points.iter().map(weight).collect();
    groups.par_iter().map(of_group).collect()
}

/// Residuals of a group, its gain taken out.
struct Residuals {
    points: Vec<PointResidual>,
}

struct PointResidual {
    /// `ε`.
    residual: f64,
    /// Derivatives of `h(y₁) - h(y₂)` by the knots.
    by_knots: [f64; COUNT],
    /// `√((h'σ)₁² + (h'σ)₂²)`.
    deviation: f64,
    /// Derivatives of its logarithm by the knots.
    log_deviation_by_knots: [f64; COUNT],
    /// Share of the first picture in its square.
    first_share: f64,
    /// Derivatives of `ln (h'σ)₁ - ln (h'σ)₂` by the knots.
    log_ratio_by_knots: [f64; COUNT],
}

impl Residuals {
    fn new(group: &[ValuePair], curve: &LogResponse) -> Self {
        let mut points: Vec<PointResidual> =
            group.iter().map(|point| PointResidual::new(point, curve)).collect();
        let weights: f64 = points.iter().map(|point| point.deviation.powi(-2)).sum();
        let mean = |of: &dyn Fn(&PointResidual) -> f64| {
            points.iter().map(|point| of(point) / point.deviation.powi(2)).sum::<f64>() / weights
        };
        // Outliers do not move the median, of which the derivative is taken as that of the mean.
        let mut differences: Vec<f64> = points.iter().map(|point| point.residual).collect();
        let gain = median(&mut differences).unwrap_or(0.0);
        let gain_by_knots: [f64; COUNT] = std::array::from_fn(|k| mean(&|point| point.by_knots[k]));
        for point in &mut points {
            point.residual = (point.residual - gain) / point.deviation;
            (0..COUNT).for_each(|k| point.by_knots[k] -= gain_by_knots[k]);
        }
        Self { points }
    }
}

impl PointResidual {
    /// Before the gain is known: the residual is a difference of logarithms.
    fn new(pair: &ValuePair, curve: &LogResponse) -> Self {
        let (mut difference, mut variance) = (-pair.log_vignetting, 0.0);
        let (mut by_knots, mut variance_by_knots) = ([0.0; COUNT], [0.0; COUNT]);
        let (mut first_variance, mut log_ratio_by_knots) = (0.0, [0.0; COUNT]);
        for (k, sign) in [1.0, -1.0].into_iter().enumerate() {
            let y = pair.values[k];
            let (left, right, share) = curve.place(y);
            let mix = |a: f64, b: f64| a + (b - a) * share;
            difference += sign * mix(left.log, right.log);
            let noise = mix(left.slope, right.slope) * pair.deviations[k] / y;
            variance += noise * noise;
            if k == 0 {
                first_variance = variance;
            }
            let by_slope = noise * pair.deviations[k] / y;
            for (row, weight) in [(left, 1.0 - share), (right, share)] {
                let (knot, part) = row.knot;
                for (knot, part) in [(knot, 1.0 - part), (knot + 1, part)] {
                    let slope_by_knot = weight * row.slope * part;
                    variance_by_knots[knot] += by_slope * slope_by_knot;
                    let log_slope_by_knot = slope_by_knot / mix(left.slope, right.slope);
                    log_ratio_by_knots[knot] += sign * log_slope_by_knot;
                }
            }
            for (at, sum) in by_knots.iter_mut().enumerate() {
                *sum += sign * mix(left.by_knots[at], right.by_knots[at]);
            }
        }
        Self {
            residual: difference,
            by_knots,
            deviation: variance.sqrt(),
            log_deviation_by_knots: variance_by_knots.map(|d| d / variance),
            first_share: first_variance / variance,
            log_ratio_by_knots,
        }
    }

    /// `ln(D² / ((h'σ)₁ (h'σ)₂))`.
    fn log_density(&self) -> f64 {
        -0.5 * (self.first_share * (1.0 - self.first_share)).ln()
    }

    /// Derivative of `ε` by a knot.
    fn slope(&self, knot: usize) -> f64 {
        self.by_knots[knot] / self.deviation - self.residual * self.log_deviation_by_knots[knot]
    }
}

struct Objective<'a> {
    groups: &'a [&'a Vec<ValuePair>],
    /// Robust weights of the points, for the second term of their cost.
    weights: Vec<Vec<f64>>,
    /// Robust deviation of the residuals.
    scale: f64,
    /// Weight of a comparison.
    share: f64,
}

impl Objective<'_> {
    /// `Σ share (e²/(1 + e²/c²) + w ln(D² / ((h'σ)₁ (h'σ)₂))) + prior` with `e = ε/s`.
    fn cost(&self, curve: &LogResponse) -> f64 {
        let s2 = self.scale.powi(2);
        let of_group = |(group, weights): (&&Vec<ValuePair>, &Vec<f64>)| {
            let residuals = Residuals::new(group, curve);
            let loss = |(point, weight): (&PointResidual, &f64)| {
                let e2 = point.residual.powi(2) / s2;
                e2 / (1.0 + e2 / LOSS_SCALE.powi(2)) + weight * point.log_density()
            };
            residuals.points.iter().zip(weights).map(loss).sum::<f64>()
        };
        let sums: Vec<f64> = self.groups.par_iter().zip(&self.weights).map(of_group).collect();
        self.share * sums.iter().sum::<f64>() + prior(curve.offsets())
    }

    fn normal_equations(&self, curve: &LogResponse) -> System {
        let of_group = |(group, weights): (&&Vec<ValuePair>, &Vec<f64>)| {
            let mut system = System::default();
            for (point, weight) in Residuals::new(group, curve).points.iter().zip(weights) {
                let weight = self.share * weight;
                let slopes: [f64; COUNT] = std::array::from_fn(|k| point.slope(k));
                system.add(&slopes, point.residual, weight / self.scale.powi(2));
                // Half of ln(D²/(ab)) has the derivative w - ½ by ln(a/b), w = a²/D², and the second
                // derivative 2 w (1 - w).
                let share = point.first_share;
                let curvature = (2.0 * share * (1.0 - share)).max(1e-6);
                system.add(
                    &point.log_ratio_by_knots,
                    (share - 0.5) / curvature,
                    weight * curvature,
                );
            }
            system
        };
        let pairs = self.groups.par_iter().zip(&self.weights);
        let parts: Vec<System> = pairs.map(of_group).collect();
        let mut sum = System::default();
        parts.iter().for_each(|part| sum.merge(part));
        sum.add_prior(curve.offsets());
        sum
    }
}

/// Knots whose mean is tied.
fn is_tied(knot: usize) -> bool {
    (TIED[0]..=TIED[1]).contains(&KNOTS[knot])
}

fn tied_mean(offsets: &[f64; COUNT]) -> f64 {
    let tied = (0..COUNT).filter(|k| is_tied(*k));
    tied.clone().map(|k| offsets[k]).sum::<f64>() / tied.count() as f64
}

/// `Σ (d_{k+1} - d_k)²/σ² + w mean(d)²`.
fn prior(offsets: &[f64; COUNT]) -> f64 {
    let walk = offsets.windows(2).map(|w| ((w[1] - w[0]) / WALK_DEVIATION).powi(2));
    walk.sum::<f64>() + TIE_WEIGHT * tied_mean(offsets).powi(2)
}

/// Normal equations of half the cost.
#[derive(Clone)]
struct System {
    hessian: [[f64; COUNT]; COUNT],
    gradient: [f64; COUNT],
}

impl Default for System {
    fn default() -> Self {
        Self { hessian: [[0.0; COUNT]; COUNT], gradient: [0.0; COUNT] }
    }
}

impl System {
    fn add(&mut self, slopes: &[f64; COUNT], residual: f64, weight: f64) {
        for (a, row) in self.hessian.iter_mut().enumerate() {
            let slope = weight * slopes[a];
            self.gradient[a] += slope * residual;
            row.iter_mut().zip(slopes).for_each(|(sum, other)| *sum += slope * other);
        }
    }

    fn merge(&mut self, other: &Self) {
        let sums = self.hessian.iter_mut().flatten().zip(other.hessian.iter().flatten());
        sums.for_each(|(sum, value)| *sum += value);
        self.gradient.iter_mut().zip(other.gradient).for_each(|(sum, value)| *sum += value);
    }

    fn add_prior(&mut self, offsets: &[f64; COUNT]) {
        for k in 0..COUNT - 1 {
            let mut slopes = [0.0; COUNT];
            (slopes[k], slopes[k + 1]) = (-1.0, 1.0);
            self.add(&slopes, offsets[k + 1] - offsets[k], WALK_DEVIATION.powi(-2));
        }
        let tied = (0..COUNT).filter(|k| is_tied(*k)).count() as f64;
        let slopes = std::array::from_fn(|k| if is_tied(k) { 1.0 / tied } else { 0.0 });
        self.add(&slopes, tied_mean(offsets), TIE_WEIGHT);
    }

    /// The offsets after a damped step.
    fn step(&self, from: &[f64; COUNT], damping: f64) -> Option<[f64; COUNT]> {
        let mut matrix: Vec<f64> = self.hessian.iter().flatten().copied().collect();
        (0..COUNT).for_each(|k| matrix[k * (COUNT + 1)] *= 1.0 + damping);
        let mut step = self.gradient;
        solve_positive_definite(&mut matrix, &mut step)
            .then(|| std::array::from_fn(|k| from[k] - step[k]))
    }
}
