//! The thread that maps frames beside tracking, in the order in which the front end gave them.

use super::super::{Session, SessionError};
use super::backlog::{Backlog, StoredJob};
use crate::keyframes::PosedKeyframe;
use crate::keyframes::delivery::{depth, into_estimated, posed_view};
use crate::reconstruction::{FrameEstimate, Reconstruction};
use i2slam_compute::CancellationToken;
use i2slam_geometry::{Image, Pose};
use i2slam_odometry::{
    DenseDepthEstimator, DepthModel, Keyframe, KeyframePictures, MAX_KEYFRAME_DISTANCE,
    MeasuredDepth,
};
use i2slam_storage::ScratchStore;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

/// Keyframes whose pictures are kept: the reach of dense depth on either side.
const KEPT_PICTURES: usize = 32;
/// Keyframes after a frame that its depth is estimated and checked with.
const LATER_VIEWS: usize = 2;
/// Frames with measured depth that wait for later keyframes at most: a camera at rest makes none.
const MAX_WAITING: usize = 16;

/// A piece of work, done in the order of sending.
pub(super) enum Job {
    Keyframe(Box<KeyframeJob>),
    Between(Box<BetweenJob>),
    /// Poses \[world from camera\] that changed, by the index of their frames.
    Correct(BTreeMap<usize, Pose<f64>>),
    /// The map begins anew.
    Restart,
}

impl Job {
    /// Its pictures.
    pub(super) fn pictures(&mut self) -> Vec<&mut Arc<Image<f32>>> {
        match self {
            Self::Keyframe(job) => {
                let KeyframePictures { colour, depth } = &mut job.pictures;
                let depth = depth.as_mut().map(|measured| &mut measured.depth);
                [&mut job.posed.colour, colour].into_iter().chain(depth).collect()
            }
            Self::Between(job) => vec![&mut job.posed.colour, &mut job.measured.depth],
            Self::Correct(_) | Self::Restart => Vec::new(),
        }
    }

    /// Its frame.
    fn posed(&mut self) -> Option<&mut PosedKeyframe> {
        match self {
            Self::Keyframe(job) => Some(&mut job.posed),
            Self::Between(job) => Some(&mut job.posed),
            Self::Correct(_) | Self::Restart => None,
        }
    }

    /// True for a frame with measured depth.
    fn is_measured(&self) -> bool {
        match self {
            Self::Keyframe(job) => job.pictures.depth.is_some() && job.depth_model.is_some(),
            Self::Between(_) => true,
            Self::Correct(_) | Self::Restart => false,
        }
    }
}

/// A keyframe with what its depth is made of.
pub(super) struct KeyframeJob {
    /// Without depth.
    pub(super) posed: PosedKeyframe,
    pub(super) keyframe: Keyframe,
    pub(super) pictures: KeyframePictures,
    pub(super) depth_model: Option<DepthModel>,
    /// Readout of the rolling shutter [s].
    pub(super) readout: f64,
    /// Steps of mapping.
    pub(super) steps: usize,
}

/// A frame between keyframes, with measured depth.
pub(super) struct BetweenJob {
    /// Without depth.
    pub(super) posed: PosedKeyframe,
    pub(super) measured: MeasuredDepth,
    /// Readout of the rolling shutter [s].
    pub(super) readout: f64,
    /// Steps of mapping.
    pub(super) steps: usize,
}

/// The thread of the map ended by a panic, which is a defect of this library.
#[derive(Clone, Copy, Debug, thiserror::Error)]
#[error("mapping ended by an internal error: please report it with the frames that led to it")]
pub struct MappingPanicked;

/// Sees every frame that was mapped, on the thread of the map, with what copies everything estimated so
/// far.
pub(crate) type OnMapped = Box<dyn FnMut(&FrameEstimate, &dyn Fn() -> Reconstruction) + Send>;

/// Jobs for a session on a thread of its own.
pub(super) struct MappingQueue {
    session: Arc<Mutex<Session>>,
    jobs: Arc<Backlog>,
    thread: Option<JoinHandle<Vec<SessionError>>>,
    /// Set once nobody wants the map.
    is_dropped: Arc<AtomicBool>,
}

impl MappingQueue {
    /// A queue for `session`, whose steps wait while `tracking` is held.
    pub(super) fn new(mut session: Session, tracking: Arc<Mutex<()>>, on_mapped: OnMapped) -> Self {
        let cancellation = &mut session.state.cancellation;
        *cancellation = asked_after_tracking(cancellation.clone(), tracking);
        let dense = dense_estimator(&session);
        let scratch = Arc::clone(&session.state.scratch);
        let jobs = Arc::new(Backlog::new(Arc::clone(&scratch)));
        let session = Arc::new(Mutex::new(session));
        let is_dropped = Arc::new(AtomicBool::new(false));
        let worker = Worker {
            is_dropped: Arc::clone(&is_dropped),
            session: Arc::clone(&session),
            dense,
            keyframes: Vec::new(),
            pictures: BTreeMap::new(),
            waiting: VecDeque::new(),
            scratch,
            unrevised: BTreeSet::new(),
            errors: Vec::new(),
            on_mapped,
        };
        let received = Arc::clone(&jobs);
        let thread = std::thread::spawn(move || {
            // Nobody waits for a thread that ended by a panic, which `finish` tells.
            let received = ClosedOnDrop(received);
            worker.run(&received.0)
        });
        Self { session, jobs, thread: Some(thread), is_dropped }
    }

