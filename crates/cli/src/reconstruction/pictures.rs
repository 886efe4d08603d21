//! Pictures of a run: files under `renders/`, comparisons for the report, and image metrics.

use crate::ground_truth::GroundTruth;
use crate::image_files::{at_size_of, read_exr, stacked};
use crate::interrupt;
use crate::progress::Progress;
use clap::ValueEnum;
use i2slam::dataset::Sequence;
use i2slam::geometry::Image;
use i2slam::{FrameEstimate, Map, Reconstruction, Viewer};
use i2slam_eval::hdr::{Gain, hdr_error};
use i2slam_eval::image::{psnr, ssim};
use i2slam_result::report::{Comparison, frames_to_show};
use i2slam_result::{Metrics, RenderKind, ResultError, save_render};
use i2slam_storage::OutputFolder;
use rayon::prelude::*;
use std::time::{Duration, Instant};

/// Number of frames in the report.
const REPORT_FRAMES: usize = 8;

/// Phase of the progress display.
const RENDERING: &str = "rendering";

/// Time that pictures of the report get after an interrupt, which ends a run within ten seconds.
const LAST_PICTURES: Duration = Duration::from_secs(6);

/// Exposures shown in the report [stops].
const STOPS: [f64; 3] = [-2.0, 0.0, 2.0];

/// Frames whose renders are written.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RenderSelection {
    All,
    Keyframes,
    None,
}

/// Inputs of rendering.
pub(crate) struct PictureRenderer<'a> {
    pub(crate) sequence: &'a Sequence,
    pub(crate) truth: &'a GroundTruth,
    pub(crate) reconstruction: &'a Reconstruction,
    pub(crate) renders: RenderSelection,
}

/// Outputs of rendering.
#[derive(Default)]
pub(crate) struct RenderedPictures {
    pub(crate) comparisons: Vec<Comparison>,
    pub(crate) metrics: ImageMetrics,
    /// First error of writing, after which no file is written.
    pub(crate) failure: Option<ResultError>,
}

/// Blur length above which frames are told apart [px].
const LONG_BLUR: f64 = 2.0;

/// Image metrics, one entry per measured frame.
#[derive(Default)]
pub(crate) struct ImageMetrics {
    psnr_blurred: Vec<f64>,
    psnr_sharp: Vec<f64>,
    ssim_sharp: Vec<f64>,
    /// PSNR of pictures taken against the true sharp ones.
    psnr_taken: Vec<f64>,
    /// PSNR of sharp renders and of pictures taken, of frames blurred over more than
    /// [`LONG_BLUR`].
    blurred: [Vec<f64>; 2],
    /// Estimated and true radiance, compared after one gain that fits all frames.
    radiance: [Vec<Image<f32>>; 2],
}

impl PictureRenderer<'_> {
    /// Renders and measures all frames; after an interrupt those of the report, as far as there is time.
    /// An empty map has no pictures.
    pub(crate) fn render(&self, folder: &OutputFolder, progress: &Progress) -> RenderedPictures {
        let frames = &self.reconstruction.frames;
        let shown = frames_to_show(frames, REPORT_FRAMES);
        let mut viewer = self.reconstruction.viewer();
        let mut rendered = RenderedPictures::default();
        if self.reconstruction.map.is_empty() {
            return rendered;
        }
        // Pictures of a field take long: after an interrupt those alone whose time is known.
        let mut longest = match self.reconstruction.map {
            Map::Gaussians(_) => Duration::ZERO,
            Map::HashGrid(_) => LAST_PICTURES,
        };
        progress.step(RENDERING, 0, frames.len());
        for (i, frame) in frames.iter().enumerate() {
            let show = shown.contains(&i);
            let is_in_time = |since| show && since + longest <= LAST_PICTURES;
            if !interrupt::elapsed().is_none_or(is_in_time) {
                continue;
            }
            let started = Instant::now();
            self.frame(frame, show, &mut viewer, folder, &mut rendered);
            if show {
                longest = started.elapsed();
            }
            progress.step(RENDERING, i + 1, frames.len());
        }
        keep_widest_range(&mut rendered.comparisons);
        rendered
    }

    fn frame(
        &self,
        frame: &FrameEstimate,
        show: bool,
        viewer: &mut Viewer<'_>,
        folder: &OutputFolder,
        rendered: &mut RenderedPictures,
    ) {
        let file = rendered.failure.is_none() && !interrupt::requested() && self.wants_files(frame);
        let sharp_truth = self.position(frame).and_then(|p| self.truth.sharp(p));
        if !(file || show || sharp_truth.is_some()) {
            return;
        }
        let sharp = viewer.sharp(frame);
        let input = self.position(frame).and_then(|p| self.sequence.load(p).ok());
        let taken = input.as_ref().map(|input| &*input.colour);
        if let Some(truth) = &sharp_truth {
            rendered.metrics.sharp(frame.blur_length, (&sharp, taken), truth);
        }
        if !(file || show) {
            return;
        }
        let blurred = viewer.blurred(frame);
        let hdr = viewer.hdr(frame.middle());
        let depth = viewer.depth(frame.middle());
        let opacity = viewer.opacity(frame.middle());
        let RenderedPictures { metrics, failure, .. } = rendered;
        let write = || match file {
            true => {
                write_all(folder, frame.index, [&sharp, &blurred, &hdr, &depth, &opacity]).err()
            }
            false => None,
        };
        let measure = || {
            taken.iter().for_each(|taken| metrics.blurred(&blurred, taken));
            let apart = self.sequence.len().div_ceil(MAX_RADIANCE).max(1);
            if self.position(frame).is_some_and(|position| position.is_multiple_of(apart)) {
                metrics.radiance(&hdr, self.truth, frame.index);
            }
        };
        // Neither uses more than one thread by itself.
        let (error, ()) = rayon::join(write, measure);
        *failure = failure.take().or(error);
        if let (true, Some(input)) = (show, input) {
            let brackets = self.brackets(frame, viewer);
            let input = std::sync::Arc::unwrap_or_clone(input.colour);
            let index = frame.index;
            rendered.comparisons.push(Comparison { index, input, sharp, blurred, depth, brackets });
        }
    }

    fn wants_files(&self, frame: &FrameEstimate) -> bool {
        match self.renders {
            RenderSelection::All => true,
            RenderSelection::Keyframes => frame.keyframe,
            RenderSelection::None => false,
        }
    }

    /// Position of a frame in the sequence.
    fn position(&self, frame: &FrameEstimate) -> Option<usize> {
        self.sequence.entries.binary_search_by_key(&frame.index, |entry| entry.index).ok()
    }

    fn brackets(&self, frame: &FrameEstimate, viewer: &mut Viewer<'_>) -> Vec<(f64, Image<f32>)> {
        if !self.reconstruction.config.formation.tone {
            return Vec::new();
        }
        let mut at = |stops: f64| {
            let mut other = frame.clone();
            other.tone.log_exposure += (stops * std::f64::consts::LN_2) as f32;
            (stops, viewer.sharp(&other))
        };
        STOPS.map(&mut at).to_vec()
    }
}

