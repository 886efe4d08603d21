//! Keyframes that come with poses through a session.

use super::Job;
use super::camera::{self, FoundCamera};
use super::drive::{Drive, Tracked, drive};
use super::path::find_path;
use super::refined::refined;
use crate::failure::{Failure, without_panics};
use crate::interrupt;
use crate::output::counted;
use crate::progress::Progress;
use i2slam::config::TrackingMethod;
use i2slam::dataset::{Frame, Sequence};
use i2slam::geometry::Pose;
use i2slam::keyframes::{
    ImportDepth, ImportOptions, KeyframeSource, MonocularSource, OdometryWarning, PictureError,
    PosedKeyframe, import,
};
use i2slam::{FrameEstimate, KeyframeSession, Reconstruction, SessionError, Warning};
use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

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
    /// Frames that have a pose: number, stamp, pose.
    path: Vec<(usize, f64, Pose<f64>)>,
    /// Frames that the keyframes stand for, those without a pose included.
    given: usize,
    frame_rate: f64,
    warnings: Vec<Warning>,
    /// What the pictures told of the camera.
    camera: Option<FoundCamera>,
    /// The sequence freed of a lens that was found.
    undistorted: Option<Sequence>,
}

/// Posed frames, one after the other.
type Between = Box<dyn ExactSizeIterator<Item = Result<PosedKeyframe, PictureError>>>;

/// A session on keyframes, and the frames between them.
struct Posed {
    session: KeyframeSession,
    between: Between,
    /// Keyframes taken in or held out.
    taken: usize,
    /// Keyframes that the map is not to see, in order.
    held_out: VecDeque<PosedKeyframe>,
    /// Frames that have a pose: number, stamp, pose.
    path: Vec<(usize, f64, Pose<f64>)>,
    warnings: Vec<Warning>,
}

impl Posed {
    /// Finds a frame between keyframes; one that cannot be used is left out with a warning.
    fn locate(&mut self, frame: Result<PosedKeyframe, PictureError>) {
        let located = match frame {
            Ok(frame) => self.session.locate(frame).map(|_| ()).map_err(|e| e.to_string()),
            Err(error) => Err(error.to_string()),
        };
        let left_out = located.err().map(|reason| format!("frame left out: {reason}").into());
        self.warnings.extend(left_out);
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
                native(sequence, *estimate_distortion, job, progress)
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
                let warnings = source.files().warnings.iter().cloned().map(Warning::from).collect();
                let wanted = *depth != ImportDepth::None && job.config.keyframed.refine_imported;
                let refined = wanted.then(|| refined(source.files(), progress)).flatten();
                Ok(Opened {
                    source: refined.unwrap_or_else(|| Box::new(source)),
                    count,
                    between: Box::new(std::iter::empty()),
                    path: Vec::new(),
                    given: count,
                    frame_rate,
                    warnings,
                    camera: None,
                    undistorted: None,
                })
            }
        }
    }
}

/// Finds the path of the camera from the pictures, with dense depth, and their lens if asked.
fn native(
    sequence: &Sequence,
    estimate_distortion: bool,
    job: &Job,
    progress: &Progress,
) -> Result<Opened, Failure> {
    let size = (sequence.camera.width, sequence.camera.height);
    let found = find_path(sequence, estimate_distortion, job, progress)?
        .with_pictures(size, |place| picture(sequence, place));
    let camera = FoundCamera::of(sequence, found.reconstruction());
    camera.lines().iter().for_each(|line| progress.note(line));
    let undistorted = camera.lens().map(|lens| sequence.with_estimated_camera(lens));
    let mut warnings = what_to_know(sequence, &found);
    let freed = undistorted.iter().flat_map(|freed| freed.warnings.clone());
    warnings.extend(freed.map(Warning::from));
    let pictures = Arc::new(undistorted.as_ref().unwrap_or(sequence).clone());
    let others = Arc::clone(&pictures);
    let source = found.with_pictures(size, move |place| picture(&pictures, place));
    let (count, between) = (source.len(), source.between(move |place| picture(&others, place)));
    let numbered = |(place, stamp, pose): (usize, f64, Pose<f64>)| {
        Some((sequence.entries.get(place)?.index, stamp, pose))
    };
    let path = source.path().into_iter().filter_map(numbered).collect();
    // The paper's system has poses of keyframes alone.
    let between: Between = match job.config.tracking.method {
        TrackingMethod::SecondOrder => Box::new(between),
        TrackingMethod::Adam => Box::new(std::iter::empty()),
    };
    let (source, frame_rate) =
        (Box::new(source.with_dense_depth(interrupt::cancellation())), sequence.frame_rate);
    let (camera, given) = (Some(camera), sequence.len());
    Ok(Opened { source, count, between, path, given, frame_rate, warnings, camera, undistorted })
}

