//! Revisited places: loop closure, cuts and covered lenses.

use crate::scene::{camera, moving, picture, render, texture, track, tracked};
use i2slam_eval::trajectory::{Alignment, absolute_trajectory_error};
use i2slam_geometry::{Image, Pose, Rotation, StampedPose, Vec3};
use i2slam_odometry::{FrontEnd, Intrinsics, Progress, Reconstruction, Warning};
use rayon::prelude::*;

fn run(pictures: &[Image<f32>]) -> Reconstruction {
    tracked(Intrinsics::Known(camera()), pictures.iter().cloned())
        .finish(Progress::default())
        .expect("a path")
}

/// Root mean square error of the posed frames after alignment by a similarity.
fn path_error(found: &Reconstruction, truth: &[Pose<f64>]) -> f64 {
    let stamped = |(world_from_camera, timestamp): (&Pose<f64>, &f64)| StampedPose {
        timestamp: *timestamp,
        world_from_camera: *world_from_camera,
    };
    let truth: Vec<StampedPose> = truth.iter().zip(&found.timestamps).map(stamped).collect();
    let error = absolute_trajectory_error(&found.trajectory(), &truth, Alignment::Sim3, 1e-3);
    error.expect("enough poses").ate_rmse_m
}

/// A room of four walls with pillars before them, a floor and a ceiling.
fn hall(from: Vec3<f64>, direction: Vec3<f64>) -> f64 {
    let mut nearest = (f64::INFINITY, 0.5);
    let mut meet = |distance: f64, face: u32, place: &dyn Fn(Vec3<f64>) -> Option<(f64, f64)>| {
        let is_nearer = distance > 1e-3 && distance < nearest.0;
        if let Some((s, t)) = is_nearer.then(|| place(from + direction * distance)).flatten() {
            nearest = (distance, texture(900 + face, s, t));
        }
    };
    for (side, half) in [(1.0, 4.0), (-1.0, 4.0), (1.0, 3.2), (-1.0, 3.2)] {
        let is_wall = half > 3.5;
        let face = (if side > 0.0 { 0 } else { 2 }) + if is_wall { 0 } else { 4 };
        let shown = |s: f64| is_wall || (s + 8.0) % 1.6 < 0.5;
        let on = |s: f64, p: Vec3<f64>| (s.abs() <= half && shown(s)).then_some((s, p.y));
        meet((side * half - from.x) / direction.x, face, &|p| on(p.z, p));
        meet((side * half - from.z) / direction.z, face + 1, &|p| on(p.x, p));
    }
    meet((1.2 - from.y) / direction.y, 8, &|p| Some((p.x, p.z)));
    meet((-1.8 - from.y) / direction.y, 9, &|p| Some((p.x, p.z)));
    nearest.1
}

/// Once round the hall and a little farther, looking outward; rough as a hand.
fn round(i: usize) -> Pose<f64> {
    let s = i as f64;
    let angle = std::f64::consts::TAU * s / 96.0;
    let turn = Rotation::exp(Vec3::new(0.0, angle, 0.0));
    let shake = Rotation::exp(Vec3::new(0.02 * (0.7 * s).sin(), 0.0, 0.02 * (0.4 * s).cos()));
    let place = Vec3::new(1.2 * angle.sin(), 0.1 * (0.3 * s).sin(), 1.2 * angle.cos());
    Pose::new(turn * shake, place)
}

fn with_noise(mut picture: Image<f32>, seed: usize) -> Image<f32> {
    let noise = i2slam_check::noise(seed as u64, picture.data.len());
    picture.data.iter_mut().zip(noise).for_each(|(v, n)| *v += 0.02 * n as f32);
    picture
}

#[test]
fn a_path_closes_where_it_comes_back() {
    let truth: Vec<Pose<f64>> = (0..104).map(round).collect();
    let noisy = |i: usize| with_noise(render(truth[i], 1.0, hall), i);
    let pictures: Vec<Image<f32>> = (0..truth.len()).into_par_iter().map(noisy).collect();
    let mut open = FrontEnd::new(Intrinsics::Known(camera())).without_loop_closure();
    let mut closed = FrontEnd::new(Intrinsics::Known(camera()));
    let closures = [&mut open, &mut closed].map(|front_end| count_loops(front_end, &pictures));
    assert!(closures[0] == 0 && (1..=3).contains(&closures[1]), "while frames come: {closures:?}");
    let seams = [&open, &closed].map(|front_end| seam(&front_end.path_so_far(None), &truth));
    assert!(seams[1] < 0.5 * seams[0], "{seams:?}");
    let [open, closed] =
        [open, closed].map(|front_end| front_end.finish(Progress::default()).expect("a path"));
    assert_eq!(closed.trajectory().len(), truth.len());
    let (closed, open) = (path_error(&closed, &truth), path_error(&open, &truth));
    assert!(closed < 0.5 * open, "{closed} {open}");
}

/// Tracks all pictures; returns the number of frames at which a loop was closed.
fn count_loops(front_end: &mut FrontEnd, pictures: &[Image<f32>]) -> usize {
    let updates = track(front_end, pictures.iter().cloned());
    updates.iter().filter(|update| update.is_loop_closed).count()
}

