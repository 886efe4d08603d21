//! Memory that goes back to the system.

/// Size from which glibc maps a block by itself [bytes]; pictures are larger.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const MMAP_THRESHOLD: libc::c_int = 256 << 10;

/// Lets glibc return every large block to the system when it is freed. By itself it raises the size
/// from which it does so to that of the largest block freed, up to 32 MiB, and pictures leave gaps that
/// nothing else fills. Other allocators need no setting.
#[cfg_attr(
    all(target_os = "linux", target_env = "gnu"),
    expect(unsafe_code, reason = "glibc has no safe interface for its settings")
)]
pub(crate) fn return_large_blocks() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: `mallopt` may be called at any time; here no other thread runs yet.
    unsafe {
        libc::mallopt(libc::M_MMAP_THRESHOLD, MMAP_THRESHOLD);
    }
}

/// Returns free pages within the heap to the system. Stages of a run free many small blocks that the
/// next ones do not need.
#[cfg_attr(
    all(target_os = "linux", target_env = "gnu"),
    expect(unsafe_code, reason = "glibc has no safe interface for its settings")
)]
pub(crate) fn return_free_pages() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: `malloc_trim` may be called at any time, on any thread.
    unsafe {
        libc::malloc_trim(0);
    }
}
