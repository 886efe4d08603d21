//! Memory that a process can have on this machine.

use std::fs;
use std::path::Path;

/// Memory of the machine, or of the control group of the process where that has less [bytes];
/// unknown except on Linux.
pub fn machine_memory() -> Option<u64> {
    let text = |path: &str| fs::read_to_string(path).unwrap_or_default();
    let groups = text("/proc/self/cgroup");
    let limits = groups.lines().filter_map(|line| group_limit(Path::new("/sys/fs/cgroup"), line));
    limits.chain(total(&text("/proc/meminfo"))).min()
}

/// `MemTotal` of `/proc/meminfo` [bytes].
fn total(text: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    kilobytes.checked_mul(1024)
}

/// Least limit of a control group and of those above it [bytes], from a line
/// `number:controllers:path` of `/proc/self/cgroup`. `None` without one: a missing file, or `max`.
fn group_limit(root: &Path, line: &str) -> Option<u64> {
    let mut parts = line.splitn(3, ':').skip(1);
    let (controllers, path) = (parts.next()?, parts.next()?);
    let (folder, file) = match controllers {
        "" => (root.to_owned(), "memory.max"),
        all if all.split(',').any(|name| name == "memory") => {
            (root.join("memory"), "memory.limit_in_bytes")
        }
        _ => return None,
    };
    let limit = |group: &Path| -> Option<u64> {
        let place = folder.join(group.strip_prefix("/").unwrap_or(group));
        fs::read_to_string(place.join(file)).ok()?.trim().parse().ok()
    };
    // In a container the path may be that of the host: then only the topmost group is there.
    Path::new(path).ancestors().filter_map(limit).min()
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::TemporaryFolder;

    #[test]
    fn the_least_limit_counts() {
        assert_eq!(total("MemFree: 1 kB\nMemTotal:    2048 kB\n"), Some(2 << 20));
        assert_eq!(total("MemFree: 1 kB\n"), None);
        let root = TemporaryFolder::new("groups");
        let write = |file: &str, text: &str| {
            let path = root.join(file);
            fs::create_dir_all(path.parent().expect("a folder")).expect("room");
            fs::write(path, text).expect("room");
        };
        write("a/memory.max", "500\n");
        write("a/b/memory.max", "max\n");
        write("memory/x/memory.limit_in_bytes", "700\n");
        let limit = |line: &str| group_limit(&root.0, line);
        assert_eq!(limit("0::/a/b"), Some(500));
        assert_eq!(limit("0::/elsewhere"), None);
        assert_eq!(limit("4:cpu,memory:/x/y"), Some(700));
        assert_eq!(limit("3:cpu:/a"), None);
        assert_eq!(limit("nonsense"), None);
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn this_machine_has_some() {
        assert!(machine_memory().is_some_and(|bytes| bytes > 64 << 20));
    }
}
