//! The response of a camera from surface points that several pictures show.
//!
//! A point has the picture values `y₁` and `y₂` in two pictures, and a response with `ln x = h(y)`
//!
//! ```text
//! h(y₁) - h(y₂) = q (ln v(r₁) - ln v(r₂)) + g
//! ```
//!
//! where `v` is the vignetting and `g` the difference of the logarithmic gains of the two pictures, one
//! unknown for each pair and channel (Mitsunaga and Nayar 1999, Grossberg and Nayar 2003). Pictures of
//! different exposure tell the shape of `h`; its scale, a power of linear values, they do not: the start
//! curve gives it, until blur tells it ([`estimate_power`](crate::blur_estimate::estimate_power)). A
//! vignetting that is known has the power of the response that it was found with, so that its power `q` is
//! unknown beside that of the start curve.
//!
//! A residual `r = h(y₁) - h(y₂) - q (ln v(r₁) - ln v(r₂)) - g` counts in the noise of the picture values,
//! `ε = r / D` with `D² = (h'σ/y)₁² + (h'σ/y)₂²` and `h' = dh / d ln y`. The noise that is in `r` is in `y₁` and
//! `y₂`, too: derivatives and `D` taken there go up and down with `r`, and so does whether a point is bright
//! enough to count. What follows is a bias that grows with the noise, in the dark before all, where few points
//! are. All three are taken at the common light of both pictures instead, which is independent of `r` to
//! first order, if the ratio of both `σ` is right (instrumental variables). The offsets `d` of the logarithmic slope at the knots ([`LogResponse`]), a
//! random walk from knot to knot, are where
//!
//! ```text
//! Σ w ∂(h(ŷ₁) - h(ŷ₂) - g)/∂d r / (s D)² + (prior) = 0        w = 1/(1 + ε²/(c s)²)²
//! ```
//!
//! with the robust deviation `s` of `ε`. `w` is that of Geman and McClure's loss (1985), which is bounded:
//! under one that is not, outliers bend the curve until they cost less. There is no cost that falls from
//! step to step; steps are halved when they grow.

mod common_light;
mod log_response;
#[cfg(test)]
mod tests;

pub use log_response::LogResponse;

use crate::tone::{ResponseCurve, StartCurve};
use common_light::{CommonLight, common_lights};
use i2slam_compute::{SIGMA_PER_MEDIAN, median, solve_positive_definite};
use log_response::{COUNT, KNOTS, log_slopes};
use rayon::prelude::*;

/// Steps at most, and the change of every `d` below which one is the last.
const STEPS: usize = 40;
const MIN_STEP: f64 = 5e-3;
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
/// Least logarithmic slope of a response: where it is steeper than that, noise of pictures would weigh nothing.
const MIN_LOG_SLOPE: f64 = 1e-3;

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

