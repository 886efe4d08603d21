//! Loop over the frames of any session, from the first to the finished map.

use super::error::{RunError, catch_panic};
use super::observer::RunContext;
use super::{RunOutcome, Stage};
use crate::reconstruction::{FrameEstimate, Reconstruction};
use crate::session::SessionError;
use crate::warning::Warning;
use std::fmt::Display;
use std::time::Instant;

/// A session as the loop needs it.
pub(super) trait FrameConsumer {
    type Item;
    /// Name of an item in messages: "frame" or "keyframe".
    const ITEM: &'static str;
    /// Stage after the last item.
    const LAST_STAGE: Stage;

    /// Processes one item, and returns the warnings about it.
    fn process(&mut self, item: Self::Item) -> (Result<(), SessionError>, Vec<Warning>);
    /// Refines everything after the last item; `on_step(done, of)` returns false to stop.
    fn finish(&mut self, on_step: &mut dyn FnMut(usize, usize) -> bool);
    fn frames(&self) -> &[FrameEstimate];
    fn take_warnings(&mut self) -> Vec<Warning>;
    /// What was asked for and is not in the result, after the last item; a sentence each.
    fn shortfalls(&self) -> Vec<String>;
    /// Adds the poses that are known of items not processed, after cancellation.
    fn keep_unprocessed(&mut self) {}
    fn reconstruction(&self) -> Reconstruction;
}

/// Processes `total` items until they end or the run is cancelled. An unreadable item is left out
/// with a warning. `started` is when the run began; `none_usable` says in words that not one item
/// could be used.
pub(super) fn run<S: FrameConsumer, E: Display>(
    session: S,
    items: impl Iterator<Item = Result<S::Item, E>>,
    total: usize,
    (started, none_usable): (Instant, &str),
    context: &RunContext,
) -> Result<RunOutcome, RunError> {
    let mut runner = Runner { session, skipped: 0, first_error: None, context };
    let cancelled = || context.cancellation.is_cancelled();
    let mut problem = catch_panic(|| runner.process_all(items, total)).err();
    if cancelled() {
        runner.session.keep_unprocessed();
    }
    if runner.session.frames().is_empty() {
        if cancelled() {
            return Err(RunError::Cancelled { before: first(S::ITEM) });
        }
        let reason = problem.map(|error| error.to_string()).or(runner.first_error);
        let reason = reason.unwrap_or_else(|| "there are none".to_owned());
        return Err(RunError::NoUsableFrame { what: none_usable.to_owned(), reason });
    }
    if problem.is_none() && !cancelled() {
        problem = catch_panic(|| runner.finish()).err();
        if cancelled() {
            runner.session.keep_unprocessed();
        }
    }
    runner.session.take_warnings().into_iter().for_each(|warning| context.warn(warning));
    let complete = problem.is_none() && !cancelled();
    Ok(RunOutcome {
        reconstruction: runner.session.reconstruction(),
        frames_given: total,
        frames_skipped: runner.skipped,
        seconds: started.elapsed().as_secs_f64(),
        complete,
        problem,
        shortfalls: if complete { runner.session.shortfalls() } else { Vec::new() },
        camera: None,
        undistorted: None,
        warnings: Vec::new(),
    })
}

fn first(item: &str) -> &'static str {
    if item == "frame" { "the first frame" } else { "the first keyframe" }
}

struct Runner<'a, S> {
    session: S,
    skipped: usize,
    first_error: Option<String>,
    context: &'a RunContext,
}

impl<S: FrameConsumer> Runner<'_, S> {
    fn process_all<E: Display>(
        &mut self,
        items: impl Iterator<Item = Result<S::Item, E>>,
        total: usize,
    ) -> Result<(), RunError> {
        for (done, item) in items.enumerate() {
            if self.context.cancellation.is_cancelled() {
                return Ok(());
            }
            match item {
                Ok(item) => self.process(item)?,
                Err(error) => self.leave_out(error.to_string()),
            }
            if let Some(estimate) = self.session.frames().last() {
                self.context.observer.frame(estimate, done + 1, total);
            }
        }
        Ok(())
    }

    fn process(&mut self, item: S::Item) -> Result<(), RunError> {
        let (processed, warnings) = self.session.process(item);
        match processed {
            Ok(()) => {}
            // No later frame can start the map either.
            Err(error @ SessionError::Map { .. }) => return Err(error.into()),
            Err(error) => self.leave_out(error.to_string()),
        }
        warnings.into_iter().for_each(|warning| self.context.warn(warning));
        Ok(())
    }

    fn leave_out(&mut self, reason: String) {
        self.context.warn(format!("{} left out: {reason}", S::ITEM));
        self.skipped += 1;
        self.first_error.get_or_insert(reason);
    }

    fn finish(&mut self) -> Result<(), RunError> {
        let Self { session, context, .. } = self;
        session.finish(&mut |done, of| {
            context.observer.progress(S::LAST_STAGE, done, of);
            !context.cancellation.is_cancelled()
        });
        Ok(())
    }
}
