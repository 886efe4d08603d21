//! Photographs of one scene, taken from places far apart and in no order.

use crate::scene::{camera, depth, picture, tracked};
use i2slam_check::noise;
use i2slam_geometry::{Camera, Image, Pose, Rotation, Tangent, Vec3};
use i2slam_odometry::{DepthPicture, FrontEnd, Intrinsics, Progress, Warning};

const COUNT: usize = 8;
const ORDER: [usize; COUNT] = [3, 7, 1, 5, 0, 6, 2, 4];

/// Places on an arc around the box, 12 degrees apart.
fn place(step: usize) -> Pose<f64> {
    let angle = 0.21 * (step as f64 - 0.5 * (COUNT - 1) as f64);
    let middle = Vec3::new(0.0, 0.0, 2.2);
    let turn = Rotation::exp(Vec3::new(0.0, angle, 0.0));
    Pose::new(turn, middle - turn.rotate(Vec3::new(0.0, 0.1 * (step % 3) as f64, 2.2)))
}

#[test]
fn photographs_in_no_order_are_matched_and_placed() {
    let order = ORDER;
    let pictures = ORDER.iter().map(|step| picture(1, place(*step), 1.0));
    let front_end = tracked(Intrinsics::Known(camera()), pictures);
    let found = front_end.finish(Progress::default()).expect("a path");
    assert!(found.is_unordered);
    assert_eq!(found.poses.iter().flatten().count(), COUNT, "{:?}", found.warnings);
    let pose = |k: usize| found.poses[k].expect("posed");
    let distance = |a: Pose<f64>, b: Pose<f64>| (a.translation - b.translation).norm();
    let ratio = |k: usize| distance(pose(0), pose(k)) / distance(place(order[0]), place(order[k]));
    let scale = ratio(1);
    for k in 1..COUNT {
        assert!((ratio(k) / scale - 1.0).abs() < 0.03, "{k}: {} of {scale}", ratio(k));
        let off = pose(0).local(pose(k)).rotation - place(order[0]).local(place(order[k])).rotation;
        assert!(off.norm() < 0.02, "{k}: {off:?}");
    }
    // Nothing is claimed against neighbours in time.
    assert!(found.deviations.iter().all(Option::is_none));
}

#[test]
fn frames_of_a_film_are_not_taken_for_photographs() {
    let pictures = (0..12).map(|i| picture(1, crate::scene::moving(i), 1.0));
    let front_end = tracked(Intrinsics::Known(camera()), pictures);
    assert!(!front_end.finish(Progress::default()).expect("a path").is_unordered);
}

#[test]
fn a_photograph_of_another_place_is_named() {
    let mut pictures: Vec<_> = ORDER.iter().map(|step| picture(1, place(*step), 1.0)).collect();
    pictures.insert(4, picture(77, place(3), 1.0));
    let front_end = tracked(Intrinsics::Known(camera()), pictures.into_iter());
    let found = front_end.finish(Progress::default()).expect("a path");
    assert!(found.is_unordered && found.poses[4].is_none());
    let named = Warning::PhotographsNotPlaced { count: 1, photographs: ORDER.len() + 1 };
    assert!(found.warnings.contains(&named), "{:?}", found.warnings);
}

#[test]
fn photographs_with_depth_are_placed_in_metres() {
    let mut front_end = FrontEnd::new(Intrinsics::Known(camera()));
    for (k, step) in ORDER.into_iter().enumerate() {
        let (pose, timestamp) = (place(step), k as f64);
        let read = Image::from_fn(camera().width, camera().height, 1, |_, column, row| {
            let (u, v) = Camera::<f64>::pixel_centre(column, row);
            depth(pose, [u, v]) as f32
        });
        let read = DepthPicture { depth: &read, timestamp };
        front_end.push(&picture(1, pose, 1.0), timestamp, Some(&read)).expect("fits");
    }
    let found = front_end.finish(Progress::default()).expect("a path");
    assert!(found.is_unordered && found.depth_model.is_some());
    let pose = |k: usize| found.poses[k].expect("posed");
    for k in 1..COUNT {
        let off = (pose(0).inverse() * pose(k)).local(place(ORDER[0]).inverse() * place(ORDER[k]));
        assert!(off.translation.norm() < 0.02 && off.rotation.norm() < 0.02, "{k}: {off:?}");
    }
}

/// Poses in another unit and world, `sigma` times 2 cm and a degree off.
fn given(sigma: f64) -> Vec<Option<Pose<f64>>> {
    let world = Pose::new(Rotation::exp(Vec3::new(0.4, 0.1, -0.7)), Vec3::new(40.0, -7.0, 3.0));
    let pose = |step: usize| {
        let n = noise(30 + step as u64, 6);
        let of = |i: usize| sigma * 3_f64.sqrt() * n[i] * if i < 3 { 0.02 } else { 0.0175 };
        let Pose { rotation, translation } =
            world * place(step).retract(Tangent::from_array(std::array::from_fn(of)));
        Some(Pose { rotation, translation: translation * 100.0 })
    };
    ORDER.into_iter().map(pose).collect()
}

/// Largest error of the rotation between two photographs [rad].
fn largest_turn(poses: &[Option<Pose<f64>>]) -> f64 {
    let pose = |k: usize| poses[k].expect("posed");
    let off = |k: usize| {
        let due = place(ORDER[k - 1]).local(place(ORDER[k])).rotation;
        (pose(k - 1).local(pose(k)).rotation - due).norm()
    };
    (1..COUNT).map(off).fold(0.0, f64::max)
}

#[test]
fn given_poses_of_photographs_are_adjusted_unless_they_are_exact() {
    let pictures: Vec<_> = ORDER.iter().map(|step| picture(1, place(*step), 1.0)).collect();
    let find = |given: &[Option<Pose<f64>>]| {
        let front_end = tracked(Intrinsics::Known(camera()), pictures.iter().cloned());
        front_end.finish_near(given, Progress::default()).expect("a path")
    };
    let exact = find(&given(0.0));
    assert!(exact.is_unordered && exact.has_given_poses && largest_turn(&exact.poses) < 1e-9);
    assert!(exact.keyframes.iter().all(|k| k.depths.len() > 10));
    let wrong = given(1.0);
    let found = find(&wrong);
    let turns = [&wrong, &found.poses].map(|poses| largest_turn(poses));
    assert!(!found.has_given_poses && turns[1] < 0.4 * turns[0], "{turns:?}");
    // Poses of some alone.
    let some: Vec<_> = (0..COUNT - 2).map(|k| given(1.0)[k]).collect();
    let found = find(&some);
    assert!(largest_turn(&found.poses) < 0.4 * turns[0], "{}", largest_turn(&found.poses));
}
