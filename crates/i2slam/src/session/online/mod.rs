//! SLAM while the camera moves: the pose of a frame when it comes, and a map that follows the
//! corrections of poses.

mod backlog;
mod mapping;
mod queue;
mod registration;

pub(crate) use mapping::{MappedFrames, OnlineMapping};
pub use queue::MappingPanicked;

use super::Session;
use crate::config::Config;
use crate::keyframes::{OdometryProgress, OdometryReconstruction};
use crate::reconstruction::{FrameEstimate, Reconstruction};
use i2slam_dataset::Frame;
use i2slam_geometry::{Camera, Image, Pose, StampedPose};
use i2slam_odometry::{
    DepthPicture, FrontEnd, Intrinsics, OdometryError, PictureError, TrackingStatus,
};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// SLAM on frames of a known camera while they come, with measured depth or without.
///
/// [`push`](Self::push) answers with the pose of its frame; the map is made on a thread of its own, in
/// an order that depends on the frames alone, so that results do not depend on time unless
/// `mapping.seconds_per_frame` is set.
/// [`finish`](Self::finish) adjusts all poses together, closes loops and refines the map.
///
/// ```no_run
/// use i2slam::{Config, OnlineSession, RunOptions};
///
/// let options = RunOptions::with_depth();
/// let sequence = options.open_sequence("rgbd_dataset_freiburg1_desk".as_ref())?;
/// let mut session = OnlineSession::new(Config::default(), sequence.camera, sequence.frame_rate);
/// for frame in sequence.stream() {
///     let update = session.push(frame?)?;
///     println!("{:?} {:?}", update.status, update.world_from_camera);
/// }
/// let reconstruction = session.finish(&mut |_, _| true)?;
/// println!("{}", reconstruction.map);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct OnlineSession {
    front_end: FrontEnd,
    mapping: OnlineMapping,
    /// Index of every frame that was accepted.
    indices: Vec<usize>,
    online: Vec<StampedPose>,
    /// Held while a frame of a camera is tracked.
    tracking: Arc<Mutex<()>>,
}

/// Answer to a frame.
#[derive(Clone, Debug)]
pub struct OnlineUpdate {
    /// Index of the frame, as it came.
    pub index: usize,
    /// Its time stamp [s].
    pub timestamp: f64,
    /// Pose at mid-exposure, where it is known. The world is the camera of the first frame in the
    /// map; the unit is the metre with depth from the first frame on, and otherwise half the median
    /// depth of that frame. By colour alone both change a little where a loop is closed, and stay as
    /// near to the poses given before as they can.
    pub world_from_camera: Option<Pose<f64>>,
    /// Status of the pose.
    pub status: TrackingStatus,
    /// True if the frame became a keyframe.
    pub is_keyframe: bool,
    /// True if a place that was seen much earlier was joined to the path of now.
    pub is_loop_closed: bool,
    /// Poses of earlier frames of the map that changed since the last frame, by their index. The map
    /// follows them.
    pub corrections: BTreeMap<usize, Pose<f64>>,
}

impl OnlineUpdate {
    /// Pose and time stamp of the frame, where the pose is known.
    pub(crate) fn stamped_pose(&self) -> Option<StampedPose> {
        let timestamp = self.timestamp;
        self.world_from_camera.map(|world_from_camera| StampedPose { timestamp, world_from_camera })
    }
}

impl OnlineSession {
    /// A session on frames of `camera`, taken from a video of `frame_rate` frames per second.
    pub fn new(config: Config, camera: Camera<f64>, frame_rate: f64) -> Self {
        Self::of(Session::refining(config, camera, frame_rate), camera, |_, _| {})
    }

    /// Maps in `session` what is tracked in pictures of the camera `tracked`, which may be larger.
    /// `on_mapped` sees every frame that was mapped, on the thread of the map, with what copies
    /// everything estimated so far.
    pub(crate) fn of(
        session: Session,
        tracked: Camera<f64>,
        on_mapped: impl FnMut(&FrameEstimate, &dyn Fn() -> Reconstruction) + Send + 'static,
    ) -> Self {
        let (scratch, tracking) = (Arc::clone(&session.state.scratch), Arc::<Mutex<()>>::default());
        Self {
            front_end: FrontEnd::new(Intrinsics::Known(tracked)).with_scratch(scratch),
            mapping: OnlineMapping::new(session, Arc::clone(&tracking), Box::new(on_mapped)),
            indices: Vec::new(),
            online: Vec::new(),
            tracking,
        }
    }

    /// Disables loop closure, before the first frame.
    #[must_use]
    pub fn without_loop_closure(mut self) -> Self {
        self.front_end = self.front_end.without_loop_closure();
        self
    }

    /// Restricts the image terms to recorded pixels, a mask such as `Sequence::valid_mask`.
    pub fn set_valid_mask(&mut self, valid_mask: Arc<Image<bool>>) {
        self.mapping.session().set_valid_mask(valid_mask);
    }

