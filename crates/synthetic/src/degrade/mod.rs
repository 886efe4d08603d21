//! Controlled degradation of an existing sequence.

mod ground_truth;

use crate::depth_noise::KinectNoise;
use crate::error::SyntheticError;
use crate::rng::{gaussian, stream};
use crate::sensor::Response;
use crate::sensor::with_noise;
use crate::spec::NoiseSpec;
use crate::write::{
    DEPTH_SCALE, output_folder, write_bytes, write_depth, write_list, write_picture,
};
use i2slam_dataset::{Frame, OpenOptions, Sequence, camera_json};
use i2slam_geometry::Image;
use i2slam_storage::OutputFolder;
use rayon::prelude::*;
use std::ops::Range;
use std::path::Path;

/// Exposure change of a covered lens [stops].
const COVERED_STOPS: f64 = -11.0;
/// Frames processed at once; bounds memory.
const BATCH: usize = 16;

/// A change of exposure from a frame on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExposureStep {
    /// First frame of the new exposure.
    pub frame: usize,
    /// Change against the recording [stops].
    pub stops: f64,
}

/// Degradations of a sequence. Frames are counted in the unthinned associated stream.
#[derive(Clone, Debug, PartialEq)]
pub struct Degradation {
    /// Seed of noise and of dropped frames.
    pub seed: u64,
    /// Depth noise, steps and holes.
    pub depth_noise: Option<KinectNoise>,
    /// Noise on exposed linear values.
    pub sensor_noise: Option<NoiseSpec>,
    /// Exposure changes, each from its frame to the next one's.
    pub exposure_steps: Vec<ExposureStep>,
    /// Share of frames dropped at random, in `[0, 1)`; the first frame is kept.
    pub drop_share: f64,
    /// Dropped frames.
    pub dropped: Vec<Range<usize>>,
    /// Frames with a covered lens: almost black, no depth.
    pub covered: Vec<Range<usize>>,
    /// Assumed camera response, for noise and exposure steps.
    pub response: Response,
}

impl Default for Degradation {
    /// No degradation; sRGB response.
    fn default() -> Self {
        Self {
            seed: 7,
            depth_noise: None,
            sensor_noise: None,
            exposure_steps: Vec::new(),
            drop_share: 0.0,
            dropped: Vec::new(),
            covered: Vec::new(),
            response: Response::Srgb,
        }
    }
}

/// Counts of a degraded sequence.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DegradationCounts {
    /// Frames written.
    pub frames: usize,
    /// Dropped frames.
    pub dropped: usize,
    /// Frames with a covered lens.
    pub covered: usize,
}

impl Degradation {
    /// Change of exposure of a frame [stops].
    fn stops(&self, frame: usize) -> f64 {
        let before = self.exposure_steps.iter().filter(|step| step.frame <= frame);
        before.max_by_key(|step| step.frame).map_or(0.0, |step| step.stops)
    }

    fn drops(&self, frame: usize) -> bool {
        let chance = stream(self.seed, 41, frame as u64).uniform();
        let by_chance = frame > 0 && chance < self.drop_share;
        by_chance || self.dropped.iter().any(|range| range.contains(&frame))
    }

    fn covers(&self, frame: usize) -> bool {
        self.covered.iter().any(|range| range.contains(&frame))
    }

    fn validate(&self) -> Result<(), SyntheticError> {
        if !(0.0..1.0).contains(&self.drop_share) {
            return refuse("share of dropped frames", self.drop_share, "0 to less than 1");
        }
        if let Some(step) = self.exposure_steps.iter().find(|s| !(-20.0..=20.0).contains(&s.stops))
        {
            return refuse("exposure step", step.stops, "-20 to 20 stops");
        }
        if let Some(noise) = &self.sensor_noise {
            for (key, value) in [("read noise", noise.read), ("shot noise", noise.shot)] {
                if !(0.0..=1.0).contains(&value) {
                    return refuse(key, value, "0 to 1");
                }
            }
        }
        Ok(())
    }

