//! Tracking against a map, or against a copy of it while the map itself is optimised.

use crate::objective::{FrameObjective, Observation};
use crate::tracking::{TrackingContext, TrackingResult, track};
use i2slam_formation::{CameraResponse, TrajectoryScale};
use i2slam_geometry::Image;
use i2slam_radiance::RadianceMap;
use std::any::Any;
use std::sync::Arc;

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

/// Copies `map` into the snapshot `last`, or into a new one with `objective`, restricted to the
/// `covered` pixels.
pub(super) fn update_snapshot<M: RadianceMap + Clone + Send + 'static>(
    last: Option<Box<dyn Tracker>>,
    map: &M,
    covered: Option<Arc<Image<bool>>>,
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
            covered.into_iter().for_each(|covered| objective.set_covered(covered));
            Box::new(MapSnapshot { map: map.clone(), objective })
        }
    }
}