/// Warnings of a path, frames named by their numbers in the sequence.
fn what_to_know<L>(sequence: &Sequence, found: &MonocularSource<L>) -> Vec<Warning>
where
    L: FnMut(usize) -> Result<Frame, PictureError>,
{
    let at = |place: usize| sequence.entries.get(place).map_or(place, |entry| entry.index);
    let number = |frame: usize| found.place(frame).map_or(frame, at);
    let left_out = |(place, why): &(usize, PictureError)| {
        Warning::of_frame(at(*place), format!("left out: {why}"))
    };
    let warnings = found.reconstruction().warnings.iter().map(|w| w.with_frame_numbers(number));
    let warnings = warnings.map(|warning| match (warning, warning.frame_range()) {
        (OdometryWarning::DisconnectedFrames { first, last }, Some(frames)) => {
            Warning::of_frames(frames, format!("{warning} (--frames {first}..{})", last + 1))
        }
        (_, Some(frames)) => Warning::of_frames(frames, warning.to_string()),
        (_, None) => warning.to_string().into(),
    });
    found.refused().iter().map(left_out).chain(warnings).collect()
}

/// The picture at a place of a sequence.
pub(super) fn picture(sequence: &Sequence, place: usize) -> Result<Frame, PictureError> {
    Ok(sequence.load(place)?)
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
    let Opened { mut source, count, between, path, given, frame_rate, .. } = opened;
    let Opened { warnings, camera, undistorted, .. } = opened;
    warnings.into_iter().for_each(|warning| progress.warn(warning));
    progress.phase("keyframes", count);
    let config = job.config.clone().with_found_readout(source.readout());
    let mut session = KeyframeSession::new(config, *source.camera(), frame_rate);
    session.set_cancellation(interrupt::cancellation());
    if let Some(covered) = &undistorted.as_ref().unwrap_or(sequence).covered {
        session.set_covered(Arc::clone(covered));
    }
    let items = std::iter::from_fn(|| source.next_keyframe());
    let held_out = VecDeque::new();
    let session = Posed { session, between, taken: 0, held_out, path, warnings: Vec::new() };
    let tracked = drive(session, items, count, (clock, "no keyframe could be used"), progress)?;
    Ok(Tracked { camera, undistorted, given, ..tracked })
}

impl Drive for Posed {
    type Item = PosedKeyframe;
    const ITEM: &'static str = "keyframe";
    const FINISH: &'static str = "refining map and poses";

    fn take_in(&mut self, keyframe: PosedKeyframe) -> (Result<(), SessionError>, Vec<Warning>) {
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

    fn keep_the_rest(&mut self) {
        let path = std::mem::take(&mut self.path).into_iter();
        let kept = path.filter(|(index, stamp, pose)| self.session.place(*index, *stamp, *pose));
        let count = kept.count();
        if count > 0 {
            let frames = counted(count, "frame");
            self.warnings.push(
                format!(
                    "ended early: the poses of {frames} are those of the front end, not refined"
                )
                .into(),
            );
        }
    }

    fn take_warnings(&mut self) -> Vec<Warning> {
        let mut warnings = std::mem::take(&mut self.warnings);
        warnings.extend(self.session.take_warnings());
        warnings
    }

    fn reconstruction(&self) -> Reconstruction {
        self.session.reconstruction()
    }
}
