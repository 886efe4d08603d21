//! Small sequences in temporary folders.

use i2slam_synthetic::{Spec, Summary, synthesise};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// An empty folder for one test, removed when dropped.
pub(crate) struct Scratch(pub(crate) PathBuf);

impl Scratch {
    pub(crate) fn new(name: &str) -> Self {
        let path =
            std::env::temp_dir().join(format!("i2slam-synthetic-{name}-{}", std::process::id()));
        std::fs::remove_dir_all(&path).ok();
        Self(path)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.0).ok();
    }
}

/// A few small frames in coarse light.
pub(crate) fn small_spec() -> Spec {
    let mut spec = Spec { seed: 5, ..Spec::default() };
    spec.camera.frames = 7;
    spec.camera.width = 80;
    spec.camera.height = 60;
    spec.camera.sub_frames = 4;
    spec.camera.sharp_samples = 2;
    spec.light.texel = 0.12;
    spec
}

/// Renders without asking to stop.
pub(crate) fn render(spec: &Spec, out: &Path) -> Summary {
    synthesise(spec, out, true, &mut |_| true).expect("a sequence")
}

/// Every file below a folder with its bytes.
pub(crate) fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut waiting = vec![folder.to_owned()];
    while let Some(next) = waiting.pop() {
        for entry in std::fs::read_dir(&next).expect("a folder").flatten() {
            let path = entry.path();
            if path.is_dir() {
                waiting.push(path);
            } else {
                let name = path.strip_prefix(folder).expect("below").to_owned();
                found.insert(name, std::fs::read(&path).expect("a file"));
            }
        }
    }
    found
}
