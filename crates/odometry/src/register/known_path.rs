//! The path of a film that was known when its last frame came, in place of one that was found from the
//! tracks alone and fits worse.
//!
//! To a camera of narrow view, a scene of little depth looks nearly like its reversal under reversed
//! translations (Szeliski and Kang 1997, *Shape ambiguities in structure from motion*). Which of the two a pair
//! of keyframes begins with is chance, and adjustment stays with it.

use super::registration::adjusted_misfit;
use crate::sfm_state::SfmState;
use i2slam_geometry::Pose;

/// Largest misfit of the known path, relative to that of the found one, at which it is taken. Measured 0.72 to
/// 0.86 on three films whose found path was the reversal or fell apart, and 0.96 to 1.21 on 19 others.
const MAX_MISFIT_RATIO: f64 = 0.9;
/// Keyframes that tell it: fewer have a relative pose and little else.
const MIN_KEYFRAMES: usize = 4;

/// Takes the `known` poses of keyframes, adjusted, in place of all that were found, where they fit those better
/// that both pose, at least half of the found ones; true if it does.
pub(crate) fn take_better_path(
    state: &mut SfmState,
    known: &[(usize, Pose<f64>)],
    adjust_focal: bool,
) -> bool {
    let found = state.posed_keyframes().len();
    let in_both = |(frame, pose): &(usize, Pose<f64>)| {
        Some(((*frame, *pose), (*frame, state.poses[*frame]?)))
    };
    let (known, common): (Vec<_>, Vec<_>) = known.iter().filter_map(in_both).unzip();
    if common.len() < MIN_KEYFRAMES.max(found.div_ceil(2)) || state.progress.is_cancelled() {
        return false;
    }
    // Observations in other frames do not affect keyframes.
    let keyframes = state.keyframes_only();
    let (misfit, _) = adjusted(&keyframes, &common, adjust_focal);
    let (known_misfit, known) = adjusted(&keyframes, &known, adjust_focal);
    let is_better = known_misfit < MAX_MISFIT_RATIO * misfit && !state.progress.is_cancelled();
    if is_better {
        state.reset();
        state.camera = known.camera;
        state.update_distortion(known.distortion);
        state.poses = known.poses;
        state.triangulate_missing();
    }
    is_better
}

/// The misfit of some keyframes from their poses on, and the state.
fn adjusted(
    keyframes: &SfmState,
    poses: &[(usize, Pose<f64>)],
    adjust_focal: bool,
) -> (f64, SfmState) {
    let mut state = keyframes.clone();
    for (frame, pose) in poses {
        state.poses[*frame] = Some(*pose);
    }
    state.triangulate_missing();
    (adjusted_misfit(&mut state, adjust_focal), state)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{camera, state};
    use i2slam_geometry::{Rotation, Vec3};

    const FRAMES: usize = 24;

    fn pose(frame: usize) -> Pose<f64> {
        Pose::new(Rotation::identity(), Vec3::new(0.05 * frame as f64, 0.0, 0.0))
    }

    /// The second half is turned away, so that what both halves see does not agree.
    fn broken(frame: usize) -> Pose<f64> {
        let turn = if frame < FRAMES / 2 { 0.0 } else { 0.4 };
        pose(frame) * Pose::new(Rotation::exp(Vec3::new(0.0, turn, 0.0)), Vec3::default())
    }

    /// A path with the poses given, found from pictures with the true ones.
    fn found(poses: fn(usize) -> Pose<f64>) -> SfmState {
        let observe = |point: Vec3<f64>, frame: usize, n: &[f64]| {
            let (u, v) = camera().project(pose(frame).inverse() * point);
            Some([u + 0.3 * n[0], v + 0.3 * n[1]])
        };
        let mut state = state((FRAMES, 12, 2), [100.0, 80.0], pose, observe);
        state.reset();
        state.poses = (0..FRAMES).map(|frame| Some(poses(frame))).collect();
        state.triangulate_missing();
        state
    }

    fn known(poses: fn(usize) -> Pose<f64>) -> Vec<(usize, Pose<f64>)> {
        (0..FRAMES).step_by(2).map(|frame| (frame, poses(frame))).collect()
    }

    #[test]
    fn the_known_path_is_taken_where_it_fits_better() {
        let mut state = found(broken);
        assert!(take_better_path(&mut state, &known(pose), false));
        let [first, last] = [0, FRAMES - 2].map(|frame| state.poses[frame].expect("posed"));
        let off = first.local(last).rotation.norm();
        assert!(off < 0.01 && state.poses[1].is_none(), "{off}");
        assert!(state.landmarks.iter().flatten().count() > 100);
    }

    #[test]
    fn a_path_that_fits_as_well_stays() {
        // Nor is one taken that poses more, or too few to tell.
        for others in [known(pose), known(broken), known(pose)[..2].to_vec(), Vec::new()] {
            for posed in [0..FRAMES, FRAMES / 2..FRAMES] {
                let mut state = found(pose);
                state.reset();
                posed.for_each(|frame| state.poses[frame] = Some(pose(frame)));
                state.triangulate_missing();
                let before = state.poses.clone();
                assert!(!take_better_path(&mut state, &others, false));
                assert_eq!(state.poses, before);
            }
        }
    }
}
