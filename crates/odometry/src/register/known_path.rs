//! The path of a film that was known when its last frame came, in place of one that was found from the
//! tracks alone and fits worse, or where none is found so.
//!
//! To a camera of narrow view a scene looks nearly like its Necker reversal, with depth and motion reversed.
//! Which of the two a pair of keyframes begins with is chance, and adjustment stays with it.

use super::initialization::has_parallax;
use super::registration::{MIN_FOCAL_FRAMES, adjust_globally};
use crate::result::Reconstruction;
use crate::sfm_state::SfmState;
use crate::warning::Warning;
use i2slam_geometry::{Camera, Pose};

/// Largest cost of the known path, relative to that of the found one, at which it is taken. Measured 0.64
/// to 0.88 on three films whose found path was another minimum, and 0.96 to 1.63 on 23 others.
const MAX_COST_RATIO: f64 = 0.9;
/// Rounds of adjustment before costs are compared.
const ADJUSTMENT_ROUNDS: usize = 2;

/// Keyframes that were posed when the last frame came, with the camera by which they were.
pub(crate) struct KnownPath {
    pub(crate) camera: Camera<f64>,
    pub(crate) keyframes: Vec<(usize, Pose<f64>)>,
}

impl KnownPath {
    /// The path of a state.
    pub(crate) fn of(state: &SfmState) -> Self {
        Self { camera: state.camera, keyframes: state.posed_keyframes() }
    }

    /// Begins the map of a film by colour alone with this path, adjusted, where no two keyframes alone do; false,
    /// and the state is empty, if it has less than half of the keyframes, or too little parallax as well.
    pub(crate) fn begin(&self, state: &mut SfmState, adjust_focal: bool) -> bool {
        state.reset();
        let least = MIN_FOCAL_FRAMES.max(state.tracks.keyframes.len().div_ceil(2));
        let is_possible = self.keyframes.len() >= least && !state.has_depth();
        if !is_possible || state.progress.is_cancelled() {
            return false;
        }
        if adjust_focal {
            // That of the search goes with another focal length.
            state.update_distortion(state.distortion.map(|k| -k));
            state.camera = self.camera;
        }
        let refined = adjusted(state.keyframes_only(), &self.keyframes, adjust_focal).1;
        let begins = has_parallax(&refined);
        if begins {
            state.start_from(refined);
        }
        begins
    }

    /// A state with these poses of keyframes, adjusted, in place of all that were found by colour alone, where
    /// they fit better those keyframes that both pose, which are at least half of the found ones.
    pub(crate) fn better_than(&self, state: &SfmState, adjust_focal: bool) -> Option<SfmState> {
        let least = MIN_FOCAL_FRAMES.max(state.posed_keyframes().len().div_ceil(2));
        let in_both = |(frame, pose): &(usize, Pose<f64>)| {
            Some(((*frame, *pose), (*frame, state.poses[*frame]?)))
        };
        let (of_known, of_found): (Vec<_>, Vec<_>) =
            self.keyframes.iter().filter_map(in_both).unzip();
        if of_known.len() < least || state.progress.is_cancelled() {
            return None;
        }
        // Observations in other frames do not affect keyframes.
        let mut keyframes = state.keyframes_only();
        keyframes.reset();
        let found_cost = adjusted(keyframes.clone(), &of_found, adjust_focal).0;
        let (known_cost, refined) = adjusted(keyframes, &of_known, adjust_focal);
        if known_cost >= MAX_COST_RATIO * found_cost || state.progress.is_cancelled() {
            return None;
        }
        let mut better = state.clone();
        better.reset();
        better.start_from(refined);
        Some(better)
    }
}

impl SfmState {
    /// Takes camera and poses of an adjusted state of the same keyframes into one without poses.
    fn start_from(&mut self, refined: SfmState) {
        self.camera = refined.camera;
        // A state of keyframes alone counts it from that of this one on.
        self.update_distortion(refined.distortion);
        self.noise_scale = refined.noise_scale;
        self.poses = refined.poses;
        self.triangulate_missing();
    }
}

impl Reconstruction {
    /// The path with the warning that it has little parallax, and none of its poses converged.
    #[must_use]
    pub(crate) fn with_little_parallax(mut self) -> Self {
        self.warnings.push(Warning::LittleParallax);
        self.deviations.iter_mut().flatten().for_each(|deviation| deviation.converged = false);
        self
    }
}

