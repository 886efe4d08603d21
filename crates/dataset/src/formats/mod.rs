//! File formats: datasets, videos, and the poses and cameras of other programs. One reader each.

mod association;
mod camera_file;
pub(crate) mod colmap;
mod deflate;
pub(crate) mod droid;
mod file_pairing;
mod folders;
mod listing;
pub(crate) mod nerfstudio;
pub(crate) mod npy;
mod npz;
mod poses;
mod record3d;
mod replica;
mod scannet;
mod sens;
mod seven_scenes;
mod stray_scanner;
mod tum;
mod video;
mod zip;

pub use camera_file::camera_json;
pub use listing::{DepthEntry, DroppedFrames, FrameEntry, FrameParts};
pub use scannet::paper_frames;
pub use tum::{read_trajectory, write_trajectory};

pub(crate) use association::{AssociationRules, associate, pair_mutually_nearest};
pub(crate) use camera_file::read_camera;
pub(crate) use file_pairing::{file_stem, last_number};
pub(crate) use folders::list_images_below;
pub(crate) use listing::Listing;
pub(crate) use tum::{published_calibration, read_unit_trajectory};
pub(crate) use video::video_rules;

use crate::camera::{Calibration, FormatDefaults};
use crate::text::{is_present, list_names};
use crate::video::is_video;
use crate::{DatasetError, OpenOptions};
use nerfstudio::TransformsFile;
use record3d::Recording;
use std::path::{Path, PathBuf};

/// Longer side of frames of telephones with LiDAR, unless options say otherwise \[px\]: two and a half
/// times that of depth.
const MAX_TELEPHONE_SIDE: usize = 640;

/// Format of a sequence on disk. See docs/datasets.md for each.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Layout {
    /// TUM RGB-D: `rgb.txt` and `depth.txt`.
    Tum,
    /// ETH3D SLAM: as TUM RGB-D, with `calibration.txt`.
    Eth3d,
    /// ScanNet, extracted: `color/`, `depth/`, `pose/`, `intrinsic/`.
    ScanNet,
    /// ScanNet, one `.sens` file.
    Sens,
    /// Replica as rendered for NICE-SLAM: `results/` and `traj.txt`.
    Replica,
    /// 7-Scenes: `frame-000000.color.png`, `.depth.png` and `.pose.txt` in one folder.
    SevenScenes,
    /// nerfstudio and instant-ngp: `transforms.json` with `depth_file_path`.
    Nerfstudio,
    /// The app Stray Scanner: `rgb.mp4`, `depth/`, `camera_matrix.csv`.
    StrayScanner,
    /// The app Record3D: one `.r3d` file, or the folder that it unpacks to.
    Record3d,
    /// A colour folder beside a depth folder, or colour images alone.
    Plain,
    /// A video file; its second track is depth where it is 16-bit grey.
    Video,
}

impl Layout {
    /// All layouts, in the order in which they are looked for.
    pub const ALL: [Self; 11] = [
        Self::Nerfstudio,
        Self::StrayScanner,
        Self::Record3d,
        Self::Replica,
        Self::SevenScenes,
        Self::ScanNet,
        Self::Sens,
        Self::Eth3d,
        Self::Tum,
        Self::Plain,
        Self::Video,
    ];

    /// Name for users.
    pub fn name(self) -> &'static str {
        self.description().0
    }

    /// Files by which the layout is recognised, for users.
    pub fn recognised_by(self) -> &'static str {
        self.description().1
    }

    fn description(self) -> (&'static str, &'static str) {
        match self {
            Self::Tum => ("TUM RGB-D", "rgb.txt, depth.txt"),
            Self::Eth3d => ("ETH3D SLAM", "rgb.txt, depth.txt, calibration.txt"),
            Self::ScanNet => {
                ("ScanNet (extracted)", "color/, depth/, intrinsic/ (or frames/ with them)")
            }
            Self::Sens => ("ScanNet (.sens)", "one .sens file, or its folder"),
            Self::Replica => ("Replica (NICE-SLAM)", "results/frame*.jpg, results/depth*.png"),
            Self::SevenScenes => ("7-Scenes", "frame-*.color.png, frame-*.depth.png"),
            Self::Nerfstudio => ("nerfstudio", "transforms.json with depth_file_path"),
            Self::StrayScanner => ("Stray Scanner", "rgb.mp4, depth/, camera_matrix.csv"),
            Self::Record3d => ("Record3D", "one .r3d file, or its folder; metadata, rgbd/"),
            Self::Plain => {
                ("colour and depth folders", "colour/ (color/, rgb/, images/), depth/, camera.json")
            }
            Self::Video => ("video", "a video file (.mp4, .mov, .mkv, .webm, .avi, ...)"),
        }
    }
}

