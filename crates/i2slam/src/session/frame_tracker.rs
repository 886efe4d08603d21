//! Frames against the map: tracking from the motion before, and localisation from a pose that is
//! roughly known.

use crate::config::{InputConfig, MapKind};
use crate::mapping::{MIN_SURFACE_OPACITY, Mapper, MappingContext};
use crate::objective::Observation;
use crate::reconstruction::FrameEstimate;
use crate::tracking::{ExpectedView, SequenceReadout, TrackingContext};
use i2slam_formation::TrajectoryScale;
use i2slam_geometry::{Image, Tangent};
use std::sync::Arc;
use std::time::Instant;

/// Trajectory scale and readout of a sequence, which carry over from frame to frame.
pub(super) struct FrameTracker {
    pub(super) frame_rate: f64,
    pub(super) scale: TrajectoryScale<f64>,
    pub(super) readout: SequenceReadout,
    /// True if held-out frames may leave their input poses: those of photographs have independent errors
    /// of half a pixel, by which their pictures would be compared with other places.
    pub(super) moves_held_out: bool,
}

impl FrameTracker {
    /// For a sequence of `frame_rate` frames per second.
    pub(super) fn new(frame_rate: f64, input: &InputConfig) -> Self {
        Self {
            frame_rate,
            scale: TrajectoryScale::from_frame_rate(frame_rate),
            readout: SequenceReadout::new(input),
            moves_held_out: false,
        }
    }

    /// Moves `estimate` to where its picture, without depth, fits the map best, with motion during
    /// exposure and tone. `previous` is the frame before it, and `exposure_motion` that of a photograph
    /// found by comparison with others, where known; the losses of `others` set what counts as a good fit.
    /// Returns whether it was found; a frame that was not stays.
    pub(super) fn localize(
        &mut self,
        mapper: &mut dyn Mapper,
        context: &MappingContext<'_>,
        (estimate, colour): (&mut FrameEstimate, &Arc<Image<f32>>),
        (previous, exposure_motion): (Option<&FrameEstimate>, Option<Tangent<f64>>),
        others: &[FrameEstimate],
    ) -> bool {
        let clock = Instant::now();
        let expected = estimate.middle();
        estimate.tracked = false;
        let Some(render) = mapper.render(expected) else { return false };
        let observation = with_map_depth(colour, render.surface(MIN_SURFACE_OPACITY));
        let tracking = TrackingContext {
            config: context.config,
            camera: context.camera,
            frame_rate: self.frame_rate,
            readout: self.readout,
            timestamps: (estimate.timestamp, estimate.timestamp),
            frames: others,
            previous,
            before_previous: None,
            exposure_motion,
            expected: Some(ExpectedView { world_from_camera: expected, render: &render }),
            keyframe: None,
            white_balance: context.white_balance,
            vignetting: context.vignetting,
            cancellation: context.cancellation,
        };
        let response = context.config.formation.tone.then(|| &context.responses[estimate.response]);
        let result = mapper.track(&tracking, &observation, response, self.scale);
        estimate.tracking_seconds += clock.elapsed().as_secs_f64();
        let Some(result) = result.filter(|result| result.tracked) else { return false };
        estimate.tracked = true;
        self.scale = result.scale;
        result.write_to(estimate, context.camera, &observation.depth);
        let is_free = self.moves_held_out && estimate.held_out;
        if context.config.parameters.frames.keeps_middle && !is_free {
            estimate.shutter = estimate.shutter.with_middle(expected);
        }
        true
    }

    /// Localises all keyframes again in their order; the tone of the gauge frame stays. In Gaussians,
    /// which a keyframe is localised in when it comes, too, it is compared with the frames before it
    /// alone.
    pub(super) fn relocalize(&mut self, mapper: &mut dyn Mapper, context: &mut MappingContext<'_>) {
        let keyframes = context.keyframes;
        for keyframe in keyframes.iter().take_while(|_| !context.cancellation.is_cancelled()) {
            let mut estimate = context.frames[keyframe.frame].clone();
            let tone = estimate.tone;
            let adjacent = keyframe.adjacent.previous_frame(&estimate);
            let earlier = &context.frames[..keyframe.frame];
            let (previous, others) = match context.config.map.kind {
                MapKind::Gaussian => (adjacent, earlier),
                MapKind::HashGrid => {
                    (adjacent.or_else(|| earlier.last().cloned()), &*context.frames)
                }
            };
            let observation = keyframe.observation.get();
            let frame = (&mut estimate, &observation.colour);
            let known =
                (previous.as_ref(), keyframe.exposure_motion(&context.frames[keyframe.frame]));
            self.localize(mapper, context, frame, known, others);
            if keyframe.has_found_motion {
                let known = &context.frames[keyframe.frame];
                (estimate.shutter, estimate.readout) = (known.shutter, known.readout);
                estimate.blur_length = known.blur_length;
            }
            if keyframe.frame == context.gauge_frame(keyframe) {
                estimate.tone = tone;
            }
            context.frames[keyframe.frame] = estimate;
        }
    }
}

/// A picture with the depth of the map, all pixels at unit variance.
fn with_map_depth(colour: &Arc<Image<f32>>, depth: Image<f32>) -> Observation {
    let mut variance = Image::new(depth.width, depth.height, 1);
    variance.data.fill(1.0);
    Observation::estimated(Arc::clone(colour), depth, variance)
}
