use super::*;
use crate::fixtures;
use i2slam_geometry::{Rotation, Vec3};

fn pose(frame: usize) -> Pose<f64> {
    let t = frame as f64;
    Pose::new(Rotation::exp(Vec3::new(0.0, 0.02 * t, 0.0)), Vec3::new(0.1 * t, 0.0, 0.0))
}

/// A film in which so many points begin in every frame.
fn film(points: usize) -> SfmState {
    let observe = |point: Vec3<f64>, frame: usize, _: &[f64]| {
        let (u, v) = fixtures::camera().project(pose(frame).inverse() * point);
        Some([u, v])
    };
    let mut state = fixtures::state((20, points, 2), [150.0, 110.0], pose, observe);
    state.reset();
    state
}

#[test]
fn a_film_of_too_few_points_has_the_given_path() {
    let given: Vec<_> = (0..20).map(|frame| Some(pose(frame))).collect();
    let mut state = film(2);
    assert!(matches!(
        estimate_path_or_take(&mut state, None, &[], false),
        Err(OdometryError::TooFewPoints)
    ));
    assert!(matches!(
        estimate_path_or_take(&mut state, None, &given, false),
        Ok(PathSource::Given)
    ));
    assert_eq!(state.poses, given);
    assert!(state.landmarks.iter().flatten().count() > 30);
}

#[test]
fn a_film_whose_path_is_found_leaves_the_given_one() {
    let off =
        |frame: usize| Pose::new(Rotation::identity(), Vec3::new(0.0, 0.05 * frame as f64, 0.0));
    let given: Vec<_> = (0..20).map(|frame| Some(off(frame) * pose(frame))).collect();
    let mut state = film(20);
    assert!(matches!(
        estimate_path_or_take(&mut state, None, &given, false),
        Ok(PathSource::Tracks)
    ));
    // The true path lies along the first camera's x axis.
    let [first, last] = [0, 19].map(|frame| state.poses[frame].expect("posed"));
    let along = (first.inverse() * last).translation;
    assert!(along.y.abs() < 0.02 * along.x && along.z.abs() < 0.02 * along.x, "{along:?}");
}

/// Of doubled pictures that are due as keyframes, the copies of those held out are none either.
#[test]
fn a_picture_that_repeats_one_held_out_is_no_keyframe() {
    let camera = Camera { width: 96, height: 72, fx: 90.0, fy: 90.0, cx: 48.0, cy: 36.0 };
    let mut front_end = FrontEnd::new(Intrinsics::Known(camera));
    let wave = |i: f32, j: f32| (0.7 * i).sin() * (0.6 * j).cos() + (0.23 * i + 0.31 * j).sin();
    let picture = |number: usize| {
        let moved = 2.0 * number as f32;
        Image::from_fn(96, 72, 1, |_, i, j| 0.5 + 0.15 * wave(i as f32 + moved, j as f32))
    };
    for number in 0..40 {
        let (picture, is_held_out) = (picture(number / 2), number % 4 == 2);
        let pushed = match is_held_out {
            true => front_end.push_held_out(&picture, number as f64, None),
            false => front_end.push(&picture, number as f64, None),
        };
        pushed.expect("a picture");
    }
    let keyframes = &front_end.map.state.tracks.keyframes;
    assert!(keyframes.len() > 3, "{keyframes:?}");
    assert!(keyframes.iter().all(|frame| frame % 4 < 2), "{keyframes:?}");
}

#[test]
fn a_camera_that_stands_still_is_told_from_one_that_sees_too_little() {
    let camera = Camera { width: 160, height: 120, fx: 150.0, fy: 150.0, cx: 80.0, cy: 60.0 };
    let wave = |i: f32, j: f32| (0.7 * i).sin() * (0.6 * j).cos() + (0.23 * i + 0.31 * j).sin();
    let end = |contrast: f32| {
        let mut front_end = FrontEnd::new(Intrinsics::Known(camera));
        for number in 0..20 {
            // A sensor's noise, so that no picture repeats the one before.
            let noise = |i: usize, j: usize| ((7 * i + 3 * j + 5 * number) % 11) as f32 - 5.0;
            let value =
                |i: usize, j: usize| 0.5 + contrast * wave(i as f32, j as f32) + 2e-4 * noise(i, j);
            let picture = Image::from_fn(160, 120, 1, |_, i, j| value(i, j));
            front_end.push(&picture, number as f64, None).expect("a picture");
        }
        front_end.finish(Progress::default()).expect_err("no path")
    };
    assert!(matches!(end(0.15), OdometryError::StillCamera { motion } if motion < 0.5));
    assert!(matches!(end(0.0), OdometryError::TooFewPoints));
}

#[test]
fn a_film_of_little_parallax_begins_with_the_known_path() {
    let moved = |frame: usize| {
        let t = frame as f64;
        Pose::new(Rotation::exp(Vec3::new(0.0, 0.004 * t, 0.0)), Vec3::new(0.0012 * t, 0.0, 0.0))
    };
    let observe = |point: Vec3<f64>, frame: usize, _: &[f64]| {
        let (u, v) = fixtures::camera().project(moved(frame).inverse() * point);
        Some([u, v])
    };
    let mut film = fixtures::state((20, 20, 2), [150.0, 110.0], moved, observe);
    film.reset();
    let without = estimate_path_or_take(&mut film.clone(), None, &[], false);
    assert!(matches!(without, Err(OdometryError::RotationOnly { .. })), "{without:?}");
    let keyframes = (0..20).step_by(2).map(|frame| (frame, moved(frame))).collect();
    let known = KnownPath { camera: film.camera, keyframes };
    let mut state = film.clone();
    let source = estimate_path_or_take(&mut state, Some(&known), &[], false);
    assert!(matches!(source, Ok(PathSource::Known)), "{source:?}");
    assert_eq!(state.posed_frames().len(), 20);
    // Poses that were given come before.
    let given: Vec<_> = (0..20).map(|frame| Some(moved(frame))).collect();
    let mut state = film.clone();
    let source = estimate_path_or_take(&mut state, Some(&known), &given, false);
    assert!(matches!(source, Ok(PathSource::Given)) && state.poses == given, "{source:?}");
}
