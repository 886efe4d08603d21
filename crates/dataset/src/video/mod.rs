//! Videos, decoded by the program `ffmpeg`. A second track of 16-bit grey is depth.
//!
//! Opening a video decodes it once to count its frames and read their time stamps; images are then
//! piped from ffmpeg on demand ([`frame_reader`]), and nothing is written to disk.

mod allowed;
mod encode;
mod ffmpeg;
mod ffmpeg_log;
mod frame_reader;
mod high_dynamic_range;
mod live_frames;
mod recording;
mod timestamps;
mod track;

use crate::DatasetError;
use crate::image::{MAX_PIXELS, image_from_rgb};
use crate::text::counted;
use ffmpeg::{Ffmpeg, Part};
use ffmpeg_log::FfmpegLog;
use high_dynamic_range::{Conversion, Transfer};
use i2slam_geometry::Image;
use std::path::{Path, PathBuf};
use timestamps::RepairedTimestamps;
use track::{Pictures, Track, TrackReader};

pub use encode::{VideoEncoder, VideoFormat};
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

/// Whether the second track of a video file is 16-bit grey; false for what cannot be decoded.
pub(crate) fn has_depth_track(path: &Path) -> bool {
    let first = Ffmpeg::find().read_log((path, Track::Depth), "showinfo", Part::Frames(1));
    first.is_ok_and(|log| log.frames.first().is_some_and(|frame| frame.is_grey16))
}

/// A video whose frames are counted.
#[derive(Debug)]
pub(crate) struct Video {
    path: PathBuf,
    ffmpeg: Ffmpeg,
    /// Width and height [px] after the rotation that the file asks for, with square pixels.
    pub(crate) size: (usize, usize),
    colour: TrackReader,
    /// Conversion of its colours, if they are of high dynamic range.
    conversion: Option<Conversion>,
    /// Depth, if the second track is 16-bit grey.
    depth: Option<TrackReader>,
    /// Whether there is a second track of which no picture can be decoded (yet).
    pub(crate) awaits_second_track: bool,
}

/// An opened video with the time stamps of its pictures.
#[derive(Debug)]
pub(crate) struct VideoListing {
    pub(crate) video: Video,
    /// One for every colour picture [s], increasing.
    pub(crate) timestamps: Vec<f64>,
    /// One for every depth picture [s], increasing; `None` for a video of colour alone.
    pub(crate) depth_timestamps: Option<Vec<f64>>,
    pub(crate) warnings: Vec<String>,
}

/// What is read of a video.
#[derive(Clone, Copy, Debug)]
pub(crate) struct VideoPart {
    /// One after the last colour picture that is counted.
    pub(crate) end: Option<usize>,
    /// Whether depth is looked for, and up to which time after the last colour picture [s].
    pub(crate) depth: Option<f64>,
    /// Rate of pictures without usable time stamps [1/s].
    pub(crate) frame_rate: f64,
}

impl Video {
    /// Counts the pictures of a part.
    pub(crate) fn open(path: &Path, part: VideoPart) -> Result<VideoListing, DatasetError> {
        Self::open_with(Ffmpeg::find(), path, part)
    }

    fn open_with(
        mut ffmpeg: Ffmpeg,
        path: &Path,
        part: VideoPart,
    ) -> Result<VideoListing, DatasetError> {
        let VideoPart { end, frame_rate, .. } = part;
        let first = ffmpeg.read_log((path, Track::Colour), "showinfo", Part::Frames(1))?;
        let size = image_size(path, &first)?;
        let listed = end.map_or(Part::All, Part::Frames);
        let log = ffmpeg.read_log((path, Track::Colour), LISTING_FILTER, listed)?;
        if log.frames.is_empty() {
            return Err(undecodable(path, &log));
        }
        // ffmpeg logs a few more frames than asked for before it ends.
        let all = log.frames.len();
        let count = end.map_or(all, |end| all.min(end));
        let mut warnings = Vec::new();
        let timestamps = timestamps(&log, count, frame_rate, &mut warnings);
        let is_whole = end.is_none_or(|end| all < end);
        warnings.extend(damage_warning(&log, &timestamps).filter(|_| is_whole));
        let conversion =
            first.transfer.map(|transfer| Conversion::new(transfer, first.has_wide_primaries));
        let is_deep = conversion.is_some();
        let colour = TrackReader::new(Pictures { track: Track::Colour, size, is_deep });
        let path = path.to_path_buf();
        let (depth, awaits_second_track) = (None, false);
        let video = Self { path, ffmpeg, size, colour, conversion, depth, awaits_second_track };
        let mut listing = VideoListing { video, timestamps, depth_timestamps: None, warnings };
        if let Some(margin) = part.depth {
            let until = listing.timestamps.last().filter(|_| !is_whole).map(|last| last + margin);
            listing.find_depth(until, frame_rate)?;
        }
        Ok(listing)
    }

    /// Whether the video lies at `path`.
    pub(crate) fn is_at(&self, path: &Path) -> bool {
        self.path == path
    }

    /// Whether depth was recorded.
    pub(crate) fn has_depth(&self) -> bool {
        self.depth.is_some()
    }

    /// Width and height of depth pictures [px], if there are any.
    pub(crate) fn depth_size(&self) -> Option<(usize, usize)> {
        Some(self.depth.as_ref()?.pictures.size)
    }

