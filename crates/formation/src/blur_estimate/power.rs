//! The power of a response from motion blur.
//!
//! Pictures of different exposure tell a response up to a power `p` of linear values. Blur tells the
//! power: it is the mean of light, so that a blurred edge between dark and bright is the brighter, the
//! larger the range of light between the same two picture values. With `ℓ = h(y)` the logarithm of
//! linear values by a response whose power is unknown, a pixel that saw the places `u` of a sharper picture
//! during the exposure of the blurred one, and the places `v` of the blurred one during that of the sharper
//! one, has
//!
//! ```text
//! (1/p) ln mean_v exp(p ℓ_v) = (1/p) ln mean_u exp(p ℓ_u) + g
//! ```
//!
//! with the gain `g` of the channel: power means of order `p`, about `mean ℓ + p var ℓ / 2`. Both sides have
//! both blurs, so that the sharper picture need not be sharp. A longer exposure widens the range, too, so that
//! its length and its time are unknowns of each pair of pictures beside `p`; with
//! `E_u = exp(p ℓ_u) / mean exp(p ℓ)` their derivatives are
//!
//! ```text
//! ((E_first + E_last)/2 - 1) / p   and   (E_last - E_first) / p
//! ```
//!
//! Noise of the sharp picture is in these derivatives as well as in the residual, and lowers `p` by a tenth
//! where pictures are noisy; the same derivatives in a second sharp picture have noise of their own, and
//! are the instruments of the estimate (two-stage least squares). Gauss-Newton with Geman and McClure's
//! weights, all but `p` eliminated.

use super::{MOMENTS, MeanLight, PairTerms, Products, Term, UNKNOWNS, deviation, median_residual};
use i2slam_compute::{SIGMA_PER_MEDIAN, median};
use rayon::prelude::*;

/// Steps of Gauss-Newton at most, and the change of `p` and of all motions \[exposures\] below which one is
/// the last.
const STEPS: usize = 15;
const MIN_STEP: f64 = 1e-3;
/// Bounds of the power: beyond, the geometry is wrong, not the response.
const BOUNDS: [f64; 2] = [0.4, 2.5];
/// Fewest pixels, and blurred pictures: of fewer the scatter says nothing.
const MIN_PIXELS: usize = 1000;
const MIN_PICTURES: usize = 4;
/// Fewest pixels of a picture.
const MIN_PICTURE_PIXELS: usize = 200;
/// Most that length and time of an exposure are off \[exposures\].
const MAX_MOTION: f64 = 0.5;
/// Sharp pictures that each blurred one is compared with.
pub const SHARP_PICTURES: usize = 2;

/// A pixel of a blurred picture in one channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlurredPixel {
    /// Logarithms of the linear values of the blurred picture at the places that the pixel saw during the
    /// exposures of sharper ones, at even intervals.
    pub blurred: [[f64; MOMENTS]; SHARP_PICTURES],
    /// Logarithms of the linear values of the sharper pictures at the places that it saw during the exposure
    /// of the blurred one.
    pub sharp: [[f64; MOMENTS]; SHARP_PICTURES],
    /// Derivative of the logarithm of a linear value by the picture value, at that of the blurred picture.
    pub slope: f64,
}

/// Pixels of a blurred picture that sharp ones explain.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct BlurredPicture {
    /// Pixels in red, green and blue.
    pub channels: [Vec<BlurredPixel>; 3],
}

/// A power of linear values, found from blur.
#[derive(Clone, Debug, PartialEq)]
pub struct PowerEstimate {
    /// `p`.
    pub power: f64,
    /// Standard deviation of `p` by the scatter between blurred pictures.
    pub deviation: f64,
    /// Robust deviation of the residuals of each picture that counts, in picture values: the smaller, the
    /// nearer the response is to the true one, up to its power.
    pub residual_deviations: Vec<f64>,
}

