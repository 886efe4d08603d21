//! Frames on their way from the front end to the map.

use super::super::{Session, SessionError};
use super::queue::{BetweenJob, Job, KeyframeJob, MappingPanicked, MappingQueue, OnMapped};
use super::registration::{Registration, image_speed};
use crate::config::{HoldOut, MapKind, MappingConfig};
use crate::keyframes::PosedKeyframe;
use crate::keyframes::delivery::{MEDIAN_DEPTH, keyframe_pictures, measured_depth, posed};
use i2slam_dataset::Frame;
use i2slam_geometry::Pose;
use i2slam_odometry::{FrameUpdate, FrontEnd, Reconstruction};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard};

/// Frames that wait for a map to start, at most: older ones have a pose in the end, and are not mapped.
const MAX_WAITING: usize = 64;

/// Frames over which the steps of a keyframe are spread: each takes this part of those left.
const FRAMES_SHARING_STEPS: usize = 4;

/// Maps the frames of a front end when their neighbours are known, and lets the map follow the
/// corrections of their poses.
///
/// A frame is sent to the map when the frame after it has come, and the camera is known where its depth
/// was taken: its motion is known then, and the landmarks of a keyframe. There it waits for two later
/// keyframes, or sixteen frames with depth. What is sent to the map, and in which order, depends on the
/// frames alone, so that the map does not depend on when its thread works.
pub(crate) struct OnlineMapping {
    queue: MappingQueue,
    /// Width and height of the pictures that are mapped [px].
    size: (usize, usize),
    /// True if frames between keyframes are mapped, too, where depth is measured.
    maps_between: bool,
    /// Steps for a keyframe, which the frames between keyframes share, and what is held out.
    mapping: MappingConfig,
    waiting: VecDeque<WaitingFrame>,
    gauge: Option<Gauge>,
    /// Every frame in the map, by its number in the front end.
    sent: BTreeMap<usize, SentFrame>,
    /// Steps of keyframes that no frame has taken yet.
    steps: usize,
    hold_out: HoldOut,
    /// Offset of depth that frames are mapped with until the next keyframe.
    registration: Registration,
}

/// Result of mapping during tracking.
pub(crate) struct MappedFrames {
    pub(crate) session: Session,
    /// The path in world and unit of length of the map.
    pub(crate) path: Reconstruction,
    /// Numbers in the front end of the frames in the map, without those to be mapped anew.
    pub(crate) current: BTreeSet<usize>,
    /// Number of the frames to be mapped anew.
    pub(crate) outdated: usize,
    pub(crate) hold_out: HoldOut,
    /// Errors of frames that could not be used.
    pub(crate) errors: Vec<SessionError>,
}

/// A frame in the map.
struct SentFrame {
    index: usize,
    /// As last sent.
    pose: Pose<f64>,
    registration: Registration,
}

struct WaitingFrame {
    /// In the front end.
    number: usize,
    picture: Frame,
    is_keyframe: bool,
}

impl WaitingFrame {
    /// Time when its depth was taken, as far as is known [s].
    fn depth_time(&self, path: &Reconstruction) -> f64 {
        let delay = path.depth_model.as_ref().map_or(0.0, |model| model.delay);
        let measured = self.picture.depth.as_ref();
        measured.map_or(f64::NEG_INFINITY, |measured| measured.timestamp + delay)
    }
}

/// World and unit of length of the map in those of the front end.
#[derive(Clone, Copy)]
struct Gauge {
    world: Pose<f64>,
    scale: f64,
    is_metric: bool,
}

impl Gauge {
    /// The camera of a frame as the world; without depth the median depth of its landmarks gives the
    /// unit.
    fn at_keyframe(found: &Reconstruction, frame: usize) -> Option<Self> {
        let pose = found.poses[frame]?;
        let is_metric = found.depth_model.is_some();
        let scale = if is_metric { 1.0 } else { MEDIAN_DEPTH / found.median_depth()? };
        let world = Pose { translation: pose.translation * scale, ..pose }.inverse();
        Some(Self { world, scale, is_metric })
    }

    fn place(&self, mut found: Reconstruction) -> Reconstruction {
        found = found.scaled(self.scale);
        found.transform(&self.world);
        found
    }
}

impl OnlineMapping {
    /// Maps with a session on keyframes with poses, in steps that wait while `tracking` is held.
    pub(crate) fn new(mut session: Session, tracking: Arc<Mutex<()>>, on_mapped: OnMapped) -> Self {
        session.keep_world();
        let (width, height) = (session.camera.width, session.camera.height);
        Self {
            size: (width, height),
            maps_between: session.config.map.kind == MapKind::Gaussian,
            hold_out: HoldOut::new(&session.config.mapping),
            mapping: session.config.mapping.clone(),
            queue: MappingQueue::new(session, tracking, on_mapped),
            waiting: VecDeque::new(),
            gauge: None,
            sent: BTreeMap::new(),
            steps: 0,
            registration: Registration::default(),
        }
    }

