//! Wrong input is told with its frames; a clean sequence brings no warning.

use crate::relative_error;
use crate::scene::{camera, depth, moving, picture, texture, tracked};
use i2slam_geometry::{Camera, Image, Pose, Rotation, Vec3};
use i2slam_odometry::{
    DepthPicture, FrontEnd, Intrinsics, PictureError, Progress, Reconstruction, Warning,
};

const FRAMES: usize = 30;

/// The result from pictures of the room; `shown` is the moment that a frame shows.
fn found(
    shown: impl Fn(usize) -> usize,
    change: impl Fn(usize, &mut Image<f32>),
) -> Reconstruction {
    let pictures = (0..FRAMES).map(|i| {
        let mut out = picture(3, moving(shown(i)), 1.0);
        change(i, &mut out);
        out
    });
    let front_end = tracked(Intrinsics::Known(camera()), pictures);
    front_end.finish(Progress::default()).expect("a path")
}

#[test]
fn a_clean_sequence_brings_no_warning() {
    assert_eq!(found(|i| i, |_, _| ()).warnings, []);
}

#[test]
fn a_stalled_source_and_a_lost_signal_are_told() {
    let shown = |i: usize| if (12..15).contains(&i) { 11 } else { i };
    let grey = |i: usize, out: &mut Image<f32>| {
        if i == 22 {
            out.data.fill(0.5);
        }
    };
    let found = found(shown, grey);
    let frozen = Warning::FrozenFrames { frames: [12, 14], count: 3 };
    assert!(found.warnings.contains(&frozen), "{:?}", found.warnings);
    assert!(found.warnings.contains(&Warning::BlankFrames { frames: [22, 22] }));
    let lost: Vec<usize> = (0..FRAMES).filter(|i| found.poses[*i].is_none()).collect();
    assert_eq!(lost, [12, 13, 14, 22]);
    assert!(found.keyframes.iter().all(|keyframe| !lost.contains(&keyframe.index)));
}

#[test]
fn a_camera_that_rests_keeps_its_poses() {
    let found = found(|i| i.min(10) + i.saturating_sub(16), |_, _| ());
    assert_eq!(found.warnings, []);
    assert!(found.poses.iter().all(Option::is_some));
}

#[test]
fn shuffled_pictures_are_told() {
    let order = [14, 11, 15, 12, 10, 13];
    let found = found(|i| if (10..16).contains(&i) { order[i - 10] } else { i }, |_, _| ());
    assert_eq!(found.warnings, [Warning::ShuffledFrames { frames: [10, 15] }]);
}

/// Whether a disc over a fifth of the picture, which crosses it against the camera, covers a place.
fn is_on_disc(i: usize, at: [f64; 2]) -> bool {
    let [x, y] = disc(i);
    (at[0] - x).hypot(at[1] - y) < 42.0
}

fn disc(i: usize) -> [f64; 2] {
    let t = i as f64;
    [45.0 + 3.5 * t, 72.0 + 14.0 * (0.35 * t).sin()]
}

/// A picture of the room behind the disc, which has a pattern of its own.
fn picture_with_disc(i: usize) -> Image<f32> {
    let (mut out, [x, y]) = (picture(3, moving(i), 1.0), disc(i));
    let (width, pixels) = (out.width, out.pixels());
    for pixel in 0..pixels {
        let (u, v) = Camera::<f64>::pixel_centre(pixel % width, pixel / width);
        if is_on_disc(i, [u, v]) {
            let value = texture(77, (u - x) / 70.0, (v - y) / 70.0) as f32;
            (0..3).for_each(|channel| out.data[channel * pixels + pixel] = value);
        }
    }
    out
}

/// Depth of the room behind the disc.
fn depth_with_disc(i: usize) -> Image<f32> {
    Image::from_fn(camera().width, camera().height, 1, |_, column, row| {
        let (u, v) = Camera::<f64>::pixel_centre(column, row);
        if is_on_disc(i, [u, v]) { 0.8 } else { depth(moving(i), [u, v]) as f32 }
    })
}