    /// Sends a job.
    pub(super) fn send(&self, job: Job) {
        self.jobs.send(job);
    }

    /// Number of jobs that wait.
    pub(super) fn waiting(&self) -> usize {
        self.jobs.len()
    }

    /// Waits until at most so many jobs do.
    pub(super) fn wait_for(&self, jobs: usize) {
        self.jobs.wait_for(jobs);
    }

    /// The session between two jobs.
    pub(super) fn session(&self) -> MutexGuard<'_, Session> {
        locked(&self.session)
    }

    /// Waits for all jobs; gives the session, and the errors of frames that could not be used.
    pub(super) fn finish(mut self) -> Result<(Session, Vec<SessionError>), MappingPanicked> {
        self.jobs.close();
        let thread = self.thread.take().map(JoinHandle::join);
        let errors = thread.unwrap_or_else(|| Ok(Vec::new())).map_err(|_| MappingPanicked)?;
        let mut session = self.session();
        let empty = session.restarted();
        Ok((std::mem::replace(&mut *session, empty), errors))
    }
}

impl Drop for MappingQueue {
    /// Ends the thread after its present job.
    fn drop(&mut self) {
        self.is_dropped.store(true, Ordering::Relaxed);
        self.jobs.close();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// A token that waits while a frame is tracked. It is asked before every job and between two refining
/// steps of the map, so that a frame has all threads soon after it has come. Whoever holds `tracking`,
/// or is a thread that tracking needs, must not ask it.
fn asked_after_tracking(
    cancellation: CancellationToken,
    tracking: Arc<Mutex<()>>,
) -> CancellationToken {
    CancellationToken::when(move || {
        drop(tracking.lock().unwrap_or_else(PoisonError::into_inner));
        cancellation.is_cancelled()
    })
}

fn dense_estimator(session: &Session) -> DenseDepthEstimator {
    DenseDepthEstimator::new(session.camera, Vec::new())
        .with_cancellation(session.state.cancellation.clone())
}

/// Closes a queue when its receiver ends.
struct ClosedOnDrop(Arc<Backlog>);

impl Drop for ClosedOnDrop {
    fn drop(&mut self) {
        self.0.close();
    }
}

fn locked(session: &Mutex<Session>) -> MutexGuard<'_, Session> {
    session.lock().unwrap_or_else(PoisonError::into_inner)
}

struct Worker {
    is_dropped: Arc<AtomicBool>,
    session: Arc<Mutex<Session>>,
    dense: DenseDepthEstimator,
    /// Indices of the keyframes so far.
    keyframes: Vec<usize>,
    /// Pictures of the last keyframes, by their number.
    pictures: BTreeMap<usize, KeyframePictures>,
    /// Frames that wait for later keyframes, each with the number of the last keyframe up to it.
    waiting: VecDeque<(usize, StoredJob)>,
    scratch: Arc<ScratchStore>,
    /// Numbers of keyframes whose measured depth was not yet compared with later pictures.
    unrevised: BTreeSet<usize>,
    errors: Vec<SessionError>,
    on_mapped: OnMapped,
}

impl Worker {
    /// Works until the last job was received.
    fn run(mut self, jobs: &Backlog) -> Vec<SessionError> {
        while let Some(job) = jobs.receive() {
            let may_begin = self.session().state.cancellation.clone();
            // Waits while a frame is tracked.
            may_begin.is_cancelled();
            if self.is_dropped() {
                return self.errors;
            }
            match job {
                Job::Keyframe(_) | Job::Between(_) => self.add_frame(job),
                Job::Correct(poses) => self.correct(&poses),
                Job::Restart => self.restart(),
            }
        }
        while let Some((number, job)) = self.waiting.pop_front().filter(|_| !self.is_dropped()) {
            self.map_frame(number, job);
        }
        self.revise_up_to(usize::MAX);
        self.errors
    }

    fn restart(&mut self) {
        let empty = self.session().restarted();
        self.dense = dense_estimator(&empty);
        self.keyframes.clear();
        self.pictures.clear();
        self.waiting.clear();
        self.unrevised.clear();
        *self.session() = empty;
    }

    fn is_dropped(&self) -> bool {
        self.is_dropped.load(Ordering::Relaxed)
    }

    fn session(&self) -> MutexGuard<'_, Session> {
        locked(&self.session)
    }

