//! A response by its logarithmic slope.
//!
//! ```text
//! d ln x / d ln y = s₀(y) exp(d(y))
//! ```
//!
//! with `x` the linear value, `y` the picture value, `s₀` the slope of a start curve and `d` straight
//! between knots, constant beyond them: any `d` is a rising curve, and adding a constant to `d` raises
//! linear values to a power.

use crate::tone::{CameraResponse, NODES, NodeSpacing, StartCurve};
use i2slam_geometry::Real;

/// Picture values of the knots: close where responses have their shoulder.
pub(super) const KNOTS: [f64; 17] = [
    0.06, 0.09, 0.13, 0.18, 0.24, 0.31, 0.38, 0.46, 0.55, 0.64, 0.72, 0.79, 0.85, 0.9, 0.94, 0.97,
    0.99,
];
/// Number of knots.
pub(super) const COUNT: usize = KNOTS.len();
/// Rows of the table: steps of a picture value from 0 to 1.
const STEPS: usize = 1024;
/// Picture value from which the curve is extrapolated to 1: beyond, 8 bits say nothing.
const MAX_TABULATED: f64 = 0.985;
/// Exponents of node spacings.
const POWERS: [f64; 2] = [1.0, 8.0];

/// A response curve as the logarithm of linear values, up to their unit.
#[derive(Clone, Debug, PartialEq)]
pub struct LogResponse {
    /// `d` at the knots.
    offsets: [f64; COUNT],
    rows: Vec<Row>,
}

/// The curve at one picture value.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
struct Row {
    /// `ln x`, 0 at the first row.
    log: f64,
    /// `d ln x / d ln y`.
    slope: f64,
    /// Derivatives of `log` by `d` at the knots.
    by_knots: [f64; COUNT],
    /// The knot before and the share of the next one: derivatives of the logarithm of `slope`.
    knot: (usize, f64),
}

/// `ln s₀` at all rows of the table from the first on.
pub(super) fn log_slopes(start: StartCurve) -> Vec<f64> {
    const STEP: f64 = 0.01;
    let log_slope = |y: f64| {
        let x = inverse(start, y);
        let [left, right] = [-STEP, STEP].map(|step| start.evaluate((x * step.exp()).min(1.0)));
        let width = if x * STEP.exp() > 1.0 { -x.ln() + STEP } else { 2.0 * STEP };
        (width / (right.ln() - left.ln())).ln()
    };
    (FIRST_ROW..=STEPS).map(|row| log_slope(row as f64 / STEPS as f64)).collect()
}

/// Linear value of a start curve's picture value, by bisection.
fn inverse(start: StartCurve, y: f64) -> f64 {
    let (mut left, mut right) = (0.0, 1.0);
    for _ in 0..60 {
        let middle = 0.5 * (left + right);
        match start.evaluate(middle) < y {
            true => left = middle,
            false => right = middle,
        }
    }
    0.5 * (left + right)
}

/// The first row of the table: a sixth of an 8-bit step.
const FIRST_ROW: usize = 1;

/// The knot before a picture value and the share of the next one.
fn knot(y: f64) -> (usize, f64) {
    let left = KNOTS.partition_point(|&k| k <= y).saturating_sub(1).min(COUNT - 2);
    let share = (y - KNOTS[left]) / (KNOTS[left + 1] - KNOTS[left]);
    (left, share.clamp(0.0, 1.0))
}

impl LogResponse {
    /// The curve of `d` at the knots, on a start curve given by [`log_slopes`].
    pub(super) fn new(start: &[f64], offsets: [f64; COUNT]) -> Self {
        let mut rows: Vec<Row> = Vec::with_capacity(start.len());
        for (index, log_slope) in start.iter().enumerate() {
            let y = (FIRST_ROW + index) as f64 / STEPS as f64;
            let (left, share) = knot(y);
            let d = offsets[left] * (1.0 - share) + offsets[left + 1] * share;
            let slope = (log_slope + d).exp();
            let mut row = Row { slope, knot: (left, share), ..Row::default() };
            if let Some(last) = rows.last() {
                let half = 0.5 * (y / (y - 1.0 / STEPS as f64)).ln();
                let (before, share_before) = last.knot;
                row.log = last.log + half * (last.slope + slope);
                row.by_knots = last.by_knots;
                row.by_knots[before] += half * last.slope * (1.0 - share_before);
                row.by_knots[before + 1] += half * last.slope * share_before;
                row.by_knots[left] += half * slope * (1.0 - share);
                row.by_knots[left + 1] += half * slope * share;
            }
            rows.push(row);
        }
        Self { offsets, rows }
    }

    /// `d` at the knots.
    pub(super) fn offsets(&self) -> &[f64; COUNT] {
        &self.offsets
    }

    /// The row before a picture value and the share of the next one.
    fn place(&self, y: f64) -> (&Row, &Row, f64) {
        let at = (y * STEPS as f64 - FIRST_ROW as f64).clamp(0.0, (self.rows.len() - 1) as f64);
        let left = (at as usize).min(self.rows.len() - 2);
        (&self.rows[left], &self.rows[left + 1], at - left as f64)
    }

    /// `ln x` of a picture value, up to a constant.
    pub fn log_linear(&self, y: f64) -> f64 {
        let (left, right, share) = self.place(y);
        left.log + (right.log - left.log) * share
    }

    /// `d ln x / d ln y`.
    pub fn slope(&self, y: f64) -> f64 {
        let (left, right, share) = self.place(y);
        left.slope + (right.slope - left.slope) * share
    }

    /// Derivatives of [`log_linear`](Self::log_linear) by `d` at the knots.
    pub(super) fn by_knots(&self, y: f64) -> [f64; COUNT] {
        let (left, right, share) = self.place(y);
        std::array::from_fn(|k| left.by_knots[k] + (right.by_knots[k] - left.by_knots[k]) * share)
    }

    /// `curves` copies of it as a camera response, whose linear value 1 is that of white. What 8 bits do
    /// not tell, close to white, goes on with the slope before.
    pub fn camera_response<T: Real>(&self, curves: usize, start: StartCurve) -> CameraResponse<T> {
        let rise = self.slope(MAX_TABULATED) * -MAX_TABULATED.ln();
        let white = self.log_linear(MAX_TABULATED) + rise;
        let halves = (white - self.log_linear(0.5)) / 2.0_f64.ln();
        let spacing = NodeSpacing::Power(halves.clamp(POWERS[0], POWERS[1]));
        let value = |node: usize| match spacing.position(node) {
            x if x <= 0.0 => 0.0,
            x => self.picture_value(x.ln() + white).min(1.0),
        };
        let nodes: Vec<f64> = (0..NODES).map(value).collect();
        CameraResponse::of_nodes(vec![nodes; curves.max(1)], start, spacing)
    }

    /// Picture value of `ln x`, extrapolated at both ends with the slope there.
    pub(super) fn picture_value(&self, log: f64) -> f64 {
        let first = FIRST_ROW as f64 / STEPS as f64;
        if log <= self.rows[0].log {
            return first * ((log - self.rows[0].log) / self.rows[0].slope).exp();
        }
        let most = self.log_linear(MAX_TABULATED);
        if log >= most {
            return MAX_TABULATED * ((log - most) / self.slope(MAX_TABULATED)).exp();
        }
        let right = self.rows.partition_point(|row| row.log < log).clamp(1, self.rows.len() - 1);
        let (a, b) = (&self.rows[right - 1], &self.rows[right]);
        let share = (log - a.log) / (b.log - a.log);
        ((FIRST_ROW + right - 1) as f64 + share) / STEPS as f64
    }
}
