//! Frames with depth, tracked and mapped one by one.

use super::observer::RunContext;
use super::runner::{self, FrameConsumer};
use super::{RunError, RunOptions, RunOutcome, Stage, shortfall};
use crate::reconstruction::{FrameEstimate, Reconstruction};
use crate::session::{Session, SessionError};
use crate::warning::Warning;
use i2slam_dataset::{Frame, Sequence};
use std::sync::Arc;
use std::time::Instant;

/// Tracks and maps every frame.
pub(super) fn run(
    sequence: &Sequence,
    options: &RunOptions,
    context: &RunContext,
) -> Result<RunOutcome, RunError> {
    let started = Instant::now();
    let mut session = Session::tracking(options.config.clone(), sequence.camera, sequence.frame_rate);
    session.set_cancellation(context.cancellation.clone());
    if let Some(valid_mask) = &sequence.valid_mask {
        session.set_valid_mask(Arc::clone(valid_mask));
    }
    context.observer.progress(Stage::Frames, 0, sequence.len());
    let none_usable = match sequence.len() {
        1 => "the only frame could not be used".to_owned(),
        all => format!("none of the {all} frames could be used"),
    };
    runner::run(session, sequence.stream(), sequence.len(), (started, &none_usable), context)
}

impl FrameConsumer for Session {
    type Item = Frame;
    const ITEM: &'static str = "frame";
    const LAST_STAGE: Stage = Stage::MapRefinement;

    fn process(&mut self, frame: Frame) -> (Result<(), SessionError>, Vec<Warning>) {
        let processed = self.track(&frame).map(|_| ());
        let mut warnings = Self::take_warnings(self);
        if warnings.is_empty() {
            let of_file = frame.warnings.iter().map(|w| Warning::of_frame(frame.index, w));
            warnings.extend(of_file);
        }
        (processed, warnings)
    }

    fn finish(&mut self, on_step: &mut dyn FnMut(usize, usize) -> bool) {
        Self::finish(self, on_step);
    }

    fn frames(&self) -> &[FrameEstimate] {
        Self::frames(self)
    }

    fn take_warnings(&mut self) -> Vec<Warning> {
        Self::take_warnings(self)
    }

    fn shortfalls(&self) -> Vec<String> {
        let held_out = shortfall::of_holding_out(self.mapping_settings(), (self.frames().len(), "frame"));
        let readout = self.is_readout_missing().then(|| {
            "no readout of a rolling shutter was found: no frame shows it \
             (input.optimise_rolling_shutter)"
                .to_owned()
        });
        held_out.into_iter().chain(readout).collect()
    }

    fn reconstruction(&self) -> Reconstruction {
        Self::reconstruction(self)
    }
}
