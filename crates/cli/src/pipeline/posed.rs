//! Keyframes that come with poses through a session.

use super::Job;
use super::camera::{self, FoundCamera};
use super::drive::{Drive, Tracked, drive};
use crate::failure::{Failure, without_panics};
use crate::interrupt;
use crate::progress::Progress;
use i2slam::config::TrackingMethod;
use i2slam::dataset::Sequence;
use i2slam::keyframes::{
    ImportDepth, ImportOptions, Intrinsics, KeyframeSource, Native, PictureError, PosedKeyframe,
    SequencePicture, import,
};
use i2slam::{Config, FrameEstimate, KeyframedSession, Reconstruction, SessionError};
use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

/// Longer side of the pictures in which the path of the camera is found, where they were recorded so
/// large [px]: smaller ones, which a map may be made of, show less exactly where points are.
const PATH_SIDE: usize = 640;

/// Where keyframes come from.
pub(crate) enum Keyframes {
    /// From the pictures alone.
    Native {
        /// Whether lens distortion is looked for, and removed.
        estimate_distortion: bool,
    },
    /// From files.
    Files {
        path: PathBuf,
        depth: ImportDepth,
        /// Folder with the variance of depth pictures.
        variance: Option<PathBuf>,
    },
}

/// A source of keyframes, how many it has, and what there is to say of it.
struct Opened {
    source: Box<dyn KeyframeSource>,
    count: usize,
    /// Frames that are no keyframes, with poses.
    between: Between,
    frame_rate: f64,
    warnings: Vec<String>,
    /// What the pictures told of the camera.
    camera: Option<FoundCamera>,
    /// The sequence freed of a lens that was found.
    undistorted: Option<Sequence>,
}

/// Posed frames, one after the other.
type Between = Box<dyn ExactSizeIterator<Item = Result<PosedKeyframe, PictureError>>>;

/// A session on keyframes, and the frames between them.
struct Posed {
    session: KeyframedSession,
    between: Between,
    /// Keyframes taken in or held out.
    taken: usize,
    /// Keyframes that the map is not to see, in order.
    held_out: VecDeque<PosedKeyframe>,
    warnings: Vec<String>,
}

impl Posed {
    /// Finds a frame between keyframes; one that cannot be used is left out with a warning.
    fn locate(&mut self, frame: Result<PosedKeyframe, PictureError>) {
        let located = match frame {
            Ok(frame) => self.session.locate(frame).map(|_| ()).map_err(|e| e.to_string()),
            Err(error) => Err(error.to_string()),
        };
        self.warnings.extend(located.err().map(|reason| format!("frame left out: {reason}")));
    }

    /// The next frame that is to be found in the finished map.
    fn next_to_locate(&mut self) -> Option<Result<PosedKeyframe, PictureError>> {
        self.held_out.pop_front().map(Ok).or_else(|| self.between.next())
    }
}

impl Keyframes {
    /// Refuses what the sequence does not allow.
    pub(super) fn check(&self, sequence: &Sequence) -> Result<(), Failure> {
        match self {
            Self::Native { estimate_distortion: true } => camera::refuse_known(sequence),
            _ => Ok(()),
        }
    }

    /// The keyframes with the pictures of a dataset.
    fn open(&self, job: &Job, sequence: &Sequence, progress: &Progress) -> Result<Opened, Failure> {
        match self {
            Self::Native { estimate_distortion } => {
                native(sequence, *estimate_distortion, &job.config, progress)
            }
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
                let (camera, undistorted) = (None, None);
                Ok(Opened { source, count, between, frame_rate, warnings, camera, undistorted })
            }
        }
    }
}

/// Finds the path of the camera from the pictures, with dense depth, and their lens if asked.
fn native(
    sequence: &Sequence,
    estimate_distortion: bool,
    config: &Config,
    progress: &Progress,
) -> Result<Opened, Failure> {
    let large = sequence.at_least(PATH_SIDE);
    camera::before(sequence, &large).iter().for_each(|line| progress.note(line));
    let intrinsics = camera::intrinsics(&large, estimate_distortion);
    let size = (sequence.camera.width, sequence.camera.height);
    let found = find_path(&large, intrinsics, progress)?
        .with_pictures(size, |place| picture(sequence, place));
    let camera = FoundCamera::of(sequence, found.reconstruction());
    camera.lines().iter().for_each(|line| progress.note(line));
    let undistorted = camera.lens().map(|lens| sequence.with_estimated_camera(lens));
    let mut warnings = what_to_know(sequence, &found);
    warnings.extend(undistorted.iter().flat_map(|freed| freed.warnings.clone()));
    let pictures = Arc::new(undistorted.as_ref().unwrap_or(sequence).clone());
    let others = Arc::clone(&pictures);
    let source = found.with_pictures(size, move |place| picture(&pictures, place));
    let (count, between) = (source.len(), source.between(move |place| picture(&others, place)));
    // The paper's system has poses of keyframes alone.
    let between: Between = match config.tracking.method {
        TrackingMethod::SecondOrder => Box::new(between),
        TrackingMethod::Adam => Box::new(std::iter::empty()),
    };
    let (source, frame_rate) = (Box::new(source.with_dense_depth()), sequence.frame_rate);
    let camera = Some(camera);
    Ok(Opened { source, count, between, frame_rate, warnings, camera, undistorted })
}