    /// An error for frames that a sequence of this length does not have.
    fn validate_on(&self, frames: usize) -> Result<(), SyntheticError> {
        let expected = format!("the sequence has frames 0 to {}", frames.saturating_sub(1));
        for (key, ranges) in [("dropped frames", &self.dropped), ("covered frames", &self.covered)]
        {
            if let Some(range) = ranges.iter().find(|range| range.end > frames) {
                let value = format!("{}..{}", range.start, range.end);
                return refuse(key, value, &expected);
            }
        }
        match self.exposure_steps.iter().find(|step| step.frame >= frames) {
            Some(step) => refuse("frame of an exposure step", step.frame, &expected),
            None => Ok(()),
        }
    }

    /// Degrades the image of a frame.
    fn degrade_image(&self, colour: &Image<f32>, index: usize) -> Image<f32> {
        let covered = if self.covers(index) { COVERED_STOPS } else { 0.0 };
        let gain = (self.stops(index) + covered).exp2() as f32;
        if gain == 1.0 && self.sensor_noise.is_none() {
            return colour.clone();
        }
        let mut random = stream(self.seed, 22, index as u64);
        let mut out = colour.clone();
        for channel in 0..3 {
            let linear: Vec<f32> = (0..=LEVELS)
                .map(|i| self.response.invert(i as f32 / LEVELS as f32, channel))
                .collect();
            for value in out.plane_mut(channel) {
                let mut exposed = linear_value(&linear, *value) * gain;
                if let Some(noise) = &self.sensor_noise {
                    exposed = with_noise(exposed, noise, gaussian(&mut random));
                }
                *value = self.response.apply(exposed, channel);
            }
        }
        out
    }

    fn depth(&self, depth: &Image<f32>, index: usize) -> Image<f32> {
        if self.covers(index) {
            return Image::new(depth.width, depth.height, 1);
        }
        let noise = self.depth_noise.as_ref();
        noise.map_or_else(|| depth.clone(), |noise| noise.apply(depth, self.seed, index))
    }
}

fn refuse<T>(key: &str, value: impl ToString, expected: &str) -> Result<T, SyntheticError> {
    let (key, value) = (key.to_owned(), value.to_string());
    Err(SyntheticError::OutOfRange { key, value, expected: expected.to_owned() })
}

/// Number of values at which the inverse response is tabulated.
const LEVELS: usize = 1020;

/// Looks up the tabulated inverse response. White is lowered by four steps of 1/1020 to stay finite.
fn linear_value(table: &[f32], value: f32) -> f32 {
    let at = (value.clamp(0.0, 1.0) * LEVELS as f32).min((LEVELS - 4) as f32);
    let below = at as usize;
    table[below] + (table[below + 1] - table[below]) * (at - below as f32)
}

/// A sequence opened for degradation, with checked options.
struct Degrader<'a> {
    dataset: &'a Path,
    sequence: Sequence,
    what: &'a Degradation,
    /// Indices of the kept frames.
    kept: Vec<usize>,
}

impl<'a> Degrader<'a> {
    /// Opens the sequence and checks the options against it; `out` is the output folder.
    fn open(dataset: &'a Path, out: &Path, what: &'a Degradation) -> Result<Self, SyntheticError> {
        what.validate()?;
        ground_truth::refuse_same_folder(dataset, out)?;
        let options = OpenOptions { minimum_gap: 0.0, ..OpenOptions::default() };
        let sequence = Sequence::open(dataset, &options)?;
        what.validate_on(sequence.len())?;
        let kept: Vec<usize> = (0..sequence.len()).filter(|&i| !what.drops(i)).collect();
        if kept.is_empty() {
            return refuse("dropped frames", "all", "a frame must be left");
        }
        Ok(Self { dataset, sequence, what, kept })
    }

    fn write(
        &self,
        folder: &OutputFolder,
        progress: &mut dyn FnMut(usize, usize) -> bool,
    ) -> Result<DegradationCounts, SyntheticError> {
        let Self { sequence, what, kept, .. } = self;
        folder.write_text("README.md", &readme(&sequence.name, what, kept))?;
        for (batch, positions) in kept.chunks(BATCH).enumerate() {
            let write = |(at, &position): (usize, &usize)| {
                write_frame(folder, &sequence.load(position)?, what, position, batch * BATCH + at)
            };
            positions.par_iter().enumerate().map(write).collect::<Result<(), SyntheticError>>()?;
            if !progress(batch * BATCH + positions.len(), kept.len()) {
                return Err(SyntheticError::Interrupted);
            }
        }
        self.write_lists(folder)?;
        Ok(DegradationCounts {
            frames: kept.len(),
            dropped: sequence.len() - kept.len(),
            covered: kept.iter().filter(|&&i| what.covers(i)).count(),
        })
    }

