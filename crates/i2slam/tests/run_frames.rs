//! Runs on the first pictures of the demo clip, whose path is found before they are mapped.

use i2slam::dataset::Sequence;
use i2slam::geometry::Pose;
use i2slam::keyframes::Stage as OdometryStage;
use i2slam::run::Stage;
use i2slam::{
    CancellationToken, Config, FrameEstimate, Map, Observer, Reconstruction, RunOptions,
    RunOutcome, reconstruct,
};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

const FRAMES: usize = 14;
/// Frames after which a run is cancelled.
const TRACKED: usize = 10;

/// Small pictures and few steps.
fn options() -> RunOptions {
    let mut options = RunOptions::with_depth();
    options.open.frames = Some(0..FRAMES);
    options.open.max_side = Some(160);
    options.config.mapping.first_iterations = 10;
    options.config.mapping.iterations = 3;
    options.config.mapping.final_iterations = 5;
    options
}

/// Few steps by colour alone.
fn options_of_colour() -> RunOptions {
    let mut options = options();
    options.poses = RunOptions::colour_alone().poses;
    options.config = Config { mapping: options.config.mapping, ..Config::default_rgb() };
    (options.open.frames, options.open.max_side) = (Some(0..24), Some(120));
    options
}

fn sequence(options: &RunOptions) -> Sequence {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cli/assets/demo");
    options.open_sequence(&folder).expect("the demo clip")
}

/// Keeps what it sees; may cancel in a stage, after [`TRACKED`] frames of it.
#[derive(Clone, Default)]
struct Recorder {
    stages: Arc<Mutex<Vec<Stage>>>,
    /// Index and count of every frame that was mapped.
    frames: Arc<Mutex<Vec<(usize, usize, usize)>>>,
    cancelled: Arc<AtomicBool>,
    cancels_in: Option<fn(Stage) -> bool>,
}

impl Observer for Recorder {
    fn progress(&self, stage: Stage, done: usize, _total: usize) {
        self.stages.lock().expect("no panic").push(stage);
        if is_tracking(stage) && done < TRACKED {
            return;
        }
        if self.cancels_in.is_some_and(|cancels_in| cancels_in(stage)) {
            self.cancelled.store(true, Ordering::SeqCst);
        }
    }

    fn frame(&self, estimate: &FrameEstimate, done: usize, total: usize) {
        self.frames.lock().expect("no panic").push((estimate.index, done, total));
    }

    fn cancellation(&self) -> CancellationToken {
        let cancelled = Arc::clone(&self.cancelled);
        CancellationToken::when(move || cancelled.load(Ordering::SeqCst))
    }
}

fn is_tracking(stage: Stage) -> bool {
    matches!(stage, Stage::Odometry(OdometryStage::Tracking { .. }))
}

fn is_odometry_after_tracking(stage: Stage) -> bool {
    matches!(stage, Stage::Odometry(_)) && !is_tracking(stage)
}

fn run(options: &RunOptions, recorder: &Recorder) -> RunOutcome {
    reconstruct(&sequence(options), options, recorder.clone()).expect("frames")
}

fn indices(outcome: &RunOutcome) -> Vec<usize> {
    outcome.reconstruction.frames.iter().map(|frame| frame.index).collect()
}

fn has_warning(outcome: &RunOutcome, text: &str) -> bool {
    outcome.warnings.iter().any(|warning| warning.text.contains(text))
}

/// Every frame is told once, counted from one on.
#[test]
fn frames_are_mapped_once() {
    let recorder = Recorder::default();
    let outcome = run(&options(), &recorder);
    assert!(outcome.complete && outcome.warnings.is_empty(), "{:?}", outcome.warnings);
    assert_eq!(indices(&outcome), (0..FRAMES).collect::<Vec<_>>());
    let stages = recorder.stages.lock().expect("done");
    assert!(stages.first().copied().is_some_and(is_tracking), "{:?}", stages.first());
    assert!(stages.contains(&Stage::Mapping) && !stages.contains(&Stage::Keyframes));
    assert_eq!(stages.last(), Some(&Stage::Refinement));
    let due: Vec<_> = (0..FRAMES).map(|index| (index, index + 1, FRAMES)).collect();
    assert_eq!(*recorder.frames.lock().expect("done"), due);
}

