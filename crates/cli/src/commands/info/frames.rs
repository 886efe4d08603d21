//! Statistics of the pictures: depth, brightness, sharpness.

use crate::failure::Failure;
use crate::ground_truth::{GroundTruth, range_stops};
use crate::interrupt;
use crate::progress::Progress;
use i2slam::dataset::{DatasetError, Frame, Layout, Sequence};
use i2slam_eval::sharpness::{SharpnessRule, laplacian_variance, sharp_frames};
use i2slam_eval::statistics::percentile;
use i2slam_result::FrameFiles;
use rayon::prelude::*;
use serde::Serialize;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Largest number of depth samples per frame.
const DEPTHS: usize = 500;

/// Display values from which a pixel counts as white, and up to which as black.
const WHITE: f32 = 254.0 / 255.0;
const BLACK: f32 = 1.0 / 255.0;

/// Statistics over all readable frames.
#[derive(Debug, Serialize)]
pub(super) struct PictureStats {
    pub(super) measured_frames: usize,
    /// Frames that cannot be read, with reasons.
    pub(super) unreadable: Vec<String>,
    /// Warnings about frames: no depth, black, white.
    pub(super) odd: Vec<String>,
    /// `null` if no pixel has depth.
    pub(super) depth: Option<DepthStats>,
    pub(super) brightness: BrightnessStats,
    pub(super) sharpness: SharpnessStats,
    /// Range of the true exposures [stops], where they are known.
    pub(super) true_exposure_range_stops: Option<f64>,
}

/// Depth over all frames.
#[derive(Debug, Serialize)]
pub(super) struct DepthStats {
    /// 1st, 50th and 99th percentile [m].
    pub(super) low_m: f64,
    pub(super) median_m: f64,
    pub(super) high_m: f64,
    /// Share of pixels with depth: mean over frames with a depth image, and the worst of these.
    pub(super) valid_share: f64,
    pub(super) valid_share_worst: f64,
}

/// Brightness of frames: the mean of all pixels and channels, display values in `[0, 1]`.
#[derive(Debug, Serialize)]
pub(super) struct BrightnessStats {
    pub(super) lowest: f64,
    pub(super) median: f64,
    pub(super) highest: f64,
    /// Between the darkest and the brightest frame, and the largest between neighbours [stops],
    /// display values taken as sRGB: exposure and scene together.
    pub(super) range_stops: f64,
    pub(super) largest_step_stops: f64,
    /// Mean share of values at the ends of the scale.
    pub(super) white_share: f64,
    pub(super) black_share: f64,
}

/// Variance of the Laplacian of 8-bit grey values.
#[derive(Debug, Serialize)]
pub(super) struct SharpnessStats {
    pub(super) lowest: f64,
    pub(super) median: f64,
    pub(super) highest: f64,
    /// Frames sharper than their neighbours, by index in the associated stream.
    pub(super) sharp_frames: Vec<usize>,
}

/// Statistics of one frame.
struct FrameStats {
    index: usize,
    depths: Vec<f64>,
    /// `None` without a depth image.
    valid_share: Option<f64>,
    brightness: f64,
    linear: f64,
    white_share: f64,
    black_share: f64,
    sharpness: f64,
    odd: Vec<String>,
}

impl PictureStats {
    pub(super) fn new(
        (sequence, files): (&Sequence, &FrameFiles),
        truth: &GroundTruth,
        progress: &Progress,
    ) -> Result<Self, Failure> {
        let (seen, unreadable) = measure_all((sequence, files), progress)?;
        if seen.is_empty() {
            let first = unreadable.into_iter().next().unwrap_or_default();
            return Err(Failure::Failed(format!("no frame can be read: {first}")));
        }
        let odd = seen.iter().flat_map(|frame| {
            frame.odd.iter().map(|what| format!("frame {}: {what}", files.name(frame.index)))
        });
        Ok(Self {
            measured_frames: seen.len(),
            unreadable,
            odd: odd.collect(),
            depth: DepthStats::new(&seen)?,
            brightness: BrightnessStats::new(&seen)?,
            sharpness: SharpnessStats::new(&seen)?,
            true_exposure_range_stops: exposure_range(truth),
        })
    }
}