/// The truncated cost of some keyframes, adjusted from their poses on, and the state.
fn adjusted(
    mut keyframes: SfmState,
    poses: &[(usize, Pose<f64>)],
    adjust_focal: bool,
) -> (f64, SfmState) {
    poses.iter().for_each(|(frame, pose)| keyframes.poses[*frame] = Some(*pose));
    keyframes.triangulate_missing();
    for _ in 0..ADJUSTMENT_ROUNDS {
        adjust_globally(&mut keyframes, adjust_focal);
    }
    let cost = keyframes.truncated_cost(&keyframes.posed_frames());
    (cost, keyframes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{camera, state};
    use i2slam_geometry::{Rotation, Vec3};

    const FRAMES: usize = 24;

    /// Around a point before the first camera, to the right or, in the reversal, to the left.
    fn orbit(frame: usize, turn: f64) -> Pose<f64> {
        let centre = Vec3::new(0.0, 0.0, 2.5);
        let rotation = Rotation::exp(Vec3::new(0.0, turn * (frame as f64 - 12.0), 0.0));
        Pose::new(rotation, centre - rotation.rotate(centre))
    }

    fn pose(frame: usize) -> Pose<f64> {
        orbit(frame, 0.008)
    }

    fn reversed(frame: usize) -> Pose<f64> {
        orbit(frame, -0.008)
    }

    /// A path with the poses given, found in pictures of narrow view with the true ones.
    fn found(poses: fn(usize) -> Pose<f64>, posed: std::ops::Range<usize>) -> SfmState {
        let observe = |point: Vec3<f64>, frame: usize, n: &[f64]| {
            let (u, v) = camera().project(pose(frame).inverse() * point);
            Some([u + 0.3 * n[0], v + 0.3 * n[1]])
        };
        let mut state = state((FRAMES, 12, 2), [25.0, 20.0], pose, observe);
        state.reset();
        posed.for_each(|frame| state.poses[frame] = Some(poses(frame)));
        state.triangulate_missing();
        state
    }

    fn known(poses: fn(usize) -> Pose<f64>, from: usize) -> KnownPath {
        let keyframes = (from..FRAMES).step_by(2).map(|frame| (frame, poses(frame))).collect();
        KnownPath { camera: camera(), keyframes }
    }

    #[test]
    fn the_reversal_is_given_up_for_the_known_path() {
        let before = found(reversed, 0..FRAMES);
        let state = known(pose, 0).better_than(&before, false).expect("a better one");
        let [first, last] = [0, FRAMES - 2].map(|frame| state.poses[frame].expect("posed"));
        let turned = |a: Pose<f64>, b: Pose<f64>| a.local(b).rotation.y;
        let share = turned(first, last) / turned(pose(0), pose(FRAMES - 2));
        assert!((share - 1.0).abs() < 0.2 && state.poses[1].is_none(), "{share}");
        assert!(state.landmarks.iter().flatten().count() > 100);
        // Half of the keyframes tell it, fewer do not.
        assert!(known(pose, 12).better_than(&before, false).is_some());
        assert!(known(pose, 14).better_than(&before, false).is_none());
    }

    #[test]
    fn a_path_that_fits_as_well_stays() {
        for posed in [0..FRAMES, FRAMES / 2..FRAMES] {
            let state = found(pose, posed);
            for others in [known(pose, 0), known(reversed, 0), known(pose, 20), known(pose, FRAMES)]
            {
                assert!(others.better_than(&state, false).is_none());
            }
        }
    }

    #[test]
    fn a_film_without_a_pair_to_begin_with_begins_with_the_known_path() {
        let mut state = found(pose, 0..0);
        let focal_length = state.camera.fx;
        state.camera = Camera { fx: 1.3 * focal_length, fy: 1.3 * focal_length, ..state.camera };
        assert!(!known(pose, 14).begin(&mut state, true) && state.posed_frames().is_empty());
        let still = known(|frame| Pose::new(pose(frame).rotation, Vec3::zero()), 0);
        assert!(!still.begin(&mut state, false) && state.posed_frames().is_empty());
        assert!(known(pose, 0).begin(&mut state, true));
        assert_eq!(state.posed_frames().len(), FRAMES / 2);
        assert!((state.camera.fx / focal_length - 1.0).abs() < 0.1, "{}", state.camera.fx);
        assert!(state.landmarks.iter().flatten().count() > 100);
    }
}
