//! Poses of the camera at any time.

use crate::motion::Motion;
use crate::scene::DeskPlace;
use crate::spec::Spec;
use crate::stills::Stills;
use i2slam_geometry::Pose;

/// A camera in motion, or one that takes photographs.
#[derive(Clone, Debug)]
pub(crate) enum CameraPath {
    /// A film.
    Film(Box<Motion>),
    /// Photographs around an object.
    Stills(Stills),
}

impl CameraPath {
    /// The path of a specification in a room with that desk, for a focal length [px].
    pub(crate) fn new(spec: &Spec, desk: DeskPlace, focal_length: f64) -> Self {
        if spec.stills.around_object {
            return Self::Stills(Stills::new(spec, focal_length));
        }
        Self::Film(Box::new(Motion::new(spec, desk)))
    }

    /// The pose `world_from_camera` at a time [s] from the first frame's stamp on.
    pub(crate) fn world_from_camera(&self, time: f64) -> Pose<f64> {
        match self {
            Self::Film(motion) => motion.world_from_camera(time),
            Self::Stills(stills) => stills.world_from_camera(time),
        }
    }
}
