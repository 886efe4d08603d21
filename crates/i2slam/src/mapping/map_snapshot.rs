//! A copy of the map that frames are tracked against while the map itself is refined.

use crate::objective::{FrameObjective, Observation, SceneMap};
use crate::tracking::{TrackingContext, TrackingResult, track};
use i2slam_formation::{CameraResponse, TrajectoryScale};
use i2slam_geometry::Image;
use std::any::Any;
use std::sync::Arc;

/// Something that finds frames in a map.
pub(crate) trait Tracker: Any + Send {
    /// Shutter poses and tone of a frame, from what the map shows.
    fn track(
        &mut self,
        context: &TrackingContext<'_>,
        observation: &Observation,
        response: Option<&CameraResponse<f32>>,
        scale: TrajectoryScale<f64>,
    ) -> TrackingResult;
}

/// The copy, and what draws it.
pub(crate) struct MapSnapshot<M: SceneMap> {
    map: M,
    objective: FrameObjective<M>,
}

impl<M: SceneMap + Clone + Send + 'static> MapSnapshot<M>
where
    FrameObjective<M>: Send,
{
    /// The snapshot before, brought up to date; the first draws with `objective`, which compares
    /// pixels that are `covered`.
    pub(crate) fn update(
        last: Option<Box<dyn Tracker>>,
        map: &M,
        covered: Option<Arc<Image<bool>>>,
        objective: impl FnOnce() -> FrameObjective<M>,
    ) -> Box<dyn Tracker> {
        let last = last.map(|last| last as Box<dyn Any>);
        match last.map(<Box<dyn Any>>::downcast::<Self>) {
            Some(Ok(mut snapshot)) => {
                snapshot.map.clone_from(map);
                snapshot
            }
            _ => {
                let mut objective = objective();
                covered.into_iter().for_each(|covered| objective.set_covered(covered));
                Box::new(Self { map: map.clone(), objective })
            }
        }
    }
}

impl<M: SceneMap + Send + 'static> Tracker for MapSnapshot<M>
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