    fn write_lists(&self, folder: &OutputFolder) -> Result<(), SyntheticError> {
        let Self { dataset, sequence, what, kept } = self;
        let entries = || kept.iter().map(|&i| &sequence.entries[i]).enumerate();
        let colour = entries().map(|(number, entry)| (number, entry.timestamp));
        let depth = entries().filter_map(|(i, entry)| Some((i, entry.depth.as_ref()?.timestamp)));
        write_list(folder, "rgb", "colour images", colour)?;
        write_list(folder, "depth", "depth images, 5000 = 1 m", depth)?;
        let camera = camera_json(&sequence.camera, DEPTH_SCALE, sequence.frame_rate);
        folder.write_text("camera.json", &camera)?;
        ground_truth::copy_ground_truth(dataset, folder, sequence, kept, what)
    }
}

/// Writes a degraded copy of a sequence in the TUM layout, undistorted, with `sharp/`, `hdr/`,
/// `exposure.csv` and ground truth renumbered. The folder appears when it is complete; an earlier
/// copy is replaced only if `overwrite`. `progress` receives the numbers of finished and of all
/// frames and returns whether to continue.
pub fn degrade(
    dataset: &Path,
    out: &Path,
    overwrite: bool,
    what: &Degradation,
    progress: &mut dyn FnMut(usize, usize) -> bool,
) -> Result<DegradationCounts, SyntheticError> {
    let degrader = Degrader::open(dataset, out, what)?;
    let mut folder = output_folder(out, "i2slam degrade", overwrite)?;
    let counts = degrader.write(&folder, progress)?;
    folder.commit_or_save()?;
    Ok(counts)
}

fn write_frame(
    folder: &OutputFolder,
    frame: &Frame,
    what: &Degradation,
    position: usize,
    number: usize,
) -> Result<(), SyntheticError> {
    let picture = what.degrade_image(&frame.colour, position);
    write_bytes(folder, &format!("rgb/{number:06}.png"), write_picture(&picture))?;
    let Some(depth) = &frame.depth else { return Ok(()) };
    let depth = what.depth(&depth.image, position);
    write_bytes(folder, &format!("depth/{number:06}.png"), write_depth(&depth))
}

/// Contents of the degraded sequence's README.
fn readme(name: &str, what: &Degradation, kept: &[usize]) -> String {
    let yes = |on: bool| if on { "yes" } else { "no" };
    let ranges = |ranges: &[Range<usize>]| {
        let words: Vec<String> = ranges.iter().map(|r| format!("{}..{}", r.start, r.end)).collect();
        if words.is_empty() { "none".into() } else { words.join(", ") }
    };
    let steps = what.exposure_steps.iter();
    let steps: Vec<String> = steps.map(|s| format!("{} stops from {}", s.stops, s.frame)).collect();
    let noise = what.sensor_noise.as_ref();
    let noise = noise.map_or("none".into(), |n| format!("read {}, shot {}", n.read, n.shot));
    // The name of a folder is no Markdown.
    let name = name.replace(char::is_control, " ").replace('<', "&lt;").replace('[', "\\[");
    format!(
        "# {name}, degraded\n\nMade by `i2slam degrade` with seed {}. Frames are counted in the source; \
         source.csv names the source of every frame here.\n\n\
         - Kinect-like depth noise: {}\n- sensor noise: {noise}\n- exposure steps: {}\n\
         - dropped by chance: {}, by range: {}\n- covered lens: {}\n- assumed response: {:?}\n- frames: {}\n",
        what.seed,
        yes(what.depth_noise.is_some()),
        if steps.is_empty() { "none".into() } else { steps.join(", ") },
        what.drop_share,
        ranges(&what.dropped),
        ranges(&what.covered),
        what.response,
        kept.len()
    )
}
