//! The odometry as its users call it, on small rendered pictures of a room, good ones and bad ones.

mod dense;
mod online;
mod photographs;
mod progress;
mod revisits;
mod scene;
mod wrong_input;

use i2slam_geometry::{Camera, Image, Pose, Rotation, Vec3};
use i2slam_odometry::{
    FrontEnd, Intrinsics, OdometryError, PictureError, Progress, Reconstruction, Warning,
};
use scene::{blurred, camera, depth, moving, picture, through_lens, tracked};

/// Runs the front end on `count` pictures.
fn run(
    intrinsics: Intrinsics,
    count: usize,
    picture_of: impl Fn(usize) -> Image<f32>,
) -> Result<Reconstruction, OdometryError> {
    tracked(intrinsics, (0..count).map(picture_of)).finish(Progress::default())
}

/// Exposure goes up and down by a factor of two.
fn gain(i: usize) -> f32 {
    2.0_f32.powf((0.7 * i as f32).sin() - 0.5)
}

fn moving_picture(i: usize) -> Image<f32> {
    picture(1, moving(i), gain(i))
}

/// Largest error of a place over the path's length, scaled to the last frame's true place.
fn relative_error(found: &Reconstruction, pose: fn(usize) -> Pose<f64>) -> f64 {
    let first = pose(0).inverse();
    let truth: Vec<Vec3<f64>> =
        (0..found.poses.len()).map(|i| (first * pose(i)).translation).collect();
    let path = found.trajectory();
    assert_eq!(path.len(), truth.len(), "every frame has a pose");
    let last = truth.len() - 1;
    let length = truth[last].norm();
    let scale = length / path[last].world_from_camera.translation.norm();
    let error = |(p, t): (&i2slam_geometry::StampedPose, &Vec3<f64>)| {
        (p.world_from_camera.translation * scale - *t).norm()
    };
    path.iter().zip(&truth).map(error).fold(0.0, f64::max) / length
}

#[test]
fn a_moving_camera_is_followed_through_blur_and_changes_of_exposure() {
    let sometimes_blurred = |i: usize| match i % 3 {
        1 => blurred(1, i, gain(i)),
        _ => moving_picture(i),
    };
    let found = run(Intrinsics::Known(camera()), 24, sometimes_blurred).expect("a good sequence");
    let error = relative_error(&found, moving);
    assert!(error < 0.01, "{error}");
    assert!(found.warnings.is_empty(), "{:?}", found.warnings);
    // Depths are those of the room, but for points on edges, which lie before or behind.
    let first = &found.keyframes[0];
    let scale = {
        let last = found.trajectory().last().expect("posed").world_from_camera;
        (moving(0).inverse() * moving(23)).translation.norm() / last.translation.norm()
    };
    let off = |d: &i2slam_odometry::SparseDepth| {
        (d.depth * scale / depth(moving(first.index), d.at)).ln().abs()
    };
    let mut errors: Vec<f64> = first.depths.iter().map(off).collect();
    errors.sort_by(f64::total_cmp);
    let (count, wrong) = (errors.len(), errors.iter().filter(|e| **e > 0.03).count());
    assert!(
        count > 150 && errors[count / 2] < 0.015 && 7 * wrong < count,
        "{wrong} of {count}, {}",
        errors[count / 2]
    );
    assert!(first.depths.iter().all(|d| d.variance > 0.0));
}

#[test]
fn an_unknown_focal_length_is_found() {
    let guess = Camera { fx: 195.0, fy: 195.0, ..camera() };
    let found = run(Intrinsics::Guess(guess), 24, moving_picture).expect("a good sequence");
    assert!((found.camera.fx / camera().fx - 1.0).abs() < 0.01, "{}", found.camera.fx);
    assert!(found.focal_deviation.is_some_and(|d| d < 0.05), "{:?}", found.focal_deviation);
}

/// A camera on the same path that also turns, which separates focal length from distortion.
fn turning(i: usize) -> Pose<f64> {
    let s = i as f64;
    let turn = Vec3::new(0.2 * (0.5 * s).sin(), 0.3 * (0.22 * s).sin(), 0.25 * (0.35 * s).sin());
    Pose::new(Rotation::exp(turn), moving(i).translation)
}

#[test]
fn the_distortion_of_a_lens_is_found_on_demand() {
    let k1 = -0.15;
    let bent = |i: usize| through_lens(1, turning(i), k1);
    let guess = Camera { fx: 170.0, fy: 170.0, ..camera() };
    let found = run(Intrinsics::GuessWithDistortion(guess), 24, bent).expect("a good sequence");
    let straight = run(Intrinsics::Guess(guess), 24, bent).expect("a path all the same");
    let [a, b] = found.distortion.expect("asked for");
    let (error, bent) = (relative_error(&found, turning), relative_error(&straight, turning));
    assert!((found.camera.fx / camera().fx - 1.0).abs() < 0.03, "{}", found.camera.fx);
    // What the lens does to a point near the corner.
    let near_corner = |k1: f64, k2: f64| k1 * 0.6 + k2 * 0.36;
    assert!((near_corner(a, b) - near_corner(k1, 0.0)).abs() < 0.02, "{a} {b}");
    assert!(error < 0.01 && error < 0.5 * bent, "{error} {bent}");
    assert_eq!(straight.distortion, None);
}

