//! The light that both pictures of a point show, given the gain between them.
//!
//! Of all pairs of values without a residual, the nearest one to the values measured, in units of their noise:
//!
//! ```text
//! h(ŷ₁) = h(y₁) - r v₁/(v₁ + v₂)        h(ŷ₂) = h(y₂) + r v₂/(v₁ + v₂)        v = (h'(ŷ) σ/ŷ)²
//! ```
//!
//! to first order the mean of both measurements by their weights, which is independent of their difference if
//! the ratio of the two `σ` is right.

use super::ValuePair;
use super::log_response::{COUNT, LogResponse};
use super::{UNKNOWNS, Unknowns};
use i2slam_compute::median;

/// Least `ŷ` that counts: below, 8 bits have few steps.
const MIN_LIGHT: f64 = 0.05;
/// Points of a group whose median is its gain.
const MIN_GROUP: usize = 20;
/// Times that the variances are taken anew.
const ROUNDS: usize = 2;

/// A point in two pictures.
pub(super) struct CommonLight {
    /// Picture values `ŷ` without a residual.
    values: [f64; 2],
    /// `ln v(r₁) - ln v(r₂)`.
    pub(super) log_vignetting: f64,
    /// `r`, a difference of logarithms.
    pub(super) residual: f64,
    /// Standard deviation of it, by that of the values.
    pub(super) deviation: f64,
}

impl CommonLight {
    fn new(pair: &ValuePair, gain: f64, unknowns: &Unknowns) -> Self {
        let (residual, curve) = (unknowns.difference(pair) - gain, &unknowns.curve);
        let logs = pair.values.map(|y| curve.log_linear(y));
        let mut values = pair.values;
        let mut variances = variances(pair, values, curve);
        for _ in 0..ROUNDS {
            let share = residual / (variances[0] + variances[1]);
            let met = [logs[0] - share * variances[0], logs[1] + share * variances[1]];
            values = met.map(|log| curve.picture_value(log).min(1.0));
            variances = self::variances(pair, values, curve);
        }
        let deviation = (variances[0] + variances[1]).sqrt();
        Self { values, log_vignetting: pair.log_vignetting, residual, deviation }
    }

    /// `ε`.
    pub(super) fn normalized(&self) -> f64 {
        self.residual / self.deviation
    }

    /// Derivatives of `h(ŷ₁) - h(ŷ₂) - q (ln v(r₁) - ln v(r₂))` by `d` at the knots and by `q`.
    pub(super) fn slopes(&self, curve: &LogResponse) -> [f64; UNKNOWNS] {
        let [first, second] = self.values.map(|y| curve.by_knots(y));
        std::array::from_fn(|k| if k < COUNT { first[k] - second[k] } else { -self.log_vignetting })
    }
}

/// Variances of the logarithms of linear values, at picture values `at`.
fn variances(pair: &ValuePair, at: [f64; 2], curve: &LogResponse) -> [f64; 2] {
    std::array::from_fn(|k| (curve.slope(at[k]) * pair.deviations[k] / at[k]).powi(2))
}

/// The points of a group whose light is not too dark; none of too few.
pub(super) fn common_lights(group: &[ValuePair], unknowns: &Unknowns) -> Vec<CommonLight> {
    let points_at = |gain: f64| {
        let points = group.iter().map(move |pair| CommonLight::new(pair, gain, unknowns));
        points.filter(|point| point.values.iter().all(|y| *y >= MIN_LIGHT))
    };
    let is_light = |pair: &&ValuePair| pair.values.iter().all(|y| *y >= MIN_LIGHT);
    let differences = group.iter().filter(is_light).map(|pair| unknowns.difference(pair));
    let Some(rough) = gain_of(differences.collect()) else { return Vec::new() };
    let residuals = points_at(rough).map(|point| rough + point.residual);
    gain_of(residuals.collect()).map_or_else(Vec::new, |gain| points_at(gain).collect())
}

/// Outliers do not move the median.
fn gain_of(mut differences: Vec<f64>) -> Option<f64> {
    if differences.len() < MIN_GROUP { None } else { median(&mut differences) }
}