    /// The session between two frames.
    pub(super) fn session(&self) -> MutexGuard<'_, Session> {
        self.queue.session()
    }

    /// Number of jobs that wait for the map.
    pub(super) fn waiting_for_map(&self) -> usize {
        self.queue.waiting()
    }

    /// Waits until at most so many jobs wait for the map.
    pub(crate) fn wait_for_map(&self, waiting: usize) {
        self.queue.wait_for(waiting);
    }

    /// Takes the last frame of the front end, whose picture has the size of those that are mapped.
    /// Returns the poses that changed since the last call, by the index of their frames.
    pub(crate) fn add_frame(
        &mut self,
        front_end: &FrontEnd,
        update: &FrameUpdate,
        picture: Frame,
    ) -> BTreeMap<usize, Pose<f64>> {
        // Every n-th of all frames is held out, not of those that are mapped.
        self.hold_out.decide(picture.index);
        let is_keyframe = update.is_keyframe;
        self.waiting.push_back(WaitingFrame { number: update.frame, picture, is_keyframe });
        if self.gauge.is_none() && update.pose.is_some() {
            self.gauge = self.first_gauge(front_end);
        }
        let Some(gauge) = self.gauge else {
            self.forget_waiting();
            return BTreeMap::new();
        };
        let found = gauge.place(front_end.path_so_far(None));
        let corrections = self.corrections(&found);
        if !corrections.is_empty() {
            self.queue.send(Job::Correct(corrections.clone()));
        }
        // The unit of a map stays: one that depth gives a unit later starts anew.
        if found.depth_model.is_some() && !gauge.is_metric {
            self.restart();
            return corrections;
        }
        let is_due = |first: &WaitingFrame| {
            first.number < update.frame
                && first.depth_time(&found) <= found.timestamps[update.frame]
        };
        while self.waiting.front().is_some_and(is_due) {
            let Some(frame) = self.waiting.pop_front() else { break };
            self.send(front_end, &found, frame);
        }
        corrections
    }

    /// The gauge from the first keyframe that waits and has a pose.
    fn first_gauge(&self, front_end: &FrontEnd) -> Option<Gauge> {
        let path = front_end.path_so_far(None);
        let is_posed = |f: &&WaitingFrame| f.is_keyframe && path.poses[f.number].is_some();
        let first = self.waiting.iter().find(is_posed)?.number;
        Gauge::at_keyframe(&front_end.path_so_far(Some(first)), first)
    }

    /// Drops the map; the next one begins with the frames that wait.
    fn restart(&mut self) {
        self.queue.send(Job::Restart);
        self.gauge = None;
        self.sent.clear();
        self.steps = 0;
    }

    /// Bounds the frames that wait for a start: those between keyframes go first.
    fn forget_waiting(&mut self) {
        while self.waiting.len() > MAX_WAITING {
            let between = self.waiting.iter().position(|frame| !frame.is_keyframe);
            self.waiting.remove(between.unwrap_or(0));
        }
    }

    /// Poses of frames in the map that differ from what was sent.
    fn corrections(&mut self, found: &Reconstruction) -> BTreeMap<usize, Pose<f64>> {
        let mut out = BTreeMap::new();
        for (number, sent) in &mut self.sent {
            let Some(now) = found.poses[*number].filter(|now| *now != sent.pose) else { continue };
            sent.pose = now;
            out.insert(sent.index, now);
        }
        out
    }

    /// True if the frame with this index is held out of the map, or would be as the next one.
    pub(super) fn is_held_out(&self, index: usize) -> bool {
        self.hold_out.is_held_out(index)
    }

    /// Replaces what is held out, before the first frame.
    pub(crate) fn set_hold_out(&mut self, hold_out: HoldOut) {
        self.hold_out = hold_out;
    }

    /// Sends a frame to the map, if it has a pose, and something to map.
    fn send(&mut self, front_end: &FrontEnd, path: &Reconstruction, frame: WaitingFrame) {
        let (Some(gauge), Some(pose)) = (self.gauge, path.poses[frame.number]) else { return };
        let WaitingFrame { number, picture, is_keyframe } = frame;
        let index = picture.index;
        let is_mapped = is_keyframe || (gauge.is_metric && self.maps_between);
        if !is_mapped {
            return;
        }
        self.steps += if is_keyframe { self.mapping.iterations } else { 0 };
        if self.is_held_out(index) {
            return;
        }
        let readout = path.rolling_shutter_readout;
        let steps = self.take_steps();
        let job = if is_keyframe {
            let found = gauge.place(front_end.path_so_far(Some(number)));
            let found = found.resized(self.size.0, self.size.1);
            let Some(keyframe) = found.keyframes.first().cloned() else { return };
            self.registration = Registration::of(&found);
            Job::Keyframe(Box::new(KeyframeJob {
                pictures: keyframe_pictures(&found, &keyframe, &picture),
                posed: posed(&found, number, picture, pose),
                depth_model: found.depth_model.clone(),
                readout,
                steps,
                keyframe,
            }))
        } else {
            let Some(measured) = measured_depth(path, number, &picture) else { return };
            let posed = posed(path, number, picture, pose);
            let posed = PosedKeyframe { is_keyframe: false, ..posed };
            Job::Between(Box::new(BetweenJob { posed, measured, readout, steps }))
        };
        let registration = self.registration.between_keyframes(path);
        self.sent.insert(number, SentFrame { index, pose, registration });
        self.queue.send(job);
    }

    /// Steps for the next frame, where those between keyframes share the steps of their keyframe.
    fn take_steps(&mut self) -> usize {
        let is_shared = self.maps_between && self.gauge.is_some_and(|gauge| gauge.is_metric);
        let steps = if is_shared { self.steps.div_ceil(FRAMES_SHARING_STEPS) } else { self.steps };
        self.steps -= steps;
        steps
    }

    /// A pose of the front end in the world of the map, once there is one.
    pub(super) fn placed(&self, pose: Pose<f64>) -> Option<Pose<f64>> {
        let gauge = self.gauge?;
        Some(gauge.world * Pose { translation: pose.translation * gauge.scale, ..pose })
    }

    /// Number of frames that were sent to the map.
    pub(crate) fn sent(&self) -> usize {
        self.sent.len()
    }

    /// True if lengths of the map, or of one that has not begun, and those of a path are metres.
    pub(crate) fn is_metric(&self, path: &Reconstruction) -> bool {
        path.depth_model.is_some() && self.gauge.is_none_or(|gauge| gauge.is_metric)
    }

    /// Waits until all frames are mapped, and corrects the map to the final path, which is returned
    /// in the world of the map: the camera of the first keyframe. Frames that are lost in the end leave
    /// the map.
    pub(crate) fn finish(self, path: Reconstruction) -> Result<MappedFrames, MappingPanicked> {
        let path = self.placed_at_the_end(path);
        let pose_of = |number: usize| path.poses.get(number).copied().flatten();
        let sent = || self.sent.iter().map(|(number, sent)| (sent.index, pose_of(*number)));
        let poses = sent().filter_map(|(index, pose)| Some((index, pose?)));
        self.queue.send(Job::Correct(poses.collect()));
        let lost: BTreeSet<usize> =
            sent().filter(|(_, pose)| pose.is_none()).map(|(index, _)| index).collect();
        let current = self.current(&path);
        let outdated = self.sent.len() - lost.len() - current.len();
        let (mut session, errors) = self.queue.finish()?;
        session.forget(&lost);
        session.config.mapping = self.mapping;
        let hold_out = self.hold_out;
        Ok(MappedFrames { session, path, current, outdated, hold_out, errors })
    }

    /// True if rows or depth of most frames in the map are elsewhere on the final path.
    pub(crate) fn is_outdated(&self, path: &Reconstruction) -> bool {
        let is_posed = |number: &&usize| path.poses.get(**number).is_some_and(Option::is_some);
        2 * self.current(path).len() < self.sent.keys().filter(is_posed).count()
    }

    /// Frames in the map with rows and depth where the final path has them.
    fn current(&self, path: &Reconstruction) -> BTreeSet<usize> {
        let path = path.clone().resized(self.size.0, self.size.1);
        let (now, depth) = (Registration::of(&path), path.median_depth().unwrap_or(f64::INFINITY));
        let is_current = |(number, sent): &(&usize, &SentFrame)| {
            let is_posed = path.poses.get(**number).is_some_and(Option::is_some);
            is_posed && !sent.registration.is_outdated(&now, image_speed(&path, **number, depth))
        };
        self.sent.iter().filter(is_current).map(|(number, _)| *number).collect()
    }

    /// The final path in the unit of the map, without depth with the length of the path through mapped
    /// frames.
    fn placed_at_the_end(&self, found: Reconstruction) -> Reconstruction {
        let known = |(number, sent): (&usize, &SentFrame)| {
            Some((sent.pose, found.poses.get(*number).copied().flatten()?))
        };
        let (were, are): (Vec<Pose<f64>>, Vec<Pose<f64>>) =
            self.sent.iter().filter_map(known).unzip();
        let ratio = Some(reach(&were) / reach(&are)).filter(|r| r.is_finite() && *r > 0.0);
        let scale = if self.is_metric(&found) { 1.0 } else { ratio.unwrap_or(MEDIAN_DEPTH) };
        let mut placed = found.scaled(scale);
        let first_keyframe = placed.keyframes.first().map(|keyframe| keyframe.world_from_camera);
        if let Some(first) = first_keyframe.or(placed.poses.iter().copied().flatten().next()) {
            placed.transform(&first.inverse());
        }
        placed
    }
}

/// Sum of the distances to the first pose.
fn reach(poses: &[Pose<f64>]) -> f64 {
    poses.iter().map(|pose| (pose.translation - poses[0].translation).norm()).sum()
}
