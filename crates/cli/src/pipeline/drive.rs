//! Any session from its first frame to its finished map.

use super::camera::FoundCamera;
use crate::failure::{Failure, without_panics};
use crate::interrupt;
use crate::progress::Progress;
use i2slam::dataset::Sequence;
use i2slam::{FrameEstimate, Reconstruction, SessionError, Warning};
use std::fmt::Display;
use std::time::Instant;

/// What a session left.
pub(crate) struct Tracked {
    pub(crate) reconstruction: Reconstruction,
    /// Frames that it was given, those that have no pose included.
    pub(crate) given: usize,
    /// Frames whose images could not be used.
    pub(crate) skipped: usize,
    /// Wall time from the first frame to the finished map [s].
    pub(crate) seconds: f64,
    /// Whether every frame of the sequence was reached and the map was finished.
    pub(crate) complete: bool,
    /// Why the run ended early, if not by the user.
    pub(crate) problem: Option<String>,
    /// What the pictures told of the camera, if they were all there was.
    pub(crate) camera: Option<FoundCamera>,
    /// The sequence as it was used, if the pictures were freed of a lens that was found in them.
    pub(crate) undistorted: Option<Sequence>,
}

/// A session, and what it calls what it takes in.
pub(super) trait Drive {
    type Item;
    /// "frame", or what else it is.
    const ITEM: &'static str;
    /// What is done after the last one.
    const FINISH: &'static str;

    /// Takes one in; what there is to say of it.
    fn take_in(&mut self, item: Self::Item) -> (Result<(), SessionError>, Vec<Warning>);
    fn finish(&mut self, on_step: &mut dyn FnMut(usize, usize) -> bool);
    fn frames(&self) -> &[FrameEstimate];
    fn take_warnings(&mut self) -> Vec<Warning>;
    /// Keeps what is known without it of what was not taken in, because the user ended it.
    fn keep_the_rest(&mut self) {}
    fn reconstruction(&self) -> Reconstruction;
}

/// Takes in all items until they or the user's patience end. One that cannot be read is left out
/// with a warning. `clock` started when the run did, `none` words that not one could be used.
pub(super) fn drive<D: Drive, E: Display>(
    session: D,
    items: impl Iterator<Item = Result<D::Item, E>>,
    total: usize,
    (clock, none): (Instant, &str),
    progress: &mut Progress,
) -> Result<Tracked, Failure> {
    let mut run = Run { session, skipped: 0, first_error: None };
    let end = without_panics(|| run.items(items, total, progress));
    let mut problem = match end {
        Err(Failure::Failed(message) | Failure::Usage(message)) => Some(message),
        _ => None,
    };
    if interrupt::requested() {
        run.session.keep_the_rest();
    }
    if run.session.frames().is_empty() {
        if interrupt::requested() {
            progress
                .note(&format!("ended before the first {}: there is nothing to write", D::ITEM));
            return Err(Failure::Interrupted);
        }
        let reason = problem.or(run.first_error).unwrap_or_else(|| "there are none".to_owned());
        return Err(Failure::Failed(format!("{none}: {reason}")));
    }
    if problem.is_none() && !interrupt::requested() {
        problem = run.finish(progress).err().and_then(|f| f.message().map(str::to_owned));
        if interrupt::requested() {
            run.session.keep_the_rest();
        }
    }
    run.tell_warnings(progress);
    Ok(Tracked {
        reconstruction: run.session.reconstruction(),
        given: total,
        skipped: run.skipped,
        seconds: clock.elapsed().as_secs_f64(),
        complete: problem.is_none() && !interrupt::requested(),
        problem,
        camera: None,
        undistorted: None,
    })
}

struct Run<D> {
    session: D,
    skipped: usize,
    first_error: Option<String>,
}

impl<D: Drive> Run<D> {
    fn items<E: Display>(
        &mut self,
        items: impl Iterator<Item = Result<D::Item, E>>,
        total: usize,
        progress: &mut Progress,
    ) -> Result<(), Failure> {
        for (done, item) in items.enumerate() {
            if interrupt::requested() {
                return Err(Failure::Interrupted);
            }
            match item {
                Ok(item) => self.item(item, progress)?,
                Err(error) => self.leave_out(error.to_string(), progress),
            }
            if let Some(estimate) = self.session.frames().last() {
                progress.frame(estimate, done + 1, total);
            }
        }
        Ok(())
    }

    fn item(&mut self, item: D::Item, progress: &Progress) -> Result<(), Failure> {
        let (taken, warnings) = self.session.take_in(item);
        match taken {
            Ok(()) => {}
            Err(error @ SessionError::Map { .. }) => {
                return Err(Failure::Failed(error.to_string()));
            }
            Err(error) => self.leave_out(error.to_string(), progress),
        }
        warnings.into_iter().for_each(|warning| progress.warn(warning));
        Ok(())
    }

    fn leave_out(&mut self, reason: String, progress: &Progress) {
        progress.warn(format!("{} left out: {reason}", D::ITEM));
        self.skipped += 1;
        self.first_error.get_or_insert(reason);
    }

    fn tell_warnings(&mut self, progress: &Progress) {
        self.session.take_warnings().into_iter().for_each(|warning| progress.warn(warning));
    }

    fn finish(&mut self, progress: &mut Progress) -> Result<(), Failure> {
        let mut begun = false;
        without_panics(|| {
            self.session.finish(&mut |done, of| {
                if !begun {
                    progress.phase(D::FINISH, of);
                    begun = true;
                }
                progress.step(done);
                !interrupt::requested()
            });
            Ok(())
        })?;
        Ok(())
    }
}
