//! Photographs of one scene, taken from places far apart and in no order.

use crate::scene::{camera, picture, tracked};
use i2slam_geometry::{Pose, Rotation, Vec3};
use i2slam_odometry::{Intrinsics, Progress, Warning};

const COUNT: usize = 8;

/// Places on an arc around the box, 12 degrees apart.
fn place(step: usize) -> Pose<f64> {
    let angle = 0.21 * (step as f64 - 0.5 * (COUNT - 1) as f64);
    let middle = Vec3::new(0.0, 0.0, 2.2);
    let turn = Rotation::exp(Vec3::new(0.0, angle, 0.0));
    Pose::new(turn, middle - turn.rotate(Vec3::new(0.0, 0.1 * (step % 3) as f64, 2.2)))
}

#[test]
fn photographs_in_no_order_are_matched_and_placed() {
    let order = [3, 7, 1, 5, 0, 6, 2, 4];
    let pictures = order.iter().map(|step| picture(1, place(*step), 1.0));
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
    let mut pictures: Vec<_> =
        [3, 7, 1, 5, 0, 6, 2, 4].iter().map(|step| picture(1, place(*step), 1.0)).collect();
    pictures.insert(4, picture(77, place(3), 1.0));
    let front_end = tracked(Intrinsics::Known(camera()), pictures.into_iter());
    let found = front_end.finish(Progress::default()).expect("a path");
    assert!(found.is_unordered && found.poses[4].is_none());
    let named = Warning::PhotographsNotPlaced { frames: [4, 4] };
    assert!(found.warnings.contains(&named), "{:?}", found.warnings);
}
