//! Duration of a run, extrapolated from its first frames, and anew when all are tracked.

use crate::config::Config;
use crate::session::RuntimeEstimate;
use i2slam_dataset::Sequence;
use std::time::Instant;

/// Frames after which the share of keyframes among them is extrapolated.
const SAMPLE_FRAMES: usize = 24;

/// Time of the adjustment after the last frame over that of tracking all frames: by colour alone, and
/// with depth, where dense alignment is much of it. Measured 0.5 to 0.74 and 3 to 4.3 on dining-room,
/// tum_fr1_rpy_fast and the demo.
const ADJUSTMENT: [f64; 2] = [0.65, 3.5];

/// Share of the time so far that tracking took at least, where frames are mapped beside it.
const MIN_TRACKING: f64 = 0.3;

/// Relative change of a forecast that is worth telling: a later part of a sequence may have more keyframes.
const MIN_CHANGE: f64 = 0.15;

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
    /// True if all frames are tracked, and an earlier forecast is replaced.
    pub is_second: bool,
}

/// Makes the forecasts of one run.
pub(super) struct Forecaster {
    config: Config,
    sequence: Sequence,
    started: Instant,
    /// True if frames are mapped while they come.
    is_online: bool,
    /// Measured before frames came where they are mapped while they come, else with the first forecast.
    pace: Option<RuntimeEstimate>,
    /// The last forecast [s].
    last: Option<f64>,
}

impl Forecaster {
    /// For a run that begins now, and maps frames after the last one.
    pub(super) fn new(config: &Config, sequence: &Sequence) -> Self {
        let (config, sequence) = (config.clone(), sequence.clone());
        let (started, is_online, pace, last) = (Instant::now(), false, None, None);
        Self { config, sequence, started, is_online, pace, last }
    }

    /// For a run that begins now, and maps frames while they come.
    pub(super) fn of_online(config: &Config, sequence: &Sequence) -> Self {
        let mut forecaster = Self::new(config, sequence);
        forecaster.pace = forecaster.measure();
        Self { started: Instant::now(), is_online: true, ..forecaster }
    }

    /// The forecast, as soon as enough of the pictures were tracked and, if it has changed, when all were:
    /// `done`, of which `keyframes` became keyframes, and `mapped` were mapped meanwhile. Does a little of
    /// everything to time it.
    pub(super) fn after(
        &mut self,
        done: usize,
        keyframes: usize,
        mapped: usize,
    ) -> Option<RuntimeForecast> {
        let frames = self.sequence.len();
        let is_second = self.last.is_some();
        let due = if is_second { frames } else { SAMPLE_FRAMES.min(frames) };
        if done < due {
            return None;
        }
        let elapsed = self.started.elapsed().as_secs_f64();
        let keyframes = (keyframes * frames).div_ceil(done);
        let pace = self.pace.or_else(|| self.measure())?;
        self.pace = Some(pace);
        let mapped_frames = if self.is_online { frames } else { keyframes };
        let mapping = pace.mapping(&self.config, keyframes, mapped_frames);
        let mapped = mapping * mapped as f64 / frames as f64;
        let path = path_seconds((elapsed, mapped), (done, frames), self.is_online);
        let seconds = path + mapping + pace.finish(&self.config, keyframes, frames);
        let is_news = self.last.is_none_or(|last| (seconds / last).ln().abs() > MIN_CHANGE);
        self.last = Some(seconds);
        let size = (self.sequence.camera.width, self.sequence.camera.height);
        is_news.then_some(RuntimeForecast { seconds, frames, keyframes, size, is_second })
    }

    fn measure(&self) -> Option<RuntimeEstimate> {
        let Sequence { camera, frame_rate, .. } = &self.sequence;
        let colour = self.sequence.load(0).ok()?.colour;
        RuntimeEstimate::measure(&self.config, camera, *frame_rate, &colour)
    }
}

/// Time of finding the path of all `frames` [s], of which `done` were tracked in `elapsed`, `mapped` of it
/// for mapping beside them: both use all cores, so that their times add up.
fn path_seconds(
    (elapsed, mapped): (f64, f64),
    (done, frames): (usize, usize),
    has_depth: bool,
) -> f64 {
    let tracked = (elapsed - mapped).max(MIN_TRACKING * elapsed);
    (1.0 + ADJUSTMENT[usize::from(has_depth)]) * tracked * frames as f64 / done as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_path_takes_tracking_and_adjustment() {
        // 4 s of 10 were mapping: 6 s for 20 of 50 frames, and the adjustment in proportion.
        assert!((path_seconds((10.0, 4.0), (20, 50), true) - 4.5 * 15.0).abs() < 1e-9);
        assert!((path_seconds((10.0, 0.0), (20, 50), false) - 1.65 * 25.0).abs() < 1e-9);
        let least = path_seconds((10.0, 30.0), (20, 50), false);
        assert!((least - 1.65 * 7.5).abs() < 1e-9, "mapping took less than was expected");
    }
}
