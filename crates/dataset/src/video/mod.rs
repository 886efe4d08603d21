//! Videos, decoded by the program `ffmpeg`.
//!
//! Opening a video decodes it once to learn how many frames it really has and when each is shown;
//! after that, pictures come through a pipe as they are asked for ([`reader`]), and nothing is
//! written to disk.

mod program;
mod reader;
mod stamps;
mod stream;
mod words;

use crate::layouts::{Listing, counted};
use crate::{DatasetError, Entry, Layout, OpenOptions};
use i2slam_geometry::Image;
use program::Ffmpeg;
use reader::Reader;
use stamps::Stamps;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use words::Words;

pub(crate) use stream::refused_stream;
pub use stream::{MAX_RECORDING_BYTES, Recording, is_stream};

/// Endings of video files.
const ENDINGS: [&str; 32] = [
    "mp4", "m4v", "mov", "qt", "mkv", "webm", "avi", "mpg", "mpeg", "m2v", "ts", "mts", "m2ts",
    "3gp", "3g2", "wmv", "asf", "flv", "ogv", "gif", "h264", "264", "h265", "hevc", "mjpeg",
    "mjpg", "y4m", "mxf", "vob", "insv", "lrv", "nut",
];

/// Frames pass the listing in this size at most: their stamps matter, not their pixels.
const LISTED: &str = "crop=min(iw\\,32):min(ih\\,32),showinfo";

/// Largest side of a picture that is taken [px].
const MAX_SIDE: usize = 1 << 15;

/// A video that ends so much before the length that it claims was cut off [s].
const CUT_OFF: f64 = 0.5;

/// Whether a path is that of a video, by its ending, or a [stream](is_stream).
pub fn is_video(path: &Path) -> bool {
    if is_stream(path) {
        return true;
    }
    let ending = path.extension().and_then(|ending| ending.to_str()).map(str::to_lowercase);
    ending.is_some_and(|ending| ENDINGS.contains(&ending.as_str())) && !path.is_dir()
}

/// A video whose frames are known.
#[derive(Debug)]
pub(crate) struct Video {
    path: PathBuf,
    ffmpeg: Ffmpeg,
    /// Width and height [px], turned as the file asks, with square pixels.
    pub(crate) size: (usize, usize),
    reader: Mutex<Option<Reader>>,
    /// Width and height of the pictures that are delivered [px].
    delivered: (usize, usize),
}

impl Video {
    /// Learns the frames, those before the end of `options.frames`. `frame_rate` [1/s] gives stamps
    /// to frames that carry none.
    pub(crate) fn list(
        path: &Path,
        options: &OpenOptions,
        frame_rate: f64,
    ) -> Result<Listing, DatasetError> {
        Self::list_with(Ffmpeg::find(), path, options, frame_rate)
    }

    fn list_with(
        mut ffmpeg: Ffmpeg,
        path: &Path,
        options: &OpenOptions,
        frame_rate: f64,
    ) -> Result<Listing, DatasetError> {
        let first = ffmpeg.listen(path, "showinfo", Some(1))?;
        let size = picture_size(path, &first)?;
        let until = options.frames.as_ref().map(|range| range.end);
        let words = ffmpeg.listen(path, LISTED, until)?;
        if words.frames.is_empty() {
            return Err(refusal(path, &words));
        }
        // A few more than asked for have passed the filter when it ends.
        let all = words.frames.len();
        let count = until.map_or(all, |until| all.min(until));
        let mut warnings = Vec::new();
        let mut stamps = match words.stamps() {
            Some(Stamps { seconds, bad }) => {
                warnings.extend(mended(&bad[..bad.partition_point(|frame| *frame < count)]));
                seconds
            }
            None => {
                let why = format!("no usable time stamps: {frame_rate} frames a second assumed");
                warnings.push(why);
                (0..count).map(|i| i as f64 / frame_rate).collect()
            }
        };
        stamps.truncate(count);
        let is_whole = until.is_none_or(|until| all < until);
        warnings.extend(damage(&words, &stamps).filter(|_| is_whole));
        let entry = |(index, &timestamp): (usize, &f64)| Entry {
            index,
            place: index,
            timestamp,
            depth_timestamp: timestamp,
            colour: path.to_path_buf(),
            depth: None,
            parts: None,
        };
        let entries = stamps.iter().enumerate().map(entry).collect();
        let (path, reader) = (path.to_path_buf(), Mutex::new(None));
        let video = Self { path, ffmpeg, size, reader, delivered: size };
        Ok(Listing { video: Some(video), warnings, ..Listing::new(Layout::Video, entries) })
    }

