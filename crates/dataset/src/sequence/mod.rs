//! A sequence of RGB-D frames on disk.

use crate::alike::check_alike;
use crate::calibration::Calibration;
use crate::checks::{camera_warning, cover_warning, depth_scale_warning, recorded};
use crate::decode::image_size;
use crate::distortion::Distortion;
use crate::guess::{Told, orientation_note};
use crate::layouts::{Listing, Source};
use crate::prepare::Preparation;
use crate::resample::Recorded;
use crate::sizes::{delivered_size, resampled};
use crate::video::refused_stream;
use crate::{DatasetError, Frame, FrameStream, Layout, OpenOptions, read_trajectory};
use i2slam_geometry::{Camera, Image, Trajectory};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Frames a second where neither the camera file nor the stamps say.
pub(crate) const DEFAULT_FRAME_RATE: f64 = 30.0;

/// The two files of a frame; of a video, the file with all frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// Place in the associated stream, before the choice by range and stride.
    pub index: usize,
    /// Place among all colour images, also those that did not enter the associated stream.
    pub place: usize,
    /// Time stamp of the colour image [s].
    pub timestamp: f64,
    /// Time stamp of the depth image [s]; the colour's where depth has none of its own.
    pub depth_timestamp: f64,
    /// The colour image file.
    pub colour: PathBuf,
    /// The depth image file; `None` only in a sequence without depth images.
    pub depth: Option<PathBuf>,
    /// Where the images lie in their files; `None`: each is a whole file.
    pub parts: Option<Parts>,
}

/// Where the two images of a frame lie in one file [bytes].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Parts {
    /// The colour image.
    pub colour: Range<u64>,
    /// The depth image.
    pub depth: Range<u64>,
}

impl Entry {
    pub(crate) fn colour_part(&self) -> Option<&Range<u64>> {
        self.parts.as_ref().map(|parts| &parts.colour)
    }

    pub(crate) fn depth_part(&self) -> Option<&Range<u64>> {
        self.parts.as_ref().map(|parts| &parts.depth)
    }
}

/// How many colour images did not enter the associated stream, and why.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LeftOut {
    /// No depth image within the tolerance, or of that name.
    pub without_depth: usize,
    /// No ground-truth pose within the tolerance (only where the folder has ground truth).
    pub without_pose: usize,
    /// No more than the minimum gap after the last kept frame.
    pub too_close: usize,
}

/// An opened sequence: which frames there are and how they are delivered.
#[derive(Clone, Debug)]
pub struct Sequence {
    /// Name of the folder, or of the file.
    pub name: String,
    /// How it lies on disk.
    pub layout: Layout,
    /// Where the camera comes from: a file, a flag or a name, in words.
    pub camera_source: String,
    /// Whether nobody gave the camera, so that its focal length is to be looked for.
    pub camera_is_guess: bool,
    /// Width and height of the recorded colour pictures, before crop and scale [px].
    pub recorded_size: (usize, usize),
    /// Pinhole camera of the delivered frames: lens removed, cropped, scaled.
    pub camera: Camera<f64>,
    /// Median frames a second of the associated stream (not divided by the stride).
    pub frame_rate: f64,
    /// Depth image value of one metre.
    pub depth_scale: f64,
    /// The frames chosen, in order of time.
    pub entries: Vec<Entry>,
    /// What did not enter the associated stream.
    pub left_out: LeftOut,
    /// The folder's `groundtruth.txt` (or `pose.txt`), for
    /// [`read_trajectory`](crate::read_trajectory).
    pub ground_truth: Option<PathBuf>,
    /// True poses `world_from_camera` that came with the frames themselves, at their times; empty
    /// for layouts that have a ground-truth file. See [`true_trajectory`](Self::true_trajectory).
    pub poses: Trajectory,
    /// 1 plane at the delivered size, false where removing the lens distortion reached beyond
    /// the recorded picture: there depth is 0 and colour repeats the edge. `None`: all covered.
    pub covered: Option<Arc<Image<bool>>>,
    /// What a user should know before the run.
    pub warnings: Vec<String>,
    /// The cameras as they recorded.
    pub(crate) recorded: Recorded,
    pub(crate) lens: Distortion,
    pub(crate) preparation: Arc<Preparation>,
    /// Whether the layout leaves out frames too close in time ([`OpenOptions::minimum_gap`]).
    pub(crate) is_thinned: bool,
}

