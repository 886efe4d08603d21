//! Ctrl-C, and what else a system ends programs by (SIGTERM, SIGHUP): the first ends the run
//! cleanly, the second at once.

use crate::output::print_status;
use i2slam::CancellationToken;
use std::sync::atomic::{AtomicBool, Ordering};

static REQUESTED: AtomicBool = AtomicBool::new(false);

/// What is being read and ends with the first Ctrl-C, in place of the run.
static READING: AtomicBool = AtomicBool::new(false);

/// Begin to listen. Where the system refuses, Ctrl-C ends the program as usual.
pub(crate) fn listen() {
    let handler = || {
        if REQUESTED.swap(true, Ordering::SeqCst) {
            std::process::exit(130);
        }
        print_status(if READING.load(Ordering::SeqCst) {
            "\nending the stream and going on with what came; once more ends at once"
        } else {
            "\nending the run and writing what there is; once more ends at once"
        });
    };
    if ctrlc::set_handler(handler).is_err() {
        print_status("warning: Ctrl-C will end this run without writing results");
    }
}

/// Reads what may have no end: Ctrl-C ends `read`, which asks [`requested`], and not the run.
pub(crate) fn reading<T>(read: impl FnOnce() -> T) -> T {
    READING.store(true, Ordering::SeqCst);
    let result = read();
    READING.store(false, Ordering::SeqCst);
    REQUESTED.store(false, Ordering::SeqCst);
    result
}

/// The same as a wish that work of the libraries asks for.
pub(crate) fn cancellation() -> CancellationToken {
    CancellationToken::when(requested)
}

/// Whether the user asked to end.
pub(crate) fn requested() -> bool {
    REQUESTED.load(Ordering::SeqCst)
}
