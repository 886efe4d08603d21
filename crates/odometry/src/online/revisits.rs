//! Places that the camera comes back to: old landmarks found in a new keyframe, and keyframes that
//! are not needed because an old one shows the same view.

use crate::relocalize::geometric_verification::verify_known_pose;
use crate::relocalize::view_overlap::{MIN_VISIBLE_LANDMARKS, ViewOverlap, view_overlap};
use crate::sfm_state::SfmState;
use crate::track::tracker::{KEYFRAME_DUE_MOTION, KEYFRAME_DUE_OVERLAP, KEYFRAME_INTERVAL};
use crate::track::tracks::Observation;
use rayon::prelude::*;

/// Frames after which a view counts as an old one: eight keyframes of a slow camera.
pub(crate) const MIN_REVISIT_AGE: usize = 8 * KEYFRAME_INTERVAL;
/// Old keyframes in which landmarks are searched.
const MAX_COMPARED_KEYFRAMES: usize = 2;

/// Old landmarks in a new keyframe.
#[derive(Clone, Debug, Default)]
pub(crate) struct Revisit {
    /// Observations of their tracks in it.
    pub(crate) observations: Vec<(usize, Observation)>,
    /// An old keyframe whose view is so near that no new one would be due.
    pub(crate) covered_by: Option<usize>,
}

/// Searches the last keyframe, which has a pose, for the landmarks of the old keyframes nearest to
/// its view, or of those alone that cover it.
pub(crate) fn find_revisit(state: &SfmState, covering_alone: bool) -> Revisit {
    let Some((image, older)) = state.tracks.keyframe_images.split_last() else {
        return Revisit::default();
    };
    let mut near: Vec<_> = older
        .iter()
        .filter(|old| old.frame + MIN_REVISIT_AGE <= image.frame)
        .map(|old| (view_overlap(state, image.frame, old.frame), old))
        .filter(|(overlap, _)| overlap.visible >= MIN_VISIBLE_LANDMARKS)
        .filter(|(overlap, _)| !covering_alone || covers(overlap, state.camera.width))
        .collect();
    near.sort_by(|a, b| a.0.motion.total_cmp(&b.0.motion));
    near.truncate(MAX_COMPARED_KEYFRAMES);
    let found: Vec<_> =
        near.par_iter().map(|(_, old)| verify_known_pose(state, image, old)).collect();
    let mut out = Revisit::default();
    for ((overlap, old), found) in near.iter().zip(found) {
        let Some(observations) = found else { continue };
        out.observations.extend(observations);
        let is_same = covers(overlap, state.camera.width);
        out.covered_by = out.covered_by.or(is_same.then_some(old.frame));
    }
    out
}

/// Whether a keyframe is so near that the tracker would not ask for a new one yet.
fn covers(overlap: &ViewOverlap, width: usize) -> bool {
    let (visible, sampled) = (overlap.visible as f64, overlap.sampled as f64);
    overlap.motion < f64::from(KEYFRAME_DUE_MOTION) * width as f64
        && visible > f64::from(KEYFRAME_DUE_OVERLAP) * sampled
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_view_covers_another_up_to_the_distance_of_keyframes() {
        let view = |visible: usize, motion: f64| ViewOverlap { sampled: 24, visible, motion };
        assert!(covers(&view(20, 8.0), 320));
        assert!(!covers(&view(20, 11.0), 320) && !covers(&view(16, 8.0), 320));
    }
}
