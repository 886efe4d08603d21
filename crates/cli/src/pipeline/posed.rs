//! Keyframes that come with poses through a session.

use super::Job;
use super::camera::{self, FoundCamera};
use super::drive::{Drive, Tracked, drive};
use crate::failure::{Failure, without_panics};
use crate::interrupt;
use crate::progress::Progress;
use i2slam::config::{MapKind, TrackingMethod};
use i2slam::dataset::Sequence;
use i2slam::keyframes::{
    ImportDepth, ImportOptions, KeyframeSource, Native, PosedKeyframe, SequencePicture, import,
};
use i2slam::{Config, FrameEstimate, KeyframedSession, Reconstruction, SessionError};
use std::error::Error;
use std::path::PathBuf;
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
    /// Frames that are no keyframes, with poses.
    between: Between<'a>,
    frame_rate: f64,
    warnings: Vec<String>,
    /// What the pictures told of the camera.
    camera: Option<FoundCamera>,
}

/// Posed frames, one after the other.
type Between<'a> =
    Box<dyn ExactSizeIterator<Item = Result<PosedKeyframe, Box<dyn Error + Send + Sync>>> + 'a>;

/// A session on keyframes, and the frames between them.
struct Posed<'a> {
    session: KeyframedSession,
    between: Between<'a>,
    warnings: Vec<String>,
}

impl Posed<'_> {
    /// Finds a frame between keyframes; one that cannot be used is left out with a warning.
    fn locate(&mut self, frame: Result<PosedKeyframe, Box<dyn Error + Send + Sync>>) {
        let located = match frame {
            Ok(frame) => self.session.locate(frame).map(|_| ()).map_err(|e| e.to_string()),
            Err(error) => Err(error.to_string()),
        };
        self.warnings.extend(located.err().map(|reason| format!("frame left out: {reason}")));
    }
}

impl Keyframes {
    /// The keyframes with the pictures of a dataset.
    fn open<'a>(
        &self,
        job: &Job,
        sequence: &'a Sequence,
        progress: &Progress,
    ) -> Result<Opened<'a>, Failure> {
        match self {
            Self::Native => native(sequence, &job.config, progress),
            Self::Files { path, depth, variance } => {
                let options = ImportOptions {
                    open: job.open.clone(),
                    depth: *depth,
                    variance: variance.clone(),
                    ..ImportOptions::default()
                };
                let source = import(path, Some(&job.dataset), &options)?;
                let (count, frame_rate) = (source.len(), source.files().frame_rate);
                let warnings = source.files().warnings.clone();
                let (source, between) = (Box::new(source), Box::new(std::iter::empty()));
                Ok(Opened { source, count, between, frame_rate, warnings, camera: None })
            }
        }
    }
}

/// Finds the path of the camera from the pictures; for Gaussians, which begin on surfaces, with dense
/// depth.
fn native<'a>(
    sequence: &'a Sequence,
    config: &Config,
    progress: &Progress,
) -> Result<Opened<'a>, Failure> {
    camera::before(sequence).iter().for_each(|line| progress.note(line));
    let mut following = Following::start(progress, sequence.len());
    let picture = move |place: usize| {
        let frame = sequence.load(place)?;
        let (index, timestamp) = (frame.index, frame.timestamp);
        Ok(SequencePicture { index, timestamp, colour: frame.colour })
    };
    let load = move |place: usize| {
        following.reach(place)?;
        picture(place)
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
    let (count, between) = (source.len(), source.between(picture));
    // The paper's system has poses of keyframes alone.
    let between: Between<'_> = match config.tracking.method {
        TrackingMethod::SecondOrder => Box::new(between),
        TrackingMethod::Adam => Box::new(std::iter::empty()),
    };
    let source = match config.map.kind {
        MapKind::Gaussian => source.with_dense_depth(),
        MapKind::HashGrid => source,
    };
    let (source, frame_rate) = (Box::new(source), sequence.frame_rate);
    Ok(Opened { source, count, between, frame_rate, warnings, camera: Some(camera) })
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
    let opened = without_panics(|| keyframes.open(job, sequence, progress))?;
    opened.warnings.iter().for_each(|warning| progress.warn(warning));
    let Opened { mut source, count, between, frame_rate, camera, .. } = opened;
    progress.phase("keyframes", count);
    let mut session = KeyframedSession::new(job.config.clone(), *source.camera(), frame_rate);
    if let Some(covered) = &sequence.covered {
        session.set_covered(Arc::clone(covered));
    }
    let items = std::iter::from_fn(|| source.next_keyframe());
    let session = Posed { session, between, warnings: Vec::new() };
    let tracked = drive(session, items, count, (clock, "no keyframe could be used"), progress)?;
    Ok(Tracked { camera, ..tracked })
}

impl Drive for Posed<'_> {
    type Item = PosedKeyframe;
    const ITEM: &'static str = "keyframe";
    const FINISH: &'static str = "refining map and poses";

    fn take_in(&mut self, keyframe: PosedKeyframe) -> (Result<(), SessionError>, Vec<String>) {
        let taken = self.session.process(keyframe).map(|_| ());
        (taken, self.session.take_warnings())
    }

    fn finish(&mut self, on_step: &mut dyn FnMut(usize, usize) -> bool) {
        let count = self.between.len();
        let (mut done, mut steps, mut goes_on) = (0, 0, true);
        self.session.finish(&mut |step, of| {
            (done, steps) = (step, of);
            goes_on = on_step(step, of + count);
            goes_on
        });
        while goes_on {
            let Some(frame) = self.between.next() else { break };
            self.locate(frame);
            done += 1;
            goes_on = on_step(done, steps + count);
        }
    }

    fn frames(&self) -> &[FrameEstimate] {
        self.session.frames()
    }

    fn take_warnings(&mut self) -> Vec<String> {
        let mut warnings = std::mem::take(&mut self.warnings);
        warnings.extend(self.session.take_warnings());
        warnings
    }

    fn reconstruction(&self) -> Reconstruction {
        self.session.reconstruction()
    }
}
