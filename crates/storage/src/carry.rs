//! Files of a folder that stay when a prepared one takes its place.

use crate::lock::LOCK;
use crate::manifest::Manifest;
use crate::staging::Staging;
use std::fs;
use std::path::Path;

/// Links the files that stay into the prepared folder, so that they are there at the instant of the
/// exchange: those of the `next` manifest, and the user's in folders that both have. Folders of the
/// user's alone are moved afterwards. Returns whether the folders can be exchanged.
pub(crate) fn carry_over(
    staging: &Staging,
    target: &Path,
    next: &Manifest,
    earlier: Option<&Manifest>,
) -> bool {
    let mut linked = Vec::new();
    for name in next.present(target).filter(|name| !staging.contains(name)) {
        linked.push(name);
        if staging.link(name, &target.join(name)).is_err() {
            staging.unlink(&linked);
            return false;
        }
    }
    let is_ours = |name: &str| earlier.is_some_and(|earlier| earlier.files.contains_key(name));
    carry_users_files(staging, target, "", &is_ours)
}

/// Links the user's files below `relative`; returns whether the user's folders can be moved.
fn carry_users_files(
    staging: &Staging,
    target: &Path,
    relative: &str,
    is_ours: &dyn Fn(&str) -> bool,
) -> bool {
    let entries = fs::read_dir(target.join(relative)).into_iter().flatten().flatten();
    entries.into_iter().all(|entry| {
        let (file_name, kind) = (entry.file_name(), entry.file_type());
        // A name that cannot stand in a line of text is moved afterwards.
        let name = file_name.to_str().filter(|name| !name.contains('\n'));
        let (Some(name), Ok(kind)) = (name, kind) else { return true };
        let name = if relative.is_empty() { name.to_owned() } else { format!("{relative}/{name}") };
        let prepared = staging.root.join(&name);
        match kind.is_dir() {
            true if prepared.is_dir() => carry_users_files(staging, target, &name, is_ours),
            true => can_be_moved(&entry.path(), target),
            false => {
                if name != LOCK && !is_ours(&name) && prepared.symlink_metadata().is_err() {
                    // What cannot be linked is moved afterwards.
                    staging.link(&name, &entry.path()).ok();
                }
                true
            }
        }
    })
}

/// Whether a folder can be given another parent: it needs write permission, and must be no mount.
#[cfg(unix)]
fn can_be_moved(folder: &Path, target: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let device = |path: &Path| path.symlink_metadata().map(|found| found.dev()).ok();
    let is_writable = rustix::fs::access(folder, rustix::fs::Access::WRITE_OK).is_ok();
    is_writable && device(folder) == device(target)
}

#[cfg(not(unix))]
fn can_be_moved(_: &Path, _: &Path) -> bool {
    true
}
