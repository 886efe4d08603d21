//! Duration of a run by colour alone, extrapolated from its first frames.

use crate::config::Config;
use crate::session::RuntimeEstimate;
use i2slam_dataset::Sequence;
use std::time::Instant;

/// Frames after which the share of keyframes among them is extrapolated.
const SAMPLE_FRAMES: usize = 24;

/// Expected duration of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RuntimeForecast {
    /// Wall time of the whole run [s].
    pub seconds: f64,
    /// Frames of the sequence.
    pub frames: usize,
    /// Keyframes that they will give.
    pub keyframes: usize,
    /// Width and height of the mapped pictures [px].
    pub size: (usize, usize),
}

/// Makes the forecast of one run, once.
pub(super) struct Forecaster {
    config: Config,
    sequence: Sequence,
    started: Instant,
    is_done: bool,
}

impl Forecaster {
    /// For a run that begins now.
    pub(super) fn new(config: &Config, sequence: &Sequence) -> Self {
        let (config, sequence) = (config.clone(), sequence.clone());
        Self { config, sequence, started: Instant::now(), is_done: false }
    }

    /// The forecast, as soon as points were followed through enough of the pictures: through
    /// `done`, of which `keyframes` became keyframes. Does a little of everything to time it.
    pub(super) fn after(&mut self, done: usize, keyframes: usize) -> Option<RuntimeForecast> {
        let frames = self.sequence.len();
        if self.is_done || done < SAMPLE_FRAMES.min(frames) {
            return None;
        }
        self.is_done = true;
        let following = self.started.elapsed().as_secs_f64() / done as f64 * frames as f64;
        let camera = &self.sequence.camera;
        let colour = self.sequence.load(0).ok()?.colour;
        let pace =
            RuntimeEstimate::measure(&self.config, camera, self.sequence.frame_rate, &colour)?;
        let keyframes = (keyframes * frames).div_ceil(done);
        let seconds = following + pace.total(&self.config, keyframes, frames);
        Some(RuntimeForecast { seconds, frames, keyframes, size: (camera.width, camera.height) })
    }
}
