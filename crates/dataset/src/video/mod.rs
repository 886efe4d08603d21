//! Videos, decoded by the program `ffmpeg`.
//!
//! Opening a video decodes it once to count its frames and read their time stamps; images are then
//! piped from ffmpeg on demand ([`frame_reader`]), and nothing is written to disk.

mod allowed;
mod ffmpeg;
mod ffmpeg_log;
mod frame_reader;
mod live_frames;
mod recording;
mod timestamps;

use crate::DatasetError;
use crate::image::{MAX_PIXELS, image_from_rgb};
use crate::text::counted;
use ffmpeg::Ffmpeg;
use ffmpeg_log::FfmpegLog;
use frame_reader::FrameReader;
use i2slam_geometry::Image;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use timestamps::RepairedTimestamps;

pub(crate) use live_frames::LiveFrames;
pub use recording::{MAX_RECORDING_BYTES, is_stream};
pub(crate) use recording::{Recording, refused_stream};

/// File name extensions of videos.
const EXTENSIONS: [&str; 32] = [
    "mp4", "m4v", "mov", "qt", "mkv", "webm", "avi", "mpg", "mpeg", "m2v", "ts", "mts", "m2ts",
    "3gp", "3g2", "wmv", "asf", "flv", "ogv", "gif", "h264", "264", "h265", "hevc", "mjpeg",
    "mjpg", "y4m", "mxf", "vob", "insv", "lrv", "nut",
];

/// Filter that logs every frame, cropped first because only time stamps are of interest.
const LISTING_FILTER: &str = "crop=min(iw\\,32):min(ih\\,32),showinfo";

/// Difference between claimed and decoded length above which a video counts as cut off [s].
const CUT_OFF_SECONDS: f64 = 0.5;

/// Whether a path names a video, by its extension, or a [stream](is_stream).
pub fn is_video(path: &Path) -> bool {
    if is_stream(path) {
        return true;
    }
    let extension = path.extension().and_then(|e| e.to_str()).map(str::to_lowercase);
    extension.is_some_and(|extension| EXTENSIONS.contains(&extension.as_str())) && !path.is_dir()
}

/// A video whose frames are counted.
#[derive(Debug)]
pub(crate) struct Video {
    path: PathBuf,
    ffmpeg: Ffmpeg,
    /// Width and height [px] after the rotation that the file asks for, with square pixels.
    pub(crate) size: (usize, usize),
    reader: Mutex<Option<FrameReader>>,
    /// Width and height of delivered images [px].
    delivered: (usize, usize),
}

/// An opened video with the time stamps of its frames.
#[derive(Debug)]
pub(crate) struct VideoListing {
    pub(crate) video: Video,
    /// One for every frame [s], increasing.
    pub(crate) timestamps: Vec<f64>,
    pub(crate) warnings: Vec<String>,
}

impl Video {
    /// Counts the frames before `end`. `frame_rate` [1/s] spaces frames if there are no usable time
    /// stamps.
    pub(crate) fn open(
        path: &Path,
        end: Option<usize>,
        frame_rate: f64,
    ) -> Result<VideoListing, DatasetError> {
        Self::open_with(Ffmpeg::find(), path, end, frame_rate)
    }

    fn open_with(
        mut ffmpeg: Ffmpeg,
        path: &Path,
        end: Option<usize>,
        frame_rate: f64,
    ) -> Result<VideoListing, DatasetError> {
        let first = ffmpeg.read_log(path, "showinfo", Some(1))?;
        let size = image_size(path, &first)?;
        let log = ffmpeg.read_log(path, LISTING_FILTER, end)?;
        if log.frames.is_empty() {
            return Err(undecodable(path, &log));
        }
        // ffmpeg logs a few more frames than asked for before it ends.
        let all = log.frames.len();
        let count = end.map_or(all, |end| all.min(end));
        let mut warnings = Vec::new();
        let mut timestamps = match log.timestamps() {
            Some(RepairedTimestamps { seconds, repaired }) => {
                let listed = repaired.partition_point(|frame| *frame < count);
                warnings.extend(repair_warning(&repaired[..listed]));
                seconds
            }
            None => {
                let why = format!("no usable time stamps: {frame_rate} frames a second assumed");
                warnings.push(why);
                (0..count).map(|i| i as f64 / frame_rate).collect()
            }
        };
        timestamps.truncate(count);
        let is_whole = end.is_none_or(|end| all < end);
        warnings.extend(damage_warning(&log, &timestamps).filter(|_| is_whole));
        let (path, reader) = (path.to_path_buf(), Mutex::new(None));
        let video = Self { path, ffmpeg, size, reader, delivered: size };
        Ok(VideoListing { video, timestamps, warnings })
    }

