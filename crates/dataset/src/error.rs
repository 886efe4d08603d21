//! The error type: what is wrong and where, what was expected, what to do.

use i2slam_storage::shortened;
use std::path::{Path, PathBuf};

/// Failure to read or write a sequence, a frame or a trajectory.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DatasetError {
    /// The path given is not a folder.
    #[error(
        "no file or folder {}: give a video, a .sens or .r3d file, or the folder of a sequence (with \
         rgb.txt and depth.txt, or colour/ and depth/)",
        path.display()
    )]
    MissingFolder {
        /// The path given.
        path: PathBuf,
    },
    /// The folder is there but holds none of the layouts.
    #[error(
        "{} {}: found {found}; expected one of{known}\n  or, for colour alone, a video or a folder of \
         pictures (JPEG, PNG, ...)",
        path.display(), no_sequence(*.has_colour)
    )]
    UnknownLayout {
        /// The folder.
        path: PathBuf,
        /// Description of what lies there.
        found: String,
        /// Whether there are pictures without depth.
        has_colour: bool,
        /// Known layouts, one per line.
        known: String,
    },
    /// One picture where a sequence is expected.
    #[error("{} is one picture: expected a folder of them, or a video", path.display())]
    OnePicture {
        /// The picture.
        path: PathBuf,
    },
    /// A folder of a video in place of the video.
    #[error("{} holds a video, and is no sequence itself: name the video, {}", path.display(), video.display())]
    FolderOfVideo {
        /// The folder.
        path: PathBuf,
        /// The first video in it, by name.
        video: PathBuf,
    },
    /// ffmpeg, which decodes and encodes videos, cannot be started.
    #[error(
        "a video needs the program ffmpeg, and {} cannot be started ({source}){}: \
         install it ({}), or set I2SLAM_FFMPEG to where it is",
        program.display(), if *.named { ", as I2SLAM_FFMPEG names it" } else { "" }, INSTALL
    )]
    NoFfmpeg {
        /// The program that could not be started.
        program: PathBuf,
        /// Whether the environment variable `I2SLAM_FFMPEG` named it.
        named: bool,
        /// The system's answer.
        source: std::io::Error,
    },
    /// A video, a folder, or a file that describes cameras, frames or poses, cannot be used.
    #[error("{}: {reason}", path.display())]
    File {
        /// The file or folder.
        path: PathBuf,
        /// Cause, and what was expected.
        reason: String,
    },
    /// A list, a folder or a trajectory without a single entry.
    #[error("{} is empty: expected {expected}", path.display())]
    Empty {
        /// The list, folder or trajectory.
        path: PathBuf,
        /// Expected contents.
        expected: &'static str,
    },
    /// No intrinsics: no `camera.json`, no flag, and the folder's name is no known sequence's.
    #[error("no camera for {}{}", path.display(), ways_to_name_a_camera(*is_video, causes))]
    NoCamera {
        /// The folder of the sequence, or the video.
        path: PathBuf,
        /// True for a video, beside which no `camera.json` is read.
        is_video: bool,
        /// Reasons why files with a camera were not used, each a clause.
        causes: Vec<String>,
    },
    /// One line of a text file cannot be used.
    #[error("{}, line {line}: {reason}", path.display())]
    Line {
        /// The text file.
        path: PathBuf,
        /// The line, counted from 1.
        line: usize,
        /// Cause, and what was expected.
        reason: String,
    },
    /// The path holds no keyframes of a known format.
    #[error(
        "{} holds no keyframes: found {found}; expected one of{known}",
        path.display()
    )]
    UnknownImport {
        /// The file or folder.
        path: PathBuf,
        /// Description of what lies there.
        found: String,
        /// Known formats, one per line.
        known: String,
    },
    /// An image file is damaged or of a kind that cannot be used.
    #[error("{}: {reason}", path.display())]
    Image {
        /// The image file.
        path: PathBuf,
        /// Cause, and what was expected.
        reason: String,
    },
    /// An image differs in size from the first frame or from the camera.
    #[error(
        "{} is {}x{} px, expected {}x{} as {reference}",
        path.display(), found.0, found.1, expected.0, expected.1
    )]
    Size {
        /// The image file.
        path: PathBuf,
        /// Its width and height [px].
        found: (usize, usize),
        /// The width and height expected [px].
        expected: (usize, usize),
        /// Description of the reference.
        reference: String,
    },
    /// Images taken with different cameras.
    #[error("{} was not taken as {}: {reason}", path.display(), first.display())]
    OtherCamera {
        /// The image that differs.
        path: PathBuf,
        /// The image it differs from.
        first: PathBuf,
        /// The difference, and what to do.
        reason: String,
    },
    /// An option outside its range.
    #[error("option {name}: {reason}")]
    Option {
        /// The field of [`OpenOptions`](crate::OpenOptions).
        name: &'static str,
        /// Cause, and what was expected.
        reason: String,
    },
    /// A frame index outside the sequence.
    #[error("frame {position} asked for, but the sequence has {frames} frames")]
    NoSuchFrame {
        /// The requested index.
        position: usize,
        /// Number of frames.
        frames: usize,
    },
    /// A file could not be written whole.
    #[error(transparent)]
    Storage(#[from] i2slam_storage::StorageError),
    /// A file could not be read or written.
    #[error("cannot {action} {}: {source}", shortened(&path.display().to_string()))]
    Io {
        /// "read" or "write".
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// The system's answer.
        source: std::io::Error,
    },
}