impl PowerEstimate {
    /// Mean over pictures of the logarithm of the residuals' deviation over that of another response, and its
    /// standard deviation by the scatter between pictures.
    #[must_use]
    pub fn log_residual_ratio(&self, other: &Self) -> [f64; 2] {
        let pairs = self.residual_deviations.iter().zip(&other.residual_deviations);
        let ratios: Vec<f64> = pairs.map(|(own, other)| (own / other).ln()).collect();
        let count = ratios.len() as f64;
        let mean = ratios.iter().sum::<f64>() / count;
        let scatter = ratios.iter().map(|ratio| (ratio - mean).powi(2)).sum::<f64>();
        [mean, (student_variance(ratios.len()) * scatter).sqrt() / count]
    }
}

/// Factor of the variance of a sum of terms over the sum of their squared deviations from the mean: that of
/// Student's distribution, as the scatter is that of few.
fn student_variance(terms: usize) -> f64 {
    terms as f64 / (terms as f64 - 3.0)
}

impl BlurredPixel {
    /// Term of one sharp picture, with the other one as instrument; the unknowns are `p`, length and time of
    /// the exposure.
    fn term(&self, sharp: usize, power: f64) -> Term {
        let lights = |picture: usize| {
            [&self.blurred, &self.sharp].map(|of| MeanLight::new(&of[picture], power))
        };
        let derivatives = |[shown, predicted]: &[MeanLight; 2]| {
            [predicted.by_power - shown.by_power, predicted.by_length, predicted.by_time]
        };
        let own = lights(sharp);
        Term {
            residual: own[0].log - own[1].log,
            derivatives: derivatives(&own),
            instruments: derivatives(&lights(1 - sharp)),
        }
    }
}

/// The power that explains the blur of pictures; `None` of too little blur.
pub fn estimate_power(pictures: &[BlurredPicture]) -> Option<PowerEstimate> {
    let pixels_of = |picture: &BlurredPicture| picture.channels.iter().map(Vec::len).sum::<usize>();
    let used: Vec<&BlurredPicture> =
        pictures.iter().filter(|picture| pixels_of(picture) >= MIN_PICTURE_PIXELS).collect();
    let pixels = used.iter().map(|picture| pixels_of(picture)).sum::<usize>();
    let pictures = used.len();
    if pixels < MIN_PIXELS || pictures < MIN_PICTURES {
        return None;
    }
    let (mut found, mut deviation) = (1.0, f64::INFINITY);
    let mut motions = vec![[Motion::default(); SHARP_PICTURES]; pictures];
    for _ in 0..STEPS {
        let products = products_of_pictures(&used, found, &motions)?;
        let of_picture = |pair: &[Products; SHARP_PICTURES]| {
            let [first, second] = pair.each_ref().map(Products::reduced);
            [first[0] + second[0], first[1] + second[1]]
        };
        let sums: Vec<[f64; 2]> = products.iter().map(of_picture).collect();
        let curvature: f64 = sums.iter().map(|sums| sums[1]).sum();
        let step = sums.iter().map(|sums| sums[0]).sum::<f64>() / curvature;
        if !(step.is_finite() && curvature > 0.0) {
            return None;
        }
        // What each picture asks for beyond the common step.
        let scatter = sums.iter().map(|sums| (sums[0] - step * sums[1]).powi(2)).sum::<f64>();
        deviation = (student_variance(pictures) * scatter).sqrt() / curvature;
        let power = (found + step).clamp(BOUNDS[0], BOUNDS[1]);
        let taken = power - found;
        found = power;
        let pairs = motions.iter_mut().flatten().zip(products.iter().flatten());
        let moved = pairs.map(|(motion, products)| motion.step(products, taken));
        // The residuals of two responses are compared: their motions have to have converged, too.
        if moved.fold(taken.abs(), f64::max) < MIN_STEP {
            break;
        }
    }
    let is_inside = BOUNDS[0] < found && found < BOUNDS[1];
    let residual_deviations = residual_deviations(&used, found, &motions)?;
    let estimate = PowerEstimate { power: found, deviation, residual_deviations };
    (is_inside && deviation.is_finite()).then_some(estimate)
}

/// Errors of the exposure of a blurred picture, in exposures.
#[derive(Clone, Copy, Default)]
struct Motion {
    length: f64,
    time: f64,
}

