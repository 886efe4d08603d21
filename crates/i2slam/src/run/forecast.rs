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
    /// Measured before frames came, where they are mapped while they come.
    pace: Option<RuntimeEstimate>,
}

impl Forecaster {
    /// For a run that begins now, and maps frames after the last one.
    pub(super) fn new(config: &Config, sequence: &Sequence) -> Self {
        let (config, sequence) = (config.clone(), sequence.clone());
        Self { config, sequence, started: Instant::now(), is_done: false, pace: None }
    }

    /// For a run that begins now, and maps frames while they come.
    pub(super) fn of_online(config: &Config, sequence: &Sequence) -> Self {
        let mut forecaster = Self::new(config, sequence);
        forecaster.pace = forecaster.measure();
        Self { started: Instant::now(), ..forecaster }
    }

    /// The forecast, as soon as enough of the pictures were tracked, and mapped where this is done while
    /// they come: `done`, of which `keyframes` became keyframes. Does a little of everything to time
    /// it.
    pub(super) fn after(&mut self, done: usize, keyframes: usize) -> Option<RuntimeForecast> {
        let frames = self.sequence.len();
        if self.is_done || done < SAMPLE_FRAMES.min(frames) {
            return None;
        }
        self.is_done = true;
        let so_far = self.started.elapsed().as_secs_f64() / done as f64 * frames as f64;
        let keyframes = (keyframes * frames).div_ceil(done);
        let rest = match self.pace {
            Some(pace) => pace.finish(&self.config, keyframes, frames),
            None => self.measure()?.total(&self.config, keyframes, frames),
        };
        let size = (self.sequence.camera.width, self.sequence.camera.height);
        Some(RuntimeForecast { seconds: so_far + rest, frames, keyframes, size })
    }

    fn measure(&self) -> Option<RuntimeEstimate> {
        let Sequence { camera, frame_rate, .. } = &self.sequence;
        let colour = self.sequence.load(0).ok()?.colour;
        RuntimeEstimate::measure(&self.config, camera, *frame_rate, &colour)
    }
}
