//! Keyframes of other programs: images with poses, and with depth and its variance if available.
//!
//! [`ImportedKeyframes::open`] recognises the [`ImportFormat`] by the files. Images are delivered as
//! those of a [`Sequence`]: undistorted, cropped, scaled. Poses become `world_from_camera` with
//! OpenCV's camera axes, whatever the convention of the files. See docs/import.md for each format.
//!
//! ```no_run
//! use i2slam_dataset::import::{ImportOptions, ImportedKeyframes};
//! let pictures = "rgbd_dataset_freiburg1_desk".as_ref();
//! let keyframes = ImportedKeyframes::open("keyframes.txt".as_ref(), Some(pictures), &ImportOptions::default())?;
//! for index in 0..keyframes.len() {
//!     let keyframe = keyframes.load(index)?;
//!     println!("{} {:?}", keyframe.timestamp, keyframe.world_from_camera.translation);
//! }
//! # Ok::<(), i2slam_dataset::DatasetError>(())
//! ```

mod colmap;
mod depth_variance;
mod droid;
mod format;
mod inverse_depth;
mod pose_convention;
mod posed_images;
mod source;
mod sparse_depth;

pub use format::ImportFormat;
pub use posed_images::UnmatchedCounts;
pub use source::{Keyframe, KeyframePose};

use crate::{DatasetError, OpenOptions, Sequence};
use format::DetectedFormat;
use i2slam_geometry::Camera;
use posed_images::ReadKeyframes;
use source::KeyframeSource;
use std::path::{Path, PathBuf};

/// Source of the depth of imported keyframes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ImportDepth {
    /// No depth.
    None,
    /// Depth in the imported files, if any.
    #[default]
    Imported,
    /// Depth images of the sequence.
    Pictures,
}

/// Options for importing keyframes. Start from [`ImportOptions::default`].
#[derive(Clone, Debug, PartialEq)]
pub struct ImportOptions {
    /// Options for opening the images. `association_tolerance` also bounds the distance in time
    /// between a pose and its image. `frames`, `stride` and `minimum_gap` (default 0 here) select
    /// images, and thereby keyframes, with the indices of the dataset opened alike. `colour_only` is
    /// ignored.
    pub open: OpenOptions,
    /// Source of depth.
    pub depth: ImportDepth,
    /// Folder with the variance of the depth images, matched by name or number to these or to the
    /// colour images: `.npy` arrays of the variance [m²], or 16-bit PNG of the standard deviation on
    /// the scale of the depth images.
    pub variance: Option<PathBuf>,
    /// Whether to compare depths and poses of some neighbours and warn of wrong pose conventions.
    /// Default true.
    pub check_conventions: bool,
    /// Whether images in arrays have channels R, G, B rather than B, G, R. Default `None`: by the
    /// name of the array, `images` of DROID-SLAM (B, G, R) or `cam0_images` of NeRF-SLAM (R, G, B).
    pub arrays_are_rgb: Option<bool>,
    /// Colour images of the sequence per step of whole-number time stamps: the stride of the program
    /// that wrote them (`--stride` of DROID-SLAM's `demo.py`, by default 3); at least 1. Default 1.
    pub frames_per_stamp: usize,
}

impl Default for ImportOptions {
    fn default() -> Self {
        Self {
            open: OpenOptions { minimum_gap: 0.0, ..OpenOptions::default() },
            depth: ImportDepth::default(),
            variance: None,
            check_conventions: true,
            arrays_are_rgb: None,
            frames_per_stamp: 1,
        }
    }
}

/// Opened keyframes of another program.
#[derive(Clone, Debug)]
pub struct ImportedKeyframes {
    /// Format on disk.
    pub format: ImportFormat,
    /// File or folder of the poses.
    pub path: PathBuf,
    /// Source of the camera for messages: a file, a flag or a dataset name.
    pub camera_source: String,
    /// Pinhole camera of the delivered images and depths.
    pub camera: Camera<f64>,
    /// Median frames a second of all images, keyframes or not; 30 where images come with the poses in
    /// one file, whose time stamps are those of keyframes alone.
    pub frame_rate: f64,
    /// The keyframes, in order of time.
    pub keyframes: Vec<KeyframePose>,
    /// Counts of poses and images that are no keyframes.
    pub unmatched: UnmatchedCounts,
    /// Whether keyframes have depth.
    pub has_depth: bool,
    /// Whether depth has a variance.
    pub has_variance: bool,
    /// True if depth is that of a few points alone.
    pub has_sparse_depth: bool,
    /// Warnings for the user, a sentence each.
    pub warnings: Vec<String>,
    source: KeyframeSource,
}

