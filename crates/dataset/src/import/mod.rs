//! Keyframes of other programs: pictures with poses, and with depth and its variance where the
//! files have them.
//!
//! [`Files::open`] recognises the [`Kind`] by the files. Pictures are delivered as those of a
//! [`Sequence`]: lens removed, cropped, scaled. Poses become `world_from_camera`
//! with OpenCV's camera axes, whatever the files hold. See docs/import.md for each kind.
//!
//! ```no_run
//! use i2slam_dataset::import::{Files, Options};
//! let pictures = "rgbd_dataset_freiburg1_desk".as_ref();
//! let files = Files::open("keyframes.txt".as_ref(), Some(pictures), &Options::default())?;
//! for place in 0..files.len() {
//!     let keyframe = files.load(place)?;
//!     println!("{} {:?}", keyframe.timestamp, keyframe.world_from_camera.translation);
//! }
//! # Ok::<(), i2slam_dataset::DatasetError>(())
//! ```

mod archive;
mod colmap;
mod conventions;
mod droid;
mod inverse_depth;
mod join;
mod keyframe;
mod kind;
mod nerfstudio;
mod npy;
mod options;
mod pictures;
mod placed;
mod sparse;
mod trajectory;
mod variance;

pub(crate) use colmap::camera_of as colmap_camera;
pub use keyframe::{Keyframe, KeyframePose};
pub use kind::Kind;
pub use options::{Depth, Options};
pub use placed::LeftOut;

use crate::{DatasetError, Sequence};
use i2slam_geometry::Camera;
use keyframe::Source;
use kind::Recognised;
use placed::Found;
use std::path::{Path, PathBuf};

/// Opened keyframes: which there are and how they are delivered.
#[derive(Clone, Debug)]
pub struct Files {
    /// How they lie on disk.
    pub kind: Kind,
    /// The file or folder that the poses come from.
    pub path: PathBuf,
    /// Where the camera comes from: a file, a flag or a name, in words.
    pub camera_source: String,
    /// Pinhole camera of the delivered pictures and depths.
    pub camera: Camera<f64>,
    /// Median frames a second of all pictures of a sequence, keyframes or not; 30 where they come
    /// with the poses, in one file, whose stamps are those of keyframes alone.
    pub frame_rate: f64,
    /// The keyframes, in order of time.
    pub keyframes: Vec<KeyframePose>,
    /// What is no keyframe, and why.
    pub left_out: LeftOut,
    /// Whether keyframes come with depth.
    pub has_depth: bool,
    /// Whether depth comes with a variance.
    pub has_variance: bool,
    /// What is odd about the files, a sentence each.
    pub warnings: Vec<String>,
    source: Source,
}

impl Files {
    /// Opens the keyframes of a file or folder.
    ///
    /// `pictures` is a sequence in any layout, or a folder of pictures; `None` (or `path` again):
    /// beside the poses, or in the same file. nerfstudio's file names its pictures itself.
    pub fn open(
        path: &Path,
        pictures: Option<&Path>,
        options: &Options,
    ) -> Result<Self, DatasetError> {
        options.open.validate()?;
        if options.frames_per_stamp == 0 {
            let reason = "expected 1 or more, got 0".into();
            return Err(DatasetError::Option { name: "frames_per_stamp", reason });
        }
        let other = pictures.filter(|&pictures| pictures != path);
        let mut found = match Recognised::in_path(path)? {
            Recognised::Nerfstudio(file) => nerfstudio::open(&file, other, options)?,
            Recognised::Colmap(model) => colmap::open(&model, other, options)?,
            Recognised::Droid(path) => droid::open(&path, other, options)?,
            Recognised::Trajectory(file) => trajectory::open(&file, other, options)?,
        };
        placed::leave_out_missing_files(&mut found);
        placed::thin(&mut found, options.open.minimum_gap);
        found.warnings.extend(found.ignored(options));
        let mut files = Self::of(found, options);
        files.check_count(pictures)?;
        if options.check_conventions {
            files.warnings.extend(conventions::warning(&files));
        }
        Ok(files)
    }

    fn of(found: Found, options: &Options) -> Self {
        let Found { kind, path, source, mut keyframes, left_out, warnings } = found;
        let open = &options.open;
        let first = open.frames.as_ref().map_or(0, |frames| frames.start);
        keyframes.retain(|keyframe| {
            open.frames.as_ref().is_none_or(|frames| frames.contains(&keyframe.index))
                && (keyframe.index - first).is_multiple_of(open.stride)
        });
        Self {
            kind,
            path,
            camera_source: source.camera_source(),
            camera: source.camera(),
            frame_rate: source.frame_rate(),
            keyframes,
            left_out,
            has_depth: source.has_depth(),
            has_variance: source.has_variance(),
            warnings,
            source,
        }
    }

    /// Two keyframes are the least that can be compared.
    fn check_count(&self, pictures: Option<&Path>) -> Result<(), DatasetError> {
        if self.len() >= 2 {
            return Ok(());
        }
        let poses = self.left_out.poses_without_picture + self.left_out.with_picture;
        let chosen = self.left_out.with_picture >= 2;
        let reason = if chosen {
            let (with, len) = (self.left_out.with_picture, self.len());
            format!("{with} have a picture, and frames and stride choose {len} of these")
        } else {
            self.left_out.reason.clone()
        };
        Err(DatasetError::TooFewKeyframes {
            path: self.path.clone(),
            pictures: pictures.unwrap_or(&self.path).to_path_buf(),
            keyframes: self.len(),
            poses,
            reason,
        })
    }

    /// Reads a keyframe with its picture.
    ///
    /// An error concerns this keyframe alone where [`DatasetError::concerns_one_frame`] says so.
    pub fn load(&self, place: usize) -> Result<Keyframe, DatasetError> {
        let frames = self.len();
        let pose = self.keyframes.get(place);
        let pose = pose.ok_or(DatasetError::NoSuchFrame { position: place, frames })?;
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

    /// The same keyframes with pictures whose longer side is `side` [px], see
    /// [`Sequence::at_least`]; those that come with the poses, in one file, stay as they are.
    #[must_use]
    pub fn at_least(&self, side: usize) -> Self {
        let source = self.source.at_least(side);
        Self { camera: source.camera(), source, ..self.clone() }
    }

    /// The sequence that the pictures come from; `None` if they come with the poses, in one file.
    pub fn sequence(&self) -> Option<&Sequence> {
        self.source.sequence()
    }
}
