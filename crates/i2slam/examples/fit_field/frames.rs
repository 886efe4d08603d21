//! Sharp pictures with their true poses and exposures.

use i2slam::dataset::{Frame, OpenOptions, Sequence};
use i2slam::geometry::{Camera, Image, Pose, StampedPose};
use std::error::Error;
use std::path::Path;

/// Every how many frames one is held out.
pub(crate) const HOLD_OUT: usize = 8;

/// A sequence at half its size, its pictures the sharp ones.
pub(crate) struct Frames {
    pub(crate) camera: Camera<f64>,
    pub(crate) frame_rate: f64,
    pub(crate) frames: Vec<Frame>,
    /// World-from-camera at mid-exposure.
    pub(crate) poses: Vec<Pose<f64>>,
    /// Exposures, by which radiance is multiplied.
    pub(crate) exposures: Vec<f32>,
}

impl Frames {
    pub(crate) fn read(folder: &Path) -> Result<Self, Box<dyn Error>> {
        let options = OpenOptions { scale: 0.5, ..OpenOptions::default() };
        let mut sequence = Sequence::open(folder, &options)?;
        for entry in &mut sequence.entries {
            let name = entry.colour.file_name().ok_or("a picture without a name")?;
            entry.colour = folder.join("sharp").join(name);
        }
        let frames = sequence.stream().collect::<Result<Vec<_>, _>>()?;
        let truth = sequence.true_trajectory()?;
        let at = |frame: &Frame| nearest(&truth, frame.timestamp).ok_or("no true pose");
        let poses = frames.iter().map(at).collect::<Result<_, _>>()?;
        let all = exposures(&std::fs::read_to_string(folder.join("exposure.csv"))?)?;
        let of = |frame: &Frame| all.get(frame.index).copied().ok_or("no exposure of a frame");
        let exposures = frames.iter().map(of).collect::<Result<_, _>>()?;
        let (camera, frame_rate) = (sequence.camera, sequence.frame_rate);
        Ok(Self { camera, frame_rate, frames, poses, exposures })
    }

    /// Whether a frame is kept from training.
    pub(crate) fn is_held_out(&self, frame: usize) -> bool {
        frame > 0 && frame.is_multiple_of(HOLD_OUT)
    }

    /// Frames to train on.
    pub(crate) fn training(&self) -> Vec<usize> {
        (0..self.frames.len()).filter(|&frame| !self.is_held_out(frame)).collect()
    }

    /// Mean over the held-out frames of the PSNR \[dB\] of what `show` makes of them.
    pub(crate) fn held_out(&self, mut show: impl FnMut(usize) -> Image<f32>) -> f64 {
        let held_out = (0..self.frames.len()).filter(|&frame| self.is_held_out(frame));
        let values = held_out.map(|frame| psnr(&show(frame), &self.frames[frame].colour));
        let values: Vec<f64> = values.collect();
        values.iter().sum::<f64>() / values.len() as f64
    }
}

fn nearest(trajectory: &[StampedPose], timestamp: f64) -> Option<Pose<f64>> {
    let stamps: Vec<f64> = trajectory.iter().map(|pose| pose.timestamp).collect();
    let index = i2slam::geometry::nearest_stamp(&stamps, timestamp, 0.01)?;
    Some(trajectory[index].world_from_camera)
}

/// The column `dt`.
fn exposures(text: &str) -> Result<Vec<f32>, Box<dyn Error>> {
    let mut lines = text.lines();
    let head = lines.next().unwrap_or_default();
    let column = head.split(',').position(|name| name == "dt").ok_or("no column dt")?;
    let value = |line: &str| Ok(line.split(',').nth(column).ok_or("a short line")?.parse()?);
    lines.map(value).collect()
}

/// PSNR \[dB\], all pixels and channels.
fn psnr(shown: &Image<f32>, truth: &Image<f32>) -> f64 {
    let square = |(a, b): (&f32, &f32)| f64::from(a.clamp(0.0, 1.0) - b).powi(2);
    let sum: f64 = shown.data.iter().zip(&truth.data).map(square).sum();
    -10.0 * (sum / truth.data.len() as f64).log10()
}