    /// Keeps a frame, and maps those that have waited for enough later ones.
    fn add_frame(&mut self, job: Job) {
        let number = self.keyframes.len();
        if let Job::Keyframe(added) = &job {
            self.keyframes.push(added.posed.index);
            self.dense.add_view(posed_view(&added.keyframe), added.depth_model.clone());
            self.pictures.insert(number, added.pictures.clone());
            self.pictures.retain(|known, _| known + KEPT_PICTURES > number);
            if job.is_measured() {
                self.unrevised.insert(number);
            }
        }
        let Some(number) = self.keyframes.len().checked_sub(1) else { return };
        self.waiting.push_back((number, StoredJob::new(job, &self.scratch)));
        let is_due = |(last, _): &(usize, StoredJob), waiting: &VecDeque<(usize, StoredJob)>| {
            last + LATER_VIEWS <= number
                || (waiting.len() > MAX_WAITING && waiting.iter().any(|(_, w)| w.job.is_measured()))
        };
        while self.waiting.front().is_some_and(|first| is_due(first, &self.waiting)) {
            let Some((number, job)) = self.waiting.pop_front() else { return };
            self.map_frame(number, job);
        }
        if let Some(settled) = number.checked_sub(MAX_KEYFRAME_DISTANCE) {
            self.revise_up_to(settled);
        }
    }

    /// Revises the depth of keyframes up to a number, which was measured, with the pictures of those
    /// around them.
    fn revise_up_to(&mut self, last: usize) {
        while self.unrevised.first().is_some_and(|first| *first <= last) && !self.is_dropped() {
            let Some(number) = self.unrevised.pop_first() else { return };
            let pictures = &self.pictures;
            let dense = self.dense.estimate(number, &mut |k| pictures.get(&k).cloned());
            let Some(mut dense) = dense else { continue };
            let Some(contradicted) = dense.contradicted.take() else { continue };
            let index = self.keyframes[number];
            self.session().revise_depth(index, into_estimated(dense), &contradicted);
        }
    }

    fn map_frame(&mut self, number: usize, job: StoredJob) {
        match job.with_pictures() {
            Job::Keyframe(job) => self.map_keyframe(number, *job),
            Job::Between(job) => self.map_between(number, *job),
            Job::Correct(_) | Job::Restart => {}
        }
    }

    fn map_keyframe(&mut self, number: usize, job: KeyframeJob) {
        let pictures = &self.pictures;
        let mut load = |k: usize| pictures.get(&k).cloned();
        let dense = self.dense.estimate(number, &mut load);
        let size = (job.posed.colour.width, job.posed.colour.height);
        let depth = Some(depth(dense, &job.keyframe, size));
        self.map(PosedKeyframe { depth, ..job.posed }, (job.readout, job.steps));
    }

    fn map_between(&mut self, near: usize, job: BetweenJob) {
        let pictures = &self.pictures;
        let mut load = |k: usize| pictures.get(&k).cloned();
        let pose = job.posed.world_from_camera;
        let depth = self.dense.fuse(pose, near, &job.measured, &mut load).map(into_estimated);
        self.map(PosedKeyframe { depth, ..job.posed }, (job.readout, job.steps));
    }

    fn map(&mut self, posed: PosedKeyframe, (readout, steps): (f64, usize)) {
        let mut session = self.session();
        if session.state.cancellation.is_cancelled() || session.failure.is_some() {
            return;
        }
        session.set_found_readout(readout);
        session.config.mapping.iterations = steps;
        let added = session.add_keyframe(posed).cloned();
        drop(session);
        let session = &self.session;
        match added {
            Ok(estimate) => (self.on_mapped)(&estimate, &|| locked(session).reconstruction()),
            Err(error) => self.errors.push(error),
        }
    }

    /// Corrects the map, and keyframes that wait for it or that depth is fused with.
    fn correct(&mut self, poses: &BTreeMap<usize, Pose<f64>>) {
        let oldest = self.keyframes.len().saturating_sub(KEPT_PICTURES);
        for (number, index) in self.keyframes.iter().enumerate().skip(oldest) {
            if let Some(pose) = poses.get(index) {
                self.dense.set_pose(number, *pose);
            }
        }
        for posed in self.waiting.iter_mut().filter_map(|(_, waiting)| waiting.job.posed()) {
            let Some(now) = poses.get(&posed.index) else { continue };
            let moved = *now * posed.world_from_camera.inverse();
            let neighbours = posed.before.iter_mut().chain(&mut posed.after);
            neighbours.for_each(|(_, pose)| *pose = moved * *pose);
            posed.world_from_camera = *now;
        }
        self.session().correct(poses);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn steps_wait_while_a_frame_is_tracked() {
        let tracking = Arc::<Mutex<()>>::default();
        let token = asked_after_tracking(CancellationToken::default(), Arc::clone(&tracking));
        let held = tracking.lock().expect("no panic");
        let step = std::thread::spawn(move || token.is_cancelled());
        std::thread::sleep(Duration::from_millis(50));
        assert!(!step.is_finished());
        drop(held);
        assert!(!step.join().expect("no panic"));
    }
}