fn assert_told(found: &Reconstruction) {
    let told = found.warnings.iter().find_map(|warning| match warning {
        Warning::MovingObject { share, .. } => Some(*share),
        _ => None,
    });
    assert!(told.is_some_and(|share| (0.1..0.5).contains(&share)), "{:?}", found.warnings);
}

#[test]
fn a_large_moving_object_is_told_and_left_out_by_colour_alone() {
    let front_end = tracked(Intrinsics::Known(camera()), (0..FRAMES).map(picture_with_disc));
    let found = front_end.finish(Progress::default()).expect("a path");
    assert_told(&found);
    let error = relative_error(&found, moving);
    assert!(error < 0.02, "{error}");
}

#[test]
fn a_large_moving_object_is_told_and_left_out_with_depth() {
    let mut front_end = FrontEnd::new(Intrinsics::Known(camera()));
    for i in 0..FRAMES {
        let (timestamp, depth) = (i as f64 / 30.0, depth_with_disc(i));
        let depth = DepthPicture { depth: &depth, timestamp };
        front_end.push(&picture_with_disc(i), timestamp, Some(&depth)).expect("they fit");
    }
    let found = front_end.finish(Progress::default()).expect("a path");
    assert_told(&found);
    let first = moving(0).inverse();
    for (i, pose) in found.poses.iter().enumerate() {
        let off = (pose.expect("a pose") * (first * moving(i)).inverse()).translation.norm();
        assert!(off < 0.005, "frame {i} is off by {off} m");
    }
}

/// Depth by the clock of another device is told and left out, a stamp that is no number is refused.
#[test]
fn depth_that_was_not_taken_with_its_picture_is_not_used() {
    let result = |late: Option<f64>| {
        let mut front_end = FrontEnd::new(Intrinsics::Known(camera()));
        for i in 0..16 {
            let (timestamp, colour) = (i as f64 / 30.0, picture(3, moving(i), 1.0));
            let depth = Image::from_fn(camera().width, camera().height, 1, |_, column, row| {
                depth(moving(i), [column as f64 + 0.5, row as f64 + 0.5]) as f32
            });
            for nowhen in [f64::NAN, f64::INFINITY] {
                let refused = DepthPicture { depth: &depth, timestamp: nowhen };
                let refused = front_end.push(&colour, timestamp, Some(&refused));
                assert!(matches!(refused, Err(PictureError::DepthStamp { .. })), "{refused:?}");
            }
            let depth =
                late.map(|late| DepthPicture { depth: &depth, timestamp: timestamp + late });
            front_end.push(&colour, timestamp, depth.as_ref()).expect("they fit");
        }
        front_end.finish(Progress::default()).expect("a path")
    };
    let (alone, other_clock) = (result(None), result(Some(-1.6e9)));
    assert_eq!(alone.poses, other_clock.poses);
    assert_eq!(other_clock.depth_model, None);
    let told = other_clock.warnings.iter().find(|w| matches!(w, Warning::DepthNotInTime { .. }));
    let told = told.map(|warning| matches!(warning, Warning::DepthNotInTime { count: 16, .. }));
    assert_eq!(told, Some(true), "{:?}", other_clock.warnings);
    assert!(result(Some(0.01)).depth_model.is_some());
}

/// A camera that sways, so that it sees the same points all the time.
fn swaying(i: usize) -> Pose<f64> {
    let s = 0.3 * i as f64;
    let turn = Vec3::new(0.02 * s.sin(), 0.03 * (0.7 * s).sin(), 0.01 * (1.3 * s).sin());
    Pose::new(Rotation::exp(turn), Vec3::new(0.2 * s.sin(), 0.05 * (0.6 * s).sin(), 0.0))
}

