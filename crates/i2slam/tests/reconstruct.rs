//! Whole runs by one call, on the first pictures of the demo clip.

use i2slam::dataset::Sequence;
use i2slam::run::Stage;
use i2slam::{
    CancellationToken, Config, FrameEstimate, Observer, PoseSource, RunError, RunOptions,
    reconstruct,
};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

#[path = "../examples/reconstruct_video.rs"]
#[expect(dead_code, reason = "its main is not called")]
mod example;

fn demo_clip() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../cli/assets/demo")
}

/// Small pictures and few steps.
fn quick(mut options: RunOptions, frames: usize) -> RunOptions {
    options.open.frames = Some(0..frames);
    options.open.max_side = Some(120);
    options.config.mapping.first_iterations = 10;
    options.config.mapping.iterations = 3;
    options.config.mapping.final_iterations = 5;
    options
}

#[test]
fn the_example_reconstructs_a_video_by_colour_alone() {
    let options = quick(RunOptions::colour_alone(), 16);
    let outcome = example::reconstruct_video(&demo_clip(), &options).expect("a path");
    assert!(outcome.complete, "{:?}", outcome.problem);
    assert_eq!((outcome.frames_given, outcome.frames_skipped), (16, 0));
    let frames = &outcome.reconstruction.frames;
    assert!(frames.len() >= 12, "{} poses", frames.len());
    assert!(outcome.reconstruction.map.gaussians() > 100);
    // The clip names its camera, so no focal length is estimated.
    assert!(outcome.camera.is_some_and(|camera| !camera.is_focal_length_estimated));
}

/// Counts frames, keeps stages, and cancels after a number of frames.
#[derive(Clone, Default)]
struct Recorder {
    frames: Arc<AtomicUsize>,
    stages: Arc<Mutex<Vec<Stage>>>,
    cancel_after: Option<usize>,
    cancelled: Arc<AtomicBool>,
}

impl Observer for Recorder {
    fn progress(&self, stage: Stage, _done: usize, _total: usize) {
        self.stages.lock().expect("one thread").push(stage);
    }

    fn frame(&self, _estimate: &FrameEstimate, done: usize, _total: usize) {
        self.frames.store(done, Ordering::SeqCst);
        if self.cancel_after == Some(done) {
            self.cancelled.store(true, Ordering::SeqCst);
        }
    }

    fn cancellation(&self) -> CancellationToken {
        let cancelled = Arc::clone(&self.cancelled);
        CancellationToken::when(move || cancelled.load(Ordering::SeqCst))
    }
}

fn open(options: &RunOptions) -> Sequence {
    options.open_sequence(&demo_clip()).expect("the clip")
}

#[test]
fn the_observer_sees_frames_and_stages() {
    let options = quick(RunOptions::with_depth(), 3);
    let recorder = Recorder::default();
    let outcome = reconstruct(&open(&options), &options, recorder.clone()).expect("frames");
    assert!(outcome.complete && outcome.camera.is_none());
    assert_eq!(recorder.frames.load(Ordering::SeqCst), 3);
    let stages = recorder.stages.lock().expect("done");
    assert_eq!(
        (stages.first(), stages.last()),
        (Some(&Stage::Frames), Some(&Stage::MapRefinement))
    );
}

#[test]
fn a_cancelled_run_keeps_its_frames() {
    let options = quick(RunOptions::with_depth(), 4);
    let recorder = Recorder { cancel_after: Some(2), ..Recorder::default() };
    let outcome = reconstruct(&open(&options), &options, recorder).expect("two frames");
    assert!(!outcome.complete && outcome.problem.is_none());
    assert_eq!(outcome.reconstruction.frames.len(), 2);
    let recorder = Recorder { cancelled: Arc::new(true.into()), ..Recorder::default() };
    let error = reconstruct(&open(&options), &options, recorder).expect_err("no frame");
    assert!(matches!(error, RunError::Cancelled { .. }), "{error}");
}

#[test]
fn a_run_that_found_nothing_falls_short() {
    let shortfalls = |change: fn(&mut RunOptions)| {
        let mut options = quick(RunOptions::with_depth(), 3);
        change(&mut options);
        let outcome = reconstruct(&open(&options), &options, ()).expect("frames");
        assert!(outcome.complete);
        outcome.shortfalls
    };
    let none = shortfalls(|options| options.open.depth_scale = Some(1e-300));
    let all = shortfalls(|options| options.open.intrinsics = Some([1e-5, 1e-5, 48.0, 36.0]));
    for (found, cause) in [(none, "frame 0: it has no depth"), (all, "the map was empty")] {
        assert_eq!(found.len(), 2, "{found:?}");
        assert!(found[0].starts_with("0 of 3 frames were tracked: "), "{found:?}");
        assert!(found[0].contains(cause) && found[1].starts_with("the map is empty"), "{found:?}");
    }
    assert_eq!(shortfalls(|_| ()), [""; 0]);
    let held_out = shortfalls(|options| options.config.mapping.hold_out = 3);
    assert!(held_out.len() == 1 && held_out[0].contains("no frame was held out"), "{held_out:?}");
}

#[test]
fn options_that_contradict_each_other_are_refused() {
    let refused = |options: &RunOptions| {
        reconstruct(&open(options), options, ()).expect_err("a contradiction").to_string()
    };
    let odometry = PoseSource::FrontEnd { with_depth: false, estimate_distortion: true };
    let with_depth_preset = quick(RunOptions::new(Config::default(), odometry.clone()), 3);
    assert_eq!(refused(&with_depth_preset), "preset default is for colour with depth");
    let known_camera = quick(RunOptions::new(Config::default_rgb(), odometry), 3);
    assert!(refused(&known_camera).contains("camera.json"), "{}", refused(&known_camera));
}
