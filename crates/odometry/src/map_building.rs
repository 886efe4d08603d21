//! The map of a sequence, from its tracks or matches.

use crate::depth::scale::scale_to_readings;
use crate::error::OdometryError;
use crate::loops::loop_closure::merge_overlapping_keyframes;
use crate::register::first_pairs::register_photographs;
use crate::register::initialization::initialize;
use crate::register::known_path::KnownPath;
use crate::register::registration::{
    adjust_all_frames, adjust_globally, register_keyframes, register_remaining_frames,
};
use crate::relocalize::relocalization::{FailedPairs, relocalize};
use crate::sfm_state::SfmState;

/// Builds the map from tracks alone, or of a film from a path that is `known` where this fits better:
/// poses of all frames, and landmarks.
pub(crate) fn build_map(
    state: &mut SfmState,
    known: Option<&KnownPath>,
    adjust_focal: bool,
) -> Result<(), OdometryError> {
    let is_started = !state.posed_frames().is_empty();
    let mut was_lost = false;
    if state.photographs.is_some() {
        register_photographs(state, adjust_focal)?;
    } else {
        if !is_started {
            initialize(state, 0..state.tracks.keyframes.len())?;
        }
        was_lost = register_and_relocalize(state, adjust_focal);
        if let Some((other, other_was_lost)) = largest_component(state, adjust_focal) {
            (*state, was_lost) = (other, other_was_lost);
        }
        // What was lost and found again has observations that another path has not.
        let is_comparable = !is_started && !was_lost && !state.has_depth();
        let known = known.filter(|_| is_comparable);
        let other = known.and_then(|known| known.better_than(state, adjust_focal));
        if let Some(mut other) = other {
            let other_was_lost = register_and_relocalize(&mut other, adjust_focal);
            if other.frames_covered() >= state.frames_covered() {
                (*state, was_lost) = (other, other_was_lost);
            }
        }
    }
    scale_to_readings(state);
    if !is_started {
        adjust_globally(state, adjust_focal);
    }
    register_remaining_frames(state);
    adjust_all_frames(state, adjust_focal);
    if was_lost {
        merge_overlapping_keyframes(state, adjust_focal);
    }
    Ok(())
}

/// Registers and relocalizes keyframes until none is left; returns whether some were relocalized.
fn register_and_relocalize(state: &mut SfmState, adjust_focal: bool) -> bool {
    let (mut failed, mut was_lost) = (FailedPairs::default(), false);
    loop {
        register_keyframes(state, adjust_focal, usize::MAX);
        if !relocalize(state, &mut failed) {
            return was_lost;
        }
        was_lost = true;
        state.triangulate_missing();
    }
}

/// The state from the longest unregistered run of keyframes, where that registers more frames, and
/// whether some were relocalized.
fn largest_component(state: &SfmState, adjust_focal: bool) -> Option<(SfmState, bool)> {
    let is_posed = |place: usize| state.poses[state.tracks.keyframes[place]].is_some();
    let places: Vec<usize> = (0..state.tracks.keyframes.len()).collect();
    let runs = places.chunk_by(|a, b| is_posed(*a) == is_posed(*b)).filter(|r| !is_posed(r[0]));
    let length =
        |run: &[usize]| run.iter().map(|place| state.frames_represented(*place)).sum::<usize>();
    let covered = state.frames_covered();
    let longest = runs.max_by_key(|run| length(run)).filter(|run| length(run) > covered)?;
    let mut other = state.clone();
    other.reset();
    initialize(&mut other, longest[0]..longest[longest.len() - 1] + 1).ok()?;
    let was_lost = register_and_relocalize(&mut other, adjust_focal);
    (other.frames_covered() > covered).then_some((other, was_lost))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{camera, state};
    use i2slam_geometry::{Pose, Rotation, Vec3};

    /// Around a point before a camera of narrow view.
    fn orbit(frame: usize) -> Pose<f64> {
        let centre = Vec3::new(0.0, 0.0, 2.5);
        let rotation = Rotation::exp(Vec3::new(0.0, 0.012 * (frame as f64 - 12.0), 0.0));
        Pose::new(rotation, centre - rotation.rotate(centre))
    }

    /// The first pair of keyframes begins with the reversal.
    #[test]
    fn a_film_goes_on_from_the_known_path_where_it_fits_better() {
        let observe = |point: Vec3<f64>, frame: usize, n: &[f64]| {
            let (u, v) = camera().project(orbit(frame).inverse() * point);
            Some([u + 0.5 * n[0], v + 0.5 * n[1]])
        };
        let mut film = state((24, 12, 2), [25.0, 20.0], orbit, observe);
        film.reset();
        let turned = |known: Option<&KnownPath>| {
            let mut found = film.clone();
            build_map(&mut found, known, false).expect("a map");
            assert_eq!(found.posed_frames().len(), 24);
            let [first, last] = [0, 22].map(|frame| found.poses[frame].expect("posed"));
            first.local(last).rotation.y / orbit(0).local(orbit(22)).rotation.y
        };
        let known: Vec<_> = (0..24).step_by(2).map(|frame| (frame, orbit(frame))).collect();
        let known = KnownPath { camera: film.camera, keyframes: known };
        let (without, with) = (turned(None), turned(Some(&known)));
        assert!(without < 0.0 && (with - 1.0).abs() < 0.2, "{without} {with}");
    }
}