/// Robust deviation of the residuals of groups of points that share a gain, taken at their picture values,
/// by a curve `y ↦ (h, h')` and the power of the vignetting, times the root of the geometric mean of
/// `D² / ((h'σ/y)₁ (h'σ/y)₂)`; `None` without points.
fn robust_deviation(
    groups: &[Vec<ValuePair>],
    vignetting_power: f64,
    curve: impl Fn(f64) -> (f64, f64) + Sync,
) -> Option<f64> {
    let of_group = |group: &Vec<ValuePair>| {
        let residuals = group.iter().map(|point| {
            let [(h1, s1), (h2, s2)] = point.values.map(&curve);
            let by_log = |k: usize, s: f64| s * point.deviations[k] / point.values[k];
            let (a, b) = (by_log(0, s1), by_log(1, s2));
            let residual = h1 - h2 - vignetting_power * point.log_vignetting;
            (residual, a.hypot(b), ((a * a + b * b) / (a * b)).ln())
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

/// Robust deviation of the residuals by the curve that channel `channel` of a response has, and the power `q`
/// of the vignetting behind it. A power of the response together with `q` changes nothing.
pub fn deviation_by_response(
    groups: &[Vec<ValuePair>],
    (response, channel): (&ResponseCurve<f32>, usize),
    vignetting_power: f64,
) -> Option<f64> {
    let curve = |y: f64| {
        let slope = y * response.log_linear_slope(channel, y);
        (response.log_linear(channel, y), slope.max(MIN_LOG_SLOPE))
    };
    robust_deviation(groups, vignetting_power, curve)
}

/// Robust deviation of the residuals by a curve.
#[cfg(test)]
fn deviation_by_curve(groups: &[Vec<ValuePair>], response: &LogResponse) -> Option<f64> {
    robust_deviation(groups, 1.0, |y| (response.log_linear(y), response.slope(y)))
}

/// A response that was found from points.
#[derive(Clone, Debug, PartialEq)]
pub struct ResponseEstimate {
    /// Its power is that of the start curve.
    pub response: LogResponse,
    /// `q`, the power of the vignetting that fits the response; about 1 without vignetting.
    pub vignetting_power: f64,
}

impl ResponseEstimate {
    /// The response between the start curve, at a share of 0, and that of the points, at 1.
    #[must_use]
    pub fn interpolated(&self, share: f64, start: StartCurve) -> LogResponse {
        LogResponse::new(&log_slopes(start), self.response.offsets().map(|d| share * d))
    }
}

/// Response and vignetting, as far as they are known.
struct Unknowns {
    curve: LogResponse,
    /// `q`.
    vignetting_power: f64,
}

impl Unknowns {
    /// `h(y₁) - h(y₂) - q (ln v(r₁) - ln v(r₂))`.
    fn difference(&self, pair: &ValuePair) -> f64 {
        let [first, second] = pair.values.map(|y| self.curve.log_linear(y));
        first - second - self.vignetting_power * pair.log_vignetting
    }
}

/// The response that explains the points of all groups best, each group with a gain of its own; `None`
/// of too few, or where they point to none. `repeats` says how often each point is compared, with the error
/// that it has: so many comparisons count as one.
pub fn estimate(
    groups: &[Vec<ValuePair>],
    repeats: f64,
    start: StartCurve,
) -> Option<ResponseEstimate> {
    let start = log_slopes(start);
    let curve = LogResponse::new(&start, [0.0; COUNT]);
    let mut found = Unknowns { curve, vignetting_power: 1.0 };
    let (mut length, mut last_change) = (1.0, f64::INFINITY);
    for _ in 0..STEPS {
        let step = System::new(groups, repeats, &found)?.solve()?;
        let change = step.iter().fold(0.0, |most: f64, d| most.max(d.abs()));
        if change > last_change {
            length *= 0.5;
        }
        last_change = change;
        // `f64::max` passes over NaN.
        if !step.iter().all(|d: &f64| d.is_finite()) {
            return None;
        }
        let offsets = std::array::from_fn(|k| found.curve.offsets()[k] + length * step[k]);
        found.curve = LogResponse::new(&start, offsets);
        found.vignetting_power += length * step[COUNT];
        // Medians and the choice of points make small jumps, about which whole steps do not come to rest.
        if length * change < MIN_STEP {
            let Unknowns { curve: response, vignetting_power } = found;
            return Some(ResponseEstimate { response, vignetting_power });
        }
    }
    None
}

/// Knots whose mean is tied.
fn is_tied(knot: usize) -> bool {
    (TIED[0]..=TIED[1]).contains(&KNOTS[knot])
}

fn tied_mean(offsets: &[f64; COUNT]) -> f64 {
    let tied = (0..COUNT).filter(|k| is_tied(*k));
    tied.clone().map(|k| offsets[k]).sum::<f64>() / tied.count() as f64
}

/// Number of unknowns: `d` at the knots, and `q`.
const UNKNOWNS: usize = COUNT + 1;

/// Linear equations of a step.
#[derive(Clone)]
struct System {
    matrix: [[f64; UNKNOWNS]; UNKNOWNS],
    right: [f64; UNKNOWNS],
}

impl Default for System {
    fn default() -> Self {
        Self { matrix: [[0.0; UNKNOWNS]; UNKNOWNS], right: [0.0; UNKNOWNS] }
    }
}

impl System {
    /// `None` of too few points.
    fn new(groups: &[Vec<ValuePair>], repeats: f64, unknowns: &Unknowns) -> Option<Self> {
        let curve = &unknowns.curve;
        let of_group = |group: &Vec<ValuePair>| common_lights(group, unknowns);
        let groups: Vec<Vec<CommonLight>> = groups.par_iter().map(of_group).collect();
        let mut all: Vec<f64> =
            groups.iter().flatten().map(|point| point.normalized().abs()).collect();
        if all.len() < MIN_POINTS {
            return None;
        }
        let scale = SIGMA_PER_MEDIAN * median(&mut all)?;
        if !(scale > 0.0 && scale.is_finite()) {
            return None;
        }
        let share = 1.0 / repeats.max(1.0);
        let of_group = |group: &Vec<CommonLight>| Self::of_group(group, curve, scale, share);
        let parts: Vec<Self> = groups.par_iter().map(of_group).collect();
        let mut sum = Self::default();
        parts.iter().for_each(|part| sum.merge(part));
        sum.add_prior(unknowns);
        Some(sum)
    }

    fn of_group(group: &[CommonLight], curve: &LogResponse, scale: f64, share: f64) -> Self {
        let weight = |point: &CommonLight| {
            let bounded = 1.0 + (point.normalized() / (LOSS_SCALE * scale)).powi(2);
            share / (bounded * scale * point.deviation).powi(2)
        };
        let weights: Vec<f64> = group.iter().map(weight).collect();
        let total: f64 = weights.iter().sum();
        let slopes: Vec<[f64; UNKNOWNS]> = group.iter().map(|point| point.slopes(curve)).collect();
        let weighted = || slopes.iter().zip(&weights);
        // The gain takes up what all have in common.
        let mean: [f64; UNKNOWNS] =
            std::array::from_fn(|k| weighted().map(|(s, w)| w * s[k]).sum::<f64>() / total);
        let mut system = Self::default();
        for ((slopes, weight), point) in weighted().zip(group) {
            let slopes = std::array::from_fn(|k| slopes[k] - mean[k]);
            system.add(&slopes, point.residual, *weight);
        }
        system
    }

    fn add(&mut self, slopes: &[f64; UNKNOWNS], residual: f64, weight: f64) {
        for (a, row) in self.matrix.iter_mut().enumerate() {
            let slope = weight * slopes[a];
            self.right[a] -= slope * residual;
            row.iter_mut().zip(slopes).for_each(|(sum, other)| *sum += slope * other);
        }
    }

    fn merge(&mut self, other: &Self) {
        let sums = self.matrix.iter_mut().flatten().zip(other.matrix.iter().flatten());
        sums.for_each(|(sum, value)| *sum += value);
        self.right.iter_mut().zip(other.right).for_each(|(sum, value)| *sum += value);
    }

    /// That of `Σ (d_{k+1} - d_k)²/σ² + w mean(d)² + (q - 1)²`.
    fn add_prior(&mut self, unknowns: &Unknowns) {
        let offsets = unknowns.curve.offsets();
        for k in 0..COUNT - 1 {
            let mut slopes = [0.0; UNKNOWNS];
            (slopes[k], slopes[k + 1]) = (-1.0, 1.0);
            self.add(&slopes, offsets[k + 1] - offsets[k], WALK_DEVIATION.powi(-2));
        }
        let tied = (0..COUNT).filter(|k| is_tied(*k)).count() as f64;
        let is_tied = |k: usize| k < COUNT && is_tied(k);
        let slopes = std::array::from_fn(|k| if is_tied(k) { 1.0 / tied } else { 0.0 });
        self.add(&slopes, tied_mean(offsets), TIE_WEIGHT);
        // Any weight will do: it decides where there is no vignetting.
        let slopes = std::array::from_fn(|k| if k == COUNT { 1.0 } else { 0.0 });
        self.add(&slopes, unknowns.vignetting_power - 1.0, 1.0);
    }

    /// Change of the unknowns.
    fn solve(&self) -> Option<[f64; UNKNOWNS]> {
        let mut matrix: Vec<f64> = self.matrix.iter().flatten().copied().collect();
        let mut step = self.right;
        solve_positive_definite(&mut matrix, &mut step).then_some(step)
    }
}