    /// Whether depth, if there is any, has the size of colour.
    pub(crate) fn has_registered_size(&self) -> bool {
        self.depth_size().is_none_or(|size| size == self.size)
    }

    /// The transfer function of a video of high dynamic range, whose pictures are converted.
    pub(crate) fn transfer(&self) -> Option<Transfer> {
        self.conversion.as_ref().map(Conversion::transfer)
    }

    /// Changes the size of delivered colour pictures [px].
    pub(crate) fn with_size(&self, size: (usize, usize)) -> Self {
        let colour = Pictures { size, ..self.colour.pictures };
        Self {
            path: self.path.clone(),
            ffmpeg: self.ffmpeg.clone(),
            colour: TrackReader::new(colour),
            conversion: self.conversion.clone(),
            depth: self.depth.as_ref().map(|depth| TrackReader::new(depth.pictures)),
            ..*self
        }
    }

    /// The colour pictures of this video at the size of delivered ones, while it is being recorded, and
    /// those of depth, if there are any.
    pub(crate) fn follow(
        &self,
        recording: &Recording,
    ) -> Result<(LiveFrames, Option<LiveFrames>), DatasetError> {
        let start = |track: &TrackReader| {
            let is_complete = recording.is_complete();
            LiveFrames::start(&self.ffmpeg, &self.path, is_complete, track.pictures)
        };
        Ok((start(&self.colour)?, self.depth.as_ref().map(start).transpose()?))
    }

    /// Decodes a colour picture: 3 planes R, G, B in [0, 1].
    pub(crate) fn decode(&self, number: usize) -> Result<Image<f32>, DatasetError> {
        let bytes = self.colour.picture((&self.ffmpeg, &self.path), number)?;
        Ok(self.colour_image(&bytes))
    }

    /// Decodes a depth picture: 1 plane of 16-bit values.
    pub(crate) fn decode_depth(&self, number: usize) -> Result<Image<u16>, DatasetError> {
        let none = || DatasetError::image(&self.path, "no second video track of 16-bit grey");
        let depth = self.depth.as_ref().ok_or_else(none)?;
        let bytes = depth.picture((&self.ffmpeg, &self.path), number)?;
        self.depth_image(&bytes).ok_or_else(none)
    }

    /// A colour picture of its bytes.
    pub(crate) fn colour_image(&self, bytes: &[u8]) -> Image<f32> {
        let (width, height) = self.colour.pictures.size;
        match &self.conversion {
            Some(conversion) => conversion.image((width, height), bytes),
            None => image_from_rgb(width, height, bytes),
        }
    }

    /// A depth picture of its bytes; `None` for a video of colour alone.
    pub(crate) fn depth_image(&self, bytes: &[u8]) -> Option<Image<u16>> {
        let (width, height) = self.depth_size()?;
        let data = bytes.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
        Some(Image { width, height, channels: 1, data })
    }
}

impl VideoListing {
    /// Counts the depth pictures up to a time [s], if the second track is 16-bit grey.
    fn find_depth(&mut self, until: Option<f64>, frame_rate: f64) -> Result<(), DatasetError> {
        let Video { path, ffmpeg, .. } = &mut self.video;
        let second = (path.as_path(), Track::Depth);
        let first = ffmpeg.read_log(second, "showinfo", Part::Frames(1))?;
        let Some(frame) = first.frames.first() else {
            self.video.awaits_second_track = !first.lacks_track;
            return Ok(());
        };
        if !frame.is_grey16 {
            return Ok(());
        }
        let (width, height) = frame.size;
        if width.min(height) < 2 || width.saturating_mul(height) > MAX_PIXELS {
            let reason = format!("its depth is {width}x{height} px, which cannot be used");
            return Err(DatasetError::file(path, reason));
        }
        let pictures = Pictures { track: Track::Depth, size: frame.size, is_deep: false };
        let part = until.map_or(Part::All, Part::Seconds);
        let log = ffmpeg.read_log(second, LISTING_FILTER, part)?;
        let mut warnings = Vec::new();
        let stamps = timestamps(&log, log.frames.len(), frame_rate, &mut warnings);
        warnings.extend(log.error().map(|error| format!("damaged (ffmpeg says: {error})")));
        let named = warnings.iter().map(|warning| format!("second video track, depth: {warning}"));
        self.warnings.extend(named);
        self.depth_timestamps = Some(stamps);
        self.video.depth = Some(TrackReader::new(pictures));
        Ok(())
    }
}

/// Time stamps of the first `count` pictures of a track [s].
fn timestamps(
    log: &FfmpegLog,
    count: usize,
    frame_rate: f64,
    warnings: &mut Vec<String>,
) -> Vec<f64> {
    let mut stamps = match log.timestamps() {
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
    stamps.truncate(count);
    stamps
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
    let reason = if log.lacks_track {
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
    } else if log.mentions("Too many packets buffered") {
        "its second video track gives no picture, and colour waits for it: leave that track out, or \
         read colour only"
            .to_owned()
    } else if log.mentions("moov atom not found") {
        format!(
            "the file is damaged, cut off, or no video ({message}): the recording or the copy was \
             probably not finished"
        )
    } else if is_stream(path) && log.mentions("partial file") {
        format!(
            "no frame of it can be decoded ({message}): an MP4 ends with its index, so that it cannot be \
             read while it comes; give the file itself, or send Matroska, MPEG-TS or an MP4 written with \
             `-movflags +faststart`"
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
