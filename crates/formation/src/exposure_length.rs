//! Length of the motion during an exposure, from pictures of one surface.
//!
//! A map that was made of blurred pictures is blurred itself, and explains them by too short a motion.
//! Two pictures tell it without a map, because blurs commute: with `m_A` and `m_B` the motions of a
//! surface point through pictures `A` and `B` while the shutter is open, and `g` the gain between them,
//!
//! ```text
//! ln mean_v A(x + v m_B) = ln mean_u B(x + u m_A) + g        u, v from -½ to ½
//! ```
//!
//! Each picture is averaged along the motion of the other one. Where the square of `m_A` is `s` times as
//! long, the right side changes by `d = ½ ((E_first + E_last)/2 - 1)` per `s`, with
//! `E_u = B(x + u m_A) / mean B`. Noise of `B` is in `d` as well as in the residual `r`, and would lengthen
//! the motion by a tenth; the same derivative `z` in a third picture `C` has noise of its own, and is the
//! instrument of the estimate (two-stage least squares)
//!
//! ```text
//! s = 1 + Σ w z r / Σ w z d
//! ```
//!
//! with Geman and McClure's weights `w`. An error of the time of an exposure shifts its picture along its
//! motion and is an unknown of each pair of pictures, as is `g` of each channel.

use crate::response_estimate::MOMENTS;
use i2slam_compute::{SIGMA_PER_MEDIAN, median};

/// Pictures that one is compared with.
pub const PARTNERS: usize = 3;

/// Fewest residuals.
const MIN_RESIDUALS: usize = 2000;
/// Residuals of a point that may have errors in common: those of all channels and partners.
const REPEATS: f64 = 3.0 * PARTNERS as f64;
/// Steps of reweighted least squares.
const STEPS: usize = 5;
/// Scale of the weights, in robust deviations of the residuals.
const LOSS_SCALE: f64 = 2.0;
/// Added to the diagonal of the unknown times, over their sum.
const RIDGE: f64 = 1e-6;

/// A surface point in a picture whose motion is sought and in another one, in one channel: logarithms of
/// linear values at even intervals of an exposure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SharedPoint {
    /// In the picture whose motion is sought, along the motion of the other.
    pub own: [f64; MOMENTS],
    /// In the other picture, along the motion that is sought.
    pub other: [f64; MOMENTS],
}

/// A surface point in the pictures that show it.
pub type SurfacePoint = [Option<SharedPoint>; PARTNERS];

/// Square of the length of a motion over that of the length that its points were sampled with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SquaredLength {
    /// Below 0 where noise outweighs a short motion.
    pub ratio: f64,
    /// Standard deviation of the ratio.
    pub deviation: f64,
}

/// Residual of a point, derivatives of what is predicted, and the instrument.
type Term = [f64; TERMS];
const TERMS: usize = 5;
const RESIDUAL: usize = 0;
const LENGTH: usize = 1;
const TIMES: [usize; 2] = [2, 3];
const INSTRUMENT: usize = 4;

/// Terms of a pair of pictures by channel.
type PairTerms = [Vec<Term>; 3];
type Products = [[f64; TERMS]; TERMS];

impl SharedPoint {
    fn term(&self) -> Term {
        let (own, own_ends) = log_mean(&self.own);
        let (other, ends) = log_mean(&self.other);
        let by_length = 0.5 * (0.5 * (ends[0] + ends[1]) - 1.0);
        [own - other, by_length, ends[1] - ends[0], own_ends[1] - own_ends[0], 0.0]
    }
}

/// Logarithm of the mean light, and the light at both ends of the exposure over it.
fn log_mean(logs: &[f64; MOMENTS]) -> (f64, [f64; 2]) {
    let light = logs.map(|log| (log - logs[0]).exp());
    let mean = light.iter().sum::<f64>() / MOMENTS as f64;
    // Half an interval beyond the first and the last moment.
    let ends = [[0, 1], [MOMENTS - 1, MOMENTS - 2]]
        .map(|[end, next]| (1.5 * light[end] - 0.5 * light[next]) / mean);
    (logs[0] + mean.ln(), ends)
}

