//! The frames of a sequence before any image is read.

use super::Layout;
use crate::file_part::FilePart;
use crate::image::DepthEncoding;
use crate::text::counted;
use crate::video::Video;
use crate::{DepthPairing, OpenOptions};
use i2slam_geometry::{Pose, StampedPose};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Files and time stamps of one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameEntry {
    /// Index in the associated stream, before the choice by range and stride.
    pub index: usize,
    /// Index among all colour images, including those dropped from the associated stream.
    pub image_index: usize,
    /// Time stamp of the colour image [s].
    pub timestamp: f64,
    /// Colour image file, or the video.
    pub colour: PathBuf,
    /// Its depth image; `None` for a frame without.
    pub depth: Option<DepthEntry>,
    /// Parts of the files that are the images; `None`: each image is a whole file.
    pub parts: Option<FrameParts>,
}

/// File and time stamp of a depth image.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthEntry {
    /// Depth image file, or the video.
    pub path: PathBuf,
    /// Index among the depth pictures of a video; 0 for an image file.
    pub index: usize,
    /// Time stamp [s]; the colour image's where depth has none of its own.
    pub timestamp: f64,
    /// File of the confidence of every reading, where 0 is the least, or the archive with it.
    pub confidence: Option<PathBuf>,
}

impl DepthEntry {
    /// Depth of an image file with a time stamp [s].
    pub(super) fn of_file(path: PathBuf, timestamp: f64) -> Self {
        Self { path, index: 0, timestamp, confidence: None }
    }
}

/// Parts of a file that are the images of a frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameParts {
    /// Colour image.
    pub colour: FilePart,
    /// Depth image.
    pub depth: Option<FilePart>,
    /// Confidence of depth.
    pub confidence: Option<FilePart>,
}

impl FrameEntry {
    pub(crate) fn colour_part(&self) -> Option<&FilePart> {
        self.parts.as_ref().map(|parts| &parts.colour)
    }

    pub(crate) fn depth_path(&self) -> Option<&Path> {
        self.depth.as_ref().map(|depth| depth.path.as_path())
    }

    pub(crate) fn depth_part(&self) -> Option<&FilePart> {
        self.parts.as_ref()?.depth.as_ref()
    }

    pub(crate) fn confidence_part(&self) -> Option<&FilePart> {
        self.parts.as_ref()?.confidence.as_ref()
    }

    /// A frame whose depth, if any, has the colour's time stamp, both images whole files.
    pub(super) fn synchronous(
        (index, image_index): (usize, usize),
        timestamp: f64,
        colour: PathBuf,
        depth: Option<PathBuf>,
    ) -> Self {
        let depth = depth.map(|path| DepthEntry::of_file(path, timestamp));
        Self { index, image_index, timestamp, colour, depth, parts: None }
    }
}

/// Numbers of colour images that are not in the associated stream, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct DroppedFrames {
    /// No depth image within the tolerance, or of that name (only by
    /// [`DepthPairing::Nearest`](crate::DepthPairing::Nearest)).
    pub without_depth: usize,
    /// No ground-truth pose within the tolerance (only where the folder has ground truth).
    pub without_pose: usize,
    /// No more than the minimum gap after the last kept frame.
    pub too_close: usize,
}

/// The associated stream of a sequence.
#[derive(Debug)]
pub(crate) struct Listing {
    pub(crate) layout: Layout,
    /// All frames, in order of time.
    pub(crate) entries: Vec<FrameEntry>,
    pub(crate) dropped: DroppedFrames,
    /// Whether frames too close in time are dropped.
    pub(crate) is_thinned: bool,
    /// True if no time stamps are there, so that frames count as equally far apart.
    pub(crate) are_times_assumed: bool,
    /// Ground-truth file of the folder, not yet read.
    pub(crate) ground_truth: Option<PathBuf>,
    /// True poses that came with the frames.
    pub(crate) poses: Vec<StampedPose>,
    pub(crate) depth_encoding: DepthEncoding,
    /// Decoder of the images, if the sequence is a video.
    pub(crate) video: Option<Video>,
    pub(crate) warnings: Vec<String>,
}

impl Listing {
    /// Frames without ground truth or warnings.
    pub(crate) fn new(layout: Layout, entries: Vec<FrameEntry>) -> Self {
        Self {
            layout,
            entries,
            dropped: DroppedFrames::default(),
            is_thinned: false,
            are_times_assumed: false,
            ground_truth: None,
            poses: Vec::new(),
            depth_encoding: DepthEncoding::Png,
            video: None,
            warnings: Vec::new(),
        }
    }

    /// Sets the true pose of every frame, with a warning if some frames have none.
    pub(super) fn set_poses(&mut self, pose: impl Fn(usize, &FrameEntry) -> Option<Pose<f64>>) {
        let mut missing = 0;
        for (i, entry) in self.entries.iter().enumerate() {
            match pose(i, entry) {
                Some(world_from_camera) => {
                    self.poses.push(StampedPose { timestamp: entry.timestamp, world_from_camera });
                }
                None => missing += 1,
            }
        }
        if missing > 0 && !self.poses.is_empty() {
            let frames = counted(missing, "frame");
            self.warnings.push(format!("{frames} without a finite, rigid true pose"));
        }
    }

    /// Leaves out frames without depth if the options want depth of each; `lack` says what they lack.
    pub(super) fn keep_those_with_depth(&mut self, options: &OpenOptions, lack: &str) {
        if options.colour_only || options.depth_pairing != DepthPairing::Nearest {
            return;
        }
        let count = self.entries.len();
        self.entries.retain(|entry| entry.depth.is_some());
        self.entries.iter_mut().enumerate().for_each(|(index, entry)| entry.index = index);
        self.drop_without_depth(count - self.entries.len(), lack);
    }

    /// Counts colour images that were dropped for lack of a depth image, with a warning; `lack` says
    /// what they lack.
    pub(super) fn drop_without_depth(&mut self, count: usize, lack: &str) {
        self.dropped.without_depth = count;
        if count > 0 {
            self.warnings.push(format!("{} left out: {lack}", counted(count, "colour image")));
        }
    }

    /// Whether some frames have depth and others have none, as a warning.
    pub(crate) fn partial_depth_warning(&self) -> Option<String> {
        let with = self.entries.iter().filter(|entry| entry.depth.is_some()).count();
        (with > 0 && with < self.entries.len()).then(|| {
            format!(
                "{with} of {} have a depth image of their own, the others colour alone",
                counted(self.entries.len(), "frame")
            )
        })
    }
}