    /// Sets the frame rate [1/s] before the second frame, with which the first is sent to the map.
    pub(crate) fn set_frame_rate(&mut self, frame_rate: f64) {
        self.mapping.session().set_frame_rate(frame_rate);
    }

    /// Tracks a frame, and hands frames to the map, which takes them in when two later keyframes, or
    /// sixteen frames with depth, have come.
    ///
    /// It never waits for the map; the map waits for it, between two steps, and that time counts in
    /// `mapping.seconds_per_frame`. Frames that wait to be mapped are kept within `memory`, others in
    /// a file. `mapping.seconds_per_frame` lets a map keep up with a camera.
    ///
    /// # Errors
    ///
    /// A frame that does not fit the camera, or whose time stamp does not follow: the session stays
    /// as it was.
    pub fn push(&mut self, frame: Frame) -> Result<OnlineUpdate, PictureError> {
        self.push_in_sizes(&frame.clone(), frame)
    }

    /// [`push`](Self::push) of a frame in the sizes that are tracked and mapped.
    pub(crate) fn push_in_sizes(
        &mut self,
        tracked: &Frame,
        mapped: Frame,
    ) -> Result<OnlineUpdate, PictureError> {
        let tracking = Arc::clone(&self.tracking);
        let _held = tracking.lock().unwrap_or_else(PoisonError::into_inner);
        let (index, timestamp) = (tracked.index, tracked.timestamp);
        let depth = tracked
            .depth
            .as_ref()
            .map(|depth| DepthPicture { depth: &depth.image, timestamp: depth.timestamp });
        let update = match self.mapping.is_held_out(index) {
            true => self.front_end.push_held_out(&tracked.colour, timestamp, depth.as_ref())?,
            false => self.front_end.push(&tracked.colour, timestamp, depth.as_ref())?,
        };
        self.indices.push(index);
        let corrections = self.mapping.add_frame(&self.front_end, &update, mapped);
        let world_from_camera = update.pose.and_then(|pose| self.mapping.placed(pose));
        self.online.extend(
            world_from_camera.map(|world_from_camera| StampedPose { timestamp, world_from_camera }),
        );
        Ok(OnlineUpdate {
            index,
            timestamp,
            world_from_camera,
            status: update.status,
            is_keyframe: update.is_keyframe,
            is_loop_closed: update.is_loop_closed,
            corrections,
        })
    }

    /// Waits until at most so many frames and corrections wait for the map, for sources that wait in
    /// turn, such as files.
    pub fn wait_for_map(&self, waiting: usize) {
        self.mapping.wait_for_map(waiting);
    }

    /// Number of frames and corrections that wait for the map, without frames that wait for later ones.
    pub fn waiting_for_map(&self) -> usize {
        self.mapping.waiting_for_map()
    }

    /// A copy of map and frames so far: those that the map has taken in. To be asked from another
    /// thread, share the session in a mutex; a frame holds it only while it is tracked.
    pub fn reconstruction(&self) -> Reconstruction {
        Reconstruction {
            online_trajectory: self.online.clone(),
            ..self.mapping.session().reconstruction()
        }
    }

    /// Adjusts all poses together and refines the map, which moves along; stops refining when `on_step(done, total)`
    /// returns false. Frames that the map was not made of have poses alone.
    ///
    /// # Errors
    ///
    /// The reason why no path was found in the frames; the map is lost then.
    pub fn finish(
        self,
        on_step: &mut dyn FnMut(usize, usize) -> bool,
    ) -> Result<Reconstruction, OnlineError> {
        let found = self.front_end.finish(OdometryProgress::default())?;
        let MappedFrames { mut session, path, errors, .. } = self.mapping.finish(found)?;
        session.state.warnings.extend(errors.iter().map(|error| error.to_string().into()));
        session.finish(on_step);
        let poses = path.poses.iter().zip(&path.timestamps);
        for (index, (pose, stamp)) in self.indices.iter().zip(poses) {
            if let Some(pose) = pose {
                session.insert_unrefined(*index, *stamp, *pose);
            }
        }
        Ok(Reconstruction { online_trajectory: self.online, ..session.reconstruction() })
    }

    /// Adjusts all poses together; the path so far once `progress` is cancelled. Mapping goes on
    /// meanwhile.
    pub(crate) fn into_path(
        self,
        progress: &OdometryProgress,
    ) -> Result<(OdometryReconstruction, OnlineMapping), OdometryError> {
        let so_far = self.front_end.path_so_far(None);
        let found = match progress.is_cancelled() {
            true => Err(OdometryError::Cancelled),
            false => self.front_end.finish(progress.clone()),
        };
        let path = match found {
            Err(OdometryError::Cancelled) => so_far,
            found => found?,
        };
        Ok((path, self.mapping))
    }
}

/// Failure to finish a session.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OnlineError {
    /// No path was found in the frames.
    #[error(transparent)]
    NoPath(#[from] OdometryError),
    /// The map could not be made.
    #[error(transparent)]
    Mapping(#[from] MappingPanicked),
}