/// The squared length of a picture's motion that explains what it and others show at `points`, by channel;
/// `None` of too few points that three pictures show, or without texture.
pub fn squared_length(points: &[Vec<SurfacePoint>; 3]) -> Option<SquaredLength> {
    let mut pairs = terms(points);
    if pairs.iter().flatten().map(Vec::len).sum::<usize>() < MIN_RESIDUALS {
        return None;
    }
    let mut found = SquaredLength { ratio: 1.0, deviation: f64::INFINITY };
    for _ in 0..STEPS {
        let sigma = deviation(&pairs)?;
        let products: Vec<Products> =
            pairs.iter().map(|pair| products_of_pair(pair, LOSS_SCALE * sigma)).collect();
        let sum = |column| products.iter().map(|p| without_times(p, column)).sum::<f64>();
        let slope = sum(LENGTH);
        let step = sum(RESIDUAL) / slope;
        if !(step.is_finite() && slope > 0.0) {
            return None;
        }
        found.ratio += step;
        found.deviation = sigma * (REPEATS * sum(INSTRUMENT)).max(0.0).sqrt() / slope;
        for (pair, products) in pairs.iter_mut().zip(&products) {
            let times = explaining_times(products, |row| row[RESIDUAL] - step * row[LENGTH]);
            for term in pair.iter_mut().flatten() {
                let shift = times[0] * term[TIMES[0]] + times[1] * term[TIMES[1]];
                term[RESIDUAL] -= step * term[LENGTH] + shift;
            }
        }
    }
    Some(found)
}

/// Terms of each pair of pictures, of points that a third one shows.
fn terms(points: &[Vec<SurfacePoint>; 3]) -> Vec<PairTerms> {
    let mut pairs = vec![PairTerms::default(); PARTNERS];
    for (channel, points) in points.iter().enumerate() {
        for point in points {
            let terms = point.map(|shared| shared.as_ref().map(SharedPoint::term));
            let seen = terms.iter().flatten().count();
            let sum: f64 = terms.iter().flatten().map(|term| term[LENGTH]).sum();
            if seen < 2 {
                continue;
            }
            for (pair, term) in pairs.iter_mut().zip(terms) {
                let Some(mut term) = term else { continue };
                term[INSTRUMENT] = (sum - term[LENGTH]) / (seen - 1) as f64;
                pair[channel].push(term);
            }
        }
    }
    pairs.retain(|pair| pair.iter().any(|channel| !channel.is_empty()));
    pairs
}

fn median_residual(channel: &[Term]) -> Option<f64> {
    median(&mut channel.iter().map(|term| term[RESIDUAL]).collect::<Vec<f64>>())
}

/// Robust deviation of the residuals from the medians of their channels.
fn deviation(pairs: &[PairTerms]) -> Option<f64> {
    let mut all = Vec::new();
    for channel in pairs.iter().flatten() {
        let Some(centre) = median_residual(channel) else { continue };
        all.extend(channel.iter().map(|term| (term[RESIDUAL] - centre).abs()));
    }
    let sigma = SIGMA_PER_MEDIAN * median(&mut all)?;
    (sigma > 0.0 && sigma.is_finite()).then_some(sigma)
}

/// Weighted sums of the products of all terms, less their means in each channel.
fn products_of_pair(channels: &PairTerms, scale: f64) -> Products {
    let mut products = Products::default();
    for channel in channels {
        let Some(centre) = median_residual(channel) else { continue };
        let weight = |term: &Term| (1.0 + ((term[RESIDUAL] - centre) / scale).powi(2)).powi(-2);
        let total: f64 = channel.iter().map(weight).sum();
        let mean: Term = std::array::from_fn(|k| {
            channel.iter().map(|term| weight(term) * term[k]).sum::<f64>() / total
        });
        for term in channel {
            let w = weight(term);
            for (a, row) in products.iter_mut().enumerate() {
                let left = w * (term[a] - mean[a]);
                (0..TERMS).for_each(|b| row[b] += left * (term[b] - mean[b]));
            }
        }
    }
    products
}

/// Errors of the times of both exposures that explain a column of the products best.
fn explaining_times(products: &Products, column: impl Fn(&Term) -> f64) -> [f64; 2] {
    let [i, j] = TIMES;
    let ridge = RIDGE * (products[i][i] + products[j][j]);
    let (a, b, c) = (products[i][i] + ridge, products[i][j], products[j][j] + ridge);
    let (first, second) = (column(&products[i]), column(&products[j]));
    let determinant = a * c - b * b;
    if determinant <= 0.0 {
        return [0.0; 2];
    }
    [(c * first - b * second) / determinant, (a * second - b * first) / determinant]
}