impl Motion {
    /// Takes a step and returns the largest change.
    fn step(&mut self, products: &Products, power_step: f64) -> f64 {
        let before = *self;
        let [_, length, time] = products.steps(power_step);
        self.length = (self.length + length).clamp(-MAX_MOTION, MAX_MOTION);
        self.time = (self.time + time).clamp(-MAX_MOTION, MAX_MOTION);
        (self.length - before.length).abs().max((self.time - before.time).abs())
    }

    fn steps(&self) -> [f64; UNKNOWNS] {
        [0.0, self.length, self.time]
    }
}

/// Terms of the pairs of each picture.
fn terms_of_pictures(
    pictures: &[&BlurredPicture],
    power: f64,
    motions: &[[Motion; SHARP_PICTURES]],
) -> Vec<[PairTerms; SHARP_PICTURES]> {
    let terms = |(picture, motions): (&&BlurredPicture, &[Motion; SHARP_PICTURES])| {
        let term = |pixel: &BlurredPixel, sharp: usize| {
            let mut term = pixel.term(sharp, power);
            term.change(motions[sharp].steps());
            term
        };
        let of_pair = |sharp| -> PairTerms {
            let channels = picture.channels.each_ref();
            channels.map(|channel| channel.iter().map(|pixel| term(pixel, sharp)).collect())
        };
        std::array::from_fn(of_pair)
    };
    pictures.par_iter().zip(motions).map(terms).collect()
}

/// Robust deviation of the residuals of each picture, `1.4826 median |r - median r| / (d ln x/dy)` with the
/// inner median over the channel of a pair, in picture values; `None` where a picture has none.
fn residual_deviations(
    pictures: &[&BlurredPicture],
    power: f64,
    motions: &[[Motion; SHARP_PICTURES]],
) -> Option<Vec<f64>> {
    let terms = terms_of_pictures(pictures, power, motions);
    let of_picture = |(picture, pairs): (&&BlurredPicture, &[PairTerms; SHARP_PICTURES])| {
        let mut residuals = Vec::new();
        for (pixels, terms) in pairs.iter().flat_map(|pair| picture.channels.iter().zip(pair)) {
            let centre = median_residual(terms);
            let in_values = |(pixel, term): (&BlurredPixel, &Term)| {
                (term.residual - centre).abs() / pixel.slope
            };
            residuals.extend(pixels.iter().zip(terms).map(in_values));
        }
        Some(SIGMA_PER_MEDIAN * median(&mut residuals)?)
    };
    pictures.iter().zip(&terms).map(of_picture).collect()
}