/// Whether a folder holds pictures, and no depth in any of the known layouts.
pub fn is_without_depth(path: &Path) -> bool {
    let found = Source::recognise(path, false);
    matches!(found, Err(DatasetError::UnknownLayout { has_colour: true, .. }))
}

impl Sequence {
    /// How it lies on disk, for people.
    pub fn layout_name(&self) -> &'static str {
        let has_depth = self.entries.iter().any(|entry| entry.depth.is_some());
        match self.layout {
            Layout::Plain if !has_depth => "folder of pictures",
            layout => layout.name(),
        }
    }

    /// Opens the sequence in a folder, in a `.sens` file, or a video. Reads lists, headers and a
    /// few depth images, no more; a video is decoded once.
    pub fn open(path: &Path, options: &OpenOptions) -> Result<Self, DatasetError> {
        options.validate()?;
        if let Some(refusal) = refused_stream(path) {
            return Err(refusal);
        }
        if !path.exists() {
            return Err(DatasetError::MissingFolder { path: path.to_path_buf() });
        }
        // A folder that is no sequence at all is worth saying before a missing camera.
        let source = Source::recognise(path, options.colour_only)?;
        Self::from_source(path, &source, options)
    }

    /// Opens what was recognised in `path`, under validated options.
    pub(crate) fn from_source(
        path: &Path,
        source: &Source,
        options: &OpenOptions,
    ) -> Result<Self, DatasetError> {
        let folder = if path.is_dir() { path } else { path.parent().unwrap_or(path) };
        let calibration = Calibration::find(folder, source, options);
        let assumed_rate = calibration.as_ref().ok().and_then(|c| c.frame_rate);
        let assumed_rate = assumed_rate.unwrap_or(DEFAULT_FRAME_RATE);
        let listing = source.list(path, options, assumed_rate)?;
        Self::of(name_of(path), listing, calibration?, options, assumed_rate)
    }

    /// Chooses the frames of a listing and prepares how they are delivered.
    pub(crate) fn of(
        name: String,
        listing: Listing,
        calibration: Calibration,
        options: &OpenOptions,
        assumed_rate: f64,
    ) -> Result<Self, DatasetError> {
        let frame_rate = median_rate(&listing.entries).unwrap_or(assumed_rate);
        let mut warnings = listing.warnings;
        let entries = choose(listing.entries, options, &mut warnings)?;
        let video = listing.video;
        let first = entries.first().filter(|_| video.is_none());
        let file = first.filter(|entry| entry.parts.is_none());
        let asked = file.and_then(|entry| Told::by(&entry.colour).orientation);
        let is_alone = listing.layout == Layout::Plain && first.is_some_and(|e| e.depth.is_none());
        let turns = options.turn_pictures && is_alone;
        let orientation = asked.filter(|_| turns).unwrap_or_default();
        let told = file.zip(asked.filter(|asked| !asked.is_none()));
        warnings.extend(told.map(|(entry, asked)| orientation_note(&entry.colour, asked, turns)));
        if file.is_some() && is_alone {
            warnings.extend(check_alike(&entries, orientation)?);
        }
        let calibration = calibration.asking(first.map(|entry| entry.colour.as_path()));
        let calibration = match first.filter(|_| !orientation.is_none()) {
            Some(entry) => {
                let stored = image_size(&entry.colour, entry.colour_part())?;
                orientation.calibration(calibration, stored)
            }
            None => calibration,
        };
        let shown = (orientation, video.as_ref());
        let recorded = recorded(&entries, &calibration, listing.depth_code, shown)?;
        let recorded_size = (recorded.colour.width, recorded.colour.height);
        let delivered = delivered_size(&recorded.grid, options)?;
        let lens = calibration.distortion;
        let (resampler, video) =
            resampled(&recorded, &lens, options.crop_border, delivered, video.as_ref());
        let preparation = Preparation {
            resampler,
            depth_scale: calibration.depth_scale,
            max_depth: options.max_depth.unwrap_or(f64::INFINITY),
            depth_code: listing.depth_code,
            invalid_depth: calibration.invalid_depth,
            colour_only: options.colour_only,
            orientation,
            video,
        };
        warnings.extend(camera_warning(&recorded, &calibration.source));
        warnings.extend(depth_scale_warning(&entries, &preparation));
        warnings.extend(cover_warning(&preparation.resampler));
        Ok(Self {
            name,
            layout: listing.layout,
            camera_source: calibration.source,
            camera_is_guess: calibration.is_guess,
            recorded_size,
            camera: preparation.resampler.camera,
            frame_rate,
            depth_scale: calibration.depth_scale,
            entries,
            left_out: listing.left_out,
            ground_truth: listing.ground_truth,
            poses: listing.poses,
            covered: preparation.resampler.covered.clone().map(Arc::new),
            warnings,
            recorded,
            lens,
            preparation: Arc::new(preparation),
            is_thinned: listing.is_thinned,
        })
    }

    /// The true poses `world_from_camera`, in order of time: those of the ground-truth file, else
    /// those that came with the frames. Empty where there is neither; an error where the file
    /// cannot be read.
    pub fn true_trajectory(&self) -> Result<Trajectory, DatasetError> {
        self.ground_truth.as_ref().map_or_else(|| Ok(self.poses.clone()), read_trajectory)
    }

    /// Reads the frame at a place of [`entries`](Self::entries).
    pub fn load(&self, position: usize) -> Result<Frame, DatasetError> {
        let frames = self.entries.len();
        let entry =
            self.entries.get(position).ok_or(DatasetError::NoSuchFrame { position, frames })?;
        self.preparation.load(entry)
    }

    /// Number of frames chosen.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether there is no frame; an opened sequence has at least one.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// All frames in order, read ahead on another thread. A frame that cannot be read is an
    /// `Err` item, and the stream goes on behind it.
    pub fn stream(&self) -> FrameStream {
        FrameStream::start(self.entries.clone(), Arc::clone(&self.preparation))
    }
}

