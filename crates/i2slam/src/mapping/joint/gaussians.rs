//! Joint optimisation of Gaussians and keyframes.
//!
//! Each keyframe is first localised in the map of those before it, which initialises its motion
//! during exposure and its tone. Then it adds Gaussians at its estimated depth, and every step moves
//! Gaussians, start and end poses, tone and response.

use super::JointMapper;
use super::localization::FrameLocator;
use crate::config::Config;
use crate::mapping::context::{MappingContext, OnStep};
use crate::mapping::gaussians::GaussianMapper;
use crate::mapping::keyframe::Keyframe;
use crate::mapping::mapper::Mapper;
use crate::reconstruction::{FrameEstimate, Map};
use crate::tracking::SequenceReadout;
use i2slam_geometry::{Camera, Image};
use i2slam_radiance::hashgrid::SettingsError;
use std::sync::Arc;

/// Gaussians that are optimised together with keyframe poses.
pub(crate) struct JointGaussianMapper {
    mapper: GaussianMapper,
    locator: FrameLocator,
}

impl JointGaussianMapper {
    /// Relocalisations of all keyframes during the final optimisation.
    pub(crate) const RELOCALIZATIONS: usize = 2;

    /// For keyframes of `camera`, taken from a video of `frame_rate` frames per second.
    pub(crate) fn new(config: &Config, camera: &Camera<f64>, frame_rate: f64) -> Self {
        let readout = SequenceReadout::new(&config.input);
        Self {
            mapper: GaussianMapper::new(config, camera),
            locator: FrameLocator::new(frame_rate, readout),
        }
    }

    /// Localises all keyframes again in their order; the tone of the gauge frame stays.
    fn relocalize(&mut self, context: &mut MappingContext<'_>) {
        for keyframe in
            context.keyframes.iter().take_while(|_| !context.cancellation.is_cancelled())
        {
            let tone = context.frames[keyframe.frame].tone;
            self.localize(context, keyframe);
            if keyframe.frame == context.gauge_frame(keyframe) {
                context.frames[keyframe.frame].tone = tone;
            }
        }
    }

    /// Localises a keyframe; one that is not found stays.
    fn localize(&mut self, context: &mut MappingContext<'_>, keyframe: &Keyframe) {
        let mut estimate = context.frames[keyframe.frame].clone();
        let previous = keyframe.adjacent.previous_frame(&estimate);
        let others = &context.frames[..keyframe.frame];
        let frame = (&mut estimate, &keyframe.observation.colour);
        self.locator.locate(
            context,
            self.mapper.map_and_objective(),
            frame,
            previous.as_ref(),
            others,
        );
        context.frames[keyframe.frame] = estimate;
    }
}

impl JointMapper for JointGaussianMapper {
    fn add(&mut self, context: &mut MappingContext<'_>) -> Result<(), SettingsError> {
        let Some((current, earlier)) = context.keyframes.split_last() else { return Ok(()) };
        let mut context = context.with_keyframes(earlier);
        let first = self.mapper.is_empty();
        if !first {
            self.localize(&mut context, current);
        }
        self.mapper.add(&mut context, current);
        self.mapper.refine(&mut context, current, first);
        context.frames[current.frame].gaussians = self.mapper.gaussians();
        Ok(())
    }

    fn finish(
        &mut self,
        context: &mut MappingContext<'_>,
        on_step: OnStep<'_>,
    ) -> Result<(), SettingsError> {
        if self.mapper.is_empty() {
            let reason =
                "the map is empty: no keyframe came with a depth, which Gaussians begin on";
            context.warnings.push(reason.into());
        }
        let steps = context.config.mapping.final_iterations;
        let part = steps.div_ceil(Self::RELOCALIZATIONS + 1);
        for round in 0..=Self::RELOCALIZATIONS {
            let done = (round * part).min(steps);
            let count = part.min(steps - done);
            if !self.mapper.refine_all(context, count, &mut |step| on_step(done + step, steps)) {
                break;
            }
            if round < Self::RELOCALIZATIONS {
                self.relocalize(context);
            }
        }
        Ok(())
    }

    fn locate(
        &mut self,
        context: &MappingContext<'_>,
        frame: (&mut FrameEstimate, &Arc<Image<f32>>),
        previous: Option<&FrameEstimate>,
    ) -> bool {
        !self.mapper.is_empty()
            && self.locator.locate(
                context,
                self.mapper.map_and_objective(),
                frame,
                previous,
                context.frames,
            )
    }

    fn set_valid_mask(&mut self, valid_mask: Arc<Image<bool>>) {
        self.mapper.set_valid_mask(valid_mask);
    }

    fn map(&self) -> Map {
        self.mapper.map()
    }
}
