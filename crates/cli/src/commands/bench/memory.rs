//! How much memory there is, where the system tells (Linux).

use std::fs;

/// Memory that can still be taken [bytes]: what the system has, or what a control group leaves.
pub(super) fn available() -> Option<u64> {
    let system = in_kilobytes(&fs::read_to_string("/proc/meminfo").ok()?, "MemAvailable:");
    match (system, left_in_group()) {
        (Some(system), Some(group)) => Some(system.min(group)),
        (system, group) => system.or(group),
    }
}

/// Memory that a process holds now [bytes]; 0 where it is not known.
pub(super) fn held_by(process: u32) -> u64 {
    let status = fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    in_kilobytes(&status, "VmRSS:").unwrap_or(0)
}

fn left_in_group() -> Option<u64> {
    let number = |file: &str| -> Option<u64> {
        fs::read_to_string(format!("/sys/fs/cgroup/{file}")).ok()?.trim().parse().ok()
    };
    Some(number("memory.max")?.saturating_sub(number("memory.current")?))
}

/// The value of a line `NAME 123 kB` [bytes].
fn in_kilobytes(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes * 1024)
}

/// A cell that runs.
#[derive(Clone, Copy, Debug)]
pub(super) struct Load {
    /// What it will hold at most, as far as is known [bytes].
    pub(super) expected: u64,
    /// What it holds now [bytes].
    pub(super) held: u64,
}

/// Whether a cell that will hold `expected` bytes fits beside others that may still grow; a
/// quarter more is asked for, because the next seed may need more than the last.
pub(super) fn fits(available: Option<u64>, expected: u64, running: &[Load]) -> bool {
    if running.is_empty() {
        return true;
    }
    let growth: u64 = running.iter().map(|load| load.expected.saturating_sub(load.held)).sum();
    available.is_none_or(|free| free.saturating_sub(growth) >= expected + expected / 4)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_read_from_the_system_s_text() {
        let text = "MemTotal:  9 kB\nMemAvailable:    2048 kB\n";
        assert_eq!(in_kilobytes(text, "MemAvailable:"), Some(2 << 20));
        assert_eq!(in_kilobytes(text, "VmRSS:"), None);
    }

    #[test]
    fn a_cell_waits_for_what_others_will_still_take() {
        let load = Load { expected: 100, held: 20 };
        assert!(fits(Some(0), 100, &[]), "one always runs");
        assert!(fits(Some(300), 100, &[load]) && fits(None, 100, &[load]));
        assert!(!fits(Some(200), 100, &[load]), "80 are promised, 125 are needed");
    }
}
