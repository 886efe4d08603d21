//! Frames of the demo clip that are tracked and mapped while they come.

use i2slam::dataset::{Frame, Sequence};
use i2slam::geometry::Pose;
use i2slam::{Config, OnlineSession, OnlineUpdate, Reconstruction, RunOptions, TrackingStatus};
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

const FRAMES: usize = 14;

fn sequence() -> Sequence {
    sequence_of(FRAMES)
}

fn sequence_of(frames: usize) -> Sequence {
    let mut options = RunOptions::with_depth();
    options.open.frames = Some(0..frames);
    options.open.max_side = Some(160);
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cli/assets/demo");
    options.open_sequence(&folder).expect("the demo clip")
}

/// Few steps.
fn config() -> Config {
    let mut config = Config::default();
    config.mapping.first_iterations = 10;
    config.mapping.iterations = 3;
    config.mapping.final_iterations = 5;
    config
}

/// Pushes all frames, some time apart, changed by `change`.
fn push_all(
    pause: Duration,
    change: impl Fn(Frame) -> Frame,
) -> (OnlineSession, Vec<OnlineUpdate>) {
    push_to((config(), &sequence()), pause, change)
}

/// Pushes all frames of a sequence to a session with these settings.
fn push_to(
    (config, sequence): (Config, &Sequence),
    pause: Duration,
    change: impl Fn(Frame) -> Frame,
) -> (OnlineSession, Vec<OnlineUpdate>) {
    let mut session = OnlineSession::new(config, sequence.camera, sequence.frame_rate);
    let mut push = |frame: Frame| {
        std::thread::sleep(pause);
        session.push(change(frame)).expect("a frame of that size")
    };
    let updates = sequence.stream().map(|frame| push(frame.expect("readable"))).collect();
    (session, updates)
}

fn finish(session: OnlineSession) -> Reconstruction {
    session.finish(&mut |_, _| true).expect("a path")
}

/// Every frame with depth has a pose at once, which the end corrects by little, and is in the map.
#[test]
fn frames_have_a_pose_and_are_mapped_when_they_come() {
    let (session, updates) = push_all(Duration::ZERO, |frame| frame);
    assert!(updates.iter().all(|update| update.status == TrackingStatus::Tracked));
    let online: Vec<Pose<f64>> = updates.iter().filter_map(|u| u.world_from_camera).collect();
    assert_eq!(online.len(), FRAMES);
    let found = finish(session);
    assert_eq!(found.frames.len(), FRAMES);
    assert_eq!(found.online_trajectory.len(), FRAMES);
    assert!(found.map.gaussians() > 1000, "{}", found.map.gaussians());
    for (frame, online) in found.frames.iter().zip(&online) {
        let off = (frame.middle().translation - online.translation).norm();
        // The first frames come before the readout of the rows is found.
        assert!(off < 0.05, "frame {}: {off} m", frame.index);
    }
    let mapped = found.frames.iter().filter(|frame| !frame.held_out).count();
    assert!(mapped >= FRAMES - 1, "{mapped}");
}

/// Frames wait for later keyframes, but a camera that hardly moves makes none: its map grows, too.
#[test]
fn a_camera_at_rest_is_mapped() {
    let sequence = sequence_of(1);
    let first = sequence.stream().next().expect("a frame").expect("readable");
    let mut session = OnlineSession::new(config(), sequence.camera, sequence.frame_rate);
    let mut keyframes = 0;
    for index in 0..30 {
        let mut frame = first.clone();
        // No sensor gives the same picture twice.
        let noise = |i: usize| ((7 * i + 13 * index) % 5) as f32 / 255.0;
        let colour = Arc::make_mut(&mut frame.colour).data.iter_mut().enumerate();
        colour.for_each(|(i, value)| *value = (*value + noise(i)).min(1.0));
        let moved = index as f64 / 30.0;
        (frame.index, frame.timestamp) = (index, frame.timestamp + moved);
        if let Some(depth) = &mut frame.depth {
            depth.timestamp += moved;
        }
        keyframes += usize::from(session.push(frame).expect("a frame of that size").is_keyframe);
    }
    assert!(keyframes < 3, "{keyframes} keyframes: the camera moved");
    session.wait_for_map(0);
    let begun = Instant::now();
    while session.reconstruction().frames.len() < 10 {
        assert!(begun.elapsed() < Duration::from_secs(60), "frames wait for ever");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// The map depends on the frames alone, not on when its thread works.
#[test]
fn the_map_does_not_depend_on_time() {
    let maps = [0, 30].map(|pause| {
        let (session, _) = push_all(Duration::from_millis(pause), |frame| frame);
        let found = finish(session);
        let poses: Vec<Pose<f64>> = found.frames.iter().map(|f| f.middle()).collect();
        (found.map, poses)
    });
    assert!(maps[0] == maps[1]);
}

/// Pictures that leave memory for a file change no byte.
#[test]
fn the_map_does_not_depend_on_memory() {
    // A megabyte of pictures: one frame.
    let maps = [4.0, 0.002].map(|memory| {
        let config = Config { memory, ..config() };
        let found = finish(push_to((config, &sequence()), Duration::ZERO, |frame| frame).0);
        let poses: Vec<Pose<f64>> = found.frames.iter().map(|f| f.middle()).collect();
        (found.map, poses)
    });
    assert!(maps[0] == maps[1]);
}

/// The map of now may be asked for at any time, and has only frames that came.
#[test]
fn the_map_of_now_can_be_asked_for() {
    let (session, _) = push_all(Duration::ZERO, |frame| frame);
    let now = session.reconstruction();
    assert!(now.frames.len() < FRAMES && now.frames.is_sorted_by_key(|frame| frame.index));
    assert_eq!(now.online_trajectory.len(), FRAMES);
}

/// A refused frame leaves the session as it was.
#[test]
fn a_frame_that_does_not_fit_is_refused() {
    let (mut session, _) = push_all(Duration::ZERO, |frame| frame);
    let old = sequence().load(0).expect("readable");
    let error = session.push(old).expect_err("a time stamp that was there before");
    assert!(error.to_string().contains("must increase"), "{error}");
    assert_eq!(finish(session).frames.len(), FRAMES);
}

/// By colour alone the map starts after some motion, and frames before it get their poses later.
#[test]
fn colour_alone_starts_later() {
    let sequence = sequence_of(3 * FRAMES);
    let without_depth = |frame| Frame { depth: None, ..frame };
    let (session, updates) = push_to((config(), &sequence), Duration::ZERO, without_depth);
    assert!(updates[0].world_from_camera.is_none());
    assert!(updates[3 * FRAMES - 1].world_from_camera.is_some());
    let found = finish(session);
    assert!(found.frames.len() >= 3 * FRAMES - 2 && found.map.gaussians() > 100);
}
