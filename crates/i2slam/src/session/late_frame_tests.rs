//! Frames with poses that come late or again, and their white balance, on a map of Gaussians.

use super::posed_tests::{keyframe, pose};
use super::*;
use crate::keyframes::{EstimatedDepth, PosedKeyframe};
use crate::reconstruction::Map;
use crate::session::tracked_tests::{CAMERA, frame};
use i2slam_formation::FrameTone;
use i2slam_geometry::{Pose, Rotation, Vec3};
use i2slam_radiance::gaussian::GaussianMap;

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

/// Gaussians on a surface that pictures contradict leave the map; it grows at the depth found instead,
/// and only there.
#[test]
fn a_contradicted_surface_is_replaced() {
    let mut session = Session::refining(quick_gaussians(), CAMERA, 30.0);
    session.add_keyframe(measured_keyframe(0)).expect("a keyframe");
    let Some(EstimatedDepth { depth, .. }) = measured_keyframe(0).depth else { panic!("measured") };
    let left = |pixel: usize| pixel % CAMERA.width < CAMERA.width / 2;
    let part = |scale: [f32; 2]| {
        let pixels = depth.data.iter().enumerate();
        let data = pixels.map(|(i, z)| z * scale[usize::from(left(i))]).collect();
        Image { data, ..depth.clone() }
    };
    let farther = EstimatedDepth { depth: part([1.0, 1.5]), variance: None };
    let before = session.mapper.map();
    session.revise_depth(99, farther.clone(), &part([0.0, 1.0]));
    let (Map::Gaussians(before), Map::Gaussians(same)) = (before, session.mapper.map()) else {
        panic!("a map of Gaussians")
    };
    assert_eq!(before.means, same.means, "no such keyframe");
    session.revise_depth(0, farther, &part([0.0, 1.0]));
    let Map::Gaussians(after) = session.mapper.map() else { panic!("a map of Gaussians") };
    let camera_from_world = session.frames()[0].middle().inverse();
    let mean_ratio = |map: &GaussianMap, of_left: bool| {
        let ratios: Vec<f64> = map
            .means
            .iter()
            .filter_map(|mean| {
                let point = camera_from_world * Vec3::from_array(mean.map(f64::from));
                let (u, v) = CAMERA.project(point);
                let pixel = v as usize * CAMERA.width + u as usize;
                let near_middle = (u - CAMERA.width as f64 / 2.0).abs() < 4.0;
                let is_shown = CAMERA.contains(u, v, 0.0) && !near_middle && left(pixel) == of_left;
                is_shown.then(|| point.z / f64::from(depth.data[pixel]))
            })
            .collect();
        ratios.iter().sum::<f64>() / ratios.len() as f64
    };
    let ratios = |of_left: bool| [mean_ratio(&before, of_left), mean_ratio(&after, of_left)];
    let (left, right) = (ratios(true), ratios(false));
    assert!((left[0] - 1.0).abs() < 0.03 && left[1] > 1.4, "{left:?}");
    assert!(right.iter().all(|ratio| (ratio - 1.0).abs() < 0.03), "{right:?}");
}

/// Tones of eight frames, whose red is multiplied in pictures.
fn tones(red: impl Fn(usize) -> f32) -> Vec<FrameTone<f32>> {
    let mut config = quick_gaussians();
    config.mapping.final_iterations = 30;
    let mut session = Session::refining(config, CAMERA, 30.0);
    for index in 0..8 {
        let mut frame = measured_keyframe(index);
        let picture = Arc::make_mut(&mut frame.colour);
        picture.plane_mut(0).iter_mut().for_each(|value| *value *= red(index));
        session.add_keyframe(frame).expect("a keyframe");
    }
    session.finish(&mut |_, _| true);
    session.frames().iter().map(|frame| frame.tone).collect()
}

#[test]
fn white_balance_is_the_same_in_all_frames_where_pictures_show_no_change() {
    let constant = tones(|_| 1.0);
    assert!(constant.iter().all(|tone| tone.log_white_balance == [0.0; 3]), "{constant:?}");
    let red = |index: usize| 0.9 + 0.1 * (index as f32).cos();
    let changing = tones(red);
    let [found, least] = [
        changing[3].log_white_balance[0] - changing[6].log_white_balance[0],
        // A linear value changes more than the value of its picture.
        (red(3) / red(6)).ln(),
    ];
    assert!(found < least, "{found} {least}");
}
