//! Overlap of the views of two frames with known poses, by landmarks of one in the other.

use crate::sfm_state::SfmState;
use i2slam_compute::median;

/// Landmarks sampled, and the number that must be visible where views overlap.
pub(crate) const SAMPLED_LANDMARKS: usize = 24;
pub(crate) const MIN_VISIBLE_LANDMARKS: usize = 12;
/// Angle between the viewing directions up to which views overlap [rad].
const MAX_VIEW_ANGLE: f64 = 0.7;

/// Landmarks of a frame seen from another one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct ViewOverlap {
    /// Landmarks sampled.
    pub(crate) sampled: usize,
    /// Those that project into the picture of the other frame.
    pub(crate) visible: usize,
    /// Median distance of their image positions in both frames [px].
    pub(crate) motion: f64,
}

/// Overlap of a frame with landmarks of another one; none where a pose is unknown.
pub(crate) fn view_overlap(state: &SfmState, frame: usize, other: usize) -> ViewOverlap {
    let (Some(pose), Some(there)) = (state.poses[frame], state.poses[other]) else {
        return ViewOverlap::default();
    };
    if pose.local(there).rotation.norm() > MAX_VIEW_ANGLE {
        return ViewOverlap::default();
    }
    let shown = &state.by_frame[other];
    let some = shown.iter().step_by((shown.len() / SAMPLED_LANDMARKS).max(1));
    let (mut sampled, mut motions) = (0, Vec::new());
    for track in some.take(SAMPLED_LANDMARKS) {
        let seen = state.tracks.tracks[*track].observation_in(other);
        let Some((landmark, seen)) = state.landmarks[*track].as_ref().zip(seen) else { continue };
        sampled += 1;
        let at = landmark.image_position(&state.camera, &pose);
        let inside = at.filter(|at| state.camera.contains(at[0], at[1], 0.0));
        motions.extend(inside.map(|at| (at[0] - seen.at()[0]).hypot(at[1] - seen.at()[1])));
    }
    let visible = motions.len();
    ViewOverlap { sampled, visible, motion: median(&mut motions).unwrap_or(f64::INFINITY) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;
    use i2slam_geometry::{Pose, Rotation, Vec3};

    /// A view from where another one was taken overlaps wholly, one beside it by less, one turned
    /// away not at all.
    #[test]
    fn views_overlap_less_the_farther_apart_they_are() {
        let pose = |frame: usize| {
            let turn = if frame < 4 { 0.0 } else { 1.2 };
            let place = Vec3::new([0.0, 0.0, 0.3, 1.0, 0.0][frame], 0.0, 0.0);
            Pose::new(Rotation::exp(Vec3::new(0.0, turn, 0.0)), place)
        };
        let observe = |point: Vec3<f64>, frame: usize, _: &[f64]| {
            let (u, v) = fixtures::camera().project(pose(frame).inverse() * point);
            Some([u, v])
        };
        let state = fixtures::state((5, 40, 1), [140.0, 100.0], pose, observe);
        let [same, beside, far, away] = [1, 2, 3, 4].map(|frame| view_overlap(&state, frame, 0));
        assert!(same.visible == same.sampled && same.motion < 1.0, "{same:?}");
        assert!(beside.visible > far.visible && beside.motion < far.motion, "{beside:?} {far:?}");
        assert!(same.visible > far.visible, "{same:?} {far:?}");
        assert_eq!(away, ViewOverlap::default());
    }
}
