//! Memory of this process: its bound, and the most that a case took. Linux alone; elsewhere memory
//! is neither bounded nor measured.

use std::fs;

/// Memory above which a case fails [bytes].
pub(crate) const LIMIT: u64 = 1_000_000_000;

/// Bounds the address space to what there is now and [`LIMIT`].
#[cfg(target_os = "linux")]
pub(crate) fn bound_address_space() -> Result<(), String> {
    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
    let now = status("VmSize").ok_or("/proc/self/status has no VmSize")?;
    let maximum = getrlimit(Resource::As).maximum;
    let limit = Rlimit { current: Some(now + LIMIT), maximum };
    setrlimit(Resource::As, limit).map_err(|e| format!("cannot bound the memory: {e}"))
}

#[cfg(not(target_os = "linux"))]
pub(crate) fn bound_address_space() -> Result<(), String> {
    Ok(())
}

/// Memory at the start of a case.
pub(crate) struct Meter {
    before: u64,
}

impl Meter {
    /// Forgets earlier peaks.
    pub(crate) fn start() -> Self {
        // Fails where there is no such file: then nothing is measured.
        let _ = fs::write("/proc/self/clear_refs", "5");
        Self { before: status("VmRSS").unwrap_or_default() }
    }

    /// The most memory since then [bytes].
    pub(crate) fn peak(&self) -> u64 {
        status("VmHWM").unwrap_or_default().saturating_sub(self.before)
    }
}

/// An entry of `/proc/self/status` [bytes].
fn status(name: &str) -> Option<u64> {
    let text = fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(':'))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()? * 1024)
}