    /// Whether the video lies at `path`.
    pub(crate) fn is_at(&self, path: &Path) -> bool {
        self.path == path
    }

    /// Changes the size of delivered images [px].
    pub(crate) fn with_size(&self, (width, height): (usize, usize)) -> Self {
        let (path, ffmpeg) = (self.path.clone(), self.ffmpeg.clone());
        let (delivered, reader) = ((width, height), Mutex::new(None));
        Self { path, ffmpeg, size: self.size, reader, delivered }
    }

    /// The frames of this video at the size of delivered images, while it is being recorded.
    pub(crate) fn follow(&self, recording: &Recording) -> Result<LiveFrames, DatasetError> {
        LiveFrames::start(&self.ffmpeg, &self.path, recording.is_complete(), self.delivered)
    }

    /// Decodes a frame: 3 planes R, G, B in [0, 1].
    pub(crate) fn decode(&self, number: usize) -> Result<Image<f32>, DatasetError> {
        let bytes = {
            let mut reader = self.reader.lock().unwrap_or_else(|poisoned| {
                // The decoder is in an unknown state: restart it.
                let mut reader = poisoned.into_inner();
                *reader = None;
                reader
            });
            let new = || FrameReader::new(self.ffmpeg.clone(), self.delivered);
            reader.get_or_insert_with(new).frame(&self.path, number)?
        };
        let (width, height) = self.delivered;
        Ok(image_from_rgb(width, height, &bytes))
    }
}

/// Width and height of the first frame with square pixels [px].
fn image_size(path: &Path, log: &FfmpegLog) -> Result<(usize, usize), DatasetError> {
    let Some(frame) = log.frames.first() else { return Err(undecodable(path, log)) };
    let (width, height) = frame.size;
    let width = (width as f64 * frame.pixel_aspect).round() as usize;
    if width.min(height) < 2 || width.saturating_mul(height) > MAX_PIXELS {
        let reason = format!("its pictures are {width}x{height} px, which cannot be used");
        return Err(DatasetError::file(path, reason));
    }
    Ok((width, height))
}

/// The error for a video without a single decodable frame.
fn undecodable(path: &Path, log: &FfmpegLog) -> DatasetError {
    let message = log.message();
    let reason = if log.mentions("matches no streams") {
        "there is no video in it (only sound, or a cover picture)".to_owned()
    } else if log.mentions("Format not on whitelist") {
        "it is a playlist, or in a container that no camera writes; files that name other files are \
         not followed: give the video itself (MP4, Matroska, AVI, MPEG, ...)"
            .to_owned()
    } else if log.mentions("no decoder found") {
        format!(
            "this ffmpeg cannot decode its video codec, {} ({message}): install a full build of \
             ffmpeg, or convert the video to H.264",
            log.codec.as_deref().unwrap_or("unknown")
        )
    } else if log.mentions("moov atom not found") {
        format!(
            "the file is damaged, cut off, or no video ({message}): the recording or the copy was \
             probably not finished"
        )
    } else {
        format!("no frame of it can be decoded, ffmpeg says: {message}")
    };
    DatasetError::file(path, reason)
}

/// A warning about frames whose time stamps were interpolated.
fn repair_warning(repaired: &[usize]) -> Option<String> {
    let first = repaired.first()?;
    let which = match repaired.len() {
        1 => format!("frame {first} has no usable time stamp: one"),
        count => format!("{count} frames, the first {first}, have no usable time stamps: some"),
    };
    Some(format!("{which} between those of the neighbours is taken"))
}

/// A warning if not all frames could be decoded.
fn damage_warning(log: &FfmpegLog, stamps: &[f64]) -> Option<String> {
    let frames = counted(stamps.len(), "frame");
    let (first, last) = (stamps.first()?, stamps.last()?);
    let missing = log.duration.map(|claimed| claimed - (last - first));
    let short = missing.filter(|m| *m > CUT_OFF_SECONDS + 0.02 * (last - first)).map(|_| {
        let claimed = log.duration.unwrap_or_default();
        format!(
            "the video says that it lasts {claimed:.1} s, but {frames} of {last:.1} s are in it"
        )
    });
    match (short, log.error()) {
        (Some(short), Some(error)) => Some(format!("{short} (ffmpeg says: {error})")),
        (Some(short), None) => Some(short),
        (None, Some(error)) => Some(format!(
            "parts of the video are damaged, {frames} can be used (ffmpeg says: {error})"
        )),
        (None, None) => None,
    }
}

#[cfg(all(test, unix))]
mod tests;
