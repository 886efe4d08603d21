//! Keyframes that come with poses through a session.

use super::track::Tracked;
use crate::failure::{Failure, without_panics};
use crate::interrupt;
use crate::progress::Progress;
use i2slam::dataset::{DatasetError, OpenOptions, Sequence};
use i2slam::keyframes::{
    Import, ImportDepth, ImportOptions, KeyframeSource, PosedKeyframe, import,
};
use i2slam::{Config, KeyframedSession, SessionError};
use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// Keyframes of files.
pub(crate) struct Keyframes {
    pub(crate) path: PathBuf,
    pub(crate) depth: ImportDepth,
    /// Folder with the variance of depth pictures.
    pub(crate) variance: Option<PathBuf>,
}

impl Keyframes {
    /// The keyframes with the pictures of a dataset.
    pub(super) fn open(&self, pictures: &Path, open: &OpenOptions) -> Result<Import, DatasetError> {
        let options = ImportOptions {
            open: open.clone(),
            depth: self.depth,
            variance: self.variance.clone(),
            ..ImportOptions::default()
        };
        import(&self.path, Some(pictures), &options)
    }
}

/// Take in every keyframe until the source or the user's patience ends. A keyframe that cannot be
/// read is left out with a warning.
pub(super) fn track(
    config: &Config,
    sequence: &Sequence,
    source: &mut Import,
    progress: &mut Progress,
) -> Result<Tracked, Failure> {
    let clock = Instant::now();
    let session =
        KeyframedSession::new(config.clone(), *source.camera(), source.files().frame_rate);
    let mut run = Run { session, total: source.len(), skipped: 0, first_error: None };
    if let Some(covered) = &sequence.covered {
        run.session.set_covered(Arc::clone(covered));
    }
    let end = without_panics(|| run.keyframes(source, progress));
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
