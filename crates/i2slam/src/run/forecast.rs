//! Duration of a run, extrapolated from its first frames, and anew when all are tracked or placed.

use crate::config::{Config, HoldOut, MapKind};
use crate::keyframes::Stage as OdometryStage;
use crate::session::RuntimeEstimate;
use i2slam_dataset::Sequence;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Frames after which the share of keyframes among them is extrapolated.
const SAMPLE_FRAMES: usize = 24;

/// Time of the adjustment after the last frame over that of tracking all frames: by colour alone, and
/// with depth, where dense alignment is much of it. Measured 0.5 to 0.74 and 3 to 4.3 on dining-room,
/// tum_fr1_rpy_fast and the demo.
const ADJUSTMENT: [f64; 2] = [0.65, 3.5];

/// Time of finding and adjusting the path of photographs once they are matched, and of their motion, over that
/// of tracking them all: with a known focal length, and with one that is searched. Measured 2.1 on 27 photographs,
/// and 2.2 and 2.6 on 16 and 21, as the next.
const PHOTOGRAPHS: [f64; 2] = [1.6, 2.25];

/// Times of dense depth, of mapping apart from it and of the end over those that are extrapolated from what is
/// timed. Measured 0.8 to 1.1, 1.3 to 2.1 and 0.9 to 1.1 on 27 photographs of `stills`, 16 of a room of `synth`
/// and 21 of tum_fr1_rpy_clip at 640x480.
const PHOTOGRAPH_PARTS: [f64; 3] = [0.9, 1.7, 1.1];

/// Part of the pairs of photographs, one in so many, after whose matching a forecast is made.
const MATCHED_ONE_IN: usize = 8;

/// Relative change of a forecast that is worth telling: a later part of a sequence may have more keyframes.
const MIN_CHANGE: f64 = 0.15;

/// Expected duration of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RuntimeForecast {
    /// Wall time of the whole run [s].
    pub seconds: f64,
    /// Frames of the sequence.
    pub frames: usize,
    /// Keyframes that they will give; of photographs, which all are, those that have a pose.
    pub keyframes: usize,
    /// Width and height of the mapped pictures [px].
    pub size: (usize, usize),
    /// True if all frames are tracked or photographs placed, and an earlier forecast is replaced.
    pub is_second: bool,
    /// True if the frames are photographs in any order.
    pub is_unordered: bool,
}

/// Forecasts of one run, made by all who see how long its path takes.
pub(super) struct RunForecasts {
    forecaster: Mutex<Forecaster>,
    /// True if the pictures so far are photographs.
    is_unordered: AtomicBool,
    /// Time that a preview of the map took so far.
    preview_microseconds: AtomicU64,
}

impl RunForecasts {
    /// For a run that begins now.
    pub(super) fn new(config: &Config, sequence: &Sequence) -> Self {
        let forecaster = Mutex::new(Forecaster::new(config, sequence));
        let (is_unordered, preview_microseconds) = (AtomicBool::new(false), AtomicU64::new(0));
        Self { forecaster, is_unordered, preview_microseconds }
    }

    /// Tells whether the pictures so far are photographs.
    pub(super) fn set_unordered(&self, is_unordered: bool) {
        self.is_unordered.store(is_unordered, Ordering::Relaxed);
    }

    /// Adds the time of a step of a preview.
    pub(super) fn add_preview(&self, taken: Duration) {
        self.preview_microseconds.fetch_add(taken.as_micros() as u64, Ordering::Relaxed);
    }

    /// The forecast, if progress of the front end allows one, and it has changed.
    pub(super) fn after_progress(
        &self,
        stage: OdometryStage,
        done: usize,
        of: usize,
    ) -> Option<RuntimeForecast> {
        let mut forecaster = self.forecaster.lock().ok()?;
        match stage {
            OdometryStage::Tracking { keyframes } if !self.is_unordered.load(Ordering::Relaxed) => {
                let preview = 1e-6 * self.preview_microseconds.load(Ordering::Relaxed) as f64;
                forecaster.after((done, keyframes), preview)
            }
            OdometryStage::Matching => forecaster.after_pairs(done, of),
            _ => None,
        }
    }

    /// The forecast once the path and motions of photographs are found, if it has changed.
    pub(super) fn after_placing(&self, placed: usize) -> Option<RuntimeForecast> {
        self.forecaster.lock().ok()?.after_placing(placed)
    }
}

/// Makes the forecasts of one run.
struct Forecaster {
    config: Config,
    sequence: Sequence,
    started: Instant,
    /// True if depth is measured.
    has_depth: bool,
    /// Measured with the first forecast, in `measuring` [s].
    pace: Option<RuntimeEstimate>,
    measuring: f64,
    /// Set once photographs are matched.
    photographs: Option<Photographs>,
    /// The last forecast [s].
    last: Option<f64>,
}

/// Photographs that are being matched.
struct Photographs {
    /// Time of tracking them all [s].
    tracking: f64,
    /// Begin of their matching, after what is timed.
    matching: Instant,
    is_told: bool,
}

impl Forecaster {
    /// For a run that begins now.
    fn new(config: &Config, sequence: &Sequence) -> Self {
        let (config, sequence) = (config.clone(), sequence.clone());
        let (started, has_depth) = (Instant::now(), sequence.frames_with_depth() > 0);
        let (pace, measuring, photographs, last) = (None, 0.0, None, None);
        Self { config, sequence, started, has_depth, pace, measuring, photographs, last }
    }

