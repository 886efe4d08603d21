//! Memory that goes back to the system.

use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Least time from one return of free pages to the next.
const PAUSE: Duration = Duration::from_secs(5);

/// Returns free pages within the heap to the system, unless that was done just before. A run makes
/// and frees pictures all the time, between small blocks that stay; glibc by itself returns what lies
/// at the end of a heap alone. Other allocators are left to themselves.
#[cfg_attr(
    all(target_os = "linux", target_env = "gnu"),
    expect(unsafe_code, reason = "glibc has no safe interface for its settings")
)]
pub(crate) fn return_free_pages() {
    static LAST: Mutex<Option<Instant>> = Mutex::new(None);
    let Ok(mut last) = LAST.lock() else { return };
    if last.is_some_and(|last| last.elapsed() < PAUSE) {
        return;
    }
    *last = Some(Instant::now());
    drop(last);
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: `malloc_trim` may be called at any time, on any thread.
    unsafe {
        libc::malloc_trim(0);
    }
}