impl DatasetError {
    /// Whether the error concerns a single frame, so that a run can skip it.
    pub fn concerns_one_frame(&self) -> bool {
        matches!(self, Self::Image { .. } | Self::Size { .. } | Self::Io { action: "read", .. })
    }

    pub(crate) fn read(path: &Path, source: std::io::Error) -> Self {
        Self::Io { action: "read", path: path.to_path_buf(), source }
    }

    pub(crate) fn write(path: &Path, source: std::io::Error) -> Self {
        Self::Io { action: "write", path: path.to_path_buf(), source }
    }

    pub(crate) fn image(path: &Path, reason: impl Into<String>) -> Self {
        Self::Image { path: path.to_path_buf(), reason: shortened(&reason.into()) }
    }

    pub(crate) fn option(name: &'static str, reason: impl Into<String>) -> Self {
        Self::Option { name, reason: reason.into() }
    }

    pub(crate) fn empty(path: &Path, expected: &'static str) -> Self {
        Self::Empty { path: path.to_path_buf(), expected }
    }

    pub(crate) fn file(path: &Path, reason: impl Into<String>) -> Self {
        Self::File { path: path.to_path_buf(), reason: shortened(&reason.into()) }
    }

    /// The error for an image of another size than expected, if it has one.
    pub(crate) fn check_size(
        path: &Path,
        found: (usize, usize),
        expected: (usize, usize),
        reference: &str,
    ) -> Result<(), Self> {
        if found == expected {
            return Ok(());
        }
        let (path, reference) = (path.to_path_buf(), reference.to_owned());
        Err(Self::Size { path, found, expected, reference })
    }

    pub(crate) fn line(path: &Path, line: usize, reason: impl Into<String>) -> Self {
        Self::Line { path: path.to_path_buf(), line, reason: shortened(&reason.into()) }
    }
}

/// Commands that install ffmpeg on this system.
const INSTALL: &str = if cfg!(target_os = "macos") {
    "`brew install ffmpeg`"
} else if cfg!(windows) {
    "`winget install ffmpeg`"
} else {
    "Debian and Ubuntu: `sudo apt install ffmpeg`, Fedora: `sudo dnf install ffmpeg-free`, Arch: \
     `sudo pacman -S ffmpeg`"
};

fn ways_to_name_a_camera(is_video: bool, causes: &[String]) -> String {
    if is_video {
        return ", which depth and given poses need: name its camera file (a camera.json beside a video is \
                not used), or give the four intrinsics or the field of view"
            .to_owned();
    }
    let mend_first: String = causes.iter().map(|cause| format!("{cause}; ")).collect();
    format!(
        ": {mend_first}put a camera.json there with fx, fy, cx, cy, width, height and depth_scale, name one, \
         or give the four intrinsics or the field of view (a folder named after freiburg1, freiburg2 or \
         freiburg3 needs none)"
    )
}

fn no_sequence(has_colour: bool) -> &'static str {
    match has_colour {
        true => "has pictures but no depth, so that it can be run by colour alone (--rgb)",
        false => "is no RGB-D sequence",
    }
}