impl std::fmt::Display for Layout {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// The error for a path in none of the layouts; `found` says what is there.
fn unknown_layout(path: &Path, found: String, has_colour: bool) -> DatasetError {
    if let Some(unread) = folders::unread_photographs(path).filter(|_| !has_colour) {
        return DatasetError::file(path, format!("found {unread}"));
    }
    if path.is_file() && file_pairing::has_image_name(path) {
        return DatasetError::OnePicture { path: path.to_path_buf() };
    }
    if let Some(video) = first_video(path).filter(|_| !has_colour) {
        return DatasetError::FolderOfVideo { path: path.to_path_buf(), video };
    }
    let line = |layout: Layout| format!("\n  {:<26}{}", layout.name(), layout.recognised_by());
    let known = Layout::ALL.into_iter().map(line).collect();
    DatasetError::UnknownLayout { path: path.to_path_buf(), found, has_colour, known }
}

/// The first video in a folder, by name.
fn first_video(folder: &Path) -> Option<PathBuf> {
    let entries = std::fs::read_dir(folder).ok()?.filter_map(Result::ok).map(|entry| entry.path());
    entries.filter(|path| is_video(path)).min()
}

/// A recognised sequence, its metadata files opened.
pub(crate) enum DetectedLayout {
    Tum,
    Eth3d(PathBuf),
    ScanNet(scannet::ScanNetFolders),
    Sens(sens::SensFile),
    Replica(replica::ReplicaFolders),
    SevenScenes,
    Nerfstudio(TransformsFile),
    StrayScanner(PathBuf),
    Record3d(Recording),
    Plain(folders::ImageFolders),
    Video,
}

impl DetectedLayout {
    /// Recognises the layout of `path`, an existing folder, `.sens` or `.r3d` file or video.
    ///
    /// With `colour_only`, sequences without depth are accepted where none with depth fits.
    pub(crate) fn detect(path: &Path, colour_only: bool) -> Result<Self, DatasetError> {
        let found = match Self::with_depth(path)? {
            None if colour_only => Self::without_depth(path)?,
            found => found,
        };
        found.ok_or_else(|| {
            let has_colour = matches!(Self::without_depth(path), Ok(Some(_)));
            unknown_layout(path, list_names(path), has_colour)
        })
    }

    /// Whether the sequence is a video.
    pub(crate) fn is_video(&self) -> bool {
        matches!(self, Self::Video)
    }

    /// True of a single file, next to which files of other sequences may lie.
    pub(crate) fn is_file(&self, path: &Path) -> bool {
        self.is_video() || (matches!(self, Self::Record3d(_)) && path.is_file())
    }

    /// True if depth is stored in metres.
    pub(crate) fn is_in_metres(&self) -> bool {
        matches!(self, Self::Record3d(_))
    }

    /// True if the layout has depth, but none of its frames.
    pub(crate) fn lacks_depth(&self) -> bool {
        matches!(self, Self::Record3d(recording) if !recording.has_depth())
    }

    fn with_depth(path: &Path) -> Result<Option<Self>, DatasetError> {
        if is_video(path) {
            return Ok(Some(Self::Video));
        }
        if record3d::is_archive(path) {
            return Recording::open_archive(path).map(Self::Record3d).map(Some);
        }
        if path.is_file() {
            return sens::SensFile::open(path).map(Self::Sens).map(Some);
        }
        if let Some(file) = nerfstudio::find(path) {
            return TransformsFile::open(&file, true).map(Self::Nerfstudio).map(Some);
        }
        if stray_scanner::is_recording(path) {
            return Ok(Some(Self::StrayScanner(path.to_path_buf())));
        }
        if record3d::is_unpacked(path) {
            return Recording::open_folder(path).map(Self::Record3d).map(Some);
        }
        if let Some(folders) = replica::find(path) {
            return Ok(Some(Self::Replica(folders)));
        }
        if seven_scenes::is_sequence(path) {
            return Ok(Some(Self::SevenScenes));
        }
        if let Some(folders) = scannet::find(path) {
            return Ok(Some(Self::ScanNet(folders)));
        }
        if let Some(file) = sens::find(path) {
            return sens::SensFile::open(&file).map(Self::Sens).map(Some);
        }
        let listed = tum::find(path, true).or_else(|| folders::find(path).map(Self::Plain));
        let is_other = listed.is_some() || folders::find_colour(path).is_some();
        match record3d::find_archive(path).filter(|_| !is_other) {
            Some(file) => Recording::open_archive(&file).map(Self::Record3d).map(Some),
            None => Ok(listed),
        }
    }

