//! Runs that map frames while they come, on the first pictures of the demo clip.

use i2slam::dataset::Sequence;
use i2slam::keyframes::Stage as OdometryStage;
use i2slam::run::Stage;
use i2slam::{
    CancellationToken, Config, FrameEstimate, Map, Observer, Reconstruction, RunOptions,
    RunOutcome, reconstruct,
};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

const FRAMES: usize = 14;
/// Frames that are mapped before more than [`TRACKED`] come.
const MAPPED: usize = 3;
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

fn sequence(options: &RunOptions) -> Sequence {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cli/assets/demo");
    options.open_sequence(&folder).expect("the demo clip")
}

/// Keeps what it sees; lets [`TRACKED`] frames come, and others when [`MAPPED`] are mapped.
#[derive(Clone, Default)]
struct Recorder {
    stages: Arc<Mutex<Vec<Stage>>>,
    /// Index and count of every frame that was mapped.
    frames: Arc<Mutex<Vec<(usize, usize, usize)>>>,
    cancelled: Arc<AtomicBool>,
    cancels_in: Option<fn(Stage) -> bool>,
    /// Panics when the first frame is mapped.
    panics: bool,
}

impl Recorder {
    fn mapped(&self) -> usize {
        self.frames.lock().expect("no panic").len()
    }

