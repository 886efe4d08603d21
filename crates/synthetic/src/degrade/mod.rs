//! Controlled degradation of an existing sequence.

mod colour;
mod depth;
mod ground_truth;
mod moving_object;
mod order;
mod readme;
mod vignetting;

pub use depth::DepthDegradation;

use crate::error::SyntheticError;
use crate::sensor::Response;
use crate::spec::NoiseSpec;
use crate::write::{
    DEPTH_SCALE, output_folder, write_bytes, write_depth, write_list, write_picture,
};
use i2slam_dataset::{DepthPicture, OpenOptions, Sequence, camera_json};
use i2slam_geometry::Image;
use i2slam_storage::OutputFolder;
use moving_object::MovingObject;
use order::{Shown, order};
use rayon::prelude::*;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

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
    /// Seed of all random choices.
    pub seed: u64,
    /// Size of the written pictures over that of the recorded ones, in `(0, 1]`. Lengths in pixels
    /// are those of the written pictures.
    pub scale: f64,
    /// Faults of depth.
    pub depth: DepthDegradation,
    /// Vignetting: share of the light that reaches the corners, in `[0.2, 1]`.
    pub vignetting: Option<f64>,
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
    /// Frames whose picture is of one grey; depth stays.
    pub grey: Vec<Range<usize>>,
    /// Frames that repeat colour and depth of the frame before the range.
    pub frozen: Vec<Range<usize>>,
    /// Frames whose pictures come in a random order, while time stamps rise.
    pub shuffled: Vec<Range<usize>>,
    /// Share of the picture that a moving object covers.
    pub moving_object: Option<f64>,
    /// Assumed camera response, for vignetting, noise and exposure steps.
    pub response: Response,
}

impl Default for Degradation {
    /// No degradation; sRGB response.
    fn default() -> Self {
        Self {
            seed: 7,
            scale: 1.0,
            depth: DepthDegradation::default(),
            vignetting: None,
            sensor_noise: None,
            exposure_steps: Vec::new(),
            drop_share: 0.0,
            dropped: Vec::new(),
            covered: Vec::new(),
            grey: Vec::new(),
            frozen: Vec::new(),
            shuffled: Vec::new(),
            moving_object: None,
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
    /// Frames of one grey.
    pub grey: usize,
    /// Frames that show the picture of another moment: frozen or shuffled.
    pub displaced: usize,
}

impl Degradation {
    /// Change of exposure of a frame [stops].
    fn stops(&self, frame: usize) -> f64 {
        let before = self.exposure_steps.iter().filter(|step| step.frame <= frame);
        before.max_by_key(|step| step.frame).map_or(0.0, |step| step.stops)
    }

    fn covers(&self, frame: usize) -> bool {
        self.covered.iter().any(|range| range.contains(&frame))
    }

    fn is_grey(&self, frame: usize) -> bool {
        self.grey.iter().any(|range| range.contains(&frame))
    }

    fn validate(&self) -> Result<(), SyntheticError> {
        if !(0.0..1.0).contains(&self.drop_share) {
            return refuse("share of dropped frames", self.drop_share, "0 to less than 1");
        }
        if let Some(step) = self.exposure_steps.iter().find(|s| !(-20.0..=20.0).contains(&s.stops))
        {
            return refuse("exposure step", step.stops, "-20 to 20 stops");
        }
        if let Some(corner) = self.vignetting.filter(|corner| !(0.2..=1.0).contains(corner)) {
            return refuse("vignetting", corner, "0.2 to 1, the share of light in the corners");
        }
        if let Some(noise) = &self.sensor_noise {
            for (key, value) in [("read noise", noise.read), ("shot noise", noise.shot)] {
                if !(0.0..=1.0).contains(&value) {
                    return refuse(key, value, "0 to 1");
                }
            }
        }
        self.depth.validate()
    }

    /// An error for frames and pixels that a sequence does not have.
    fn validate_on(&self, sequence: &Sequence) -> Result<(), SyntheticError> {
        let frames = sequence.len();
        let expected = format!("the sequence has frames 0 to {}", frames.saturating_sub(1));
        for (key, ranges) in [
            ("dropped frames", &self.dropped),
            ("covered frames", &self.covered),
            ("grey frames", &self.grey),
            ("frozen frames", &self.frozen),
            ("shuffled frames", &self.shuffled),
        ] {
            if let Some(range) = ranges.iter().find(|range| range.end > frames) {
                let value = format!("{}..{}", range.start, range.end);
                return refuse(key, value, &expected);
            }
        }
        if let Some(range) = self.shuffled.iter().find(|range| range.len() < 2) {
            let value = format!("{}..{}", range.start, range.end);
            return refuse("shuffled frames", value, "at least two frames");
        }
        if let Some(step) = self.exposure_steps.iter().find(|step| step.frame >= frames) {
            return refuse("frame of an exposure step", step.frame, &expected);
        }
        self.depth.validate_on(sequence.camera.width, sequence.camera.height)
    }
}

fn refuse<T>(key: &str, value: impl ToString, expected: &str) -> Result<T, SyntheticError> {
    let (key, value) = (key.to_owned(), value.to_string());
    Err(SyntheticError::OutOfRange { key, value, expected: expected.to_owned() })
}

/// A sequence opened for degradation, with checked options.
struct Degrader<'a> {
    dataset: &'a Path,
    sequence: Sequence,
    what: &'a Degradation,
    /// The frames to be written.
    order: Vec<Shown>,
    object: Option<MovingObject>,
}

impl<'a> Degrader<'a> {
    /// Opens the sequence and checks the options against it; `out` is the output folder.
    fn open(dataset: &'a Path, out: &Path, what: &'a Degradation) -> Result<Self, SyntheticError> {
        what.validate()?;
        ground_truth::refuse_same_folder(dataset, out)?;
        let options = OpenOptions { minimum_gap: 0.0, scale: what.scale, ..OpenOptions::default() };
        let sequence = Sequence::open(dataset, &options)?;
        what.validate_on(&sequence)?;
        let order = order(what, sequence.len())?;
        let object = what.moving_object;
        let object =
            object.map(|share| MovingObject::new(share, &sequence, what.seed)).transpose()?;
        Ok(Self { dataset, sequence, what, order, object })
    }

