//! The power of a response from motion blur.
//!
//! Pictures of different exposure tell a response up to a power `p` of linear values. Blur tells the
//! power: it is the mean of light, so that a blurred edge between dark and bright is the brighter, the
//! larger the range of light between the same two picture values. With `ℓ = h(y)` the logarithm of
//! linear values by a response whose power is unknown, a blurred pixel that saw the places `u` of a
//! sharp picture during its exposure has
//!
//! ```text
//! ℓ = (1/p) ln mean_u exp(p ℓ_u) + g
//! ```
//!
//! with the gain `g` of the channel: the power mean of order `p`, about `mean ℓ_u + p var ℓ_u / 2`. A longer
//! exposure widens the range, too, so that its length and its time are unknowns of each pair of pictures
//! beside `p`; with `E_u = exp(p ℓ_u) / mean exp(p ℓ)` their derivatives are
//!
//! ```text
//! ((E_first + E_last)/2 - 1) / p   and   (E_last - E_first) / p
//! ```
//!
//! Gauss-Newton with Geman and McClure's weights, all but `p` eliminated.

use i2slam_compute::{SIGMA_PER_MEDIAN, median};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Moments of an exposure.
pub const MOMENTS: usize = 12;

/// Steps of Gauss-Newton; eight reach the optimum.
const STEPS: usize = 15;
/// Bounds of the power: beyond, the geometry is wrong, not the response.
const BOUNDS: [f64; 2] = [0.4, 2.5];
/// Fewest pixels, and blurred pictures.
const MIN_PIXELS: usize = 1000;
const MIN_PICTURES: usize = 2;
/// Most that length and time of an exposure are off \[exposures\].
const MAX_MOTION: f64 = 0.5;
/// Added to the diagonals of what is eliminated, over their sum: pictures without blur tell neither
/// length nor time of the exposure.
const RIDGE: f64 = 1e-9;
/// Scale of the weights, in robust deviations of the residuals.
const LOSS_SCALE: f64 = 2.0;

/// A pixel of a blurred picture in one channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlurredPixel {
    /// Logarithm of its linear value.
    pub blurred: f64,
    /// Logarithms of the linear values that a sharp picture has at the places that the pixel saw, at even
    /// intervals of the exposure.
    pub sharp: [f64; MOMENTS],
}

/// Pixels of a blurred picture that a sharp one explains.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct BlurPair {
    /// Number of the blurred picture.
    pub picture: usize,
    /// Pixels in red, green and blue.
    pub channels: [Vec<BlurredPixel>; 3],
}

/// A power of linear values, found from blur.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PowerEstimate {
    /// `p`.
    pub power: f64,
    /// Standard deviation of `p` by the scatter between blurred pictures.
    pub deviation: f64,
}

/// Residual of a pixel and the derivatives of what is predicted.
#[derive(Clone, Copy)]
struct Term {
    /// Observed less predicted, then the derivatives by `p`, length and time of the exposure.
    values: [f64; 4],
}

const RESIDUAL: usize = 0;
const POWER: usize = 1;
const LENGTH: usize = 2;
const TIME: usize = 3;

impl BlurredPixel {
    fn term(&self, power: f64) -> Term {
        let mean = self.sharp.iter().sum::<f64>() / MOMENTS as f64;
        let raised = self.sharp.map(|log| (power * (log - mean)).exp());
        let sum = raised.iter().sum::<f64>() / MOMENTS as f64;
        let products = self.sharp.iter().zip(raised).map(|(log, r)| (log - mean) * r);
        let by_power = products.sum::<f64>() / (MOMENTS as f64 * sum);
        // Half an interval beyond the first and the last moment.
        let ends = [[0, 1], [MOMENTS - 1, MOMENTS - 2]]
            .map(|[end, next]| (1.5 * raised[end] - 0.5 * raised[next]) / sum);
        let log = sum.ln();
        let residual = self.blurred - mean - log / power;
        let length = (0.5 * (ends[0] + ends[1]) - 1.0) / power;
        let time = (ends[1] - ends[0]) / power;
        Term { values: [residual, by_power / power - log / (power * power), length, time] }
    }
}