    /// Whether it is the video in a file.
    pub(crate) fn is(&self, path: &Path) -> bool {
        self.path == path
    }

    /// The same, delivering pictures of another size.
    pub(crate) fn delivering(&self, (width, height): (usize, usize)) -> Self {
        let (path, ffmpeg) = (self.path.clone(), self.ffmpeg.clone());
        let (delivered, reader) = ((width, height), Mutex::new(None));
        Self { path, ffmpeg, size: self.size, reader, delivered }
    }

    /// The picture of a frame: R, G, B in [0, 1].
    pub(crate) fn picture(&self, number: usize) -> Result<Image<f32>, DatasetError> {
        let bytes = {
            let mut reader = self.reader.lock().unwrap_or_else(|poisoned| {
                // A decoder in an unknown state is started anew.
                let mut reader = poisoned.into_inner();
                *reader = None;
                reader
            });
            let new = || Reader::new(self.ffmpeg.clone(), self.delivered);
            reader.get_or_insert_with(new).picture(&self.path, number)?
        };
        let (width, height) = self.delivered;
        let mut picture = Image::new(width, height, 3);
        for channel in 0..3 {
            let plane = picture.plane_mut(channel).iter_mut();
            for (value, pixel) in plane.zip(bytes.chunks_exact(3)) {
                *value = f32::from(pixel[channel]) / 255.0;
            }
        }
        Ok(picture)
    }
}

/// Width and height of the first frame with square pixels [px].
fn picture_size(path: &Path, words: &Words) -> Result<(usize, usize), DatasetError> {
    let Some(frame) = words.frames.first() else { return Err(refusal(path, words)) };
    let (width, height) = frame.size;
    let width = (width as f64 * frame.pixel_aspect).round() as usize;
    if width.min(height) < 2 || width.max(height) > MAX_SIDE {
        let reason = format!("its pictures are {width}x{height} px, which cannot be used");
        return Err(DatasetError::video(path, reason));
    }
    Ok((width, height))
}

/// Why no frame came.
fn refusal(path: &Path, words: &Words) -> DatasetError {
    let blame = words.blame();
    let reason = if words.blames("matches no streams") {
        "there is no video in it (only sound, or a cover picture)".to_owned()
    } else if words.blames("no decoder found") {
        format!(
            "this ffmpeg cannot decode its video codec, {} ({blame}): install a full build of \
             ffmpeg, or convert the video to H.264",
            words.codec.as_deref().unwrap_or("unknown")
        )
    } else if words.blames("moov atom not found") {
        format!(
            "the file is damaged, cut off, or no video ({blame}): the recording or the copy was \
             probably not finished"
        )
    } else {
        format!("no frame of it can be decoded, ffmpeg says: {blame}")
    };
    DatasetError::video(path, reason)
}

/// A warning of frames whose stamps were put between those of others.
fn mended(bad: &[usize]) -> Option<String> {
    let first = bad.first()?;
    let which = match bad.len() {
        1 => format!("frame {first} has no usable time stamp: one"),
        count => format!("{count} frames, the first {first}, have no usable time stamps: some"),
    };
    Some(format!("{which} between those of the neighbours is taken"))
}

/// A warning if not everything could be decoded.
fn damage(words: &Words, stamps: &[f64]) -> Option<String> {
    let frames = counted(stamps.len(), "frame");
    let (first, last) = (stamps.first()?, stamps.last()?);
    let missing = words.duration.map(|claimed| claimed - (last - first));
    let short = missing.filter(|m| *m > CUT_OFF + 0.02 * (last - first)).map(|_| {
        let claimed = words.duration.unwrap_or_default();
        format!(
            "the video says that it lasts {claimed:.1} s, but {frames} of {last:.1} s are in it"
        )
    });
    match (short, words.error()) {
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
