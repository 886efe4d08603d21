//! Keyframes that come with poses through a session.

use super::Job;
use super::camera::{self, FoundCamera};
use super::drive::{Drive, Tracked, drive};
use crate::failure::{Failure, without_panics};
use crate::interrupt;
use crate::progress::Progress;
use i2slam::dataset::{OpenOptions, Sequence};
use i2slam::keyframes::{
    ImportDepth, ImportOptions, KeyframeSource, Native, PosedKeyframe, SequencePicture, import,
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
    /// What the pictures told of the camera.
    camera: Option<FoundCamera>,
}

impl Keyframes {
    /// The keyframes with the pictures of a dataset.
    fn open<'a>(
        &self,
        pictures: &Path,
        open: &OpenOptions,
        sequence: &'a Sequence,
        progress: &Progress,
    ) -> Result<Opened<'a>, Failure> {
        match self {
            Self::Native => native(sequence, progress),
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
                let source = Box::new(source);
                Ok(Opened { source, count, frame_rate, warnings, camera: None })
            }
        }
    }
}

/// Finds the path of the camera from the pictures.
fn native<'a>(sequence: &'a Sequence, progress: &Progress) -> Result<Opened<'a>, Failure> {
    camera::before(sequence).iter().for_each(|line| progress.note(line));
    let mut following = Following::start(progress, sequence.len());
    let load = move |place| {
        following.reach(place)?;
        let frame = sequence.load(place)?;
        let (index, timestamp) = (frame.index, frame.timestamp);
        Ok(SequencePicture { index, timestamp, colour: frame.colour })
    };
    let source = Native::find(camera::intrinsics(sequence), sequence.len(), load);
    if interrupt::requested() {
        progress.note("ended before the path of the camera was found: there is nothing to write");
        return Err(Failure::Interrupted);
    }
    let source = source
        .map_err(|error| Failure::Failed(format!("no path of the camera was found: {error}")))?;
    let camera = FoundCamera::of(sequence, source.reconstruction());
    camera.lines().iter().for_each(|line| progress.note(line));
    let refused = source.refused().iter();
    let mut warnings: Vec<String> =
        refused.map(|(place, why)| format!("picture {place} left out: {why}")).collect();
    warnings.extend(source.reconstruction().warnings.iter().map(ToString::to_string));
    let count = source.len();
    let (source, frame_rate) = (Box::new(source), sequence.frame_rate);
    Ok(Opened { source, count, frame_rate, warnings, camera: Some(camera) })
}

/// How far the front end is with its pictures; of their second reading nothing is said.
struct Following {
    progress: Progress,
    count: usize,
    reached: usize,
}

impl Following {
    fn start(progress: &Progress, count: usize) -> Self {
        let mut progress = progress.clone();
        progress.phase("following points", count);
        Self { progress, count, reached: 0 }
    }

    /// The front end asks for the picture at a place; an error if the user has enough.
    fn reach(&mut self, place: usize) -> Result<(), &'static str> {
        if self.reached < self.count {
            if interrupt::requested() {
                return Err("ended by the user");
            }
            self.reached = place + 1;
            self.progress.step(self.reached);
            if self.reached == self.count {
                self.progress.phase("finding the path of the camera", self.count);
            }
        }
        Ok(())
    }
}

/// Take in every keyframe.
pub(super) fn track(
    job: &Job,
    keyframes: &Keyframes,
    sequence: &Sequence,
    progress: &mut Progress,
) -> Result<Tracked, Failure> {
    let clock = Instant::now();
    let opened = without_panics(|| keyframes.open(&job.dataset, &job.open, sequence, progress))?;
    opened.warnings.iter().for_each(|warning| progress.warn(warning));
    let Opened { mut source, count, frame_rate, camera, .. } = opened;
    progress.phase("keyframes", count);
    let mut session = KeyframedSession::new(job.config.clone(), *source.camera(), frame_rate);
    if let Some(covered) = &sequence.covered {
        session.set_covered(Arc::clone(covered));
    }
    let items = std::iter::from_fn(|| source.next_keyframe());
    let tracked = drive(session, items, count, (clock, "no keyframe could be used"), progress)?;
    Ok(Tracked { camera, ..tracked })
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
