//! Poses as they are known when the frames come.

use crate::scene::{camera, depth, moving, picture};
use i2slam_geometry::{Camera, Image, Pose};
use i2slam_odometry::{DepthPicture, FrameUpdate, FrontEnd, Intrinsics, Progress, TrackingStatus};
use i2slam_storage::ScratchStore;
use std::sync::Arc;

const FRAMES: usize = 24;

/// Exact depth of the room.
fn measured(pose: Pose<f64>) -> Image<f32> {
    Image::from_fn(camera().width, camera().height, 1, |_, column, row| {
        depth(pose, [column as f64 + 0.5, row as f64 + 0.5]) as f32
    })
}

/// Updates of frames along a path, black where `is_covered`, with exact depth on demand.
fn updates(
    path: &[Pose<f64>],
    with_depth: bool,
    is_covered: impl Fn(usize) -> bool,
) -> Vec<FrameUpdate> {
    tracked(Intrinsics::Known(camera()), path, with_depth, is_covered).1
}

fn tracked(
    intrinsics: Intrinsics,
    path: &[Pose<f64>],
    with_depth: bool,
    is_covered: impl Fn(usize) -> bool,
) -> (FrontEnd, Vec<FrameUpdate>) {
    let mut front_end = FrontEnd::new(intrinsics);
    let mut push = |(i, pose): (usize, &Pose<f64>)| {
        let (width, height, timestamp) = (camera().width, camera().height, i as f64 / 30.0);
        let colour = match is_covered(i) {
            true => Image::new(width, height, 3),
            false => picture(1, *pose, 1.0),
        };
        let measured = measured(*pose);
        let measured = with_depth.then_some(DepthPicture { depth: &measured, timestamp });
        front_end.push(&colour, timestamp, measured.as_ref()).expect("a picture of that size")
    };
    let updates = path.iter().enumerate().map(&mut push).collect();
    (front_end, updates)
}

/// Largest error of the known places in the world of the first of them, over the path's length,
/// with lengths scaled to the last one without depth.
fn online_error(updates: &[FrameUpdate], path: &[Pose<f64>], is_metric: bool) -> f64 {
    let posed: Vec<(Pose<f64>, Pose<f64>)> =
        updates.iter().filter_map(|u| Some((u.pose?, path[u.frame]))).collect();
    let ((first, there), (last, end)) = (posed[0], posed[posed.len() - 1]);
    let length = (there.inverse() * end).translation.norm();
    let scale = if is_metric { 1.0 } else { length / (first.inverse() * last).translation.norm() };
    let error = |(found, truth): &(Pose<f64>, Pose<f64>)| {
        let place = (first.inverse() * *found).translation * scale;
        (place - (there.inverse() * *truth).translation).norm()
    };
    posed.iter().map(error).fold(0.0, f64::max) / length
}

fn path() -> Vec<Pose<f64>> {
    (0..FRAMES).map(moving).collect()
}

#[test]
fn with_depth_every_frame_has_a_metric_pose_at_once() {
    let found = updates(&path(), true, |_| false);
    assert!(found.iter().all(|update| update.status == TrackingStatus::Tracked));
    let error = online_error(&found, &path(), true);
    assert!(error < 0.01, "{error}");
}

/// Material stored at twice its rate: keyframes may fall on repeats.
#[test]
fn repeated_pictures_stay_where_the_first_was() {
    let path: Vec<Pose<f64>> = (0..2 * FRAMES).map(|i| moving(i / 2)).collect();
    let found = updates(&path, true, |_| false);
    assert!(found.iter().all(|update| update.status == TrackingStatus::Tracked));
    // The map may have been adjusted in between.
    let place = |update: &FrameUpdate| update.pose.expect("tracked").translation;
    let off = |pair: &[FrameUpdate]| (place(&pair[0]) - place(&pair[1])).norm();
    let off = found.chunks(2).map(off).fold(0.0, f64::max);
    assert!(off < 5e-3, "{off}");
    let error = online_error(&found, &path, true);
    assert!(error < 0.01, "{error}");
}

