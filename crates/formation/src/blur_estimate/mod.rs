//! Estimates from motion blur, by pictures of one surface alone: the power of a response's linear values
//! ([`estimate_power`]) and the length of the motion during an exposure ([`squared_length`]).
//!
//! Both compare a picture with the mean of another one along a motion, and are least squares in one unknown
//! and two more of each pair of pictures. Noise is in the derivatives as well as in the residuals, which
//! biases least squares by a tenth; the same derivatives in a third picture have noise of their own, and are
//! the instruments of the estimate (two-stage least squares).

mod length;
mod power;

pub use length::{PARTNERS, SharedPoint, SquaredLength, SurfacePoint, squared_length};
pub use power::{BlurredPicture, BlurredPixel, PowerEstimate, SHARP_PICTURES, estimate_power};

use i2slam_compute::{SIGMA_PER_MEDIAN, median};

/// Moments of an exposure.
pub const MOMENTS: usize = 12;

/// Scale of Geman and McClure's weights, in robust deviations of the residuals.
const LOSS_SCALE: f64 = 2.0;
/// Added to the diagonals of what is eliminated, over their sum: pictures without blur tell neither
/// length nor time of an exposure.
const RIDGE: f64 = 1e-9;

/// Mean light along a motion as a picture shows it whose linear values have to be raised to `power`, in
/// logarithms of its linear values.
struct MeanLight {
    log: f64,
    by_power: f64,
    /// By the length of the motion, in parts of it.
    by_length: f64,
    /// By the time of the exposure, in exposures.
    by_time: f64,
}

impl MeanLight {
    /// Of logarithms of linear values at even intervals.
    fn new(logs: &[f64; MOMENTS], power: f64) -> Self {
        let mean = logs.iter().sum::<f64>() / MOMENTS as f64;
        let raised = logs.map(|log| (power * (log - mean)).exp());
        let sum = raised.iter().sum::<f64>() / MOMENTS as f64;
        let products = logs.iter().zip(raised).map(|(log, r)| (log - mean) * r);
        let by_power = products.sum::<f64>() / (MOMENTS as f64 * sum);
        // Half an interval beyond the first and the last moment.
        let ends = [[0, 1], [MOMENTS - 1, MOMENTS - 2]]
            .map(|[end, next]| (1.5 * raised[end] - 0.5 * raised[next]) / sum);
        let log = sum.ln();
        Self {
            log: mean + log / power,
            by_power: by_power / power - log / (power * power),
            by_length: (0.5 * (ends[0] + ends[1]) - 1.0) / power,
            by_time: (ends[1] - ends[0]) / power,
        }
    }
}

/// A residual, with the derivatives of what is predicted by the unknown in common and by two of the pair,
/// and the instruments of these.
#[derive(Clone, Copy)]
struct Term {
    residual: f64,
    derivatives: [f64; UNKNOWNS],
    instruments: [f64; UNKNOWNS],
}

/// The unknown in common, and two of each pair of pictures.
const UNKNOWNS: usize = 3;

/// Terms of a pair of pictures, by channel, each of which has a gain of its own.
type PairTerms = [Vec<Term>; 3];

impl Term {
    /// Takes off what changes of the unknowns explain.
    fn change(&mut self, steps: [f64; UNKNOWNS]) {
        let explained = self.derivatives.iter().zip(steps).map(|(d, step)| d * step);
        self.residual -= explained.sum::<f64>();
    }
}

fn median_residual(channel: &[Term]) -> f64 {
    let mut residuals: Vec<f64> = channel.iter().map(|term| term.residual).collect();
    median(&mut residuals).unwrap_or(0.0)
}

/// Robust deviation of the residuals of all pairs from the medians of their channels; `None` of none.
fn deviation<'a>(pairs: impl Iterator<Item = &'a PairTerms>) -> Option<f64> {
    let mut all = Vec::new();
    for channel in pairs.flatten() {
        let centre = median_residual(channel);
        all.extend(channel.iter().map(|term| (term.residual - centre).abs()));
    }
    let sigma = SIGMA_PER_MEDIAN * median(&mut all)?;
    (sigma > 0.0 && sigma.is_finite()).then_some(sigma)
}

/// Weighted sums of the products of instruments with residual, derivatives and instruments of a pair of
/// pictures, less their means in each channel.
#[derive(Default)]
struct Products {
    residual: [f64; UNKNOWNS],
    derivatives: [[f64; UNKNOWNS]; UNKNOWNS],
    instruments: [[f64; UNKNOWNS]; UNKNOWNS],
}

