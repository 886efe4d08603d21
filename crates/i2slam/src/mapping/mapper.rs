//! The interface between a session and its map: mapping, and tracking against the map or a copy.

use super::context::{MappingContext, OnStep};
use super::keyframe::Keyframe;
use crate::objective::{FrameObjective, Observation};
use crate::reconstruction::Map;
use crate::tracking::{TrackingContext, TrackingResult, track};
use i2slam_formation::{CameraResponse, TrajectoryScale};
use i2slam_geometry::Image;
use i2slam_radiance::RadianceMap;
use i2slam_radiance::hashgrid::SettingsError;
use std::any::Any;
use std::sync::Arc;

/// A map that grows with tracked frames.
pub(crate) trait Mapper: Send {
    fn is_empty(&self) -> bool;

    /// Invalid settings for which the map could not be started.
    fn failure(&self) -> Option<SettingsError> {
        None
    }

    /// Number of Gaussians; 0 of a map without.
    fn gaussians(&self) -> usize {
        0
    }

    /// Restricts the image terms to recorded pixels.
    fn set_valid_mask(&mut self, valid_mask: Arc<Image<bool>>);

    /// Tracks frames against the map; `None` while it is empty.
    fn tracker(&mut self) -> Option<&mut dyn Tracker>;

    /// A copy of the map to track against, in the memory of `last`; `None` while it is empty.
    fn snapshot(
        &self,
        valid_mask: Option<Arc<Image<bool>>>,
        last: Option<Box<dyn Tracker>>,
    ) -> Option<Box<dyn Tracker>>;

    /// Extends the map by what the current frame sees for the first time; starts an empty map.
    fn add(&mut self, context: &mut MappingContext<'_>, current: &Keyframe);

    /// Optimises map and keyframes; `first` allows the iterations of a new map.
    fn refine(&mut self, context: &mut MappingContext<'_>, current: &Keyframe, first: bool);

    /// Final optimisation over all keyframes; stops when `on_step(done, total)` returns false.
    fn finish(&mut self, context: &mut MappingContext<'_>, on_step: OnStep<'_>);

    fn map(&self) -> Map;
}

/// Tracks frames against a map of some kind.
pub(crate) trait Tracker: Any + Send {
    /// Shutter poses and tone of a frame.
    fn track(
        &mut self,
        context: &TrackingContext<'_>,
        observation: &Observation,
        response: Option<&CameraResponse<f32>>,
        scale: TrajectoryScale<f64>,
    ) -> TrackingResult;
}

/// A map, or a copy of one, and the objective that compares pictures with it.
pub(super) struct MapSnapshot<M: RadianceMap> {
    pub(super) map: M,
    pub(super) objective: FrameObjective<M>,
}

impl<M: RadianceMap + Send + 'static> Tracker for MapSnapshot<M>
where
    FrameObjective<M>: Send,
{
    fn track(
        &mut self,
        context: &TrackingContext<'_>,
        observation: &Observation,
        response: Option<&CameraResponse<f32>>,
        scale: TrajectoryScale<f64>,
    ) -> TrackingResult {
        track(context, &mut self.objective, &self.map, observation, response, scale)
    }
}

/// Copies `map` into the snapshot `last`, or a new one with `objective` and `valid_mask`.
pub(super) fn update_snapshot<M: RadianceMap + Clone + Send + 'static>(
    last: Option<Box<dyn Tracker>>,
    map: &M,
    valid_mask: Option<Arc<Image<bool>>>,
    objective: impl FnOnce() -> FrameObjective<M>,
) -> Box<dyn Tracker>
where
    FrameObjective<M>: Send,
{
    let last = last.map(|last| last as Box<dyn Any>);
    match last.map(<Box<dyn Any>>::downcast::<MapSnapshot<M>>) {
        Some(Ok(mut snapshot)) => {
            snapshot.map.clone_from(map);
            snapshot
        }
        _ => {
            let mut objective = objective();
            valid_mask.into_iter().for_each(|valid_mask| objective.set_valid_mask(valid_mask));
            Box::new(MapSnapshot { map: map.clone(), objective })
        }
    }
}