/// The second keyframe starts a map, which the third one proves.
#[test]
fn by_colour_alone_frames_have_poses_once_a_keyframe_hardly_changes_the_path() {
    let found = updates(&path(), false, |_| false);
    let started = found.iter().position(|update| update.status == TrackingStatus::Tracked);
    let started = started.expect("the map starts");
    assert!((1..3 * FRAMES / 4).contains(&started), "{started}");
    assert!(
        found[..started].iter().all(|update| {
            update.pose.is_none() && update.status == TrackingStatus::Initializing
        })
    );
    assert!(found[started..].iter().all(|update| update.pose.is_some()));
    let error = online_error(&found, &path(), false);
    assert!(error < 0.02, "{error}");
}

/// With depth a guess gives no pose: its readings would fit no landmark.
#[test]
fn a_guessed_camera_counts_by_colour_alone() {
    let (path, known) = (path(), camera());
    let guess = Intrinsics::Guess(Camera { fx: 1.1 * known.fx, fy: 1.1 * known.fy, ..known });
    let (front_end, found) = tracked(guess, &path, false, |_| false);
    assert_eq!(front_end.camera().fx, 1.1 * known.fx, "too few keyframes to correct it");
    let posed = found.iter().filter(|update| update.pose.is_some()).count();
    assert!(4 * posed > FRAMES, "{posed}");
    let error = online_error(&found, &path, false);
    assert!(error < 0.1, "{error}");
    let (_, found) = tracked(guess, &path, true, |_| false);
    assert!(found.iter().all(|update| update.status == TrackingStatus::Initializing));
}

#[test]
fn keyframes_correct_a_guessed_focal_length() {
    let turn = 2 * FRAMES - 2;
    let path: Vec<Pose<f64>> = (0..turn).map(|i| moving(i.min(turn - i))).collect();
    let known = camera();
    let guess = Intrinsics::Guess(Camera { fx: 1.1 * known.fx, fy: 1.1 * known.fy, ..known });
    let (front_end, _) = tracked(guess, &path, false, |_| false);
    let focal_error = (front_end.camera().fx / known.fx).ln().abs();
    assert!(focal_error < 0.02, "{focal_error}");
}

#[test]
fn frames_behind_a_covered_lens_are_lost_and_the_place_is_found_again() {
    // The camera comes back to where it was covered.
    let path: Vec<Pose<f64>> = (0..22).chain(12..28).map(moving).collect();
    for with_depth in [true, false] {
        let found = updates(&path, with_depth, |i| (22..26).contains(&i));
        let lost = |i: usize| found[i].status == TrackingStatus::Lost && found[i].pose.is_none();
        assert!((22..26).all(lost), "{:?}", &found[20..28]);
        // New points have a depth by colour alone only with the second keyframe that sees them.
        let again = if with_depth { 27 } else { 34 };
        assert!(
            (again..38).all(|i| found[i].status == TrackingStatus::Tracked),
            "{:?}",
            &found[26..]
        );
        let error = online_error(&found, &path, with_depth);
        assert!(error < 0.05, "{error}");
    }
}

/// No point is followed through so many covered pictures; by colour alone the map starts behind them.
#[test]
fn landmarks_are_found_again_where_constant_velocity_shows_them() {
    const COVERED: std::ops::Range<usize> = 14..19;
    for with_depth in [true, false] {
        let found = updates(&path(), with_depth, |i| COVERED.contains(&i));
        assert!(found[COVERED].iter().all(|update| update.pose.is_none()));
        let again = if with_depth { COVERED.end } else { COVERED.end + 1 };
        assert!(found[again..].iter().all(|u| u.status == TrackingStatus::Tracked), "{found:?}");
        let error = online_error(&found, &path(), with_depth);
        assert!(error < 0.02, "{error}");
    }
}