impl Products {
    /// With the robust deviation of all residuals.
    fn new(channels: &PairTerms, sigma: f64) -> Self {
        let mut products = Self::default();
        for channel in channels.iter().filter(|channel| !channel.is_empty()) {
            let (centre, scale) = (median_residual(channel), LOSS_SCALE * sigma);
            let weight = |term: &Term| (1.0 + ((term.residual - centre) / scale).powi(2)).powi(-2);
            let weights: Vec<f64> = channel.iter().map(weight).collect();
            let total: f64 = weights.iter().sum();
            let mean = |value: &dyn Fn(&Term) -> f64| {
                weights.iter().zip(channel).map(|(w, term)| w * value(term)).sum::<f64>() / total
            };
            let residual = mean(&|term| term.residual);
            let derivatives: [f64; UNKNOWNS] = std::array::from_fn(|k| mean(&|t| t.derivatives[k]));
            let instruments: [f64; UNKNOWNS] = std::array::from_fn(|k| mean(&|t| t.instruments[k]));
            for (w, term) in weights.iter().zip(channel) {
                for (row, instrument) in term.instruments.iter().enumerate() {
                    let left = w * (instrument - instruments[row]);
                    products.residual[row] += left * (term.residual - residual);
                    for k in 0..UNKNOWNS {
                        let (derivative, other) = (term.derivatives[k], term.instruments[k]);
                        products.derivatives[row][k] += left * (derivative - derivatives[k]);
                        products.instruments[row][k] += left * (other - instruments[k]);
                    }
                }
            }
        }
        products
    }

    /// Unknowns of the pair that explain a column of products best.
    fn of_pair(&self, column: [f64; UNKNOWNS]) -> [f64; 2] {
        let [_, [_, a, b], [_, c, d]] = self.derivatives;
        let ridge = RIDGE * (a.abs() + d.abs());
        let (a, d) = (a + ridge, d + ridge);
        let determinant = a * d - b * c;
        if a <= 0.0 || d <= 0.0 || determinant <= 0.0 {
            return [0.0; 2];
        }
        let [_, first, second] = column;
        [(d * first - b * second) / determinant, (a * second - c * first) / determinant]
    }

    /// Product of the first instrument with a column, without what the unknowns of the pair explain of it.
    fn without_pair(&self, column: [f64; UNKNOWNS]) -> f64 {
        let [first, second] = self.of_pair(column);
        column[0] - first * self.derivatives[0][1] - second * self.derivatives[0][2]
    }

    /// `[Σ w z r, Σ w z d]` of instrument, residual and derivative of the unknown in common.
    fn reduced(&self) -> [f64; 2] {
        let derivative = self.derivatives.map(|row| row[0]);
        [self.residual, derivative].map(|column| self.without_pair(column))
    }

    /// `Σ w z²`.
    fn instrument_square(&self) -> f64 {
        self.without_pair(self.instruments.map(|row| row[0])).max(0.0)
    }

    /// Changes of all unknowns, that in common given.
    fn steps(&self, common: f64) -> [f64; UNKNOWNS] {
        let rest = |row: usize| self.residual[row] - common * self.derivatives[row][0];
        let [first, second] = self.of_pair(std::array::from_fn(rest));
        [common, first, second]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::noise;

    /// Terms whose derivatives are seen with noise that is in the residual, too.
    fn terms(unknowns: [f64; UNKNOWNS], seed: u64) -> PairTerms {
        let term = |at: u64| {
            let random = noise(1000 * seed + at, 9);
            let truth: [f64; UNKNOWNS] = std::array::from_fn(|k| random[k]);
            let [seen, again] =
                [3, 6].map(|from| std::array::from_fn(|k| truth[k] + 0.7 * random[from + k]));
            let explained: f64 = truth.iter().zip(unknowns).map(|(d, x)| d * x).sum();
            // Noise of the derivative by the unknown in common.
            let residual = explained - 0.3 * random[3];
            Term { residual, derivatives: seen, instruments: again }
        };
        std::array::from_fn(|channel| {
            (0..3000).map(|i| term(10_000 * channel as u64 + i)).collect()
        })
    }

    fn estimate(mut terms: PairTerms) -> [f64; UNKNOWNS] {
        let mut found = [0.0; UNKNOWNS];
        for _ in 0..8 {
            let products = Products::new(&terms, deviation([&terms].into_iter()).expect("noise"));
            let [gradient, slope] = products.reduced();
            let steps = products.steps(gradient / slope);
            terms.iter_mut().flatten().for_each(|term| term.change(steps));
            found = std::array::from_fn(|k| found[k] + steps[k]);
        }
        found
    }

    #[test]
    fn instruments_remove_the_bias_of_noise() {
        let truth = [0.5, -0.3, 0.2];
        let terms = terms(truth, 1);
        let found = estimate(terms.clone());
        (0..UNKNOWNS).for_each(|k| assert!((found[k] - truth[k]).abs() < 0.06, "{found:?}"));
        let own = terms.map(|channel| {
            channel.into_iter().map(|t| Term { instruments: t.derivatives, ..t }).collect()
        });
        assert!((estimate(own)[0] - truth[0]).abs() > 0.15);
    }
}
