//! Length of the motion during an exposure, from pictures of one surface.
//!
//! A map that was made of blurred pictures is blurred itself, and explains them by too short a motion.
//! Two pictures tell it without the colours of a map, because blurs commute: with `m_A` and `m_B` the motions of a
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

use super::{MOMENTS, MeanLight, PairTerms, Products, Term, deviation};

/// Pictures that one is compared with.
pub const PARTNERS: usize = 3;

/// Fewest residuals.
const MIN_RESIDUALS: usize = 2000;
/// Residuals of a point that may have errors in common: those of all channels and partners.
const REPEATS: f64 = 3.0 * PARTNERS as f64;
/// Steps of reweighted least squares.
const STEPS: usize = 5;

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

impl SharedPoint {
    /// Without instrument of the squared length; the other unknowns are the times of both exposures.
    fn term(&self) -> Term {
        let [own, other] = [&self.own, &self.other].map(|logs| MeanLight::new(logs, 1.0));
        let derivatives = [0.5 * other.by_length, other.by_time, own.by_time];
        Term { residual: own.log - other.log, derivatives, instruments: derivatives }
    }
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
        let sigma = deviation(pairs.iter())?;
        let products: Vec<Products> = pairs.iter().map(|pair| Products::new(pair, sigma)).collect();
        let [gradient, slope] = products
            .iter()
            .map(Products::reduced)
            .fold([0.0; 2], |sum, reduced| [sum[0] + reduced[0], sum[1] + reduced[1]]);
        let step = gradient / slope;
        if !(step.is_finite() && slope > 0.0) {
            return None;
        }
        found.ratio += step;
        let square: f64 = products.iter().map(Products::instrument_square).sum();
        found.deviation = sigma * (REPEATS * square).sqrt() / slope;
        for (pair, products) in pairs.iter_mut().zip(&products) {
            let steps = products.steps(step);
            pair.iter_mut().flatten().for_each(|term| term.change(steps));
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
            let sum: f64 = terms.iter().flatten().map(|term| term.derivatives[0]).sum();
            if seen < 2 {
                continue;
            }
            for (pair, term) in pairs.iter_mut().zip(terms) {
                let Some(mut term) = term else { continue };
                term.instruments[0] = (sum - term.derivatives[0]) / (seen - 1) as f64;
                pair[channel].push(term);
            }
        }
    }
    pairs.retain(|pair| pair.iter().any(|channel| !channel.is_empty()));
    pairs
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

    /// Noise that derivative and residual have in common lengthens the motion.
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
            let slope = [shared.term().derivatives[0]];
            let by_length = |s: &[f64]| surface.at(place, 2.0 * s[0].sqrt());
            assert_gradient("length", &[1.0], &slope, 1e-4, 0.05, by_length);
        }
    }
}
