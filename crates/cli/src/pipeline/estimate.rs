//! What a long job by colour alone will take, told after a few frames.

use super::Job;
use super::posed::picture;
use i2slam::dataset::Sequence;
use i2slam::{Config, RuntimeEstimate};
use std::time::Instant;

/// Frames after which the keyframes among them tell how many there will be.
const FEW: usize = 24;
/// Smaller pictures are not advised [px].
const MIN_ADVISED: usize = 240;
/// Shorter jobs are not worth a word [s].
const LONG: f64 = 60.0;

/// Tells once what a job will take.
pub(super) struct Estimate {
    config: Config,
    sequence: Sequence,
    /// Whether flags can make the job smaller: the program's own clip takes none.
    is_adjustable: bool,
    started: Instant,
    is_told: bool,
}

impl Estimate {
    /// Of a job that begins now.
    pub(super) fn new(job: &Job, sequence: &Sequence) -> Self {
        Self {
            config: job.config.clone(),
            sequence: sequence.clone(),
            is_adjustable: job.title.is_none(),
            started: Instant::now(),
            is_told: false,
        }
    }

    /// What there is to tell once points were followed through `done` pictures, of which
    /// `keyframes` became some.
    pub(super) fn after(&mut self, done: usize, keyframes: usize) -> Option<String> {
        let frames = self.sequence.len();
        if self.is_told || done < FEW.min(frames) {
            return None;
        }
        self.is_told = true;
        let following = self.started.elapsed().as_secs_f64() / done as f64 * frames as f64;
        let camera = &self.sequence.camera;
        let colour = picture(&self.sequence, 0).ok()?.colour;
        let rate = self.sequence.frame_rate;
        let pace = RuntimeEstimate::measure(&self.config, camera, rate, &colour)?;
        let keyframes = (keyframes * frames).div_ceil(done);
        let seconds = following + pace.total(&self.config, keyframes, frames);
        let size = (camera.width, camera.height);
        let advice = if self.is_adjustable { advice(size) } else { String::new() };
        (seconds > LONG).then(|| words(seconds, (frames, keyframes), size) + &advice)
    }
}

/// The estimate, and what it is of.
fn words(
    seconds: f64,
    (frames, keyframes): (usize, usize),
    (width, height): (usize, usize),
) -> String {
    format!(
        "this will take about {}: {frames} frames of {width}x{height} px, some {keyframes} \
         keyframes",
        minutes(seconds)
    )
}

/// What makes a job smaller.
fn advice((width, height): (usize, usize)) -> String {
    let half = width.max(height) / 2;
    let smaller = match half >= MIN_ADVISED {
        true => format!("--max-side {half} would take about a third of that, "),
        false => String::new(),
    };
    format!("; {smaller}--stride N takes every N-th frame, --frames A..B a part")
}

/// A time that is known roughly.
fn minutes(seconds: f64) -> String {
    let minutes = seconds / 60.0;
    match minutes {
        m if m < 1.5 => format!("{:.0} s", 10.0 * (seconds / 10.0).round()),
        m if m < 90.0 => format!("{m:.0} min"),
        m => format!("{:.1} h", m / 60.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_rounded_as_they_are_known() {
        assert_eq!(minutes(63.0), "60 s");
        assert_eq!(minutes(754.0), "13 min");
        assert_eq!(minutes(3.0 * 3600.0), "3.0 h");
        let told = words(600.0, (300, 62), (480, 640)) + &advice((480, 640));
        for part in
            ["10 min", "300 frames of 480x640 px", "62 keyframes", "--max-side 320", "--stride"]
        {
            assert!(told.contains(part), "{told}");
        }
        assert!(!advice((320, 240)).contains("--max-side"));
    }
}