/// The way back shows what the way there has shown: old landmarks are followed again, and stored
/// keyframes cover the view.
#[test]
fn a_camera_that_goes_forth_and_back_needs_no_more_keyframes() {
    let turn = 2 * FRAMES - 2;
    let place = |i: usize| if i % turn < FRAMES { i % turn } else { turn - i % turn };
    let path: Vec<Pose<f64>> = (0..3 * turn).map(|i| moving(place(i))).collect();
    let found = updates(&path, true, |_| false);
    let keyframes = |pass: usize| {
        found[pass * turn..(pass + 1) * turn].iter().filter(|update| update.is_keyframe).count()
    };
    assert!(4 * keyframes(2) <= keyframes(0), "{} {}", keyframes(0), keyframes(2));
    assert!(found.iter().all(|update| update.status == TrackingStatus::Tracked));
    let error = online_error(&found[..FRAMES], &path[..FRAMES], true);
    assert!(error < 0.01, "{error}");
    let length = (path[0].inverse() * path[FRAMES - 1]).translation.norm();
    let off = |update: &FrameUpdate| {
        let (start, truth) = (path[0].inverse(), path[update.frame]);
        let start_found = found[0].pose.expect("tracked").inverse();
        let pose = update.pose.expect("tracked");
        ((start_found * pose).translation - (start * truth).translation).norm() / length
    };
    let last = found[2 * turn..].iter().map(off).fold(0.0, f64::max);
    assert!(last < 0.01, "{last}");
}

/// By colour alone keyframes are dropped from where on recordings are long.
#[test]
fn a_long_way_by_colour_alone_needs_no_more_keyframes_where_it_was_before() {
    let turn = 2 * FRAMES - 2;
    let place = |i: usize| if i % turn < FRAMES { i % turn } else { turn - i % turn };
    let path: Vec<Pose<f64>> = (0..300 + 2 * turn).map(|i| moving(place(i))).collect();
    let found = updates(&path, false, |_| false);
    let keyframes =
        |from: usize| found[from..from + turn].iter().filter(|update| update.is_keyframe).count();
    let (before, last) = (keyframes(turn), keyframes(300 + turn));
    assert!(4 * last <= before, "{before} {last}");
    let error = online_error(&found, &path, false);
    assert!(error < 0.02, "{error}");
}

#[test]
fn pictures_in_a_file_change_no_byte_of_the_result() {
    let run = |scratch: Option<Arc<ScratchStore>>| {
        let mut front_end = FrontEnd::new(Intrinsics::Known(camera()));
        if let Some(scratch) = scratch {
            front_end = front_end.with_scratch(scratch);
        }
        for (i, pose) in (0..60).map(|i| moving(i.min(60 - i))).enumerate() {
            let (colour, measured) = (picture(1, pose, 1.0), measured(pose));
            let depth = DepthPicture { depth: &measured, timestamp: i as f64 / 30.0 };
            front_end.push(&colour, i as f64 / 30.0, Some(&depth)).expect("a picture of that size");
        }
        let found = front_end.finish(Progress::default()).expect("a path");
        (found.poses, found.online_poses, found.deviations)
    };
    let folder = i2slam_check::TemporaryFolder::new("front-end-scratch");
    let scratch = ScratchStore::new(300_000, folder.join(""));
    assert_eq!(run(Some(Arc::clone(&scratch))), run(None));
    assert_eq!(scratch.failure(), None);
    assert!(scratch.file_bytes() > 1_000_000 && scratch.resident_bytes() <= 300_000);
}

#[test]
fn the_number_of_threads_changes_no_pose() {
    let with_threads = |count: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(count).build().expect("threads");
        pool.install(|| updates(&path()[..12], true, |_| false))
    };
    assert_eq!(with_threads(1), with_threads(2));
}