    fn wait_for_the_map(&self) {
        let begun = Instant::now();
        while self.mapped() < if self.panics { 1 } else { MAPPED } {
            assert!(begun.elapsed() < Duration::from_secs(60), "nothing is mapped");
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

impl Observer for Recorder {
    fn progress(&self, stage: Stage, done: usize, _total: usize) {
        self.stages.lock().expect("no panic").push(stage);
        if stage == Stage::Online && done < TRACKED {
            return;
        }
        if stage == Stage::Online {
            self.wait_for_the_map();
        }
        if self.cancels_in.is_some_and(|cancels_in| cancels_in(stage)) {
            self.cancelled.store(true, Ordering::SeqCst);
        }
    }

    fn frame(&self, estimate: &FrameEstimate, done: usize, total: usize) {
        self.frames.lock().expect("no panic").push((estimate.index, done, total));
        assert!(!self.panics || self.mapped() > 1, "as asked");
    }

    fn cancellation(&self) -> CancellationToken {
        let cancelled = Arc::clone(&self.cancelled);
        CancellationToken::when(move || cancelled.load(Ordering::SeqCst))
    }
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

/// Every frame is told, counted from one on, and some before the path is adjusted.
#[test]
fn frames_are_mapped_while_they_come() {
    let recorder = Recorder::default();
    let outcome = run(&options(), &recorder);
    assert!(outcome.complete && outcome.warnings.is_empty(), "{:?}", outcome.warnings);
    assert_eq!(indices(&outcome), (0..FRAMES).collect::<Vec<_>>());
    let stages = recorder.stages.lock().expect("done");
    assert_eq!(stages.first(), Some(&Stage::Online));
    assert!(stages.contains(&Stage::Mapping) && !stages.contains(&Stage::Keyframes));
    assert_eq!(stages.last(), Some(&Stage::Refinement));
    let frames = recorder.frames.lock().expect("done");
    assert!((0..FRAMES).all(|index| frames.iter().any(|frame| frame.0 == index)), "{frames:?}");
    assert!(frames.iter().all(|(_, done, total)| (1..=*total).contains(done)), "{frames:?}");
    assert_eq!(frames.last().map(|(_, done, total)| (*done, *total)), Some((FRAMES, FRAMES)));
}

/// Path and map so far are in the result.
#[test]
fn a_run_cancelled_while_frames_come_keeps_path_and_map() {
    let cancels_in: Option<fn(Stage) -> bool> = Some(|stage| stage == Stage::Online);
    let recorder = Recorder { cancels_in, ..Recorder::default() };
    let outcome = run(&options(), &recorder);
    assert!(!outcome.complete && outcome.problem.is_none());
    assert_eq!(indices(&outcome), (0..TRACKED).collect::<Vec<_>>());
    assert!(outcome.reconstruction.map.gaussians() > 1000);
    assert_eq!(outcome.reconstruction.online_trajectory.len(), TRACKED);
    assert!(has_warning(&outcome, "neither exposure nor motion blur"), "{:?}", outcome.warnings);
}

/// The path so far stands for one that is not adjusted to the end.
#[test]
fn a_run_cancelled_while_the_path_is_adjusted_keeps_path_and_map() {
    let cancels_in: Option<fn(Stage) -> bool> = Some(|stage| matches!(stage, Stage::Odometry(_)));
    let recorder = Recorder { cancels_in, ..Recorder::default() };
    let outcome = run(&options(), &recorder);
    assert!(!outcome.complete && outcome.problem.is_none());
    assert_eq!(indices(&outcome), (0..FRAMES).collect::<Vec<_>>());
    assert!(outcome.reconstruction.map.gaussians() > 1000);
}

/// Its frames are mapped after the last one then.
#[test]
fn a_panic_of_the_map_is_told_once_and_loses_nothing() {
    let recorder = Recorder { panics: true, ..Recorder::default() };
    let outcome = run(&options(), &recorder);
    assert!(outcome.complete, "{:?}", outcome.problem);
    let told = outcome.warnings.iter().filter(|w| w.text.contains("all frames are mapped again"));
    assert_eq!(told.count(), 1, "{:?}", outcome.warnings);
    assert_eq!(indices(&outcome), (0..FRAMES).collect::<Vec<_>>());
    assert!(outcome.reconstruction.map.gaussians() > 1000);
    assert!(outcome.reconstruction.frames.iter().all(|frame| !frame.held_out));
}

/// Held out are those that a map made after the last frame would hold out.
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

/// By colour alone a map is shown while frames come to those who follow it, and nothing else changes.
/// Frames that are held out are no keyframes, others are in their place.
#[test]
fn a_map_by_colour_alone_can_be_followed() {
    let mut options = options();
    options.poses = RunOptions::colour_alone().poses;
    options.config = Config { mapping: options.config.mapping, ..Config::default_rgb() };
    (options.open.frames, options.open.max_side) = (Some(0..24), Some(120));
    options.config.mapping.hold_out_frames = HELD_OUT.to_vec();
    let outcome = |follows: bool| {
        let follower = Follower { follows, ..Follower::default() };
        let found = reconstruct(&sequence(&options), &options, follower.clone()).expect("a path");
        (follower.maps.load(Ordering::SeqCst), found.reconstruction)
    };
    let ((none, alone), (some, followed)) = (outcome(false), outcome(true));
    assert!(none == 0 && some > 0, "{none} and {some} maps");
    let poses = |found: &Reconstruction| -> Vec<_> {
        found.frames.iter().map(FrameEstimate::middle).collect()
    };
    assert_eq!(poses(&alone), poses(&followed));
    let keyframes = |found: &Reconstruction| -> Vec<usize> {
        found.frames.iter().filter(|f| f.keyframe).map(|f| f.index).collect()
    };
    options.config.mapping.hold_out_frames.clear();
    let all = reconstruct(&sequence(&options), &options, ()).expect("a path").reconstruction;
    let (some, all) = (keyframes(&alone), keyframes(&all));
    assert!(HELD_OUT.iter().all(|i| all.contains(i) && !some.contains(i)), "{some:?} {all:?}");
    assert!(some.len() + HELD_OUT.len() > all.len() + 1, "{some:?} {all:?}");
    let (Map::Gaussians(alone), Map::Gaussians(followed)) = (&alone.map, &followed.map) else {
        panic!("maps of Gaussians")
    };
    assert_eq!(alone.means, followed.means);
}
