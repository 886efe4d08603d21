//! Search for the motions of all photographs: each in turn is given the best of many motions, then
//! the best ones are refined.

use super::patch_pairs::{FREQUENCIES, FREQUENCY, NOISE, PatchPair};
use i2slam_compute::CancellationToken;
use i2slam_geometry::Image;
use rayon::prelude::*;
use std::f32::consts::{PI, TAU};
use std::sync::LazyLock;

/// Shortest motion that is tried [px], ratio of each length to the one before, and the longest over
/// the longer side of the picture.
const MIN_LENGTH: f32 = 1.0;
const LENGTH_RATIO: f32 = 1.41;
const MAX_LENGTH_RATIO: f32 = 0.1;
/// Directions that are tried, over half a turn.
const DIRECTIONS: usize = 12;
/// Rounds over all photographs, at most.
const ROUNDS: usize = 6;
/// Steps of the refinement over the length of the motion.
const STEPS: [f32; 3] = [0.2, 0.1, 0.05];
/// Difference of logarithms from which on a ratio counts no more: it compares different surfaces.
const MAX_RESIDUAL: f32 = 2.0;
/// Cost of a motion as long as the picture, over the weight of its ratios.
const LENGTH_COST: f64 = 0.16;
/// Standard deviation of the blur of a pixel [px].
const PIXEL_SIGMA: f32 = 0.3;
/// Periods along a motion from which on the zeros of sinc² are narrower than a patch resolves.
const RESOLVED_PERIODS: f32 = 0.7;

/// Share of the power of each frequency that a picture keeps.
type KeptPowers = [f32; FREQUENCIES];

/// Motions of `count` photographs [px]; `None` without pairs.
pub(super) fn search_motions(
    count: usize,
    longer_side: f32,
    pairs: &[PatchPair],
    cancellation: &CancellationToken,
) -> Vec<Option<[f32; 2]>> {
    let mut search = Search::new(count, longer_side, pairs);
    let candidates = candidates(longer_side);
    for _ in 0..ROUNDS {
        let mut is_changed = false;
        for photograph in 0..count {
            if cancellation.is_cancelled() {
                return vec![None; count];
            }
            let found = search.best(photograph, &candidates);
            is_changed |= found != search.motions[photograph];
            search.motions[photograph] = found;
        }
        if !is_changed {
            break;
        }
    }
    for step in STEPS {
        for photograph in (0..count).take_while(|_| !cancellation.is_cancelled()) {
            let nearby = neighbours(search.motions[photograph], step);
            search.motions[photograph] = search.best(photograph, &nearby);
        }
    }
    let motions = search.motions.into_iter().zip(&search.of_photograph);
    motions.map(|(motion, pairs)| (!pairs.is_empty()).then_some(motion)).collect()
}

/// The motions that are tried at first, and none.
fn candidates(longer_side: f32) -> Vec<[f32; 2]> {
    let longest = MAX_LENGTH_RATIO * longer_side;
    let lengths = std::iter::successors(Some(MIN_LENGTH), |last| Some(last * LENGTH_RATIO));
    let of_length = |length: f32| {
        (0..DIRECTIONS).map(move |direction| {
            let (sin, cos) = (PI * direction as f32 / DIRECTIONS as f32).sin_cos();
            [length * cos, length * sin]
        })
    };
    let moving = lengths.take_while(|length| *length < longest).flat_map(of_length);
    std::iter::once([0.0; 2]).chain(moving).collect()
}

/// A motion and those around it; none around rest.
fn neighbours([x, y]: [f32; 2], step: f32) -> Vec<[f32; 2]> {
    if [x, y] == [0.0; 2] {
        return vec![[x, y]];
    }
    let (along, across) = ([x * step, y * step], [-y * step, x * step]);
    let moved = [[0.0; 2], along, along.map(|v| -v), across, across.map(|v| -v)];
    moved.iter().map(|[dx, dy]| [x + dx, y + dy]).collect()
}

struct Search<'a> {
    pairs: &'a [PatchPair],
    /// Indices of the pairs of each photograph.
    of_photograph: Vec<Vec<usize>>,
    longer_side: f32,
    motions: Vec<[f32; 2]>,
}

impl<'a> Search<'a> {
    fn new(count: usize, longer_side: f32, pairs: &'a [PatchPair]) -> Self {
        let mut of_photograph = vec![Vec::new(); count];
        for (index, pair) in pairs.iter().enumerate() {
            pair.photographs.iter().for_each(|photograph| of_photograph[*photograph].push(index));
        }
        Self { pairs, of_photograph, longer_side, motions: vec![[0.0; 2]; count] }
    }

    /// The candidate that explains the pairs of a photograph best, the others given; the first of equals.
    fn best(&self, photograph: usize, candidates: &[[f32; 2]]) -> [f32; 2] {
        let pairs: Vec<ComparedPair<'_>> =
            self.of_photograph[photograph].iter().map(|i| self.compared(*i, photograph)).collect();
        let weights: f64 = pairs.iter().map(|compared| weight(compared.pair)).sum();
        let cost = |motion: &[f32; 2]| {
            let length = f64::from(motion[0].hypot(motion[1]) / self.longer_side);
            pairs.iter().map(|compared| compared.cost(*motion)).sum::<f64>()
                + LENGTH_COST * length * weights
        };
        let costs: Vec<f64> = candidates.par_iter().map(cost).collect();
        let best = (0..candidates.len()).min_by(|a, b| costs[*a].total_cmp(&costs[*b]));
        best.map_or([0.0; 2], |best| candidates[best])
    }

