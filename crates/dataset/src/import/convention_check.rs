//! Whether depths and poses fit together, and which other convention would.
//!
//! Depth of a keyframe, carried to the next one by their poses, must meet that one's depth and
//! colour. Poses read by a wrong convention miss both, and those read by the right one do not.

mod miss;
mod reading;

use super::{Files, Kind};
use i2slam_geometry::Pose;
use miss::{Miss, mean};
use reading::Reading;

/// Pairs of keyframes that are looked at.
const PAIRS: usize = 6;

/// One pair may miss for reasons of its own.
const MIN_PAIRS: usize = 2;

/// Another convention must miss by less than this share of what the given one misses by.
const BETTER: f64 = 0.6;

/// Factors of positions that are tried: powers of 2 up to this one, and their inverses.
const MAX_SCALE: i32 = 10;

/// Mean miss of pixels seen again above which depths and poses do not fit at all: colours that have
/// nothing to do with each other miss by a half, depths by nearly 1.
const UNFIT: f64 = 0.6;

/// Another way to take the poses.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Candidate {
    Read(Reading),
    /// Positions multiplied by this.
    Scaled(f64),
}

impl Candidate {
    /// As given first, then other readings, then other units.
    fn all(kind: Kind) -> Vec<Self> {
        let has_order = matches!(kind, Kind::Droid | Kind::Trajectory);
        let readings = Reading::ALL.into_iter().filter(|reading| has_order || !reading.order);
        let powers = (-MAX_SCALE..=MAX_SCALE).filter(|&power| power != 0);
        let scales = powers.map(|power| Self::Scaled(2_f64.powi(power)));
        readings.map(Self::Read).chain(scales).collect()
    }

    fn pose(self, pose: Pose<f64>, kind: Kind) -> Pose<f64> {
        match self {
            Self::Read(reading) => reading.of(pose, kind),
            Self::Scaled(scale) => Pose { translation: pose.translation * scale, ..pose },
        }
    }
}

/// A warning if depths and poses disagree, with the convention that fits better if there is one.
pub(super) fn warning(files: &Files) -> Option<String> {
    if !files.has_depth {
        return None;
    }
    let candidates = Candidate::all(files.kind);
    let pairs = misses(files, &candidates);
    if pairs.len() < MIN_PAIRS {
        return None;
    }
    let of = |which: usize| pairs.iter().map(|pair| pair[which].whole).collect::<Vec<f64>>();
    let given = of(0);
    let from = "from one keyframe to the next the mismatch (colour and depth) is";
    let miss = mean(&given)?;
    let better = |is_reading: bool| {
        let places = (1..candidates.len())
            .filter(|&which| matches!(candidates[which], Candidate::Read(_)) == is_reading);
        best(places.map(|which| (candidates[which], of(which))), &given)
    };
    match better(true).or_else(|| better(false)) {
        Some((Candidate::Read(reading), other)) => Some(format!(
            "wrong convention? {from} {miss:.2} of 1, and {other:.2} if the poses are {}: {} is \
             expected to hold {}",
            reading.words(files.kind),
            files.path.display(),
            files.kind.convention()
        )),
        Some((Candidate::Scaled(scale), other)) => Some(format!(
            "depths and poses in different units? {from} {miss:.2} of 1, and {other:.2} if \
             positions are multiplied by about {scale}"
        )),
        None => {
            let seen: Vec<f64> = pairs.iter().filter_map(|pair| pair[0].seen).collect();
            let miss = mean(&seen).filter(|&miss| seen.len() >= MIN_PAIRS && miss > UNFIT)?;
            Some(format!(
                "depths and poses disagree: {from} {miss:.2} of 1, and no other convention fits \
                 better; are they of these pictures?"
            ))
        }
    }
}

/// The candidate that misses least and its mean miss, if that is clearly less than what is given.
fn best<T>(candidates: impl Iterator<Item = (T, Vec<f64>)>, given: &[f64]) -> Option<(T, f64)> {
    let means = candidates.filter_map(|(what, misses)| Some((what, mean(&misses)?, misses)));
    let (what, mean_miss, misses) = means.min_by(|a, b| a.1.total_cmp(&b.1))?;
    let often = misses.iter().zip(given).filter(|(other, given)| other < given).count();
    let clearly = mean_miss < BETTER * mean(given)? && 3 * often > 2 * given.len();
    clearly.then_some((what, mean_miss))
}

/// What every candidate misses by, for every pair that can be compared. No more than two keyframes
/// are held at once.
fn misses(files: &Files, candidates: &[Candidate]) -> Vec<Vec<Miss>> {
    let of_pair = |(first, second): (usize, usize)| {
        let (a, b) = (files.load(first).ok()?, files.load(second).ok()?);
        let miss = |candidate: &Candidate| {
            let pose = |pose: Pose<f64>| candidate.pose(pose, files.kind);
            let b_from_a = pose(b.world_from_camera).inverse() * pose(a.world_from_camera);
            Miss::of(&files.camera, &a, &b, b_from_a)
        };
        candidates.iter().map(miss).collect::<Option<Vec<Miss>>>()
    };
    pairs(files).into_iter().filter_map(of_pair).collect()
}

/// Pairs spread over all keyframes: neighbours in time, or those that share most points.
fn pairs(files: &Files) -> Vec<(usize, usize)> {
    let last = files.len().saturating_sub(1);
    let mut places: Vec<usize> = (0..PAIRS).map(|k| k * last / PAIRS).collect();
    places.dedup();
    let other = |place: usize| files.source.shares_most(&files.keyframes, place);
    places.into_iter().map(|place| (place, other(place).unwrap_or(place + 1))).collect()
}