fn products_of_pictures(
    pictures: &[&BlurredPicture],
    power: f64,
    motions: &[[Motion; SHARP_PICTURES]],
) -> Option<Vec<[Products; SHARP_PICTURES]>> {
    let terms = terms_of_pictures(pictures, power, motions);
    let sigma = deviation(terms.iter().flatten())?;
    let of_picture = |pairs: &[PairTerms; SHARP_PICTURES]| {
        pairs.each_ref().map(|terms| Products::new(terms, sigma))
    };
    Some(terms.par_iter().map(of_picture).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::{assert_gradient, noise};

    /// Motion of the sharper pictures over that of the blurred ones.
    const SHARP_MOTION: f64 = 0.4;

    /// Pairs of pictures in which pixels saw edges of several heights, by a response whose linear values
    /// have to be raised to `power`; one pixel in ten is of something else.
    fn pictures(power: f64, length: f64, count: u64) -> Vec<BlurredPicture> {
        let moment = |u: usize| (u as f64 + 0.5) / MOMENTS as f64;
        let pixel = |seed: u64, gain: f64| {
            let random = noise(seed, 12);
            let (height, place) = (1.5 * random[0], 0.5 + 0.7 * random[1]);
            // An edge that takes a quarter of the exposure to pass.
            let light = |t: f64| height * ((t - place) * 4.0).clamp(-0.5, 0.5);
            // Logarithm of the light of a motion of that length about a time.
            let mean = |time: f64, length: f64| {
                let times = (0..600).map(|i| time + length * ((f64::from(i) + 0.5) / 600.0 - 0.5));
                (times.map(|t| light(t).exp()).sum::<f64>() / 600.0).ln()
            };
            let other = if seed.is_multiple_of(10) { random[2] } else { 0.0 };
            let shown = |v: usize| {
                let light = mean(0.5 + SHARP_MOTION * (moment(v) - 0.5), length);
                (light + gain + other + 0.03 * random[3]) / power
            };
            let seen =
                |u: usize, noise: f64| (mean(moment(u), SHARP_MOTION) + 0.03 * noise) / power;
            BlurredPixel {
                blurred: [std::array::from_fn(shown); SHARP_PICTURES],
                sharp: [4, 8].map(|first| std::array::from_fn(|u| seen(u, random[first + u % 4]))),
                slope: 2.0,
            }
        };
        let channel = |pair: u64, c: u64| {
            let gain = noise(1000 + pair, 3)[c as usize];
            (0..400).map(|i| pixel(10_000 * pair + 3 * i + c, gain)).collect()
        };
        let picture = |number: u64| BlurredPicture {
            channels: std::array::from_fn(|c| channel(number, c as u64)),
        };
        (0..count).map(picture).collect()
    }

    #[test]
    fn blur_tells_the_power() {
        for power in [0.7, 1.0, 1.4] {
            let found = estimate_power(&pictures(power, 1.0, 6)).expect("blur");
            let error = (found.power / power - 1.0).abs();
            assert!(error < 0.05 && found.deviation < 0.05, "{power}: {found:?}");
        }
    }

    /// A bent response leaves more unexplained, whatever its power.
    #[test]
    fn the_residual_tells_the_shape_of_the_response() {
        let estimate = |bend: f64| {
            let mut pictures = pictures(1.0, 1.0, 6);
            let pixels = pictures.iter_mut().flat_map(|picture| picture.channels.iter_mut());
            for pixel in pixels.flatten() {
                let bent = |log: f64| log + bend * log * log;
                pixel.slope *= 1.0 + 2.0 * bend * pixel.blurred[0][MOMENTS / 2];
                pixel.blurred = pixel.blurred.map(|logs| logs.map(bent));
                pixel.sharp = pixel.sharp.map(|logs| logs.map(bent));
            }
            estimate_power(&pictures).expect("blur")
        };
        let [known, less, more] = [0.0, -0.1, 0.1].map(estimate);
        for bent in [less, more] {
            let [log_ratio, deviation] = known.log_residual_ratio(&bent);
            assert!(log_ratio < -0.03 && log_ratio < -2.0 * deviation, "{known:?} {bent:?}");
        }
    }

    #[test]
    fn exposures_that_are_longer_than_known_change_little() {
        for length in [0.9, 1.15] {
            let found = estimate_power(&pictures(1.0, length, 6)).expect("blur");
            assert!((found.power - 1.0).abs() < 0.07, "{length}: {found:?}");
        }
    }

    #[test]
    fn pictures_without_blur_tell_nothing() {
        let mut sharp = pictures(1.0, 1.0, 6);
        for pixel in sharp.iter_mut().flat_map(|pair| pair.channels.iter_mut().flatten()) {
            pixel.sharp = pixel.sharp.map(|sharp| [sharp[0]; MOMENTS]);
        }
        assert_eq!(estimate_power(&sharp), None);
        assert_eq!(estimate_power(&pictures(1.0, 1.0, 3)), None);
        assert_eq!(estimate_power(&[]), None);
    }

    #[test]
    fn slope_of_a_prediction_agrees_with_differences() {
        for seed in 1..6 {
            let random = noise(seed, 2 * MOMENTS);
            let of = |first: usize| [std::array::from_fn(|u| random[first + u]); SHARP_PICTURES];
            let pixel = BlurredPixel { blurred: of(0), sharp: of(MOMENTS), slope: 1.0 };
            let slope = [pixel.term(0, 0.8).derivatives[0]];
            let residual = |x: &[f64]| -pixel.term(0, x[0]).residual;
            assert_gradient("power", &[0.8], &slope, 1e-5, 1e-6, residual);
        }
    }
}