    fn compared(&self, index: usize, photograph: usize) -> ComparedPair<'_> {
        let pair = &self.pairs[index];
        let is_second = pair.photographs[1] == photograph;
        let other = Sampling::new(pair, !is_second);
        let other = other.kept(self.motions[pair.photographs[usize::from(!is_second)]]);
        ComparedPair { pair, is_second, own: Sampling::new(pair, is_second), other }
    }
}

/// A pair as one of its photographs is compared, what the other one keeps given.
struct ComparedPair<'a> {
    pair: &'a PatchPair,
    is_second: bool,
    own: Sampling,
    other: KeptPowers,
}

impl ComparedPair<'_> {
    fn cost(&self, motion: [f32; 2]) -> f64 {
        let own = self.own.kept(motion);
        match self.is_second {
            true => cost_of(self.pair, &self.other, &own),
            false => cost_of(self.pair, &own, &self.other),
        }
    }
}

/// The compared frequencies as one photograph of a pair shows them, and what it keeps of them at rest.
struct Sampling {
    /// [periods per pixel of the finest level]
    frequencies: [[f32; 2]; FREQUENCIES],
    at_rest: KeptPowers,
}

impl Sampling {
    fn new(pair: &PatchPair, is_second: bool) -> Self {
        let shown = FREQUENCY
            .map(|frequency| if is_second { pair.in_second(frequency) } else { frequency });
        let at_rest = |[x, y]: [f32; 2]| {
            let pixel = (-(x * x + y * y) * PIXEL_SIGMA * PIXEL_SIGMA).exp();
            // The first patch is read at pixels, the second one between them.
            let interpolation = if is_second { cubic_power(x) * cubic_power(y) } else { 1.0 };
            pixel * interpolation
        };
        let frequencies = shown.map(|both| both.map(|value| value * pair.scale / TAU));
        Self { frequencies, at_rest: shown.map(at_rest) }
    }

    /// Share of the powers that is kept in a motion [px].
    fn kept(&self, [u, v]: [f32; 2]) -> KeptPowers {
        std::array::from_fn(|f| {
            let [x, y] = self.frequencies[f];
            self.at_rest[f] * box_power(x * u + y * v)
        })
    }
}

/// Mean share of the power of a frequency [rad/px] that cubic interpolation keeps, over all places between
/// pixels.
fn cubic_power(frequency: f32) -> f32 {
    const STEPS: f32 = 64.0;
    static TABLE: LazyLock<Vec<f32>> = LazyLock::new(|| {
        (0..=STEPS as usize).map(|i| mean_cubic_power(PI * i as f32 / STEPS)).collect()
    });
    let at = (frequency.abs() / PI * STEPS).min(STEPS - 1.0);
    let (below, share) = (at as usize, at.fract());
    TABLE[below] + share * (TABLE[below + 1] - TABLE[below])
}

fn mean_cubic_power(frequency: f32) -> f32 {
    const PLACES: usize = 16;
    // A line of a wave, interpolated at places between its pixels.
    let power = |place: usize| {
        let t = (place as f32 + 0.5) / PLACES as f32;
        let part = |phase: f32| {
            let wave = Image::from_fn(6, 6, 1, |_, column, _| {
                (frequency * (column as f32 - 2.0) + phase).cos()
            });
            wave.cubic_tap(2.5 + t, 3.0).map_or(0.0, |tap| tap.sample(&wave.data))
        };
        part(0.0).powi(2) + part(-0.5 * PI).powi(2)
    };
    (0..PLACES).map(power).sum::<f32>() / PLACES as f32
}

/// sinc² of a number of periods, with its zeros filled as far as a patch does not resolve them.
fn box_power(periods: f32) -> f32 {
    let phase = PI * periods.abs();
    if phase < 1e-3 {
        return 1.0;
    }
    let sinc = phase.sin() / phase;
    let envelope = if phase > PI * RESOLVED_PERIODS { 0.5 / (phase * phase) } else { 0.0 };
    (sinc * sinc).max(envelope)
}

/// Weight of the ratios of a pair: those of noise count little.
fn weight(pair: &PatchPair) -> f64 {
    f64::from(pair.sums.iter().map(|sum| sum / (sum + 4.0 * NOISE)).sum::<f32>())
}

/// Sum of the differences between measured and expected ratios.
fn cost_of(pair: &PatchPair, first: &KeptPowers, second: &KeptPowers) -> f64 {
    let mut cost = 0.0;
    for f in 0..FREQUENCIES {
        let sum = pair.sums[f];
        let power = sum / (first[f] + second[f]);
        let expected = ((power * first[f] + NOISE) / (power * second[f] + NOISE)).ln();
        let residual = (pair.log_ratios[f] - expected).abs().min(MAX_RESIDUAL);
        cost += sum / (sum + 4.0 * NOISE) * residual;
    }
    f64::from(cost)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn interpolation_dims_high_frequencies() {
        assert!((cubic_power(0.0) - 1.0).abs() < 1e-5);
        let values: Vec<f32> = (0..8).map(|i| cubic_power(0.39 * i as f32)).collect();
        assert!(values.windows(2).all(|pair| pair[1] < pair[0] + 1e-5), "{values:?}");
        // Five periods in sixteen pixels.
        assert!((cubic_power(5.0 * TAU / 16.0) - 0.77).abs() < 0.02, "{values:?}");
    }

    #[test]
    fn a_box_keeps_what_its_transform_says() {
        assert_eq!(box_power(0.0), 1.0);
        let half = (2.0 / PI).powi(2);
        assert!((box_power(0.5) - half).abs() < 1e-6 && (box_power(-0.5) - half).abs() < 1e-6);
        // The zero at one period is filled.
        assert!((box_power(1.0) - 0.5 / (PI * PI)).abs() < 1e-6);
    }
}
