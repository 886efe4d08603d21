//! Opened sequences: which frames there are, their camera, and how frames are loaded.

mod black_bars;
mod checks;
mod delivery;
mod exif_consistency;
mod find_calibration;
mod frames;
mod live;
mod live_pairing;

pub use frames::{DepthPicture, Frame, FrameStream};
pub use live::{LiveFrameStream, LiveSequence, RecordedSequence};

pub(crate) use delivery::delivered_size;

use crate::camera::{Calibration, Distortion, ExifHints};
use crate::formats::{DetectedLayout, DroppedFrames, FrameEntry, Layout, Listing, read_trajectory};
use crate::image::{RecordingCameras, image_size};
use crate::video::{is_stream, is_video, refused_stream};
use crate::{DatasetError, OpenOptions};
use black_bars::black_bars_warning;
use checks::{
    assumed_scale_warning, camera_warning, coverage_warning, depth_scale_warning, recording_cameras,
};
use delivery::delivery;
use exif_consistency::{check_exif_consistency, orientation_note};
use find_calibration::find_calibration;
use frames::FrameLoader;
use i2slam_compute::median;
use i2slam_geometry::{Camera, Image, Trajectory};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Frames a second where neither the camera file nor the time stamps tell.
pub(crate) const DEFAULT_FRAME_RATE: f64 = 30.0;

/// An opened sequence of frames.
#[derive(Clone, Debug)]
pub struct Sequence {
    /// Name of the folder or file.
    pub name: String,
    /// Format on disk.
    pub layout: Layout,
    /// Source of the camera for messages: a file, a flag or a dataset name.
    pub camera_source: String,
    /// Whether the camera is assumed, so that its focal length should be estimated.
    pub camera_is_guess: bool,
    /// Width and height of recorded colour images, before crop and scale [px].
    pub recorded_size: (usize, usize),
    /// Pinhole camera of the delivered frames: lens removed, cropped, scaled.
    pub camera: Camera<f64>,
    /// Median frames a second of the associated stream (not divided by the stride).
    pub frame_rate: f64,
    /// True if neither time stamps nor a frame rate were recorded, so that frames count as
    /// 30 a second.
    pub are_times_assumed: bool,
    /// Depth image value of one metre.
    pub depth_scale: f64,
    /// True where neither the format nor a file nor the user gives it.
    pub is_depth_scale_assumed: bool,
    /// The chosen frames, in order of time.
    pub entries: Vec<FrameEntry>,
    /// Counts of colour images that are not in the associated stream.
    pub dropped: DroppedFrames,
    /// The folder's `groundtruth.txt` (or `pose.txt`), for
    /// [`read_trajectory`].
    pub ground_truth: Option<PathBuf>,
    /// True poses `world_from_camera` that came with the frames themselves, at their times; empty
    /// for layouts that have a ground-truth file. See [`true_trajectory`](Self::true_trajectory).
    pub poses: Trajectory,
    /// 1 plane at the delivered size, false where undistortion reaches beyond the recorded image:
    /// there depth is 0 and colour repeats the edge. `None`: all pixels are valid.
    pub valid_mask: Option<Arc<Image<bool>>>,
    /// Warnings for the user, a sentence each.
    pub warnings: Vec<String>,
    pub(crate) cameras: RecordingCameras,
    pub(crate) lens: Distortion,
    pub(crate) loader: Arc<FrameLoader>,
    /// Whether frames too close in time are dropped ([`OpenOptions::minimum_gap`]).
    pub(crate) is_thinned: bool,
}

/// True for a folder of images without depth in any known layout, for a video file without a depth track, and
/// for a recording of Record3D without depth.
pub fn is_without_depth(path: &Path) -> bool {
    if is_video(path) && !is_stream(path) {
        return !crate::video::has_depth_track(path);
    }
    match DetectedLayout::detect(path, false) {
        Ok(found) => found.lacks_depth(),
        Err(error) => matches!(error, DatasetError::UnknownLayout { has_colour: true, .. }),
    }
}