/// Writes the pictures of a frame; the first error is that of the first kind that failed.
fn write_all(
    folder: &OutputFolder,
    index: usize,
    pictures: [&Image<f32>; 5],
) -> Result<(), ResultError> {
    let kinds = RenderKind::ALL.into_par_iter().zip(pictures).with_max_len(1);
    let written: Vec<_> =
        kinds.map(|(kind, picture)| save_render(folder, "renders", kind, index, picture)).collect();
    written.into_iter().collect()
}

/// Keeps the exposures of the frame with the most pixels that are burnt out or black.
fn keep_widest_range(comparisons: &mut [Comparison]) {
    let lost =
        |c: &Comparison| c.input.data.iter().filter(|&&v| !(0.02..0.98).contains(&v)).count();
    let widest = (0..comparisons.len()).max_by_key(|&i| lost(&comparisons[i]));
    for (i, comparison) in comparisons.iter_mut().enumerate() {
        if Some(i) != widest {
            comparison.brackets.clear();
        }
    }
}

/// Largest number of frames for radiance, which is compared for all of them at once.
const MAX_RADIANCE: usize = 100;

impl ImageMetrics {
    fn blurred(&mut self, predicted: &Image<f32>, taken: &Image<f32>) {
        let measured = psnr(&in_range(predicted), taken);
        self.psnr_blurred.extend(measured.ok().filter(|v| v.is_finite()));
    }

    /// Compares a render, and the picture taken, with the true sharp picture.
    fn sharp(
        &mut self,
        blur_length: f64,
        (rendered, taken): (&Image<f32>, Option<&Image<f32>>),
        truth: &Image<f32>,
    ) {
        let rendered = in_range(rendered);
        let finite = |value: &f64| value.is_finite();
        let of_render = psnr(&rendered, truth).ok().filter(finite);
        let of_taken = taken.and_then(|taken| psnr(taken, truth).ok()).filter(finite);
        self.psnr_sharp.extend(of_render);
        self.psnr_taken.extend(of_taken);
        self.ssim_sharp.extend(ssim(&rendered, truth).ok());
        if let (true, Some(of_render), Some(of_taken)) =
            (blur_length > LONG_BLUR, of_render, of_taken)
        {
            self.blurred[0].push(of_render);
            self.blurred[1].push(of_taken);
        }
    }

    fn radiance(&mut self, rendered: &Image<f32>, truth: &GroundTruth, index: usize) {
        let known = truth.radiance(index).and_then(|path| read_exr(&path).ok());
        let Some(known) = known.and_then(|known| at_size_of(known, rendered)) else { return };
        self.radiance[0].push(rendered.clone());
        self.radiance[1].push(known);
    }

    /// Writes the means over all frames.
    pub(crate) fn write_to(&self, metrics: &mut Metrics) {
        metrics.psnr_blurred_db = mean(&self.psnr_blurred);
        metrics.psnr_blurred_frames = self.psnr_blurred.len();
        metrics.psnr_sharp_db = mean(&self.psnr_sharp);
        metrics.ssim_sharp = mean(&self.ssim_sharp);
        metrics.sharp_frames = self.psnr_sharp.len();
        metrics.psnr_taken_db = mean(&self.psnr_taken);
        metrics.frames_over_2px = self.blurred[0].len();
        metrics.psnr_sharp_over_2px_db = mean(&self.blurred[0]);
        metrics.psnr_taken_over_2px_db = mean(&self.blurred[1]);
        if self.radiance[0].is_empty() {
            return;
        }
        let [estimate, truth] = self.radiance.each_ref().map(|frames| stacked(frames));
        if let Ok(error) = hdr_error(Gain::Common, &estimate, &truth) {
            metrics.hdr_log2_rmse_stops = Some(error.log2_rmse_stops);
            metrics.hdr_mu_law_psnr_db = Some(error.mu_law_psnr_db);
            metrics.hdr_frames = self.radiance[0].len();
        }
    }
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Clamps a picture to `[0, 1]`, as it is written.
fn in_range(picture: &Image<f32>) -> Image<f32> {
    let data = picture.data.iter().map(|v| v.clamp(0.0, 1.0)).collect();
    Image { data, ..*picture }
}