/// `Σ w z v` of the instrument `z` and a column `v`, without what the times explain of them.
fn without_times(products: &Products, column: usize) -> f64 {
    let row = &products[INSTRUMENT];
    let times = explaining_times(products, |row| row[column]);
    row[column] - times[0] * row[TIMES[0]] - times[1] * row[TIMES[1]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::{assert_gradient, noise};

    const PIXELS: usize = 500;
    /// Waves per pixel, at most, of the texture.
    const FINEST: f64 = 0.12;

    /// Logarithm of the light of a surface, with noise of a picture.
    struct Surface {
        waves: Vec<f64>,
        noise: Vec<f64>,
    }

    impl Surface {
        fn new(channel: u64, picture: u64, deviation: f64) -> Self {
            let noise = noise(31 * picture + channel + 7, PIXELS + 100);
            Self {
                waves: noise_of_waves(channel),
                noise: noise.iter().map(|n| n * deviation).collect(),
            }
        }

        /// Mean light of `length` pixels around a place, as its logarithm; the noise is interpolated.
        fn at(&self, place: f64, length: f64) -> f64 {
            let moments = if length > 0.0 { 48 } else { 1 };
            let light = |moment: usize| {
                let x = place + length * ((moment as f64 + 0.5) / moments as f64 - 0.5);
                let waves = self.waves.chunks_exact(3);
                waves
                    .map(|w| 0.25 * (std::f64::consts::TAU * FINEST * w[0] * x + 3.0 * w[1]).sin())
                    .sum::<f64>()
                    .exp()
            };
            let mean = (0..moments).map(light).sum::<f64>() / moments as f64;
            let (pixel, share) = ((place + 20.0).floor(), (place + 20.0).fract());
            let [here, next] = [0, 1].map(|i| self.noise[pixel as usize + i]);
            mean.ln() + here * (1.0 - share) + next * share
        }
    }

    fn noise_of_waves(channel: u64) -> Vec<f64> {
        noise(1000 + channel, 24)
    }

    /// A picture that moved by `length` pixels, and others that moved by `other`, sampled along `assumed`.
    fn points(
        [length, other, assumed]: [f64; 3],
        deviation: f64,
        partners: [u64; 3],
    ) -> [Vec<SurfacePoint>; 3] {
        let moment = |m: usize| (m as f64 + 0.5) / MOMENTS as f64 - 0.5;
        std::array::from_fn(|channel| {
            let picture = |number| Surface::new(channel as u64, number, deviation);
            let (own, others) = (picture(0), partners.map(picture));
            let point = |pixel: usize| {
                let place = 10.0 + pixel as f64;
                let in_own = std::array::from_fn(|m| own.at(place + other * moment(m), length));
                let along = |surface: &Surface| SharedPoint {
                    own: in_own,
                    other: std::array::from_fn(|m| surface.at(place + assumed * moment(m), other)),
                };
                others.each_ref().map(|surface| Some(along(surface)))
            };
            (0..PIXELS).map(point).collect()
        })
    }

    fn found_length(length: f64, other: f64, deviation: f64, partners: [u64; 3]) -> f64 {
        let mut assumed = 0.6 * length;
        for _ in 0..4 {
            let points = points([length, other, assumed], deviation, partners);
            let found = squared_length(&points).expect("texture");
            assumed *= found.ratio.sqrt();
        }
        assumed
    }

    #[test]
    fn noisy_pictures_tell_the_length() {
        for (length, other) in [(3.0, 0.0), (6.0, 0.0), (6.0, 3.0)] {
            let found = found_length(length, other, 0.04, [1, 2, 3]);
            assert!((found / length - 1.0).abs() < 0.04, "{length} {other}: {found}");
        }
    }

    /// The same noise in derivative and residual lengthens the motion.
    #[test]
    fn an_instrument_needs_noise_of_its_own() {
        let [apart, same] =
            [[1, 2, 3], [1, 1, 1]].map(|partners| found_length(3.0, 0.0, 0.16, partners));
        assert!((apart / 3.0 - 1.0).abs() < 0.1 && same > apart + 0.1, "{same} {apart}");
    }

    #[test]
    fn three_pictures_are_enough_and_two_tell_nothing() {
        let mut points = points([3.0, 0.0, 3.0], 0.04, [1, 2, 3]);
        points.iter_mut().flatten().for_each(|point| point[2] = None);
        let found = squared_length(&points).expect("texture");
        assert!((found.ratio - 1.0).abs() < 0.1, "{found:?}");
        points.iter_mut().flatten().for_each(|point| point[1] = None);
        assert_eq!(squared_length(&points), None);
    }

    /// A blurred value by the length that its picture moved, in steps that the samples resolve.
    #[test]
    fn slope_by_length_agrees_with_differences() {
        let surface = Surface::new(0, 0, 0.0);
        for pixel in 0..20 {
            let place = 10.0 + f64::from(pixel);
            let sample = |m| surface.at(place + 2.0 * ((f64::from(m) + 0.5) / 12.0 - 0.5), 0.0);
            let shared = SharedPoint {
                own: [0.0; MOMENTS],
                other: std::array::from_fn(|m| sample(m as u32)),
            };
            let slope = [shared.term()[LENGTH]];
            let by_length = |s: &[f64]| surface.at(place, 2.0 * s[0].sqrt());
            assert_gradient("length", &[1.0], &slope, 1e-4, 0.05, by_length);
        }
    }
}