/// The power that explains the blur of pairs of pictures; `None` of too little blur.
pub fn estimate_power(pairs: &[BlurPair]) -> Option<PowerEstimate> {
    let pixels = pairs.iter().flat_map(|pair| &pair.channels).map(Vec::len).sum::<usize>();
    let used = pairs.iter().filter(|pair| pair.channels.iter().any(|c| !c.is_empty()));
    let pictures = used.map(|pair| pair.picture).collect::<BTreeSet<usize>>().len();
    if pixels < MIN_PIXELS || pictures < MIN_PICTURES {
        return None;
    }
    let mut estimate = PowerEstimate { power: 1.0, deviation: f64::INFINITY };
    let mut motions = vec![Motion::default(); pairs.len()];
    for _ in 0..STEPS {
        let products = products_of_pairs(pairs, estimate.power, &motions)?;
        let reduced = products.iter().map(|products| products.without_motion());
        let mut sums: BTreeMap<usize, [f64; 2]> = BTreeMap::new();
        for (pair, [gradient, curvature]) in pairs.iter().zip(reduced) {
            let sum = sums.entry(pair.picture).or_default();
            *sum = [sum[0] + gradient, sum[1] + curvature];
        }
        let curvature: f64 = sums.values().map(|sums| sums[1]).sum();
        let step = sums.values().map(|sums| sums[0]).sum::<f64>() / curvature;
        if !step.is_finite() {
            return None;
        }
        // What each picture asks for beyond the common step.
        let scatter = sums.values().map(|sums| (sums[0] - step * sums[1]).powi(2)).sum::<f64>();
        let freedom = pictures as f64 / (pictures as f64 - 1.0);
        estimate.deviation = (freedom * scatter).sqrt() / curvature;
        let power = (estimate.power + step).clamp(BOUNDS[0], BOUNDS[1]);
        let taken = power - estimate.power;
        estimate.power = power;
        for (motion, products) in motions.iter_mut().zip(&products) {
            motion.step(products, taken);
        }
    }
    let is_inside = BOUNDS[0] < estimate.power && estimate.power < BOUNDS[1];
    (is_inside && estimate.deviation.is_finite()).then_some(estimate)
}

/// What is wrong with the exposure of a blurred picture, in exposures.
#[derive(Clone, Copy, Default)]
struct Motion {
    length: f64,
    time: f64,
}

impl Motion {
    /// Residual of a term with this motion.
    fn residual(&self, term: &Term) -> f64 {
        let values = &term.values;
        values[RESIDUAL] - self.length * values[LENGTH] - self.time * values[TIME]
    }

    fn step(&mut self, products: &Products, power_step: f64) {
        let [length, time] = products.motion(|sums| sums[RESIDUAL] - power_step * sums[POWER]);
        self.length = (self.length + length).clamp(-MAX_MOTION, MAX_MOTION);
        self.time = (self.time + time).clamp(-MAX_MOTION, MAX_MOTION);
    }
}

/// Weighted sums of the products of residual and derivatives, less their means in each channel.
struct Products([[f64; 4]; 4]);

impl Products {
    /// Length and time of the exposure that explain a column of the products best.
    fn motion(&self, column: impl Fn(&[f64; 4]) -> f64) -> [f64; 2] {
        let sums = &self.0;
        let ridge = RIDGE * (sums[LENGTH][LENGTH] + sums[TIME][TIME]);
        let (a, b, c) =
            (sums[LENGTH][LENGTH] + ridge, sums[LENGTH][TIME], sums[TIME][TIME] + ridge);
        let (length, time) = (column(&sums[LENGTH]), column(&sums[TIME]));
        let determinant = a * c - b * b;
        if determinant <= 0.0 {
            return [0.0; 2];
        }
        [(c * length - b * time) / determinant, (a * time - b * length) / determinant]
    }

    /// `[Σ w v e, Σ w v²]`, `v` and `e` being derivative by `p` and residual without what length and time
    /// of the exposure explain of them.
    fn without_motion(&self) -> [f64; 2] {
        let power = &self.0[POWER];
        let of = |column: usize| {
            let [length, time] = self.motion(|sums| sums[column]);
            power[column] - length * power[LENGTH] - time * power[TIME]
        };
        [of(RESIDUAL), of(POWER).max(0.0)]
    }
}

fn products_of_pairs(pairs: &[BlurPair], power: f64, motions: &[Motion]) -> Option<Vec<Products>> {
    let terms = |(pair, motion): (&BlurPair, &Motion)| -> [Vec<Term>; 3] {
        let term = |pixel: &BlurredPixel| {
            let mut term = pixel.term(power);
            term.values[RESIDUAL] = motion.residual(&term);
            term
        };
        std::array::from_fn(|c| pair.channels[c].iter().map(term).collect())
    };
    let terms: Vec<[Vec<Term>; 3]> = pairs.par_iter().zip(motions).map(terms).collect();
    let distances = |channel: &Vec<Term>| {
        let centre = median_residual(channel);
        channel.iter().map(|t| (t.values[RESIDUAL] - centre).abs()).collect::<Vec<f64>>()
    };
    let mut all: Vec<f64> = terms.par_iter().flatten_iter().flat_map_iter(distances).collect();
    let scale = LOSS_SCALE * SIGMA_PER_MEDIAN * median(&mut all)?;
    let is_scale = scale > 0.0 && scale.is_finite();
    is_scale.then(|| terms.par_iter().map(|t| products_of_pair(t, scale)).collect())
}

