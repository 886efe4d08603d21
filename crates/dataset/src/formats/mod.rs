//! What a folder holds: which layout, and the pairs of colour and depth images in it.

mod associated;
mod eth3d;
mod nerfstudio;
pub(crate) mod pairs;
mod plain;
mod poses;
mod replica;
mod scannet;
mod sens;
mod seven_scenes;

pub(crate) use nerfstudio::Scene;
pub(crate) use plain::below as pictures_below;

use crate::calibration::{Calibration, Traits};
use crate::decode::DepthCode;
use crate::video::{Video, is_video};
use crate::{DatasetError, Entry, LeftOut, OpenOptions};
use i2slam_geometry::StampedPose;
use std::path::{Path, PathBuf};

/// How a sequence lies on disk. See docs/datasets.md for each.
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
    /// A colour folder beside a depth folder, or pictures alone.
    Plain,
    /// A video file, colour alone.
    Video,
}

impl Layout {
    /// All layouts, in the order in which they are looked for.
    pub const ALL: [Self; 9] = [
        Self::Nerfstudio,
        Self::Replica,
        Self::SevenScenes,
        Self::ScanNet,
        Self::Sens,
        Self::Eth3d,
        Self::Tum,
        Self::Plain,
        Self::Video,
    ];

    /// Its name for people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tum => "TUM RGB-D",
            Self::Eth3d => "ETH3D SLAM",
            Self::ScanNet => "ScanNet (extracted)",
            Self::Sens => "ScanNet (.sens)",
            Self::Replica => "Replica (NICE-SLAM)",
            Self::SevenScenes => "7-Scenes",
            Self::Nerfstudio => "nerfstudio",
            Self::Plain => "colour and depth folders",
            Self::Video => "video",
        }
    }

    /// The files by which it is recognised.
    pub fn recognised_by(self) -> &'static str {
        match self {
            Self::Tum => "rgb.txt, depth.txt",
            Self::Eth3d => "rgb.txt, depth.txt, calibration.txt",
            Self::ScanNet => "color/, depth/, intrinsic/ (or frames/ with them)",
            Self::Sens => "one .sens file, or its folder",
            Self::Replica => "results/frame*.jpg, results/depth*.png",
            Self::SevenScenes => "frame-*.color.png, frame-*.depth.png",
            Self::Nerfstudio => "transforms.json with depth_file_path",
            Self::Plain => "colour/ (color/, rgb/, images/), depth/, camera.json",
            Self::Video => "a video file (.mp4, .mov, .mkv, .webm, .avi, ...), colour alone",
        }
    }
}

impl std::fmt::Display for Layout {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// The associated stream of a sequence.
#[derive(Debug)]
pub(crate) struct Listing {
    pub(crate) layout: Layout,
    /// All pairs, in order of time.
    pub(crate) entries: Vec<Entry>,
    pub(crate) left_out: LeftOut,
    /// Whether frames too close in time are left out.
    pub(crate) is_thinned: bool,
    /// The folder's ground truth, whether or not it can be read.
    pub(crate) ground_truth: Option<PathBuf>,
    /// True poses that came with the frames.
    pub(crate) poses: Vec<StampedPose>,
    pub(crate) depth_code: DepthCode,
    /// What decodes the pictures, if they are those of a video.
    pub(crate) video: Option<Video>,
    pub(crate) warnings: Vec<String>,
}

impl Listing {
    /// Frames without anything else known of them.
    pub(crate) fn new(layout: Layout, entries: Vec<Entry>) -> Self {
        Self {
            layout,
            entries,
            left_out: LeftOut::default(),
            is_thinned: false,
            ground_truth: None,
            poses: Vec::new(),
            depth_code: DepthCode::Png,
            video: None,
            warnings: Vec::new(),
        }
    }

    /// Counts colour images without a depth image of their name or number.
    fn leave_out_without_depth(&mut self, count: usize) {
        self.left_out.without_depth = count;
        if count > 0 {
            self.warnings.push(format!(
                "{} left out: no depth image of that name or number",
                counted(count, "colour image")
            ));
        }
    }
}

/// `1 frame`, `3 frames`: for words that take an s.
pub(crate) fn counted(count: usize, word: &str) -> String {
    format!("{count} {word}{}", if count == 1 { "" } else { "s" })
}

/// A recognised sequence.
pub(crate) enum Source {
    Tum,
    Eth3d(PathBuf),
    ScanNet(scannet::Folders),
    Sens(sens::Stream),
    Replica(replica::Folders),
    SevenScenes,
    Nerfstudio(Scene),
    Plain(plain::Folders),
    Video,
}

impl Source {
    /// Finds out what lies in `path`, an existing folder, `.sens` file or video.
    ///
    /// With `colour_only` also what has no depth, if nothing with depth fits.
    pub(crate) fn recognise(path: &Path, colour_only: bool) -> Result<Self, DatasetError> {
        let found = Self::with_depth(path)?;
        let found = match found {
            None if colour_only => Self::without_depth(path)?,
            found => found,
        };
        found.ok_or_else(|| {
            let found = contents(path);
            let has_colour = matches!(Self::without_depth(path), Ok(Some(_)));
            DatasetError::UnknownLayout { path: path.to_path_buf(), found, has_colour }
        })
    }

