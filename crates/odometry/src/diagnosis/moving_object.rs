//! Moving objects: parts of the picture whose points contradict the pose persistently.

use crate::segmentation::picture_share::{MovingPart, moving_share, persistent_parts};
use crate::sfm_state::SfmState;

/// Observations of a track that is judged, at least.
const MIN_OBSERVATIONS: usize = 4;

/// Parts of a sequence in which a large share of the picture does not move with the rest: points
/// that were left out as moving, and those that no landmark explains.
pub(crate) fn moving_parts(state: &SfmState) -> Vec<MovingPart> {
    let mut moving = vec![Vec::new(); state.poses.len()];
    for o in state.moving_tracks.iter().flat_map(|track| &track.observations) {
        moving[o.frame].push((o.raw(), true));
    }
    let posed = state.posed_frames();
    let share = |frame: usize| {
        let points = explained_points(state, frame).chain(moving[frame].iter().copied());
        (frame, moving_share(&state.camera, points))
    };
    persistent_parts(&posed.into_iter().map(share).collect::<Vec<_>>())
}

/// Positions of the points in a frame [px], and whether no landmark explains them.
fn explained_points(state: &SfmState, frame: usize) -> impl Iterator<Item = ([f64; 2], bool)> + '_ {
    let is_judged = |track: usize| {
        let seen = &state.tracks.tracks[track].observations;
        seen.iter().filter(|o| state.poses[o.frame].is_some()).count() >= MIN_OBSERVATIONS
    };
    let observations = state.observations_in(frame).filter(move |(track, _)| is_judged(*track));
    observations.map(|(track, o)| (o.raw(), state.landmarks[track].is_none() || o.is_outlier))
}
