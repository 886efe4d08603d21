//! Keyframes that were lost, after a cut or behind a covered lens, found again by their looks.

use crate::relocalize::geometric_verification::{Recognised, recognise};
use crate::sfm_state::Scene;
use crate::track::thumbnail::Look;
use rayon::prelude::*;
use std::collections::{HashMap, HashSet};

/// Likeness that a keyframe must have to be compared, and how many are compared.
const MIN_LIKENESS: f32 = 0.5;
const COMPARED: usize = 3;
/// Keyframes nearer than this in order to a better one are not compared.
const APART: usize = 3;
/// Keyframes that one is compared with in vain at most, so that work stays in proportion to the
/// number of those that are lost.
const MAX_COMPARED: usize = 30;
/// Keyframes that are tried at once.
const AT_ONCE: usize = 8;

/// A keyframe and an older one.
type Pair = (usize, usize);

/// Pairs of keyframes that were compared in vain.
#[derive(Debug, Default)]
pub(crate) struct Tried {
    pairs: HashSet<Pair>,
    /// Number of pairs of every newer frame.
    counts: HashMap<usize, usize>,
}

impl Tried {
    fn add(&mut self, pair: Pair) {
        if self.pairs.insert(pair) {
            *self.counts.entry(pair.0).or_default() += 1;
        }
    }

    fn has(&self, pair: Pair) -> bool {
        self.pairs.contains(&pair)
    }

    /// Whether a frame was compared often enough.
    fn is_given_up(&self, frame: usize) -> bool {
        self.counts.get(&frame).is_some_and(|count| *count >= MAX_COMPARED)
    }
}

/// The keyframes that look most like one, of those that may be compared.
pub(crate) fn most_alike<'a>(
    scene: &'a Scene,
    look: &Look,
    may: impl Fn(usize, &Look) -> bool,
) -> Vec<&'a Look> {
    let of = |(place, other): (usize, &'a Look)| {
        let likeness = look.likeness(other);
        (likeness > MIN_LIKENESS && may(place, other)).then_some((likeness, place, other))
    };
    let mut all: Vec<_> = scene.tracks.looks.iter().enumerate().filter_map(of).collect();
    all.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut chosen: Vec<(usize, &Look)> = Vec::new();
    for (_, place, other) in all {
        if chosen.len() < COMPARED && chosen.iter().all(|(p, _)| p.abs_diff(place) >= APART) {
            chosen.push((place, other));
        }
    }
    chosen.into_iter().map(|(_, other)| other).collect()
}

/// Poses keyframes that show a place which is known; returns which, none if there are no more.
pub(crate) fn relocalise(scene: &mut Scene, tried: &mut Tried) -> Vec<usize> {
    let looks = scene.tracks.looks.iter().enumerate();
    let lost = looks
        .filter(|(_, look)| scene.poses[look.frame].is_none() && !tried.is_given_up(look.frame));
    let lost: Vec<usize> = lost.map(|(place, _)| place).collect();
    for some in lost.chunks(AT_ONCE) {
        if scene.progress.is_cancelled() {
            break;
        }
        let may = |look: &Look, other: &Look| {
            scene.poses[other.frame].is_some() && !tried.has((look.frame, other.frame))
        };
        let search = |place: &usize| {
            let look = &scene.tracks.looks[*place];
            let compared = most_alike(scene, look, |_, other| may(look, other));
            let found = compared.iter().find_map(|old| recognise(scene, look, old));
            (found, compared.iter().map(|old| (look.frame, old.frame)).collect())
        };
        let (found, compared): (Vec<Option<Recognised>>, Vec<Vec<Pair>>) =
            some.par_iter().map(search).unzip();
        compared.into_iter().flatten().for_each(|pair| tried.add(pair));
        let mut posed = Vec::new();
        for (place, found) in some.iter().zip(found) {
            let Some(found) = found else { continue };
            let frame = scene.tracks.looks[*place].frame;
            scene.poses[frame] = Some(found.world_from_camera);
            scene.add_sights(found.sights);
            posed.push(frame);
        }
        if !posed.is_empty() {
            return posed;
        }
    }
    Vec::new()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_that_was_compared_often_is_given_up() {
        let mut tried = Tried::default();
        for old in 0..MAX_COMPARED {
            assert!(!tried.is_given_up(99));
            (0..2).for_each(|_| tried.add((99, old)));
        }
        assert!(tried.is_given_up(99) && !tried.is_given_up(98) && tried.has((99, 0)));
    }
}
