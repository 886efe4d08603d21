//! Ctrl-C, SIGTERM and SIGHUP: the first ends a run cleanly, the second ends the program.

use crate::console::print_status;
use i2slam::CancellationToken;
use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

static REQUESTED: AtomicBool = AtomicBool::new(false);

/// When the last first signal came.
static SINCE: Mutex<Option<Instant>> = Mutex::new(None);

/// File in which a stream is recorded; a second signal leaves it.
static RECORDING: Mutex<Option<PathBuf>> = Mutex::new(None);

/// Whether a stream is being read, which the first signal ends in place of the run.
static READING: AtomicBool = AtomicBool::new(false);

/// Installs the signal handler. Where the system refuses, Ctrl-C ends the program as usual.
pub(crate) fn listen() {
    listen_for("\nending the run and writing what there is; once more ends at once");
}

/// As [`listen`], with another answer to the first signal.
pub(crate) fn listen_for(answer: &'static str) {
    let handler = move || {
        if REQUESTED.swap(true, Ordering::SeqCst) {
            if let Some(path) = RECORDING.lock().ok().and_then(|path| path.clone()) {
                print_status(&format!("the recorded stream is left in {}", path.display()));
            }
            std::process::exit(130);
        }
        if let Ok(mut since) = SINCE.lock() {
            *since = Some(Instant::now());
        }
        print_status(if READING.load(Ordering::SeqCst) {
            "\nending the stream and reconstructing what was recorded; once more ends at once"
        } else {
            answer
        });
    };
    if ctrlc::set_handler(handler).is_err() {
        print_status("warning: Ctrl-C will end this run without writing results");
    }
}

/// A stream that may have no end is read: Ctrl-C ends the reading, which polls [`requested`], and not
/// the run.
pub(crate) struct Reading(());

/// Names the file in which a stream is recorded while it is there, `None` when it is removed.
pub(crate) fn set_recording(path: Option<PathBuf>) {
    if let Ok(mut recording) = RECORDING.lock() {
        *recording = path;
    }
}

impl Reading {
    pub(crate) fn start() -> Self {
        READING.store(true, Ordering::SeqCst);
        Self(())
    }
}

impl Drop for Reading {
    fn drop(&mut self) {
        // In this order: a run must not see the signal that ended the stream.
        REQUESTED.store(false, Ordering::SeqCst);
        READING.store(false, Ordering::SeqCst);
    }
}

/// Token for the libraries, cancelled by the first signal that does not end a stream.
pub(crate) fn cancellation() -> CancellationToken {
    CancellationToken::when(|| requested() && !READING.load(Ordering::SeqCst))
}

/// Time since the user asked to stop; none if nobody did.
pub(crate) fn elapsed() -> Option<Duration> {
    let since = SINCE.lock().ok().and_then(|since| *since);
    since.filter(|_| requested()).map(|since| since.elapsed())
}

/// Whether the user asked to stop.
pub(crate) fn requested() -> bool {
    REQUESTED.load(Ordering::SeqCst)
}
