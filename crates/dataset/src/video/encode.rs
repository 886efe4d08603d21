//! Pictures encoded as a video by ffmpeg.

use super::ffmpeg::Ffmpeg;
use crate::DatasetError;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr};
use std::thread::JoinHandle;

/// Size and frame rate of a video to be made.
#[derive(Clone, Copy, Debug)]
pub struct VideoFormat<'a> {
    /// Width and height of the pictures [px]; an odd last column or row is left out.
    pub size: (usize, usize),
    /// Pictures per second.
    pub rate: u32,
    /// Comment in the file.
    pub comment: &'a str,
}

/// An MP4 file that is being made: H.264 where ffmpeg has its encoder, else MPEG-4. What was written
/// is removed unless the video is finished.
pub struct VideoEncoder {
    child: Child,
    log: Option<JoinHandle<String>>,
    path: PathBuf,
    is_finished: bool,
}

impl VideoEncoder {
    /// Starts ffmpeg, which writes a new file.
    ///
    /// # Errors
    /// [`DatasetError::NoFfmpeg`]; those of the system.
    pub fn start(path: &Path, format: VideoFormat<'_>) -> Result<Self, DatasetError> {
        let mut child = Ffmpeg::find().encode(path, format)?;
        let log = child.stderr.take().map(|log| std::thread::spawn(move || text(log)));
        Ok(Self { child, log, path: path.to_path_buf(), is_finished: false })
    }

    /// Adds a picture: bytes R, G, B of every pixel, row by row.
    ///
    /// # Errors
    /// [`DatasetError::File`] if ffmpeg has ended, with its reason.
    pub fn add(&mut self, pixels: &[u8]) -> Result<(), DatasetError> {
        let written = self.child.stdin.as_mut().map(|input| input.write_all(pixels));
        match written {
            Some(Ok(())) => Ok(()),
            _ => Err(self.failure()),
        }
    }

    /// Ends the video; the file is complete then.
    ///
    /// # Errors
    /// [`DatasetError::File`] if ffmpeg fails, with its reason.
    pub fn finish(mut self) -> Result<(), DatasetError> {
        drop(self.child.stdin.take());
        match self.child.wait() {
            Ok(status) if status.success() => {
                self.is_finished = true;
                Ok(())
            }
            _ => Err(self.failure()),
        }
    }

    /// The reason that ffmpeg gave.
    fn failure(&mut self) -> DatasetError {
        drop(self.child.stdin.take());
        let log = self.log.take().and_then(|log| log.join().ok()).unwrap_or_default();
        let reason = log.lines().rev().find(|line| !line.trim().is_empty());
        let reason = reason.unwrap_or("it gave no reason");
        DatasetError::file(&self.path, format!("ffmpeg cannot encode the video: {reason}"))
    }
}

impl Drop for VideoEncoder {
    fn drop(&mut self) {
        if !self.is_finished {
            // It may have ended already, or never have written.
            drop(self.child.kill());
            drop(self.child.wait());
            drop(std::fs::remove_file(&self.path));
        }
    }
}

/// The log to its end, of which the last part counts.
fn text(mut log: ChildStderr) -> String {
    let mut bytes = Vec::new();
    // What could be read says the reason.
    drop(log.read_to_end(&mut bytes));
    String::from_utf8_lossy(&bytes).into_owned()
}
