//! Localisation of frames in a map from roughly known poses.

use crate::mapping::context::MappingContext;
use crate::mapping::depth_inpainting::MIN_SURFACE_OPACITY;
use crate::objective::{FrameObjective, Observation};
use crate::reconstruction::FrameEstimate;
use crate::tracking::{SequenceReadout, TrackingContext, track};
use i2slam_formation::TrajectoryScale;
use i2slam_geometry::Image;
use i2slam_radiance::RadianceMap;
use i2slam_radiance::Render;
use std::sync::Arc;
use std::time::Instant;

/// Localises frames in a map; trajectory scale and readout carry over from frame to frame.
pub(super) struct FrameLocator {
    frame_rate: f64,
    scale: TrajectoryScale<f64>,
    readout: SequenceReadout,
}

impl FrameLocator {
    pub(super) fn new(frame_rate: f64, readout: SequenceReadout) -> Self {
        Self { frame_rate, scale: TrajectoryScale::from_frame_rate(frame_rate), readout }
    }

    /// Moves `estimate` to where its picture, without depth, fits the map best, with motion during
    /// exposure and tone. `previous` is the frame before it if known; the losses of `others` set
    /// what counts as a good fit. Returns whether it was found; a frame that was not stays.
    pub(super) fn locate<M: RadianceMap>(
        &mut self,
        context: &MappingContext<'_>,
        (map, objective): (&M, &mut FrameObjective<M>),
        (estimate, colour): (&mut FrameEstimate, &Arc<Image<f32>>),
        previous: Option<&FrameEstimate>,
        others: &[FrameEstimate],
    ) -> bool {
        let clock = Instant::now();
        let expected = estimate.middle();
        let observation = with_map_depth(colour, objective.render(map, expected));
        let tracking = TrackingContext {
            config: context.config,
            camera: context.camera,
            frame_rate: self.frame_rate,
            readout: self.readout,
            timestamps: (estimate.timestamp, estimate.timestamp),
            frames: others,
            previous,
            before_previous: None,
            expected: Some(expected),
            keyframe: None,
            cancellation: context.cancellation,
        };
        let response = context.config.formation.tone.then(|| &context.responses[estimate.response]);
        let result = track(&tracking, objective, map, &observation, response, self.scale);
        estimate.tracking_seconds += clock.elapsed().as_secs_f64();
        estimate.tracked = result.tracked;
        if !result.tracked {
            return false;
        }
        self.scale = result.scale;
        result.write_to(estimate, context.camera, &observation.depth);
        true
    }
}

/// A picture with the depth of the map, all pixels at unit variance.
fn with_map_depth(colour: &Arc<Image<f32>>, render: &Render) -> Observation {
    let depth = render.surface(MIN_SURFACE_OPACITY);
    let mut variance = Image::new(depth.width, depth.height, 1);
    variance.data.fill(1.0);
    Observation::estimated(Arc::clone(colour), depth, variance)
}
