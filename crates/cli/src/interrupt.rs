//! Ctrl-C: the first ends the run cleanly, the second at once.

use crate::output::complain;
use std::sync::atomic::{AtomicBool, Ordering};

static REQUESTED: AtomicBool = AtomicBool::new(false);

/// Begin to listen. Where the system refuses, Ctrl-C ends the program as usual.
pub(crate) fn listen() {
    let handler = || {
        if REQUESTED.swap(true, Ordering::SeqCst) {
            std::process::exit(130);
        }
        complain("\nending the run and writing what there is; once more ends at once");
    };
    if ctrlc::set_handler(handler).is_err() {
        complain("warning: Ctrl-C will end this run without writing results");
    }
}

/// Whether the user asked to end.
pub(crate) fn requested() -> bool {
    REQUESTED.load(Ordering::SeqCst)
}