    /// The forecast, as soon as enough of the pictures were tracked and, if it has changed, when all were:
    /// `done`, of which `keyframes` became keyframes, while a preview of the map took `preview` [s]. Does a
    /// little of everything to time it.
    fn after(
        &mut self,
        (done, keyframes): (usize, usize),
        preview: f64,
    ) -> Option<RuntimeForecast> {
        let frames = self.sequence.len();
        let is_second = self.last.is_some();
        let due = if is_second { frames } else { SAMPLE_FRAMES.min(frames) };
        if done < due {
            return None;
        }
        let elapsed = self.started.elapsed().as_secs_f64() - self.measuring;
        let path_keyframes = (keyframes * frames).div_ceil(done);
        let keyframes = self.config.fitted_keyframes(path_keyframes, self.frames_not_held_out());
        let pace = match self.pace {
            Some(pace) => pace,
            None => {
                let clock = Instant::now();
                let pace = self.measure(false)?;
                self.measuring = clock.elapsed().as_secs_f64();
                *self.pace.insert(pace)
            }
        };
        let maps_between = self.has_depth && self.config.map.kind == MapKind::Gaussian;
        let mapped = if maps_between { frames } else { keyframes };
        let dense = if self.has_depth { path_keyframes } else { keyframes };
        let mapping = pace.mapping(&self.config, (path_keyframes, dense), mapped);
        let path = path_seconds(elapsed - preview, (done, frames), self.has_depth);
        let preview = preview * frames as f64 / done as f64;
        let after = mapping + pace.finish(&self.config, keyframes, frames);
        let seconds = self.measuring + path + preview + after;
        let is_told = self.last.is_none_or(|last| is_news(seconds, last));
        self.last = Some(seconds);
        is_told.then(|| RuntimeForecast { is_second, ..self.forecast(seconds, keyframes) })
    }

    fn frames_not_held_out(&self) -> usize {
        let mut hold_out = HoldOut::new(&self.config.mapping);
        self.sequence.entries.iter().filter(|entry| !hold_out.decide(entry.index)).count()
    }

    /// The forecast of photographs, once enough of their pairs were matched: `done` of `pairs`. Times a little
    /// of everything before.
    fn after_pairs(&mut self, done: usize, pairs: usize) -> Option<RuntimeForecast> {
        if self.photographs.is_none() {
            let tracking = self.started.elapsed().as_secs_f64();
            self.pace = self.measure(true);
            let (matching, is_told) = (Instant::now(), false);
            self.photographs = Some(Photographs { tracking, matching, is_told });
        }
        let (pace, found) = (self.pace?, self.photographs.as_mut()?);
        if found.is_told || done == 0 || done * MATCHED_ONE_IN < pairs {
            return None;
        }
        found.is_told = true;
        let after = found.matching.elapsed().as_secs_f64() * (pairs - done) as f64 / done as f64;
        let ratio = PHOTOGRAPHS[usize::from(self.sequence.camera_is_guess)];
        let path = self.started.elapsed().as_secs_f64() + after + ratio * found.tracking;
        let count = self.sequence.len();
        let seconds = path + self.mapping_of_photographs(&pace, count);
        self.last = Some(seconds);
        Some(RuntimeForecast { is_unordered: true, ..self.forecast(seconds, count) })
    }

    /// The forecast of photographs once their path and motions are found, and `placed` of them have a pose; `None`
    /// if it has not changed.
    fn after_placing(&mut self, placed: usize) -> Option<RuntimeForecast> {
        let (pace, last) = (self.pace?, self.last?);
        let mapping = self.mapping_of_photographs(&pace, placed);
        let seconds = self.started.elapsed().as_secs_f64() + mapping;
        self.last = Some(seconds);
        let (is_second, is_unordered) = (true, true);
        let forecast = self.forecast(seconds, placed);
        is_news(seconds, last).then_some(RuntimeForecast { is_second, is_unordered, ..forecast })
    }

    /// Time of so many photographs with a pose, from dense depth to the end [s].
    fn mapping_of_photographs(&self, pace: &RuntimeEstimate, count: usize) -> f64 {
        let dense = pace.dense_depth * count as f64;
        let mapping = pace.mapping(&self.config, (count, count), count) - dense;
        let finish = pace.finish(&self.config, count, count);
        let [over_dense, over_mapping, over_finish] = PHOTOGRAPH_PARTS;
        over_dense * dense + over_mapping * mapping + over_finish * finish
    }

    /// A first forecast of a film.
    fn forecast(&self, seconds: f64, keyframes: usize) -> RuntimeForecast {
        let size = (self.sequence.camera.width, self.sequence.camera.height);
        let (is_second, is_unordered) = (false, false);
        let frames = self.sequence.len();
        RuntimeForecast { seconds, frames, keyframes, size, is_second, is_unordered }
    }

    fn measure(&self, is_unordered: bool) -> Option<RuntimeEstimate> {
        let Sequence { camera, frame_rate, .. } = &self.sequence;
        let colour = self.sequence.load(0).ok()?.colour;
        RuntimeEstimate::measure(&self.config, camera, *frame_rate, (&colour, is_unordered))
    }
}

/// True if a forecast differs from the last one by what is worth telling.
fn is_news(seconds: f64, last: f64) -> bool {
    (seconds / last).ln().abs() > MIN_CHANGE
}

/// Time of finding the path of all `frames` [s], of which `done` were tracked in `elapsed`.
fn path_seconds(elapsed: f64, (done, frames): (usize, usize), has_depth: bool) -> f64 {
    (1.0 + ADJUSTMENT[usize::from(has_depth)]) * elapsed * frames as f64 / done as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_path_takes_tracking_and_adjustment() {
        // 6 s for 20 of 50 frames, and the adjustment in proportion.
        assert!((path_seconds(6.0, (20, 50), true) - 4.5 * 15.0).abs() < 1e-9);
        assert!((path_seconds(10.0, (20, 50), false) - 1.65 * 25.0).abs() < 1e-9);
    }
}