/// Distance from where the last frame is to where it should be, as seen from the first one, with the
/// length of the path scaled to the true one.
fn seam(found: &Reconstruction, truth: &[Pose<f64>]) -> f64 {
    let path = found.trajectory();
    let (first, last) = (&path[0], &path[path.len() - 1]);
    let at = |pose: &StampedPose| (pose.timestamp * 30.0).round() as usize;
    let relative = (first.world_from_camera.inverse() * last.world_from_camera).translation;
    let true_relative = (truth[at(first)].inverse() * truth[at(last)]).translation;
    let length = |places: &mut dyn Iterator<Item = Vec3<f64>>| {
        let places: Vec<Vec3<f64>> = places.collect();
        places.windows(2).map(|p| (p[1] - p[0]).norm()).sum::<f64>()
    };
    let scale = length(&mut truth.iter().map(|pose| pose.translation))
        / length(&mut path.iter().map(|pose| pose.world_from_camera.translation));
    (relative * scale - true_relative).norm()
}

/// A long wall with a pattern that repeats, and a floor that does not; pillars that repeat, too.
fn arcade(from: Vec3<f64>, direction: Vec3<f64>) -> f64 {
    let at = |distance: f64| from + direction * distance;
    let pillar = at((3.2 - from.z) / direction.z);
    if (pillar.x + 60.0) % 1.5 < 0.4 && pillar.y < 1.2 {
        return texture(70, (pillar.x + 60.0) % 1.5, pillar.y);
    }
    let (wall, floor) = (at((4.0 - from.z) / direction.z), at((1.2 - from.y) / direction.y));
    if wall.y < 1.2 {
        return 0.8 * texture(71, (wall.x + 60.0) % 1.5, wall.y)
            + 0.2 * texture(72, wall.x, wall.y);
    }
    texture(73, floor.x, floor.z)
}

#[test]
fn what_repeats_along_a_way_closes_no_path() {
    let way = |i: usize| {
        let s = i as f64;
        let turn = Vec3::new(0.02 * (0.4 * s).sin(), 0.03 * (0.3 * s).sin(), 0.0);
        Pose::new(Rotation::exp(turn), Vec3::new(0.15 * s, 0.03 * (0.5 * s).sin(), 0.0))
    };
    let truth: Vec<Pose<f64>> = (0..60).map(way).collect();
    let pictures: Vec<Image<f32>> = truth.par_iter().map(|p| render(*p, 1.0, arcade)).collect();
    let mut front_end = FrontEnd::new(Intrinsics::Known(camera()));
    assert_eq!(count_loops(&mut front_end, &pictures), 0, "loops closed while frames come");
    let found = front_end.finish(Progress::default()).expect("a path");
    let error = path_error(&found, &truth);
    assert!(error < 0.02 * truth[59].translation.x, "{error}");
}

/// Pictures of the first room, but for those of `other`, which are of another one or black.
fn interrupted(other: std::ops::Range<usize>, seed: Option<u32>) -> Vec<Image<f32>> {
    let one = |i: usize| match seed {
        _ if !other.contains(&i) => picture(1, moving(i), 1.0),
        Some(seed) => picture(seed, moving(i), 1.0),
        None => Image::new(camera().width, camera().height, 3),
    };
    (0..30).into_par_iter().map(one).collect()
}

fn lost(found: &Reconstruction) -> Vec<usize> {
    let is_lost = |i: &usize| found.poses[*i].is_none();
    (0..found.poses.len()).filter(is_lost).collect()
}

#[test]
fn frames_behind_a_covered_lens_are_lost_and_those_on_both_sides_posed() {
    let found = run(&interrupted(12..18, None));
    assert_eq!(lost(&found), (12..18).collect::<Vec<_>>());
    let warning = Warning::BlankFrames { frames: [12, 17] };
    assert!(found.warnings.contains(&warning), "{:?}", found.warnings);
    let truth: Vec<Pose<f64>> = (0..30).map(moving).collect();
    let error = path_error(&found, &truth);
    assert!(error < 0.01, "{error}");
}

#[test]
fn both_sides_of_a_cut_at_one_place_are_posed() {
    // After the cut the camera continues from a place that it passed before.
    let truth: Vec<Pose<f64>> = (0..14).chain((4..18).rev()).map(moving).collect();
    let mut pictures: Vec<Image<f32>> = truth.par_iter().map(|p| picture(1, *p, 1.0)).collect();
    pictures.splice(14..14, interrupted(3..7, Some(9)).drain(3..7));
    let found = run(&pictures);
    assert_eq!(lost(&found), [14, 15, 16, 17]);
    let mut truth = truth;
    truth.splice(14..14, (3..7).map(moving));
    let error = path_error(&found, &truth);
    assert!(error < 0.01, "{error}");
}

#[test]
fn a_cut_is_reported_and_the_part_that_shows_another_place_named() {
    let mut front_end = FrontEnd::new(Intrinsics::Known(camera()));
    for (i, picture) in interrupted(0..11, Some(7)).iter().enumerate() {
        let update =
            front_end.push(picture, i as f64 / 30.0, None).expect("a picture of that size");
        assert_eq!(update.is_cut, i == 11, "frame {i}");
    }
    let found = front_end.finish(Progress::default()).expect("a path");
    assert_eq!(lost(&found), (0..11).collect::<Vec<_>>());
    let warning = Warning::DisconnectedFrames { frames: [0, 10] };
    assert!(found.warnings.contains(&warning), "{:?}", found.warnings);
    assert!(found.warnings.contains(&Warning::FramesLost { lost: 11, frames: 30 }));
}