/// Warnings of a path, frames named by their numbers in the sequence.
fn what_to_know<L>(sequence: &Sequence, found: &Native<L>) -> Vec<String>
where
    L: FnMut(usize) -> Result<SequencePicture, PictureError>,
{
    let at = |place: usize| sequence.entries.get(place).map_or(place, |entry| entry.index);
    let number = |frame: usize| found.place(frame).map_or(frame, at);
    let refused = found.refused().iter();
    let left_out = refused.map(|(place, why)| format!("frame {} left out: {why}", at(*place)));
    let warnings = found.reconstruction().warnings.iter();
    left_out.chain(warnings.map(|warning| warning.numbered(number).to_string())).collect()
}

/// The path of the camera through pictures as they are.
fn find_path<'a>(
    sequence: &'a Sequence,
    intrinsics: Intrinsics,
    progress: &Progress,
) -> Result<Native<impl FnMut(usize) -> Result<SequencePicture, PictureError> + use<'a>>, Failure> {
    let mut following = Following::start(progress, sequence.len());
    let load = move |place: usize| {
        following.reach(place);
        picture(sequence, place)
    };
    let found = Native::find(intrinsics, sequence.len(), load, interrupt::requested);
    if interrupt::requested() {
        progress.note("ended before the path of the camera was found: there is nothing to write");
        return Err(Failure::Interrupted);
    }
    found.map_err(|error| Failure::Failed(format!("no path of the camera was found: {error}")))
}

/// The picture at a place of a sequence.
fn picture(sequence: &Sequence, place: usize) -> Result<SequencePicture, PictureError> {
    let frame = sequence.load(place)?;
    let (index, timestamp) = (frame.index, frame.timestamp);
    Ok(SequencePicture { index, timestamp, colour: frame.colour })
}

/// How far the front end is with its pictures.
struct Following {
    progress: Progress,
    count: usize,
}

impl Following {
    fn start(progress: &Progress, count: usize) -> Self {
        let mut progress = progress.clone();
        progress.phase("following points", count);
        Self { progress, count }
    }

    /// The front end asks for the picture at a place.
    fn reach(&mut self, place: usize) {
        self.progress.step(place + 1);
        if place + 1 == self.count {
            self.progress.phase("finding the path of the camera", self.count);
        }
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
    let Opened { mut source, count, between, frame_rate, camera, undistorted, .. } = opened;
    progress.phase("keyframes", count);
    let config = job.config.clone().with_found_readout(source.readout());
    let mut session = KeyframedSession::new(config, *source.camera(), frame_rate);
    if let Some(covered) = &undistorted.as_ref().unwrap_or(sequence).covered {
        session.set_covered(Arc::clone(covered));
    }
    let items = std::iter::from_fn(|| source.next_keyframe());
    let held_out = VecDeque::new();
    let session = Posed { session, between, taken: 0, held_out, warnings: Vec::new() };
    let tracked = drive(session, items, count, (clock, "no keyframe could be used"), progress)?;
    Ok(Tracked { camera, undistorted, ..tracked })
}

impl Drive for Posed {
    type Item = PosedKeyframe;
    const ITEM: &'static str = "keyframe";
    const FINISH: &'static str = "refining map and poses";

    fn take_in(&mut self, keyframe: PosedKeyframe) -> (Result<(), SessionError>, Vec<String>) {
        self.taken += 1;
        if self.session.holds_out(self.taken - 1) {
            self.held_out.push_back(keyframe);
            return (Ok(()), Vec::new());
        }
        let taken = self.session.process(keyframe).map(|_| ());
        (taken, self.session.take_warnings())
    }

    fn finish(&mut self, on_step: &mut dyn FnMut(usize, usize) -> bool) {
        let count = self.held_out.len() + self.between.len();
        let (mut done, mut steps, mut goes_on) = (0, 0, true);
        self.session.finish(&mut |step, of| {
            (done, steps) = (step, of);
            goes_on = on_step(step, of + count);
            goes_on
        });
        while goes_on {
            let Some(frame) = self.next_to_locate() else { break };
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