impl Sequence {
    /// Name of the format on disk, for users.
    pub fn layout_name(&self) -> &'static str {
        match self.layout {
            Layout::Plain if self.frames_with_depth() == 0 => "folder of pictures",
            layout => layout.name(),
        }
    }

    /// Transfer function of a video of high dynamic range, HLG or PQ, whose pictures are converted.
    pub fn high_dynamic_range(&self) -> Option<&'static str> {
        Some(self.loader.video.as_ref()?.transfer()?.name())
    }

    /// Opens a folder, a `.sens` or `.r3d` file or a video. Reads lists, headers and a few depth images only;
    /// a video is decoded once.
    pub fn open(path: &Path, options: &OpenOptions) -> Result<Self, DatasetError> {
        options.validate()?;
        if let Some(refusal) = refused_stream(path) {
            return Err(refusal);
        }
        if !path.exists() {
            return Err(DatasetError::MissingFolder { path: path.to_path_buf() });
        }
        check_kind(path)?;
        // Detected first: that a folder holds no sequence matters more than a missing camera.
        let layout = DetectedLayout::detect(path, options.colour_only)?;
        Self::from_layout(path, &layout, options)
    }

    /// Opens a detected layout with validated options.
    pub(crate) fn from_layout(
        path: &Path,
        layout: &DetectedLayout,
        options: &OpenOptions,
    ) -> Result<Self, DatasetError> {
        let options = &layout.with_usual_options(options);
        let calibration = find_calibration(path, layout, options);
        let assumed_rate = calibration.as_ref().ok().and_then(|c| c.format.frame_rate);
        let is_rate_given = assumed_rate.is_some();
        let assumed_rate = assumed_rate.unwrap_or(DEFAULT_FRAME_RATE);
        let mut listing = layout.list(path, options, assumed_rate)?;
        listing.are_times_assumed &= !is_rate_given;
        Self::from_listing(name_of(path), listing, calibration?, options, assumed_rate)
    }

    /// Chooses the frames of a listing and prepares their loading.
    pub(crate) fn from_listing(
        name: String,
        listing: Listing,
        calibration: Calibration,
        options: &OpenOptions,
        assumed_rate: f64,
    ) -> Result<Self, DatasetError> {
        let frame_rate = median_rate(&listing.entries).unwrap_or(assumed_rate);
        let partial_depth = listing.partial_depth_warning().filter(|_| !options.colour_only);
        let mut warnings = listing.warnings;
        warnings.extend(partial_depth);
        let entries = choose(listing.entries, options, &mut warnings)?;
        let video = listing.video;
        let first = entries.first().filter(|_| video.is_none());
        let file = first.filter(|entry| entry.parts.is_none());
        // Depth, poses and lists refer to images as stored, so only plain colour images are rotated.
        let exif = file.and_then(|entry| ExifHints::read(&entry.colour).orientation);
        let has_depth = entries.iter().any(|entry| entry.depth.is_some());
        let is_alone = listing.layout == Layout::Plain && !has_depth;
        let is_applied = options.turn_pictures && is_alone;
        let orientation = exif.filter(|_| is_applied).unwrap_or_default();
        let noted = file.zip(exif.filter(|exif| !exif.is_identity()));
        warnings
            .extend(noted.map(|(entry, exif)| orientation_note(&entry.colour, exif, is_applied)));
        if file.is_some() && is_alone {
            warnings.extend(check_exif_consistency(&entries, orientation)?);
        }
        let calibration = calibration.refined_by_exif(first.map(|entry| entry.colour.as_path()));
        let turned = first.filter(|_| !orientation.is_identity());
        let stored = turned.and_then(|e| image_size(&e.colour, e.colour_part()).ok());
        let calibration = match stored {
            Some(stored) => orientation.apply_to_calibration(calibration, stored),
            None => calibration,
        };
        let source = (orientation, video.as_ref());
        let cameras = recording_cameras(&entries, &calibration, listing.depth_encoding, source)?;
        let recorded_size = (cameras.colour.width, cameras.colour.height);
        let delivered = delivered_size(&cameras.grid, options)?;
        let lens = calibration.distortion;
        let (resampler, video) =
            delivery(&cameras, &lens, options.crop_border, delivered, video.as_ref());
        let loader = FrameLoader {
            resampler,
            depth_scale: calibration.format.depth_scale,
            max_depth: options.max_depth.unwrap_or(f64::INFINITY),
            depth_encoding: listing.depth_encoding,
            invalid_depth: calibration.format.invalid_depth,
            colour_only: options.colour_only,
            orientation,
            video,
        };
        warnings.extend(camera_warning(&cameras, &calibration.source));
        let is_read = has_depth && !options.colour_only;
        let assumed = is_read.then(|| assumed_scale_warning(&calibration.format)).flatten();
        warnings.extend(depth_scale_warning(&entries, &loader).or(assumed));
        warnings.extend(coverage_warning(&loader.resampler));
        warnings.extend(black_bars_warning(&entries, &loader, recorded_size));
        Ok(Self {
            name,
            layout: listing.layout,
            camera_source: calibration.source,
            camera_is_guess: calibration.is_guess,
            recorded_size,
            camera: loader.resampler.camera,
            frame_rate,
            depth_scale: calibration.format.depth_scale,
            is_depth_scale_assumed: calibration.format.is_scale_assumed,
            entries,
            dropped: listing.dropped,
            ground_truth: listing.ground_truth,
            poses: listing.poses,
            valid_mask: loader.resampler.valid_mask.clone().map(Arc::new),
            warnings,
            cameras,
            lens,
            loader: Arc::new(loader),
            is_thinned: listing.is_thinned,
            are_times_assumed: listing.are_times_assumed,
        })
    }

    /// True poses `world_from_camera` in order of time: of the ground-truth file, else those that came
    /// with the frames. Empty if there is neither; an error if the file cannot be read.
    pub fn true_trajectory(&self) -> Result<Trajectory, DatasetError> {
        self.ground_truth.as_ref().map_or_else(|| Ok(self.poses.clone()), read_trajectory)
    }

    /// Reads the frame at an index of [`entries`](Self::entries).
    pub fn load(&self, position: usize) -> Result<Frame, DatasetError> {
        let frames = self.entries.len();
        let entry =
            self.entries.get(position).ok_or(DatasetError::NoSuchFrame { position, frames })?;
        self.loader.load(entry)
    }

    /// Number of chosen frames that have a depth image, whether it is read or not.
    pub fn frames_with_depth(&self) -> usize {
        self.entries.iter().filter(|entry| entry.depth.is_some()).count()
    }

    /// Number of chosen frames.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether there is no frame; an opened sequence has at least one.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Iterates over all frames in order, read ahead on another thread. A frame that cannot be read
    /// is an `Err` item, and the stream continues.
    pub fn stream(&self) -> FrameStream {
        FrameStream::start(self.entries.clone(), Arc::clone(&self.loader))
    }
}