/// The front end's last pose when its frame came, and the result, with depth where `is_read`.
fn with_some_depth(
    is_read: impl Fn(usize, [f64; 2]) -> bool,
) -> (Option<Pose<f64>>, Reconstruction) {
    let mut front_end = FrontEnd::new(Intrinsics::Known(camera()));
    let mut online = None;
    for i in 0..SWAY_FRAMES {
        let depth = Image::from_fn(camera().width, camera().height, 1, |_, column, row| {
            let at = [column as f64 + 0.5, row as f64 + 0.5];
            if is_read(i, at) { depth(swaying(i), at) as f32 } else { 0.0 }
        });
        let timestamp = i as f64 / 30.0;
        let depth = DepthPicture { depth: &depth, timestamp };
        let update = front_end.push(&picture(3, swaying(i), 1.0), timestamp, Some(&depth));
        online = update.expect("they fit").pose;
    }
    (online, front_end.finish(Progress::default()).expect("a path"))
}

/// Dense alignment with depth finds relative poses with the focal length that was given.
#[test]
fn a_focal_length_that_is_far_off_is_told_with_depth() {
    let wrong = Camera { fx: 1.3 * camera().fx, fy: 1.3 * camera().fy, ..camera() };
    let mut front_end = FrontEnd::new(Intrinsics::Known(wrong));
    for i in 0..SWAY_FRAMES {
        let depth = Image::from_fn(camera().width, camera().height, 1, |_, column, row| {
            depth(swaying(i), [column as f64 + 0.5, row as f64 + 0.5]) as f32
        });
        let timestamp = i as f64 / 30.0;
        let depth = DepthPicture { depth: &depth, timestamp };
        front_end.push(&picture(3, swaying(i), 1.0), timestamp, Some(&depth)).expect("they fit");
    }
    let found = front_end.finish(Progress::default()).expect("a path");
    let is_told = |w: &Warning| match w {
        Warning::FocalLengthMismatch { fitting, .. } => (fitting / camera().fx).ln().abs() < 0.05,
        _ => false,
    };
    assert!(found.warnings.iter().any(is_told), "{:?}", found.warnings);
}

/// Frames until the swaying camera is far from where it began.
const SWAY_FRAMES: usize = 27;

/// A map that begins by parallax gets its unit of length from the first readings.
#[test]
fn depth_that_comes_late_gives_metres() {
    let (online, found) = with_some_depth(|i, _| i >= SWAY_FRAMES / 3);
    let length = |pose: Option<Pose<f64>>| pose.expect("a pose").translation.norm();
    let truth = length(Some(swaying(0).inverse() * swaying(SWAY_FRAMES - 1)));
    for (found, name) in [(found.poses[SWAY_FRAMES - 1], "at the end"), (online, "online")] {
        let ratio = length(found) / truth;
        assert!((ratio - 1.0).abs() < 0.03, "{name}: {ratio}");
    }
    assert!(relative_error(&found, swaying) < 0.01);
    assert!(found.depth_model.is_some() && found.warnings.is_empty(), "{:?}", found.warnings);
}

#[test]
fn depth_without_readings_is_colour_alone_and_told() {
    let (_, blank) = with_some_depth(|_, _| false);
    let colour = (0..SWAY_FRAMES).map(|i| picture(3, swaying(i), 1.0));
    let alone = tracked(Intrinsics::Known(camera()), colour);
    let alone = alone.finish(Progress::default()).expect("a path");
    assert_eq!((blank.poses, blank.online_poses), (alone.poses, alone.online_poses));
    assert_eq!(blank.depth_model, None);
    assert_eq!(blank.warnings, [Warning::DepthNotUsed { count: SWAY_FRAMES }]);
}

/// A sensor that sees a small part of every picture.
#[test]
fn depth_of_too_few_points_is_told() {
    let (_, found) = with_some_depth(|_, at| at[0] > 180.0 && at[1] > 130.0);
    assert_eq!(found.depth_model, None);
    assert_eq!(found.warnings, [Warning::DepthNotUsed { count: SWAY_FRAMES }]);
    assert!(relative_error(&found, swaying) < 0.02);
}
