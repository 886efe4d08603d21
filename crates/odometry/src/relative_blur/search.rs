//! Search for the motions of all photographs: each in turn is given the best of many motions, then
//! the best ones are refined.

use super::patch_pairs::{FREQUENCIES, FREQUENCY, NOISE, PatchPair};
use i2slam_compute::CancellationToken;
use rayon::prelude::*;
use std::f32::consts::{PI, TAU};

/// Shortest motion that is tried [px], ratio of each length to the one before, and the longest over
/// the longer side of the picture.
const MIN_LENGTH: f32 = 1.0;
const LENGTH_RATIO: f32 = 1.41;
const MAX_LENGTH_RATIO: f32 = 0.1;
/// Directions that are tried, over half a turn.
const DIRECTIONS: usize = 12;
/// Rounds over all photographs, at most.
const ROUNDS: usize = 6;
/// Steps of the refinement over the length of the motion; for still ones of [`MIN_LENGTH`].
const STEPS: [f32; 3] = [0.2, 0.1, 0.05];
/// Difference of logarithms from which on a ratio counts no more: it compares different surfaces.
const MAX_RESIDUAL: f32 = 2.0;
/// Cost of a motion as long as the picture, over the weight of its ratios.
const LENGTH_COST: f64 = 0.16;
/// Standard deviation of the blur of a pixel and its interpolation [px].
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
        for photograph in 0..count {
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

/// A motion and those around it; a motion at rest has none.
fn neighbours([x, y]: [f32; 2], step: f32) -> Vec<[f32; 2]> {
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
        let pairs = &self.of_photograph[photograph];
        // What the other photographs keep does not depend on the candidate.
        let others: Vec<KeptPowers> =
            pairs.iter().map(|index| self.kept_by_other(&self.pairs[*index], photograph)).collect();
        let weights: f64 = pairs.iter().map(|index| weight(&self.pairs[*index])).sum();
        let cost = |motion: &[f32; 2]| {
            let length = f64::from(motion[0].hypot(motion[1]) / self.longer_side);
            let terms = pairs.iter().zip(&others).map(|(index, other)| {
                let pair = &self.pairs[*index];
                let is_second = pair.photographs[1] == photograph;
                let own = kept(pair, is_second, *motion);
                if is_second { cost_of(pair, other, &own) } else { cost_of(pair, &own, other) }
            });
            terms.sum::<f64>() + LENGTH_COST * length * weights
        };
        let costs: Vec<f64> = candidates.par_iter().map(cost).collect();
        let best = (0..candidates.len()).min_by(|a, b| costs[*a].total_cmp(&costs[*b]));
        best.map_or([0.0; 2], |best| candidates[best])
    }

    fn kept_by_other(&self, pair: &PatchPair, photograph: usize) -> KeptPowers {
        let is_second = pair.photographs[0] == photograph;
        kept(pair, is_second, self.motions[pair.photographs[usize::from(is_second)]])
    }
}

/// What the first or the second photograph of a pair keeps if it moves by `motion` [px].
fn kept(pair: &PatchPair, is_second: bool, motion: [f32; 2]) -> KeptPowers {
    let motion = motion.map(|pixels| pixels * pair.scale);
    FREQUENCY.map(|frequency| {
        let [x, y] = if is_second { pair.in_second(frequency) } else { frequency };
        let pixel = (-(x * x + y * y) * PIXEL_SIGMA * PIXEL_SIGMA).exp();
        pixel * box_power((x * motion[0] + y * motion[1]) / TAU)
    })
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
