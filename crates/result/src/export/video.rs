//! A flight along the smoothed path of the camera as a video, encoded by ffmpeg.

use super::error::ExportError;
use super::scene::Scene;
use super::smooth_path::smooth_path;
use super::watch::Watch;
use crate::pictures::interleaved_bytes;
use i2slam::dataset::{VideoEncoder, VideoFormat};
use i2slam_storage::write_file;
use std::hash::{BuildHasher, RandomState};
use std::io;
use std::path::{Path, PathBuf};

/// Pictures per second.
const RATE: u32 = 30;

/// Writes the video, as long as the recording, with a comment; returns the number of pictures and the
/// length [s].
///
/// # Errors
/// [`ExportError::Video`] if ffmpeg is missing or fails; those of the system;
/// [`ExportError::Cancelled`].
pub fn write(
    scene: &Scene,
    out: &Path,
    comment: &str,
    watch: &Watch<'_>,
) -> Result<(usize, f64), ExportError> {
    let times: Vec<f64> = scene.frames.iter().map(|frame| frame.timestamp).collect();
    let poses: Vec<_> = scene.frames.iter().map(|frame| frame.middle()).collect();
    let path = smooth_path(&times, &poses, f64::from(RATE));
    let reconstruction = &scene.reconstruction;
    let size = (reconstruction.camera.width, reconstruction.camera.height);
    // ffmpeg goes back to the beginning of a file when it ends, which a stream does not let it.
    let scratch = Scratch::new();
    let format = VideoFormat { size, rate: RATE, comment };
    let mut encoder = VideoEncoder::start(&scratch.0, format)?;
    let mut viewer = reconstruction.viewer();
    for (done, pose) in path.iter().enumerate() {
        watch.step("rendering", done, path.len())?;
        let picture = viewer.sharp(&reconstruction.virtual_frame(done, *pose));
        encoder.add(&interleaved_bytes(&picture))?;
    }
    encoder.finish()?;
    write_file(out, |out| io::copy(&mut i2slam_storage::open(&scratch.0)?, out).map(drop))?;
    Ok((path.len(), path.len() as f64 / f64::from(RATE)))
}

/// A new name for a file that is removed in the end.
struct Scratch(PathBuf);

impl Scratch {
    fn new() -> Self {
        let number = RandomState::new().hash_one(std::process::id());
        Self(std::env::temp_dir().join(format!("i2slam-{number:016x}.mp4")))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // It may never have been made.
        drop(std::fs::remove_file(&self.0));
    }
}