    fn write(
        &self,
        folder: &OutputFolder,
        progress: &mut dyn FnMut(usize, usize) -> bool,
    ) -> Result<DegradationCounts, SyntheticError> {
        let Self { sequence, what, order, .. } = self;
        folder.write_text("README.md", &readme::readme(&sequence.name, what, order.len()))?;
        for (batch, frames) in order.chunks(BATCH).enumerate() {
            let write = |(at, shown): (usize, &Shown)| {
                self.write_frame(folder, shown.picture, batch * BATCH + at)
            };
            frames.par_iter().enumerate().map(write).collect::<Result<(), SyntheticError>>()?;
            if !progress(batch * BATCH + frames.len(), order.len()) {
                return Err(SyntheticError::Interrupted);
            }
        }
        self.write_lists(folder)?;
        let count = |is: &dyn Fn(&Shown) -> bool| order.iter().filter(|shown| is(shown)).count();
        Ok(DegradationCounts {
            frames: order.len(),
            dropped: sequence.len() - order.len(),
            covered: count(&|shown| what.covers(shown.picture)),
            grey: count(&|shown| what.is_grey(shown.picture)),
            displaced: count(&|shown| shown.picture != shown.stamp),
        })
    }

    /// Writes frame `source` as number `number`.
    fn write_frame(
        &self,
        folder: &OutputFolder,
        source: usize,
        number: usize,
    ) -> Result<(), SyntheticError> {
        let frame = self.sequence.load(source)?;
        let colour = match &self.object {
            Some(object) => {
                let depth = frame.depth_image();
                Arc::new(object.draw_colour(&frame.colour, depth, frame.timestamp))
            }
            None => Arc::clone(&frame.colour),
        };
        let picture = self.what.degrade_colour(&colour, &self.sequence.camera, source);
        write_bytes(folder, &format!("rgb/{number:06}.png"), write_picture(&picture))?;
        let Some(own) = frame.depth else { return Ok(()) };
        let depth = write_depth(&self.depth(&own, source));
        write_bytes(folder, &format!("depth/{number:06}.png"), depth)
    }

    /// Degraded depth of frame `source`, of which `own` is the depth picture.
    fn depth(&self, own: &DepthPicture, source: usize) -> Image<f32> {
        if self.what.covers(source) {
            return Image::new(own.image.width, own.image.height, 1);
        }
        let drawn = self.object.as_ref().map(|object| object.draw_depth(&own.image, own.timestamp));
        let depth = drawn.as_ref().unwrap_or(&own.image);
        self.what.depth.apply(depth, self.what.seed, source)
    }

    fn write_lists(&self, folder: &OutputFolder) -> Result<(), SyntheticError> {
        let Self { sequence, what, order, .. } = self;
        let entry = |frame: usize| &sequence.entries[frame];
        let colour = order.iter().enumerate().map(|(i, shown)| (i, entry(shown.stamp).timestamp));
        write_list(folder, "rgb", "colour images", colour)?;
        let depth = order.iter().enumerate().filter_map(|(i, shown)| {
            let (own, is_shown) = (entry(shown.stamp), entry(shown.picture).depth.is_some());
            let stamp = own.depth.as_ref().map_or(own.timestamp, |depth| depth.timestamp);
            is_shown.then_some((i, stamp + what.depth.delay))
        });
        write_list(folder, "depth", "depth images, 5000 = 1 m", depth)?;
        let camera = camera_json(&sequence.camera, DEPTH_SCALE, sequence.frame_rate);
        folder.write_text("camera.json", &camera)?;
        if let Some(lens) = vignetting::falloff(what) {
            folder.write_text("vignetting.json", &vignetting::json(&lens))?;
        }
        ground_truth::copy_ground_truth(self.dataset, folder, sequence, order, what)
    }
}

/// Writes a degraded copy of a sequence in the TUM layout, undistorted, with `sharp/`, `hdr/`,
/// `exposure.csv` and ground truth renumbered. The folder appears when it is complete; an earlier
/// copy is replaced only if `overwrite`. `progress` receives the numbers of finished and of all
/// frames and returns whether to continue.
///
/// In each frame a moving object is drawn first, then depth and colour get their faults (colour first vignetting, then exposure and noise), then lens
/// and picture are covered; frozen and shuffled frames show the result.
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