/// An error for anything that is neither a folder nor a regular file.
pub(crate) fn check_kind(path: &Path) -> Result<(), DatasetError> {
    if path.is_dir() {
        return Ok(());
    }
    i2slam_storage::open(path).map(drop).map_err(|e| DatasetError::read(path, e))
}

/// Name of a sequence: that of its folder, or of its file without extension.
pub(crate) fn name_of(path: &Path) -> String {
    let whole = path.canonicalize().unwrap_or_else(|_| path.to_path_buf());
    let name = if whole.is_file() { whole.file_stem() } else { whole.file_name() };
    name.map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Median frame rate between neighbours [1/s].
fn median_rate(entries: &[FrameEntry]) -> Option<f64> {
    let gaps = entries.windows(2).map(|pair| pair[1].timestamp - pair[0].timestamp);
    let mut gaps: Vec<f64> = gaps.filter(|&gap| gap > 0.0).collect();
    median(&mut gaps).map(f64::recip)
}

/// Selects the entries within the range, every `stride`-th.
fn choose(
    entries: Vec<FrameEntry>,
    options: &OpenOptions,
    warnings: &mut Vec<String>,
) -> Result<Vec<FrameEntry>, DatasetError> {
    let count = entries.len();
    let range = options.frames.clone().unwrap_or(0..count);
    if range.start >= range.end.min(count) {
        let reason = format!(
            "{}..{} holds no frame: the sequence has the frames 0..{count}",
            range.start, range.end
        );
        return Err(DatasetError::option("frames", reason));
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
