//! Frames with poses that come late or again, on a map of Gaussians.

use super::posed_tests::{keyframe, pose};
use super::*;
use crate::keyframes::{EstimatedDepth, PosedKeyframe};
use crate::session::tracked_tests::{CAMERA, frame};
use i2slam_geometry::{Pose, Rotation, Vec3};

/// A few steps on a map of Gaussians.
fn quick_gaussians() -> Config {
    let mut config = Config::preset("default-rgb").expect("known");
    let mapping = &mut config.mapping;
    (mapping.first_iterations, mapping.iterations) = (5, 2);
    config
}

/// At the pose and with the depth of the room.
fn measured_keyframe(index: usize) -> PosedKeyframe {
    let depth = frame(index, pose(index)).depth.expect("measured").image;
    let depth = EstimatedDepth { depth: (*depth).clone(), variance: None };
    PosedKeyframe { depth: Some(depth), ..keyframe(index, pose(index)) }
}

/// A frame that comes late takes its place, and the tone of the frame before it.
#[test]
fn a_late_frame_goes_between_its_neighbours() {
    let mut session = Session::refining(quick_gaussians(), CAMERA, 30.0);
    for index in [0, 1, 3, 4] {
        session.add_keyframe(measured_keyframe(index)).expect("a keyframe");
    }
    for frame in &mut session.state.frames {
        frame.tone.log_exposure = frame.index as f32;
    }
    // A blank frame is not mapped, and keeps the tone that it begins with.
    let mut blank = measured_keyframe(2);
    Arc::make_mut(&mut blank.colour).data.fill(0.0);
    session.add_keyframe(blank).expect("a keyframe");
    let indices = |session: &Session| -> Vec<usize> {
        session.frames().iter().map(|frame| frame.index).collect()
    };
    assert_eq!(indices(&session), [0, 1, 2, 3, 4]);
    assert_eq!(session.frames()[2].tone.log_exposure, 1.0);
    let keyframes: Vec<usize> = session.state.keyframes.iter().map(|k| k.frame).collect();
    assert_eq!(keyframes, [0, 1, 3, 4]);
}

/// A frame that is mapped again replaces itself; one that cannot be used does not.
#[test]
fn a_frame_that_comes_again_is_replaced() {
    let mut session = Session::refining(quick_gaussians(), CAMERA, 30.0);
    for index in 0..4 {
        session.add_keyframe(measured_keyframe(index)).expect("a keyframe");
    }
    let (frames, gaussians) = (session.frames().len(), session.mapper.gaussians());
    let lost = PosedKeyframe {
        world_from_camera: Pose::new(Rotation::identity(), Vec3::new(f64::NAN, 0.0, 0.0)),
        ..measured_keyframe(0)
    };
    session.add_keyframe(lost).expect_err("no pose");
    assert_eq!((session.frames().len(), session.mapper.gaussians()), (frames, gaussians));
    session.add_keyframe(measured_keyframe(0)).expect("a keyframe");
    assert_eq!(session.frames().len(), frames);
    let keyframes: Vec<usize> = session.state.keyframes.iter().map(|k| k.frame).collect();
    assert_eq!(keyframes, [0, 1, 2, 3]);
    let again = session.mapper.gaussians();
    assert!(again < gaussians + gaussians / 4, "{gaussians} -> {again}");
}