/// The path so far is in the result, with depth and by colour alone.
#[test]
fn a_run_cancelled_while_frames_are_tracked_keeps_their_path() {
    for options in [options(), options_of_colour()] {
        let recorder = Recorder { cancels_in: Some(is_tracking), ..Recorder::default() };
        let outcome = run(&options, &recorder);
        assert!(!outcome.complete && outcome.problem.is_none());
        assert_eq!(indices(&outcome), (0..TRACKED).collect::<Vec<_>>());
        assert_eq!(outcome.reconstruction.map.gaussians(), 0);
        assert_eq!(outcome.reconstruction.online_trajectory.len(), TRACKED);
        let warned = has_warning(&outcome, "neither exposure nor motion blur");
        assert!(warned, "{:?}", outcome.warnings);
    }
}

/// The path so far stands for one that is not adjusted to the end.
#[test]
fn a_run_cancelled_while_the_path_is_adjusted_keeps_the_path() {
    let recorder = Recorder { cancels_in: Some(is_odometry_after_tracking), ..Recorder::default() };
    let outcome = run(&options(), &recorder);
    assert!(!outcome.complete && outcome.problem.is_none());
    assert_eq!(indices(&outcome), (0..FRAMES).collect::<Vec<_>>());
}

/// Every fourth of all frames is held out, and never mapped.
#[test]
fn held_out_frames_are_drawn_once() {
    let mut options = options();
    options.config.mapping.hold_out = 4;
    let recorder = Recorder::default();
    let outcome = run(&options, &recorder);
    let held_out = outcome.reconstruction.frames.iter().filter(|frame| frame.held_out);
    assert_eq!(held_out.map(|frame| frame.index).collect::<Vec<_>>(), [4, 8, 12]);
    let mapped = recorder.frames.lock().expect("done");
    assert!(mapped.iter().all(|(index, ..)| ![4, 8, 12].contains(index)), "{mapped:?}");
}

/// Follows the map; counts copies with Gaussians that were had while frames came.
#[derive(Clone, Default)]
struct Follower {
    maps: Arc<AtomicUsize>,
    is_tracking: Arc<AtomicBool>,
    follows: bool,
}

impl Observer for Follower {
    fn progress(&self, stage: Stage, done: usize, total: usize) {
        let tracking = matches!(stage, Stage::Odometry(OdometryStage::Tracking { .. }));
        self.is_tracking.store(tracking && done < total, Ordering::SeqCst);
    }

    fn map(&self, current: &dyn Fn() -> Reconstruction) {
        let counts = self.is_tracking.load(Ordering::SeqCst) && current().map.gaussians() > 100;
        self.maps.fetch_add(usize::from(counts), Ordering::SeqCst);
    }

    fn follows_map(&self) -> bool {
        self.follows
    }
}

/// Frames of the clip that become keyframes by colour alone.
const HELD_OUT: [usize; 3] = [5, 13, 17];

/// Reconstruction without a follower of the map; one that is followed shows maps, and is the same.
fn follow(options: &RunOptions) -> Reconstruction {
    let outcome = |follows: bool| {
        let follower = Follower { follows, ..Follower::default() };
        let found = reconstruct(&sequence(options), options, follower.clone()).expect("a path");
        (follower.maps.load(Ordering::SeqCst), found.reconstruction)
    };
    let ((none, alone), (some, followed)) = (outcome(false), outcome(true));
    assert!(none == 0 && some > 0, "{none} and {some} maps");
    assert!(poses(&alone) == poses(&followed) && means(&alone) == means(&followed));
    alone
}

/// With depth a map is shown while frames come to those who follow it, and nothing else changes.
#[test]
fn a_map_with_depth_can_be_followed() {
    follow(&options());
}

/// By colour alone a map is shown, too. Frames that are held out are no keyframes, others are in their
/// place.
#[test]
fn a_map_by_colour_alone_can_be_followed() {
    let mut options = options_of_colour();
    options.config.mapping.hold_out_frames = HELD_OUT.to_vec();
    let alone = follow(&options);
    let keyframes = |found: &Reconstruction| -> Vec<usize> {
        found.frames.iter().filter(|f| f.keyframe).map(|f| f.index).collect()
    };
    options.config.mapping.hold_out_frames.clear();
    let all = reconstruct(&sequence(&options), &options, ()).expect("a path").reconstruction;
    let (some, all) = (keyframes(&alone), keyframes(&all));
    assert!(HELD_OUT.iter().all(|i| all.contains(i) && !some.contains(i)), "{some:?} {all:?}");
    assert!(some.len() + HELD_OUT.len() > all.len() + 1, "{some:?} {all:?}");
}

fn poses(found: &Reconstruction) -> Vec<Pose<f64>> {
    found.frames.iter().map(FrameEstimate::middle).collect()
}

fn means(found: &Reconstruction) -> &[[f32; 3]] {
    match &found.map {
        Map::Gaussians(map) => &map.means,
        Map::HashGrid(_) => panic!("a map of Gaussians"),
    }
}
