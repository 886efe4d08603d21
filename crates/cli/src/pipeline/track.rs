//! The frames of a sequence through a session.

use super::drive::{Drive, Tracked, drive};
use crate::failure::Failure;
use crate::interrupt;
use crate::progress::Progress;
use i2slam::dataset::{Frame, Sequence};
use i2slam::{Config, FrameEstimate, Reconstruction, Session, SessionError, Warning};
use std::sync::Arc;
use std::time::Instant;

/// Track and map every frame.
pub(super) fn track(
    config: &Config,
    sequence: &Sequence,
    progress: &mut Progress,
) -> Result<Tracked, Failure> {
    let clock = Instant::now();
    let mut session = Session::new(config.clone(), sequence.camera, sequence.frame_rate);
    session.set_cancellation(interrupt::cancellation());
    if let Some(covered) = &sequence.covered {
        session.set_covered(Arc::clone(covered));
    }
    let none = match sequence.len() {
        1 => "the only frame could not be used".to_owned(),
        all => format!("none of the {all} frames could be used"),
    };
    drive(session, sequence.stream(), sequence.len(), (clock, &none), progress)
}

impl Drive for Session {
    type Item = Frame;
    const ITEM: &'static str = "frame";
    const FINISH: &'static str = "refining the map";

    fn take_in(&mut self, frame: Frame) -> (Result<(), SessionError>, Vec<Warning>) {
        let taken = self.process(&frame).map(|_| ());
        let mut warnings = Self::take_warnings(self);
        if warnings.is_empty() {
            let odd = frame.warnings.iter().map(|w| Warning::of_frame(frame.index, w));
            warnings.extend(odd);
        }
        (taken, warnings)
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

    fn reconstruction(&self) -> Reconstruction {
        Self::reconstruction(self)
    }
}