/// Measures all frames in order; the second list says why others cannot be read.
fn measure_all(
    (sequence, files): (&Sequence, &FrameFiles),
    progress: &Progress,
) -> Result<(Vec<FrameStats>, Vec<String>), Failure> {
    let done = AtomicUsize::new(0);
    let measure = |place: usize, frame: Result<Frame, DatasetError>| {
        if interrupt::requested() {
            return Err(Failure::Interrupted);
        }
        let index = sequence.entries[place].index;
        let stats = match frame {
            Ok(frame) => Ok(FrameStats::new(&frame)?),
            Err(error) => Err(format!("frame {}: {error}", files.name(index))),
        };
        progress.step("frames", done.fetch_add(1, Ordering::Relaxed) + 1, sequence.len());
        Ok(stats)
    };
    let stats: Result<Vec<Result<FrameStats, String>>, Failure> = match sequence.layout {
        // A video is decoded from front to back.
        Layout::Video => {
            sequence.stream().enumerate().map(|(i, frame)| measure(i, frame)).collect()
        }
        _ => {
            let places = (0..sequence.len()).into_par_iter();
            places.map(|place| measure(place, sequence.load(place))).collect()
        }
    };
    let (mut seen, mut unreadable) = (Vec::new(), Vec::new());
    for stats in stats? {
        match stats {
            Ok(stats) => seen.push(stats),
            Err(reason) => unreadable.push(reason),
        }
    }
    Ok((seen, unreadable))
}

impl FrameStats {
    fn new(frame: &Frame) -> Result<Self, Failure> {
        let values = &frame.colour.data;
        let share = |is: &dyn Fn(f32) -> bool| {
            values.iter().filter(|&&v| is(v)).count() as f64 / values.len() as f64
        };
        let mean = |of: &dyn Fn(f64) -> f64| {
            values.iter().map(|&v| of(f64::from(v))).sum::<f64>() / values.len() as f64
        };
        let depth = frame.depth.as_ref().map_or(&[][..], |depth| &depth.image.data);
        let valid: Vec<f64> = depth.iter().filter(|&&z| z > 0.0).map(|&z| f64::from(z)).collect();
        Ok(Self {
            index: frame.index,
            valid_share: (!depth.is_empty()).then(|| valid.len() as f64 / depth.len() as f64),
            depths: valid.iter().copied().step_by(valid.len() / DEPTHS + 1).collect(),
            brightness: mean(&|v| v),
            linear: mean(&srgb_to_linear),
            white_share: share(&|v| v >= WHITE),
            black_share: share(&|v| v <= BLACK),
            sharpness: laplacian_variance(&frame.colour)? * 255.0 * 255.0,
            odd: frame.warnings.clone(),
        })
    }
}

/// Linear light of an sRGB value (IEC 61966-2-1).
fn srgb_to_linear(v: f64) -> f64 {
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

impl DepthStats {
    fn new(stats: &[FrameStats]) -> Result<Option<Self>, Failure> {
        let all: Vec<f64> = stats.iter().flat_map(|frame| frame.depths.iter().copied()).collect();
        if all.is_empty() {
            return Ok(None);
        }
        let shares: Vec<f64> = stats.iter().filter_map(|frame| frame.valid_share).collect();
        Ok(Some(Self {
            low_m: percentile(&all, 1.0)?,
            median_m: percentile(&all, 50.0)?,
            high_m: percentile(&all, 99.0)?,
            valid_share: shares.iter().sum::<f64>() / shares.len() as f64,
            valid_share_worst: shares.into_iter().fold(1.0, f64::min),
        }))
    }
}

impl BrightnessStats {
    fn new(stats: &[FrameStats]) -> Result<Self, Failure> {
        let grey: Vec<f64> = stats.iter().map(|frame| frame.brightness).collect();
        // Black frames (a covered lens) have no brightness in stops: half a level stands for them.
        let stops = |frame: &FrameStats| frame.linear.max(srgb_to_linear(0.5 / 255.0)).log2();
        let stops: Vec<f64> = stats.iter().map(stops).collect();
        let steps = stops.windows(2).map(|pair| (pair[1] - pair[0]).abs());
        let mean =
            |of: fn(&FrameStats) -> f64| stats.iter().map(of).sum::<f64>() / stats.len() as f64;
        Ok(Self {
            lowest: percentile(&grey, 0.0)?,
            median: percentile(&grey, 50.0)?,
            highest: percentile(&grey, 100.0)?,
            range_stops: percentile(&stops, 100.0)? - percentile(&stops, 0.0)?,
            largest_step_stops: steps.fold(0.0, f64::max),
            white_share: mean(|frame| frame.white_share),
            black_share: mean(|frame| frame.black_share),
        })
    }
}

impl SharpnessStats {
    fn new(stats: &[FrameStats]) -> Result<Self, Failure> {
        let all: Vec<f64> = stats.iter().map(|frame| frame.sharpness).collect();
        let sharp = sharp_frames(&all, SharpnessRule::default())?;
        Ok(Self {
            lowest: percentile(&all, 0.0)?,
            median: percentile(&all, 50.0)?,
            highest: percentile(&all, 100.0)?,
            sharp_frames: sharp.into_iter().map(|place| stats[place].index).collect(),
        })
    }
}

fn exposure_range(truth: &GroundTruth) -> Option<f64> {
    let exposures: Vec<f64> = truth.tones.iter().map(|tone| tone.exposure).collect();
    (!exposures.is_empty()).then(|| range_stops(&exposures))
}
