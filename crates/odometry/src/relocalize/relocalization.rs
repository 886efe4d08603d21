//! Relocalization of keyframes without a pose, as after a cut or a covered lens.

use crate::relocalize::geometric_verification::{Relocalization, match_and_verify};
use crate::sfm_state::SfmState;
use crate::track::thumbnail::KeyframeImage;
use rayon::prelude::*;
use std::collections::{HashMap, HashSet};

/// Thumbnail correlation of a candidate, and number of candidates.
const MIN_THUMBNAIL_CORRELATION: f32 = 0.5;
const MAX_CANDIDATES: usize = 3;
/// Distance in keyframes between two candidates.
const MIN_CANDIDATE_GAP: usize = 3;
/// Failed verifications after which a keyframe is given up; bounds the work per lost keyframe.
const MAX_ATTEMPTS: usize = 30;
/// Keyframes that are verified in parallel.
const KEYFRAMES_PER_BATCH: usize = 8;

/// Frames of a keyframe and an older one.
type FramePair = (usize, usize);

/// Pairs of keyframes whose verification failed.
#[derive(Debug, Default)]
pub(crate) struct FailedPairs {
    pairs: HashSet<FramePair>,
    /// Number of pairs of every newer frame.
    counts: HashMap<usize, usize>,
}

impl FailedPairs {
    fn add(&mut self, pair: FramePair) {
        if self.pairs.insert(pair) {
            *self.counts.entry(pair.0).or_default() += 1;
        }
    }

    fn contains(&self, pair: FramePair) -> bool {
        self.pairs.contains(&pair)
    }

    /// Whether verification of a frame has failed too often.
    fn is_given_up(&self, frame: usize) -> bool {
        self.counts.get(&frame).is_some_and(|count| *count >= MAX_ATTEMPTS)
    }
}

/// The keyframes with the most similar thumbnails, of those that `may` be compared.
pub(crate) fn candidate_keyframes<'a>(
    state: &'a SfmState,
    image: &KeyframeImage,
    may: impl Fn(usize, &KeyframeImage) -> bool,
) -> Vec<&'a KeyframeImage> {
    let of = |(place, other): (usize, &'a KeyframeImage)| {
        let thumbnail_correlation = image.thumbnail_correlation(other);
        (thumbnail_correlation > MIN_THUMBNAIL_CORRELATION && may(place, other)).then_some((
            thumbnail_correlation,
            place,
            other,
        ))
    };
    let mut all: Vec<_> = state.tracks.keyframe_images.iter().enumerate().filter_map(of).collect();
    all.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut chosen: Vec<(usize, &KeyframeImage)> = Vec::new();
    for (_, place, other) in all {
        if chosen.len() < MAX_CANDIDATES
            && chosen.iter().all(|(p, _)| p.abs_diff(place) >= MIN_CANDIDATE_GAP)
        {
            chosen.push((place, other));
        }
    }
    chosen.into_iter().map(|(_, other)| other).collect()
}

/// Localises lost keyframes in the map; returns the frames of the first batch with a success, none
/// if there are no more.
pub(crate) fn relocalize(state: &mut SfmState, failed: &mut FailedPairs) -> Vec<usize> {
    let keyframe_images = state.tracks.keyframe_images.iter().enumerate();
    let lost = keyframe_images.filter(|(_, image)| {
        state.poses[image.frame].is_none() && !failed.is_given_up(image.frame)
    });
    let lost: Vec<usize> = lost.map(|(place, _)| place).collect();
    for some in lost.chunks(KEYFRAMES_PER_BATCH) {
        if state.progress.is_cancelled() {
            break;
        }
        let may = |image: &KeyframeImage, other: &KeyframeImage| {
            state.poses[other.frame].is_some() && !failed.contains((image.frame, other.frame))
        };
        let search = |place: &usize| {
            let image = &state.tracks.keyframe_images[*place];
            let compared = candidate_keyframes(state, image, |_, other| may(image, other));
            let found = compared.iter().find_map(|old| match_and_verify(state, image, old));
            (found, compared.iter().map(|old| (image.frame, old.frame)).collect())
        };
        let (found, compared): (Vec<Option<Relocalization>>, Vec<Vec<FramePair>>) =
            some.par_iter().map(search).unzip();
        compared.into_iter().flatten().for_each(|pair| failed.add(pair));
        let mut posed = Vec::new();
        for (place, found) in some.iter().zip(found) {
            let Some(found) = found else { continue };
            let frame = state.tracks.keyframe_images[*place].frame;
            state.poses[frame] = Some(found.world_from_camera);
            state.add_observations(found.observations);
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
        let mut failed = FailedPairs::default();
        for old in 0..MAX_ATTEMPTS {
            assert!(!failed.is_given_up(99));
            (0..2).for_each(|_| failed.add((99, old)));
        }
        assert!(failed.is_given_up(99) && !failed.is_given_up(98) && failed.contains((99, 0)));
    }
}
