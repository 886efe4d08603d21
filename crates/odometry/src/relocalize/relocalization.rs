//! Relocalization of keyframes without a pose, as after a cut or a covered lens.

use crate::relocalize::geometric_verification::{Relocalization, match_and_verify};
use crate::sfm_state::SfmState;
use crate::track::thumbnail::KeyframeImage;
use rayon::prelude::*;
use std::collections::{HashMap, HashSet};
use std::sync::Arc;

/// Thumbnail correlation of a candidate, and number of candidates.
const MIN_THUMBNAIL_CORRELATION: f32 = 0.5;
const MAX_CANDIDATES: usize = 3;
/// Distance in keyframes between two candidates.
const MIN_CANDIDATE_GAP: usize = 3;
/// Failed verifications after which a keyframe is given up; bounds the work per lost keyframe.
const MAX_ATTEMPTS: usize = 30;
/// Keyframes that are verified in parallel.
const KEYFRAMES_PER_BATCH: usize = 8;

/// Frames of older keyframes that every newer one was compared with in vain.
#[derive(Clone, Debug, Default)]
pub(crate) struct FailedPairs(HashMap<usize, HashSet<usize>>);

impl FailedPairs {
    fn contains(&self, new: usize, old: usize) -> bool {
        self.0.get(&new).is_some_and(|compared| compared.contains(&old))
    }

    /// Whether verification of a frame has failed too often.
    fn is_given_up(&self, frame: usize) -> bool {
        self.0.get(&frame).is_some_and(|compared| compared.len() >= MAX_ATTEMPTS)
    }
}

/// Keyframes that `may` be compared with most similar thumbnails, and their indices.
pub(crate) fn candidate_keyframes<'a>(
    state: &'a SfmState,
    image: &KeyframeImage,
    may: impl Fn(usize, &KeyframeImage) -> bool,
) -> Vec<(usize, &'a KeyframeImage)> {
    let of = |(place, other): (usize, &'a KeyframeImage)| {
        let correlation = may(place, other).then(|| image.thumbnail_correlation(other))?;
        (correlation > MIN_THUMBNAIL_CORRELATION).then_some((correlation, place, other))
    };
    let mut all: Vec<_> =
        state.tracks.keyframe_images.iter().map(Arc::as_ref).enumerate().filter_map(of).collect();
    all.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut chosen: Vec<(usize, &KeyframeImage)> = Vec::new();
    for (_, place, other) in all {
        if chosen.len() < MAX_CANDIDATES
            && chosen.iter().all(|(p, _)| p.abs_diff(place) >= MIN_CANDIDATE_GAP)
        {
            chosen.push((place, other));
        }
    }
    chosen
}

/// Localises lost keyframes in the map until a batch has a success; returns whether one had.
pub(crate) fn relocalize(state: &mut SfmState, failed: &mut FailedPairs) -> bool {
    let frames = state.tracks.keyframes.clone();
    relocalize_any_of(state, &frames, failed)
}

/// As [`relocalize`], for the lost ones of some keyframes.
pub(crate) fn relocalize_any_of(
    state: &mut SfmState,
    frames: &[usize],
    failed: &mut FailedPairs,
) -> bool {
    let images = state.tracks.keyframe_images.clone();
    let is_lost = |image: &&Arc<KeyframeImage>| {
        state.poses[image.frame].is_none()
            && !failed.is_given_up(image.frame)
            && frames.binary_search(&image.frame).is_ok()
    };
    let lost: Vec<&KeyframeImage> = images.iter().filter(is_lost).map(Arc::as_ref).collect();
    for batch in lost.chunks(KEYFRAMES_PER_BATCH) {
        if state.progress.is_cancelled() {
            break;
        }
        let search = |image: &&KeyframeImage| {
            let may = |_, other: &KeyframeImage| {
                state.poses[other.frame].is_some() && !failed.contains(image.frame, other.frame)
            };
            let compared = candidate_keyframes(state, image, may);
            let found = compared.iter().find_map(|(_, old)| match_and_verify(state, image, old));
            (found, compared.iter().map(|(_, old)| old.frame).collect())
        };
        let found: Vec<(Option<Relocalization>, Vec<usize>)> =
            batch.par_iter().map(search).collect();
        let mut is_any_found = false;
        for (image, (found, compared)) in batch.iter().zip(found) {
            failed.0.entry(image.frame).or_default().extend(compared);
            let Some(found) = found else { continue };
            state.poses[image.frame] = Some(found.world_from_camera);
            state.add_observations(found.observations);
            is_any_found = true;
        }
        if is_any_found {
            return true;
        }
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_that_was_compared_often_is_given_up() {
        let mut failed = FailedPairs::default();
        for old in 0..MAX_ATTEMPTS {
            assert!(!failed.is_given_up(99));
            failed.0.entry(99).or_default().extend([old, old]);
        }
        assert!(failed.is_given_up(99) && !failed.is_given_up(98) && failed.contains(99, 0));
    }
}