pub(crate) fn name_of(path: &Path) -> String {
    let whole = path.canonicalize().unwrap_or_else(|_| path.to_path_buf());
    let name = if whole.is_file() { whole.file_stem() } else { whole.file_name() };
    name.map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
}

/// The median of the frame rates between neighbours [1/s].
fn median_rate(entries: &[Entry]) -> Option<f64> {
    let gaps = entries.windows(2).map(|pair| pair[1].timestamp - pair[0].timestamp);
    let mut gaps: Vec<f64> = gaps.filter(|&gap| gap > 0.0).collect();
    gaps.sort_by(f64::total_cmp);
    gaps.get(gaps.len() / 2).map(|gap| gap.recip())
}

/// The entries within the range, every `stride`-th.
fn choose(
    entries: Vec<Entry>,
    options: &OpenOptions,
    warnings: &mut Vec<String>,
) -> Result<Vec<Entry>, DatasetError> {
    let count = entries.len();
    let range = options.frames.clone().unwrap_or(0..count);
    if range.start >= range.end.min(count) {
        let reason = format!(
            "{}..{} holds no frame: the sequence has the frames 0..{count}",
            range.start, range.end
        );
        return Err(DatasetError::Option { name: "frames", reason });
    }
    if range.end > count {
        warnings.push(format!(
            "frames {}..{} asked for, the sequence ends at {count}",
            range.start, range.end
        ));
    }
    let (start, end) = (range.start, range.end.min(count));
    Ok(entries.into_iter().take(end).skip(start).step_by(options.stride).collect())
}
