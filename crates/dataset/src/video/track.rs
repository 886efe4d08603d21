//! The tracks of a video, and random access to their pictures.

use super::ffmpeg::Ffmpeg;
use super::frame_reader::FrameReader;
use crate::DatasetError;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

/// A video track of a container. Cover pictures do not count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Track {
    /// The first one.
    Colour,
    /// The second one.
    Depth,
}

impl Track {
    /// ffmpeg's name for it.
    pub(super) fn map(self) -> &'static str {
        match self {
            Self::Colour => "0:V:0",
            Self::Depth => "0:V:1",
        }
    }
}

/// Pictures as ffmpeg gives them: R G B bytes, scaled to the size, of high dynamic range 16 bits each; or
/// depth as it was recorded, 16 bits a pixel. The lower byte comes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Pictures {
    pub(super) track: Track,
    /// Width and height [px]; of depth as recorded.
    pub(super) size: (usize, usize),
    /// True if colour has 16 bits a channel.
    pub(super) is_deep: bool,
}

impl Pictures {
    /// Filter that makes them of the frames of the track.
    pub(super) fn filter(&self) -> String {
        let (width, height) = self.size;
        match self.track {
            Track::Colour => {
                let format = if self.is_deep { "rgb48le" } else { "rgb24" };
                format!(
                    "scale={width}:{height}:flags=area+accurate_rnd+full_chroma_int,setsar=1,\
                     format={format}"
                )
            }
            Track::Depth => "format=gray16le".to_owned(),
        }
    }

    /// Length of a picture [bytes].
    pub(super) fn bytes(&self) -> usize {
        let pixel = match self.track {
            Track::Colour if self.is_deep => 6,
            Track::Colour => 3,
            Track::Depth => 2,
        };
        pixel * self.size.0 * self.size.1
    }
}

/// Random access to the pictures of a track.
#[derive(Debug)]
pub(super) struct TrackReader {
    pub(super) pictures: Pictures,
    reader: Mutex<Option<FrameReader>>,
}

impl TrackReader {
    pub(super) fn new(pictures: Pictures) -> Self {
        Self { pictures, reader: Mutex::new(None) }
    }

    /// The bytes of a picture.
    pub(super) fn picture(
        &self,
        (ffmpeg, path): (&Ffmpeg, &Path),
        number: usize,
    ) -> Result<Arc<Vec<u8>>, DatasetError> {
        let mut reader = self.reader.lock().unwrap_or_else(|poisoned: PoisonError<_>| {
            // The decoder is in an unknown state: restart it.
            let mut reader = poisoned.into_inner();
            *reader = None;
            reader
        });
        let new = || FrameReader::new(ffmpeg.clone(), self.pictures);
        reader.get_or_insert_with(new).frame(path, number)
    }
}