fn median_residual(channel: &[Term]) -> f64 {
    let mut residuals: Vec<f64> = channel.iter().map(|term| term.values[RESIDUAL]).collect();
    median(&mut residuals).unwrap_or(0.0)
}

fn products_of_pair(channels: &[Vec<Term>; 3], scale: f64) -> Products {
    let mut products = [[0.0; 4]; 4];
    for channel in channels.iter().filter(|channel| !channel.is_empty()) {
        let centre = median_residual(channel);
        let weight =
            |term: &Term| (1.0 + ((term.values[RESIDUAL] - centre) / scale).powi(2)).powi(-2);
        let total: f64 = channel.iter().map(weight).sum();
        let mean: [f64; 4] = std::array::from_fn(|k| {
            channel.iter().map(|term| weight(term) * term.values[k]).sum::<f64>() / total
        });
        for term in channel {
            let (w, values) = (weight(term), term.values);
            for (a, row) in products.iter_mut().enumerate() {
                let left = w * (values[a] - mean[a]);
                (0..4).for_each(|b| row[b] += left * (values[b] - mean[b]));
            }
        }
    }
    Products(products)
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::{assert_gradient, noise};

    /// Pairs of pictures in which pixels saw edges of several heights, by a response whose linear values
    /// have to be raised to `power`; one pixel in ten is of something else.
    fn pairs(power: f64, length: f64, count: u64) -> Vec<BlurPair> {
        let pixel = |seed: u64, gain: f64| {
            let random = noise(seed, 8);
            let (height, place) = (1.5 * random[0], 0.5 + 0.7 * random[1]);
            // An edge that takes a quarter of the exposure to pass.
            let light = |t: f64| height * ((t - place) * 4.0).clamp(-0.5, 0.5);
            let times = (0..600).map(|i| 0.5 + length * ((f64::from(i) + 0.5) / 600.0 - 0.5));
            let mean = times.map(|t| light(t).exp()).sum::<f64>() / 600.0;
            let at = |u: usize| light((u as f64 + 0.5) / MOMENTS as f64);
            let other = if seed.is_multiple_of(10) { random[2] } else { 0.0 };
            BlurredPixel {
                blurred: (mean.ln() + gain + other + 0.03 * random[3]) / power,
                sharp: std::array::from_fn(|u| (at(u) + 0.03 * random[4 + u % 4]) / power),
            }
        };
        let channel = |pair: u64, c: u64| {
            let gain = noise(1000 + pair, 3)[c as usize];
            (0..400).map(|i| pixel(10_000 * pair + 3 * i + c, gain)).collect()
        };
        let pair = |pair: u64| BlurPair {
            picture: pair as usize / 2,
            channels: std::array::from_fn(|c| channel(pair, c as u64)),
        };
        (0..count).map(pair).collect()
    }

    #[test]
    fn blur_tells_the_power() {
        for power in [0.7, 1.0, 1.4] {
            let found = estimate_power(&pairs(power, 1.0, 6)).expect("blur");
            let error = (found.power / power - 1.0).abs();
            assert!(error < 0.05 && found.deviation < 0.05, "{power}: {found:?}");
        }
    }

    #[test]
    fn exposures_that_are_longer_than_known_change_little() {
        for length in [0.9, 1.15] {
            let found = estimate_power(&pairs(1.0, length, 6)).expect("blur");
            assert!((found.power - 1.0).abs() < 0.07, "{length}: {found:?}");
        }
    }

    #[test]
    fn pictures_without_blur_tell_nothing() {
        let mut sharp = pairs(1.0, 1.0, 6);
        for pixel in sharp.iter_mut().flat_map(|pair| pair.channels.iter_mut().flatten()) {
            pixel.sharp = [pixel.sharp[0]; MOMENTS];
        }
        assert_eq!(estimate_power(&sharp), None);
        assert_eq!(estimate_power(&pairs(1.0, 1.0, 2)), None);
        assert_eq!(estimate_power(&[]), None);
    }

    #[test]
    fn slope_of_a_prediction_agrees_with_differences() {
        for seed in 1..6 {
            let random = noise(seed, MOMENTS);
            let pixel = BlurredPixel { blurred: 0.2, sharp: std::array::from_fn(|u| random[u]) };
            let slope = [pixel.term(0.8).values[POWER]];
            let residual = |x: &[f64]| -pixel.term(x[0]).values[RESIDUAL];
            assert_gradient("power", &[0.8], &slope, 1e-5, 1e-6, residual);
        }
    }
}
