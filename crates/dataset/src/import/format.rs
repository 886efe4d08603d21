//! Recognition of the formats of imported keyframes.

use crate::DatasetError;
use crate::formats::{colmap, read_unit_trajectory};
use crate::sequence::check_kind;
use crate::text::{data_lines, list_names, read_text};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Format of imported keyframes. See docs/import.md for each.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ImportFormat {
    /// nerfstudio's and instant-ngp's `transforms.json`.
    Nerfstudio,
    /// A sparse model of COLMAP, text or binary.
    Colmap,
    /// Arrays of DROID-SLAM or NeRF-SLAM: a folder of `.npy` files, or an `.npz`.
    Droid,
    /// A trajectory in the TUM format, and pictures.
    Trajectory,
}

impl ImportFormat {
    /// All formats, in the order in which they are looked for.
    pub const ALL: [Self; 4] = [Self::Nerfstudio, Self::Colmap, Self::Droid, Self::Trajectory];

    /// Name for users.
    pub fn name(self) -> &'static str {
        self.description()[0]
    }

    /// Pose convention of the files, for users.
    pub fn convention(self) -> &'static str {
        self.description()[1]
    }

    /// Files by which the format is recognised, for users.
    pub fn recognised_by(self) -> &'static str {
        self.description()[2]
    }

    fn description(self) -> [&'static str; 3] {
        match self {
            Self::Nerfstudio => [
                "nerfstudio",
                "world_from_camera, OpenGL axes (y up, z backwards)",
                "transforms.json, or its folder",
            ],
            Self::Colmap => [
                "COLMAP",
                "camera_from_world, quaternion w x y z, OpenCV axes",
                "cameras and images as .bin or .txt, in the folder, in sparse/0 or in sparse",
            ],
            Self::Droid => [
                "DROID-SLAM arrays",
                "camera_from_world, quaternion x y z w, OpenCV axes",
                "poses.npy with others in a folder, or one .npz",
            ],
            Self::Trajectory => [
                "TUM trajectory",
                "world_from_camera, quaternion x y z w, OpenCV axes",
                "a text file with lines timestamp tx ty tz qx qy qz qw, or a folder with it as \
                 trajectory.txt",
            ],
        }
    }
}

impl std::fmt::Display for ImportFormat {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// A recognised format with its files.
pub(super) enum DetectedFormat {
    Nerfstudio(PathBuf),
    Colmap(colmap::Model),
    Droid(PathBuf),
    Trajectory(PathBuf),
}

impl DetectedFormat {
    /// Recognises the format of `path`.
    pub(super) fn detect(path: &Path) -> Result<Self, DatasetError> {
        let unknown = |found: String| {
            let line = |format: ImportFormat| {
                format!("\n  {:<26}{}", format.name(), format.recognised_by())
            };
            let known = ImportFormat::ALL.into_iter().map(line).collect();
            Err(DatasetError::UnknownImport { path: path.to_path_buf(), found, known })
        };
        if path.exists() {
            check_kind(path)?;
        }
        let found =
            if path.is_file() { Self::detect_file(path) } else { Self::detect_folder(path) };
        match found {
            Some(found) => Ok(found),
            None if !path.exists() => unknown("nothing".into()),
            None if is_torch_file(path) => unknown(
                "a file of torch.save: write its arrays with np.savez (docs/import.md, DROID-SLAM)"
                    .into(),
            ),
            None if path.is_file() => unknown(of_another_kind(path)),
            None => unknown(list_names(path)),
        }
    }

    fn detect_file(path: &Path) -> Option<Self> {
        let has_end = |end: &str| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(end));
        let folder = path.parent().unwrap_or(Path::new("."));
        let is_model = ["cameras", "images", "points3D"]
            .iter()
            .any(|name| path.file_stem().is_some_and(|stem| stem == *name));
        if has_end("json") {
            return Some(Self::Nerfstudio(path.to_path_buf()));
        }
        if has_end("npz") {
            return Some(Self::Droid(path.to_path_buf()));
        }
        if is_model && let Some(model) = colmap::find(folder, has_end("txt")) {
            return Some(Self::Colmap(model));
        }
        is_trajectory(path).then(|| Self::Trajectory(path.to_path_buf()))
    }

    fn detect_folder(path: &Path) -> Option<Self> {
        let file = |name: &str| Some(path.join(name)).filter(|file| file.is_file());
        let archive = || {
            let files = std::fs::read_dir(path).into_iter().flatten().flatten();
            let ends = |file: &PathBuf| file.extension().is_some_and(|end| end == "npz");
            let mut files = files.map(|entry| entry.path()).filter(ends);
            files.next().filter(|_| files.next().is_none())
        };
        let arrays = || file("poses.npy").map(|_| path.to_path_buf()).or_else(archive);
        file("transforms.json")
            .map(Self::Nerfstudio)
            .or_else(|| colmap::find(path, false).map(Self::Colmap))
            .or_else(|| arrays().map(Self::Droid))
            .or_else(|| file("trajectory.txt").map(Self::Trajectory))
    }
}

/// Description of a file of no known format; of a text file with why it is no trajectory.
fn of_another_kind(path: &Path) -> String {
    let is_text = path.extension().is_some_and(|end| end.eq_ignore_ascii_case("txt"));
    match read_unit_trajectory(path) {
        Err(DatasetError::Line { line, reason, .. }) if is_text => {
            format!("a text file that is no trajectory (line {line}: {reason})")
        }
        _ => "a file of another kind".to_owned(),
    }
}

/// Whether a file was written by torch.save, by its extension or first archive member.
fn is_torch_file(path: &Path) -> bool {
    let mut head = Vec::new();
    let read = |file: File| file.take(128).read_to_end(&mut head);
    let is_file = i2slam_storage::open(path).and_then(read).is_ok();
    let named = path.extension().is_some_and(|end| end == "pth" || end == "pt");
    is_file && (named || head.windows(8).any(|word| word == b"data.pkl"))
}

/// Whether the first data line of a text file starts with a number and has at least 7 columns.
fn is_trajectory(path: &Path) -> bool {
    let Ok(text) = read_text(path) else { return false };
    data_lines(&text).next().is_none_or(|(_, line)| {
        let mut words = line.split_whitespace();
        words.next().is_some_and(|word| word.parse::<f64>().is_ok()) && words.count() >= 6
    })
}
