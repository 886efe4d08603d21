//! Ctrl-C, SIGTERM and SIGHUP.

use crate::console::print_status;
use std::sync::atomic::{AtomicBool, Ordering};

static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Handles Ctrl-C, SIGTERM and SIGHUP: the first ends the jobs and writes the report, the second
/// ends the program at once.
pub(crate) fn listen() {
    let handler = || {
        if INTERRUPTED.swap(true, Ordering::SeqCst) {
            std::process::exit(130);
        }
        print_status("\nending the jobs and writing what there is; once more ends at once");
    };
    if ctrlc::set_handler(handler).is_err() {
        print_status("warning: Ctrl-C will end this benchmark without writing tables");
    }
}

/// Whether the user asked to end.
pub(crate) fn interrupted() -> bool {
    INTERRUPTED.load(Ordering::SeqCst)
}