/// On a straight path a lens cannot be told from another focal length: none is taken.
#[test]
fn a_lens_that_is_not_determined_is_none() {
    let guess = Camera { fx: 170.0, fy: 170.0, ..camera() };
    let straight = run(Intrinsics::Guess(guess), 24, moving_picture).expect("a good sequence");
    let asked =
        run(Intrinsics::GuessWithDistortion(guess), 24, moving_picture).expect("a good sequence");
    assert_eq!(asked.distortion, Some([0.0; 2]));
    assert!(asked.warnings.contains(&Warning::DistortionUndetermined), "{:?}", asked.warnings);
    let off = |found: &Reconstruction| (found.camera.fx / camera().fx).ln().abs();
    assert!(off(&asked) < off(&straight) + 0.01, "{} {}", asked.camera.fx, straight.camera.fx);
}

#[test]
fn intrinsics_that_are_wrong_by_a_fifth_are_noticed() {
    let wrong = Camera { fx: 180.0, fy: 180.0, ..camera() };
    let found = run(Intrinsics::Known(wrong), 24, moving_picture).expect("still a path");
    assert_eq!(found.camera, wrong, "what was given stays");
    let doubtful = |w: &Warning| match w {
        Warning::FocalLengthMismatch { given, fitting, .. } => *given == 180.0 && *fitting < 170.0,
        _ => false,
    };
    assert!(found.warnings.iter().any(doubtful), "{:?}", found.warnings);
}

#[test]
fn a_still_camera_is_recognised() {
    let still = |i: usize| picture(1, moving(0), gain(i));
    let failure = run(Intrinsics::Known(camera()), 12, still).expect_err("nothing moves");
    assert!(matches!(failure, OdometryError::StillCamera { motion } if motion < 0.5), "{failure}");
    let frozen = run(Intrinsics::Known(camera()), 12, |_| picture(1, moving(0), 1.0));
    let failure = frozen.expect_err("nothing moves");
    assert!(matches!(failure, OdometryError::StillCamera { .. }), "{failure}");
}

#[test]
fn a_camera_that_only_turns_is_recognised() {
    let turning = |i: usize| {
        let s = i as f64;
        let turn = Vec3::new(0.02 * (0.4 * s).sin(), -0.02 * s, 0.0);
        picture(1, Pose::new(Rotation::exp(turn), Vec3::zero()), gain(i))
    };
    let failure = run(Intrinsics::Known(camera()), 20, turning).expect_err("no parallax");
    assert!(
        matches!(failure, OdometryError::RotationOnly { residual } if residual < 1.0),
        "{failure}"
    );
}

/// Of an uneven cut the longer side is posed, though the shorter moves four times as fast.
#[test]
fn the_longer_side_of_a_cut_is_posed() {
    let cut = 10;
    let uneven = |i: usize| match i < cut {
        true => picture(1, moving(4 * i), 1.0),
        false => picture(7, moving(i - cut), 1.0),
    };
    let found =
        run(Intrinsics::Known(camera()), 46, uneven).expect("both sides are good sequences");
    let is_posed = |i: &usize| found.poses[*i].is_some();
    let posed: Vec<usize> = (0..46).filter(is_posed).collect();
    assert_eq!(posed, (cut..46).collect::<Vec<_>>());
}

#[test]
fn dark_pictures_and_noise_give_an_error() {
    let black = |_| Image::new(192, 144, 3);
    let failure = run(Intrinsics::Known(camera()), 8, black).expect_err("nothing to see");
    assert_eq!(failure, OdometryError::TooFewPoints);
    let noise = |i: usize| {
        let data = i2slam_check::noise(i as u64, 192 * 144 * 3);
        let data = data.into_iter().map(|v| 0.5 + 0.5 * v as f32).collect();
        Image { width: 192, height: 144, channels: 3, data }
    };
    assert!(run(Intrinsics::Known(camera()), 8, noise).is_err());
}

#[test]
fn pictures_that_do_not_fit_are_refused_and_values_that_are_not_finite_do_no_harm() {
    let mut front_end = FrontEnd::new(Intrinsics::Known(camera()));
    let size = front_end.push(&Image::new(100, 100, 3), 0.0, None);
    assert!(matches!(size, Err(PictureError::Size { size: [100, 100], .. })));
    for channels in [0, 2] {
        let planes = front_end.push(&Image::new(192, 144, channels), 0.0, None);
        assert!(matches!(planes, Err(PictureError::Planes { .. })));
    }
    let mut poisoned = moving_picture(0);
    poisoned.data[5000..9000].fill(f32::NAN);
    assert!(front_end.push(&poisoned, 1.0, None).is_ok());
    for stamp in [1.0, 0.5, f64::NAN] {
        let refused = front_end.push(&moving_picture(1), stamp, None);
        assert!(matches!(refused, Err(PictureError::Stamp { .. })));
    }
    let tiny = Camera { width: 20, height: 20, ..camera() };
    let refused = FrontEnd::new(Intrinsics::Known(tiny)).push(&Image::new(20, 20, 3), 0.0, None);
    assert!(matches!(refused, Err(PictureError::TooSmall { .. })));
}

#[test]
fn a_camera_that_is_none_gives_an_error() {
    for f in [0.0, f64::NAN, f64::INFINITY] {
        let camera = Camera { fx: f, fy: f, ..camera() };
        for intrinsics in [Intrinsics::Known(camera), Intrinsics::Guess(camera)] {
            assert!(run(intrinsics, 8, moving_picture).is_err(), "{intrinsics:?}");
        }
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let pictures: Vec<Image<f32>> = (0..12).map(moving_picture).collect();
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| run(Intrinsics::Known(camera()), 12, |i| pictures[i].clone()))
            .expect("a good sequence")
    };
    let (one, three) = (with(1), with(3));
    assert_eq!(one.trajectory(), three.trajectory());
    let depths =
        |r: &Reconstruction| r.keyframes.iter().flat_map(|k| k.depths.clone()).collect::<Vec<_>>();
    assert_eq!(depths(&one), depths(&three));
}
