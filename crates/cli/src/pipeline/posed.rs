//! Keyframes that come with poses through a session.

use super::Job;
use super::track::Tracked;
use crate::failure::{Failure, without_panics};
use crate::interrupt;
use crate::progress::Progress;
use i2slam::dataset::{OpenOptions, Sequence};
use i2slam::keyframes::{
    ImportDepth, ImportOptions, Intrinsics, KeyframeSource, Native, PosedKeyframe, SequencePicture,
    import,
};
use i2slam::{KeyframedSession, SessionError};
use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// Where keyframes come from.
pub(crate) enum Keyframes {
    /// From the pictures alone.
    Native,
    /// From files.
    Files {
        path: PathBuf,
        depth: ImportDepth,
        /// Folder with the variance of depth pictures.
        variance: Option<PathBuf>,
    },
}

/// A source of keyframes, how many it has, and what there is to say of it.
struct Opened<'a> {
    source: Box<dyn KeyframeSource + 'a>,
    count: usize,
    frame_rate: f64,
    warnings: Vec<String>,
}

impl Keyframes {
    /// The keyframes with the pictures of a dataset.
    fn open<'a>(
        &self,
        pictures: &Path,
        open: &OpenOptions,
        sequence: &'a Sequence,
    ) -> Result<Opened<'a>, Failure> {
        match self {
            Self::Native => native(sequence),
            Self::Files { path, depth, variance } => {
                let options = ImportOptions {
                    open: open.clone(),
                    depth: *depth,
                    variance: variance.clone(),
                    ..ImportOptions::default()
                };
                let source = import(path, Some(pictures), &options)?;
                let (count, frame_rate) = (source.len(), source.files().frame_rate);
                let warnings = source.files().warnings.clone();
                Ok(Opened { source: Box::new(source), count, frame_rate, warnings })
            }
        }
    }
}

/// Finds the path of the camera from the pictures.
fn native(sequence: &Sequence) -> Result<Opened<'_>, Failure> {
    let load = |place| {
        let frame = sequence.load(place)?;
        let (index, timestamp) = (frame.index, frame.timestamp);
        Ok(SequencePicture { index, timestamp, colour: frame.colour })
    };
    let source = Native::find(Intrinsics::Known(sequence.camera), sequence.len(), load)
        .map_err(|error| Failure::Failed(format!("no path of the camera was found: {error}")))?;
    let refused = source.refused().iter();
    let mut warnings: Vec<String> =
        refused.map(|(place, why)| format!("picture {place} left out: {why}")).collect();
    warnings.extend(source.reconstruction().warnings.iter().map(ToString::to_string));
    let count = source.len();
    Ok(Opened { source: Box::new(source), count, frame_rate: sequence.frame_rate, warnings })
}

/// Take in every keyframe until the source or the user's patience ends. A keyframe that cannot be
/// read is left out with a warning.
pub(super) fn track(
    job: &Job,
    keyframes: &Keyframes,
    sequence: &Sequence,
    progress: &mut Progress,
) -> Result<Tracked, Failure> {
    let clock = Instant::now();
    let opened = without_panics(|| keyframes.open(&job.dataset, &job.open, sequence))?;
    opened.warnings.iter().for_each(|warning| progress.warn(warning));
    let Opened { mut source, count, frame_rate, .. } = opened;
    let session = KeyframedSession::new(job.config.clone(), *source.camera(), frame_rate);
    let mut run = Run { session, total: count, skipped: 0, first_error: None };
    if let Some(covered) = &sequence.covered {
        run.session.set_covered(Arc::clone(covered));
    }
    let end = without_panics(|| run.keyframes(source.as_mut(), progress));
    let mut problem = match end {
        Err(Failure::Failed(message) | Failure::Usage(message)) => Some(message),
        _ => None,
    };
    if run.session.frames().is_empty() && !interrupt::requested() {
        let reason = problem.or(run.first_error).unwrap_or_else(|| "there are none".to_owned());
        return Err(Failure::Failed(format!("no keyframe could be used: {reason}")));
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
    session: KeyframedSession,
    /// Keyframes that there are.
    total: usize,
    skipped: usize,
    first_error: Option<String>,
}

impl Run {
    fn keyframes(
        &mut self,
        source: &mut dyn KeyframeSource,
        progress: &mut Progress,
    ) -> Result<(), Failure> {
        let mut done = 0;
        while let Some(keyframe) = source.next_keyframe() {
            if interrupt::requested() {
                return Err(Failure::Interrupted);
            }
            self.keyframe(keyframe, progress)?;
            done += 1;
            if let Some(estimate) = self.session.frames().last() {
                progress.frame(estimate, done, self.total);
            }
        }
        Ok(())
    }

    fn keyframe(
        &mut self,
        keyframe: Result<PosedKeyframe, Box<dyn Error + Send + Sync>>,
        progress: &Progress,
    ) -> Result<(), Failure> {
        let keyframe = match keyframe {
            Ok(keyframe) => keyframe,
            Err(error) => {
                self.leave_out(error.to_string(), progress);
                return Ok(());
            }
        };
        match self.session.process(keyframe) {
            Ok(_) => {}
            Err(error @ SessionError::Map { .. }) => {
                return Err(Failure::Failed(error.to_string()));
            }
            Err(error) => self.leave_out(error.to_string(), progress),
        }
        self.session.take_warnings().iter().for_each(|warning| progress.warn(warning));
        Ok(())
    }

    fn leave_out(&mut self, reason: String, progress: &Progress) {
        progress.warn(&format!("keyframe left out: {reason}"));
        self.skipped += 1;
        self.first_error.get_or_insert(reason);
    }

    fn finish(&mut self, progress: &mut Progress) -> Result<(), Failure> {
        let mut begun = false;
        without_panics(|| {
            self.session.finish(&mut |done, of| {
                if !begun {
                    progress.phase("refining map and poses", of);
                    begun = true;
                }
                progress.step(done);
                !interrupt::requested()
            });
            Ok(())
        })?;
        self.session.take_warnings().iter().for_each(|warning| progress.warn(warning));
        Ok(())
    }
}