    /// Whether the sequence has no depth at all.
    pub(crate) fn is_video(&self) -> bool {
        matches!(self, Self::Video)
    }

    fn with_depth(path: &Path) -> Result<Option<Self>, DatasetError> {
        if is_video(path) {
            return Ok(Some(Self::Video));
        }
        if path.is_file() {
            return sens::Stream::open(path).map(Self::Sens).map(Some);
        }
        if let Some(file) = nerfstudio::find(path) {
            return Scene::open(&file, true).map(Self::Nerfstudio).map(Some);
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
            return sens::Stream::open(&file).map(Self::Sens).map(Some);
        }
        if associated::has_lists(path) {
            return Ok(Some(eth3d::find(path).map_or(Self::Tum, Self::Eth3d)));
        }
        Ok(plain::find(path).map(Self::Plain))
    }

    fn without_depth(path: &Path) -> Result<Option<Self>, DatasetError> {
        let transforms = path.join("transforms.json");
        if transforms.is_file() {
            return Scene::open(&transforms, false).map(Self::Nerfstudio).map(Some);
        }
        if associated::has_colour_list(path) {
            return Ok(Some(eth3d::find(path).map_or(Self::Tum, Self::Eth3d)));
        }
        Ok(plain::find_colour(path).map(Self::Plain))
    }

    /// What the layout says of every sequence of its kind.
    pub(crate) fn traits(&self) -> Traits {
        match self {
            Self::ScanNet(_) => scannet::TRAITS,
            Self::Sens(stream) => stream.traits(),
            Self::Replica(_) => replica::TRAITS,
            Self::SevenScenes => seven_scenes::TRAITS,
            Self::Nerfstudio(scene) => scene.traits(),
            Self::Tum | Self::Eth3d(_) | Self::Plain(_) | Self::Video => Traits::default(),
        }
    }

    /// The camera that the sequence's own files (or its publishers) tell of.
    pub(crate) fn calibration(&self) -> Result<Option<Calibration>, DatasetError> {
        match self {
            Self::Tum | Self::Plain(_) | Self::Video => Ok(None),
            Self::Eth3d(file) => eth3d::calibration(file).map(Some),
            Self::ScanNet(folders) => scannet::calibration(folders).map(Some),
            Self::Sens(stream) => stream.calibration().map(Some),
            Self::Replica(folders) => replica::calibration(folders).map(Some),
            Self::SevenScenes => Ok(Some(seven_scenes::calibration())),
            Self::Nerfstudio(scene) => scene.calibration().map(Some),
        }
    }

    /// Lists the frames. `frame_rate` [1/s] gives stamps to frames that carry none.
    pub(crate) fn list(
        &self,
        path: &Path,
        options: &OpenOptions,
        frame_rate: f64,
    ) -> Result<Listing, DatasetError> {
        match self {
            Self::Tum => associated::list(path, Layout::Tum, options),
            Self::Eth3d(_) => associated::list(path, Layout::Eth3d, options),
            Self::ScanNet(folders) => scannet::list(folders, options, frame_rate),
            Self::Sens(stream) => stream.list(options, frame_rate),
            Self::Replica(folders) => replica::list(folders, frame_rate),
            Self::SevenScenes => seven_scenes::list(path, frame_rate),
            Self::Nerfstudio(scene) => scene.list(frame_rate),
            Self::Plain(folders) => plain::list(path, folders, options, frame_rate),
            Self::Video => Video::list(path, options, frame_rate),
        }
    }
}

/// The first names in a folder, for an error message.
pub(crate) fn contents(folder: &Path) -> String {
    if folder.is_file() {
        return "a file of another kind".into();
    }
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    match names.len() {
        0 => "an empty folder".into(),
        1..=8 => names.join(", "),
        count => format!("{}, ... ({count} in all)", names[..8].join(", ")),
    }
}