/// Path of the file with the camera of keyframes, if it is a file of its own that a sequence can be
/// opened with ([`OpenOptions::camera`]): that of COLMAP and of nerfstudio.
pub fn camera_file(keyframes: &Path) -> Option<PathBuf> {
    match DetectedFormat::detect(keyframes).ok()? {
        DetectedFormat::Colmap(model) => Some(model.file("cameras")),
        DetectedFormat::Nerfstudio(file) => Some(file),
        DetectedFormat::Droid(_) | DetectedFormat::Trajectory(_) => None,
    }
}

impl ImportedKeyframes {
    /// Opens the keyframes of a file or folder.
    ///
    /// `pictures` is a sequence in any layout or a folder of images; `None` (or `path` again): beside
    /// the poses, or in the same file. nerfstudio's file names its images itself.
    pub fn open(
        path: &Path,
        pictures: Option<&Path>,
        options: &ImportOptions,
    ) -> Result<Self, DatasetError> {
        options.open.validate()?;
        if options.frames_per_stamp == 0 {
            return Err(DatasetError::option("frames_per_stamp", "expected 1 or more, got 0"));
        }
        let other = pictures.filter(|&pictures| pictures != path);
        let mut found = match DetectedFormat::detect(path)? {
            DetectedFormat::Nerfstudio(file) => {
                posed_images::open_nerfstudio(&file, other, options)?
            }
            DetectedFormat::Colmap(model) => colmap::open(&model, other, options)?,
            DetectedFormat::Droid(path) => droid::open(&path, other, options)?,
            DetectedFormat::Trajectory(file) => {
                posed_images::open_trajectory(&file, other, options)?
            }
        };
        posed_images::drop_missing_files(&mut found);
        posed_images::thin(&mut found, options.open.minimum_gap);
        found.warnings.extend(found.ignored_options(options));
        let mut keyframes = Self::select(found, options);
        keyframes.check_count(pictures)?;
        if options.check_conventions {
            keyframes.warnings.extend(pose_convention::convention_warning(&keyframes));
        }
        Ok(keyframes)
    }

    /// Selects the keyframes within range and stride.
    fn select(found: ReadKeyframes, options: &ImportOptions) -> Self {
        let ReadKeyframes { format, path, source, mut keyframes, unmatched, warnings } = found;
        let open = &options.open;
        let first = open.frames.as_ref().map_or(0, |frames| frames.start);
        keyframes.retain(|keyframe| {
            open.frames.as_ref().is_none_or(|frames| frames.contains(&keyframe.index))
                && (keyframe.index - first).is_multiple_of(open.stride)
        });
        Self {
            format,
            path,
            camera_source: source.camera_source(),
            camera: source.camera(),
            frame_rate: source.frame_rate(),
            keyframes,
            unmatched,
            has_depth: source.has_depth(),
            has_variance: source.has_variance(),
            has_sparse_depth: source.has_sparse_depth(),
            warnings,
            source,
        }
    }

    /// An error for fewer than two keyframes.
    fn check_count(&self, pictures: Option<&Path>) -> Result<(), DatasetError> {
        if self.len() >= 2 {
            return Ok(());
        }
        let poses = self.unmatched.poses_without_image + self.unmatched.with_image;
        let chosen = self.unmatched.with_image >= 2;
        let reason = if chosen {
            let (with, len) = (self.unmatched.with_image, self.len());
            format!("{with} have a picture, and frames and stride choose {len} of these")
        } else {
            self.unmatched.reason.clone()
        };
        let (keyframes, pictures) = (self.len(), pictures.unwrap_or(&self.path).display());
        let reason = format!(
            "{keyframes} of {poses} poses are keyframes with a picture in {pictures}, expected at \
             least 2: {reason}"
        );
        Err(DatasetError::file(&self.path, reason))
    }

    /// Reads a keyframe with its image.
    ///
    /// An error concerns this keyframe alone if [`DatasetError::concerns_one_frame`] says so.
    pub fn load(&self, index: usize) -> Result<Keyframe, DatasetError> {
        let frames = self.len();
        let pose = self.keyframes.get(index);
        let pose = pose.ok_or(DatasetError::NoSuchFrame { position: index, frames })?;
        self.source.load(pose)
    }

    /// Number of keyframes; an opened import has at least two.
    pub fn len(&self) -> usize {
        self.keyframes.len()
    }

    /// Whether there is no keyframe.
    pub fn is_empty(&self) -> bool {
        self.keyframes.is_empty()
    }

    /// Enlarges images to a longer side of `side` [px], see [`Sequence::at_least`]; those that come
    /// with the poses in one file stay as they are.
    #[must_use]
    pub fn at_least(&self, side: usize) -> Self {
        let source = self.source.at_least(side);
        Self { camera: source.camera(), source, ..self.clone() }
    }

    /// The sequence of the images; `None` if they come with the poses in one file.
    pub fn sequence(&self) -> Option<&Sequence> {
        self.source.sequence()
    }
}
