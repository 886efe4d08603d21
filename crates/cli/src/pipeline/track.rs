//! The frames of a sequence through a session.

use crate::failure::{Failure, without_panics};
use crate::interrupt;
use crate::progress::Progress;
use i2slam::dataset::{DatasetError, Frame, Sequence};
use i2slam::{Config, Reconstruction, Session, SessionError};
use std::sync::Arc;
use std::time::Instant;

/// What a session left.
pub(crate) struct Tracked {
    pub(crate) reconstruction: Reconstruction,
    /// Frames whose images could not be used.
    pub(crate) skipped: usize,
    /// Wall time from the first frame to the finished map [s].
    pub(crate) seconds: f64,
    /// Whether every frame of the sequence was reached and the map was finished.
    pub(crate) complete: bool,
    /// Why the run ended early, if not by the user.
    pub(crate) problem: Option<String>,
}

/// Track and map every frame until the sequence or the user's patience ends. A frame that cannot
/// be read is left out with a warning.
pub(crate) fn track(
    config: &Config,
    sequence: &Sequence,
    progress: &mut Progress,
) -> Result<Tracked, Failure> {
    let clock = Instant::now();
    let mut session = Session::new(config.clone(), sequence.camera, sequence.frame_rate);
    if let Some(covered) = &sequence.covered {
        session.set_covered(Arc::clone(covered));
    }
    let mut run = Run { session, skipped: 0, first_error: None };
    let end = without_panics(|| run.frames(sequence, progress));
    let mut problem = match end {
        Err(Failure::Failed(message) | Failure::Usage(message)) => Some(message),
        _ => None,
    };
    if run.session.frames().is_empty() && !interrupt::requested() {
        let reason = problem.or(run.first_error).unwrap_or_default();
        let message = match sequence.len() {
            1 => format!("the only frame could not be used: {reason}"),
            all => format!("none of the {all} frames could be used: {reason}"),
        };
        return Err(Failure::Failed(message));
    }
    if problem.is_none() && !interrupt::requested() {
        problem = run.finish(progress).err().and_then(|f| f.message().map(str::to_owned));
    }
    Ok(Tracked {
        reconstruction: run.session.reconstruction(),
        skipped: run.skipped,
        seconds: clock.elapsed().as_secs_f64(),
        complete: problem.is_none() && !interrupt::requested(),
        problem,
    })
}

struct Run {
    session: Session,
    skipped: usize,
    first_error: Option<String>,
}

impl Run {
    fn frames(&mut self, sequence: &Sequence, progress: &mut Progress) -> Result<(), Failure> {
        let total = sequence.len();
        for (done, frame) in sequence.stream().enumerate() {
            if interrupt::requested() {
                return Err(Failure::Interrupted);
            }
            self.frame(frame, progress)?;
            if let Some(estimate) = self.session.frames().last() {
                progress.frame(estimate, done + 1, total);
            }
        }
        Ok(())
    }

    fn frame(
        &mut self,
        frame: Result<Frame, DatasetError>,
        progress: &Progress,
    ) -> Result<(), Failure> {
        let frame = match frame {
            Ok(frame) => frame,
            Err(error) => {
                self.leave_out(error.to_string(), progress);
                return Ok(());
            }
        };
        match self.session.process(&frame) {
            Ok(_) => {}
            Err(error @ SessionError::Map { .. }) => {
                return Err(Failure::Failed(error.to_string()));
            }
            Err(error) => self.leave_out(error.to_string(), progress),
        }
        let mut warnings = self.session.take_warnings();
        if warnings.is_empty() {
            let odd = frame.warnings.iter().map(|w| format!("frame {}: {w}", frame.index));
            warnings.extend(odd);
        }
        warnings.iter().for_each(|warning| progress.warn(warning));
        Ok(())
    }

    fn leave_out(&mut self, reason: String, progress: &Progress) {
        progress.warn(&format!("frame left out: {reason}"));
        self.skipped += 1;
        self.first_error.get_or_insert(reason);
    }

    fn finish(&mut self, progress: &mut Progress) -> Result<(), Failure> {
        let mut begun = false;
        without_panics(|| {
            self.session.finish(&mut |done, of| {
                if !begun {
                    progress.phase("refining the map", of);
                    begun = true;
                }
                progress.step(done);
                !interrupt::requested()
            });
            Ok(())
        })
    }
}