    fn without_depth(path: &Path) -> Result<Option<Self>, DatasetError> {
        let transforms = path.join("transforms.json");
        if is_present(&transforms) {
            return TransformsFile::open(&transforms, false).map(Self::Nerfstudio).map(Some);
        }
        Ok(tum::find(path, false).or_else(|| folders::find_colour(path).map(Self::Plain)))
    }

    /// Properties of all sequences of this layout.
    pub(crate) fn defaults(&self) -> FormatDefaults {
        match self {
            Self::ScanNet(_) => scannet::DEFAULTS,
            Self::Sens(file) => file.defaults(),
            Self::Replica(_) => replica::DEFAULTS,
            Self::SevenScenes => seven_scenes::DEFAULTS,
            Self::Nerfstudio(file) => file.defaults(),
            Self::StrayScanner(_) => stray_scanner::DEFAULTS,
            Self::Record3d(recording) => recording.defaults(),
            Self::Video => video::DEFAULTS,
            Self::Tum | Self::Eth3d(_) => FormatDefaults::TUM,
            Self::Plain(_) => FormatDefaults::PLAIN,
        }
    }

    /// The options with what is usual for this layout, where it is not given.
    pub(crate) fn with_usual_options(&self, options: &OpenOptions) -> OpenOptions {
        match self {
            Self::StrayScanner(_) | Self::Record3d(_) => {
                let usual = (options.scale == 1.0).then_some(MAX_TELEPHONE_SIDE);
                OpenOptions { max_side: options.max_side.or(usual), ..options.clone() }
            }
            _ => options.clone(),
        }
    }

    /// Calibration in the sequence's own files, or the one published for the dataset.
    pub(crate) fn calibration(&self) -> Result<Option<Calibration>, DatasetError> {
        match self {
            Self::Tum | Self::Plain(_) | Self::Video => Ok(None),
            Self::Eth3d(file) => tum::eth3d_calibration(file).map(Some),
            Self::ScanNet(folders) => scannet::calibration(folders).map(Some),
            Self::Sens(file) => file.calibration().map(Some),
            Self::Replica(folders) => replica::calibration(folders).map(Some),
            Self::SevenScenes => Ok(Some(seven_scenes::calibration())),
            Self::Nerfstudio(file) => file.calibration().map(Some),
            Self::StrayScanner(folder) => stray_scanner::calibration(folder).map(Some),
            Self::Record3d(recording) => recording.calibration(),
        }
    }

    /// Reasons why files that hold a camera in other layouts were not used, each a clause.
    pub(crate) fn unused_files(folder: &Path) -> Vec<String> {
        nerfstudio::unused(folder).into_iter().chain(tum::missing_list(folder)).collect()
    }

    /// Lists the frames. `frame_rate` [1/s] spaces frames without time stamps.
    pub(crate) fn list(
        &self,
        path: &Path,
        options: &OpenOptions,
        frame_rate: f64,
    ) -> Result<Listing, DatasetError> {
        match self {
            Self::Tum => tum::list(path, Layout::Tum, options),
            Self::Eth3d(_) => tum::list(path, Layout::Eth3d, options),
            Self::ScanNet(folders) => scannet::list(folders, options, frame_rate),
            Self::Sens(file) => file.list(options, frame_rate),
            Self::Replica(folders) => replica::list(folders, options, frame_rate),
            Self::SevenScenes => seven_scenes::list(path, options, frame_rate),
            Self::Nerfstudio(file) => file.list(options, frame_rate),
            Self::StrayScanner(folder) => stray_scanner::list(folder, options, frame_rate),
            Self::Record3d(recording) => recording.list(options, frame_rate),
            Self::Plain(folders) => folders::list(path, folders, options, frame_rate),
            Self::Video => video::list(path, options, frame_rate),
        }
    }
}
