//! Keyframes that come with poses through a session.

use super::Job;
use super::drive::{Drive, Tracked, drive};
use crate::failure::{Failure, without_panics};
use crate::progress::Progress;
use i2slam::dataset::{OpenOptions, Sequence};
use i2slam::keyframes::{
    ImportDepth, ImportOptions, Intrinsics, KeyframeSource, Native, PosedKeyframe, SequencePicture,
    import,
};
use i2slam::{FrameEstimate, KeyframedSession, Reconstruction, SessionError};
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

/// Take in every keyframe.
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
    let mut session = KeyframedSession::new(job.config.clone(), *source.camera(), frame_rate);
    if let Some(covered) = &sequence.covered {
        session.set_covered(Arc::clone(covered));
    }
    let items = std::iter::from_fn(|| source.next_keyframe());
    drive(session, items, count, (clock, "no keyframe could be used"), progress)
}

impl Drive for KeyframedSession {
    type Item = PosedKeyframe;
    const ITEM: &'static str = "keyframe";
    const FINISH: &'static str = "refining map and poses";

    fn take_in(&mut self, keyframe: PosedKeyframe) -> (Result<(), SessionError>, Vec<String>) {
        let taken = self.process(keyframe).map(|_| ());
        (taken, Self::take_warnings(self))
    }

    fn finish(&mut self, on_step: &mut dyn FnMut(usize, usize) -> bool) {
        Self::finish(self, on_step);
    }

    fn frames(&self) -> &[FrameEstimate] {
        Self::frames(self)
    }

    fn take_warnings(&mut self) -> Vec<String> {
        Self::take_warnings(self)
    }

    fn reconstruction(&self) -> Reconstruction {
        Self::reconstruction(self)
    }
}
