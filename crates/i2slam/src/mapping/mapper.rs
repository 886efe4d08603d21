//! The interface between a session and its map.

use super::context::{MappingContext, OnStep};
use super::keyframe::Keyframe;
use crate::objective::{FrameObjective, Observation};
use crate::reconstruction::Map;
use crate::tracking::{TrackingContext, TrackingResult, track};
use i2slam_formation::{CameraResponse, TrajectoryScale};
use i2slam_geometry::{Image, Pose};
use i2slam_radiance::hashgrid::SettingsError;
use i2slam_radiance::{RadianceMap, Render};
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::Arc;

/// A map of some kind, which frames are tracked against and which grows with them.
pub(crate) trait Mapper: Send {
    fn is_empty(&self) -> bool;

    /// Number of Gaussians; 0 of a map without.
    fn gaussians(&self) -> usize {
        0
    }

    /// Restricts the image terms to recorded pixels.
    fn set_valid_mask(&mut self, valid_mask: Arc<Image<bool>>);

    /// Shutter poses and tone of a frame; `None` while the map is empty.
    fn track(
        &mut self,
        context: &TrackingContext<'_>,
        observation: &Observation,
        response: Option<&CameraResponse<f32>>,
        scale: TrajectoryScale<f64>,
    ) -> Option<TrackingResult>;

    /// The map seen from a pose; `None` while it is empty.
    fn render(&mut self, world_from_camera: Pose<f64>) -> Option<Render>;

    /// Extends the map by what the current frame sees for the first time; starts an empty map. Fails
    /// by settings that allow no map.
    fn add(
        &mut self,
        context: &mut MappingContext<'_>,
        current: &Keyframe,
    ) -> Result<Growth, SettingsError>;

    /// Optimises map and keyframes for the steps that the growth by the current frame asks for.
    fn refine(&mut self, context: &mut MappingContext<'_>, current: &Keyframe, growth: Growth);

    /// Prepares the final optimisation over all keyframes. Fails as [`add`](Self::add).
    fn plan_final(
        &mut self,
        context: &mut MappingContext<'_>,
    ) -> Result<FinalRefinement, SettingsError>;

    /// Takes the final `steps` out of `total`, until `on_step` returns false; returns its
    /// last value.
    fn refine_all(
        &mut self,
        context: &mut MappingContext<'_>,
        steps: (Range<usize>, usize),
        on_step: OnStep<'_>,
    ) -> bool;

    /// Adapts the map to corrected poses. `motions` are those of frames in the world, by their index,
    /// where the map has to move along; none where poses were refined in the map itself.
    fn correct(&mut self, _context: &MappingContext<'_>, _motions: &BTreeMap<usize, Pose<f64>>) {}

    /// Removes what frames with these indices brought into the map, where that is known.
    fn forget(&mut self, _frames: &BTreeSet<usize>) {}

    /// Removes what lies on the surface of `depth`, 0 where there is none, as a keyframe sees it, and
    /// extends the map where that opened it; nothing in a map without parts that can be removed.
    fn replace_surface(
        &mut self,
        _context: &mut MappingContext<'_>,
        _keyframe: &Keyframe,
        _depth: &Image<f32>,
    ) {
    }

    /// Removes what keyframes see through, by their depth; nothing in a map without parts that can be
    /// removed.
    fn remove_contradicted(&mut self, _context: &MappingContext<'_>) {}

    /// Changes log radiance by `change`, of the place of the frame that brought it and the radiance, and
    /// differences of log radiance by the factor `stretch`. Returns whether the map can do so.
    fn change_radiance(
        &mut self,
        _context: &MappingContext<'_>,
        _change: &dyn Fn(usize, [f32; 3]) -> [f32; 3],
        _stretch: f32,
    ) -> bool {
        false
    }

    fn map(&self) -> Map;
}

/// Change of a map by a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Growth {
    /// It waits for more frames to start with.
    Waiting,
    /// It was started, or started again.
    Started,
    Extended,
}

/// Extent of the final optimisation.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FinalRefinement {
    pub(crate) steps: usize,
    /// Relocalisations of all keyframes during these steps, where their poses are refined.
    pub(crate) relocalizations: usize,
}

/// A map and the objective that compares pictures with it.
pub(super) struct ComparedMap<M: RadianceMap> {
    pub(super) map: M,
    pub(super) objective: FrameObjective<M>,
}

impl<M: RadianceMap> ComparedMap<M> {
    /// See [`Mapper::track`].
    pub(super) fn track(
        &mut self,
        context: &TrackingContext<'_>,
        observation: &Observation,
        response: Option<&CameraResponse<f32>>,
        scale: TrajectoryScale<f64>,
    ) -> TrackingResult {
        track(context, &mut self.objective, &self.map, observation, response, scale)
    }

    /// See [`Mapper::render`].
    pub(super) fn render(&mut self, world_from_camera: Pose<f64>) -> Render {
        self.objective.render(&self.map, world_from_camera).clone()
    }
}
