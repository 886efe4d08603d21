//! Frames of the demo clip that come as those of a stream.

use super::*;
use crate::run::reconstruct_stream;
use crate::{CancellationToken, FrameEstimate, RunOutcome};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
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

/// Keeps what it sees; lets [`TRACKED`] frames come, and others when [`MAPPED`] are mapped.
#[derive(Clone, Default)]
struct Recorder {
    /// Index and count of every frame that was mapped.
    frames: Arc<Mutex<Vec<(usize, usize, usize)>>>,
    notes: Arc<Mutex<Vec<String>>>,
    cancelled: Arc<AtomicBool>,
    /// Cancels once [`TRACKED`] frames have come.
    cancels: bool,
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

    fn has_note(&self, text: &str) -> bool {
        self.notes.lock().expect("no panic").iter().any(|note| note.contains(text))
    }
}

impl Observer for Recorder {
    fn progress(&self, stage: Stage, done: usize, _total: usize) {
        if stage == Stage::Online && done >= TRACKED {
            self.wait_for_the_map();
            self.cancelled.store(self.cancels, Ordering::SeqCst);
        }
    }

    fn frame(&self, estimate: &FrameEstimate, done: usize, total: usize) {
        self.frames.lock().expect("no panic").push((estimate.index, done, total));
        assert!(!self.panics || self.mapped() > 1, "as asked");
    }

    fn note(&self, text: &str) {
        self.notes.lock().expect("no panic").push(text.to_owned());
    }

    fn cancellation(&self) -> CancellationToken {
        let cancelled = Arc::clone(&self.cancelled);
        CancellationToken::when(move || cancelled.load(Ordering::SeqCst))
    }
}

/// Runs on frames that come one by one, each as `change` leaves it.
fn run(recorder: &Recorder, change: fn(&mut Sequence)) -> RunOutcome {
    run_with(options(), recorder, change)
}

fn run_with(options: RunOptions, recorder: &Recorder, change: fn(&mut Sequence)) -> RunOutcome {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cli/assets/demo");
    let mut sequence = options.open_sequence(&folder).expect("the demo clip");
    change(&mut sequence);
    let large = sequence.at_least(ODOMETRY_SIDE);
    let source = Source { first: &sequence, large: &large, has_depth: true };
    let frames = |of: &Sequence| of.stream().map(|frame| frame.expect("a frame"));
    let sizes = (frames(&large), Some(frames(&sequence)));
    let context = RunContext::new(recorder.clone());
    let tracked = TrackedStream::of_frames(&source, sizes, (&options, false), &context);
    reconstruct_stream(&sequence, tracked, &options, recorder.clone()).expect("frames")
}

fn indices(outcome: &RunOutcome) -> Vec<usize> {
    outcome.reconstruction.frames.iter().map(|frame| frame.index).collect()
}

/// Every frame is told, counted from one on, and some before all have come.
#[test]
fn frames_are_mapped_while_they_come() {
    let recorder = Recorder::default();
    let outcome = run(&recorder, |_| {});
    assert!(outcome.complete && outcome.warnings.is_empty(), "{:?}", outcome.warnings);
    assert_eq!(indices(&outcome), (0..FRAMES).collect::<Vec<_>>());
    let frames = recorder.frames.lock().expect("done");
    assert!((0..FRAMES).all(|index| frames.iter().any(|frame| frame.0 == index)), "{frames:?}");
    assert!(frames.iter().all(|(_, done, total)| (1..=*total).contains(done)), "{frames:?}");
}

/// Their rate is that of the camera, by which the map counts.
#[test]
fn every_second_frame_is_mapped_once() {
    let recorder = Recorder::default();
    let mut every_second = options();
    (every_second.open.stride, every_second.open.frames) = (2, Some(0..2 * FRAMES));
    let outcome = run_with(every_second, &recorder, |_| {});
    assert!(outcome.complete, "{:?}", outcome.problem);
    assert!(!recorder.has_note("frames a second"), "{:?}", recorder.notes);
    assert_eq!(indices(&outcome), (0..2 * FRAMES).step_by(2).collect::<Vec<_>>());
}

/// Frames of a cancelled run still come; the map stays as it is.
#[test]
fn a_run_cancelled_while_frames_come_keeps_path_and_map() {
    let recorder = Recorder { cancels: true, ..Recorder::default() };
    let outcome = run(&recorder, |_| {});
    assert!(!outcome.complete && outcome.problem.is_none());
    assert_eq!(indices(&outcome), (0..FRAMES).collect::<Vec<_>>());
    assert!(outcome.reconstruction.map.gaussians() > 1000);
    assert!(recorder.mapped() < FRAMES);
}

/// Its frames are mapped after the last one then.
#[test]
fn a_panic_of_the_map_is_told_once_and_loses_nothing() {
    let recorder = Recorder { panics: true, ..Recorder::default() };
    let outcome = run(&recorder, |_| {});
    assert!(outcome.complete, "{:?}", outcome.problem);
    let told = outcome.warnings.iter().filter(|w| w.text.contains("all frames are mapped again"));
    assert_eq!(told.count(), 1, "{:?}", outcome.warnings);
    assert_eq!(indices(&outcome), (0..FRAMES).collect::<Vec<_>>());
    assert!(outcome.reconstruction.map.gaussians() > 1000);
    assert!(outcome.reconstruction.frames.iter().all(|frame| !frame.held_out));
}

/// Depth that is 50 ms late is known to be so only after the last frame: all are mapped a second time.
#[test]
fn a_map_of_late_depth_is_made_anew() {
    let late = |sequence: &mut Sequence| {
        for entry in &mut sequence.entries {
            entry.depth.iter_mut().for_each(|depth| depth.timestamp += 0.05);
        }
    };
    let recorder = Recorder::default();
    let outcome = run(&recorder, late);
    assert!(outcome.complete, "{:?}", outcome.problem);
    let delay = outcome.camera.as_ref().map(|camera| camera.depth_delay);
    assert!(delay.is_some_and(|delay| (delay + 0.05).abs() < 0.025), "{delay:?}");
    assert!(recorder.has_note("all frames are mapped again"));
    assert_eq!(indices(&outcome), (0..FRAMES).collect::<Vec<_>>());
}

#[test]
fn poses_that_come_late_are_told() {
    let begin = Instant::now();
    let tracked = |seconds_of_frame: f64| {
        let mut lag = Lag::default();
        let moment =
            |frame: u32| begin + Duration::from_secs_f64(seconds_of_frame * f64::from(frame));
        (0..60).for_each(|frame| lag.frame(0.05 * f64::from(frame), moment(frame)));
        lag.end(moment(60));
        lag.note()
    };
    assert_eq!((tracked(0.01), tracked(0.05), tracked(0.065)), (None, None, None));
    let note = tracked(0.1).expect("three seconds and a frame");
    assert!(note.contains("up to 3.0 s late") || note.contains("up to 3.1 s late"), "{note}");
    assert_eq!(Lag::default().note(), None);
}
