//! Answer of the front end to a frame.

use i2slam_geometry::Pose;

/// Pose and status of a frame at the time when it came.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameUpdate {
    /// Its index among the accepted pictures.
    pub frame: usize,
    /// `world_from_camera` at mid-exposure, where it is known. With depth the world is the first
    /// keyframe, and the unit the metre from the moment on when enough depth was read. By colour alone
    /// both are arbitrary; corrections leave them where they fit the poses given before best.
    pub pose: Option<Pose<f64>>,
    /// Status of the pose.
    pub status: TrackingStatus,
    /// The picture shows another scene than the one before.
    pub is_cut: bool,
    /// The picture became a keyframe. None is made where an old one shows the same view; by colour
    /// alone that counts in long recordings.
    pub is_keyframe: bool,
    /// The keyframe before this picture was joined to a place that was seen much earlier, and all
    /// keyframes were adjusted to it.
    pub is_loop_closed: bool,
}

/// Knowledge of the pose of a frame at the time when it came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrackingStatus {
    /// There is no map yet, or by colour alone none that holds.
    Initializing,
    /// Registered to the map.
    Tracked,
    /// The picture shows nothing of the map.
    Lost,
}
