//! Joint refinement of Gaussians and of keyframes that came with poses.
//!
//! Each keyframe is first found in the map that those before it made, which tells the motion over
//! its exposure and its gains; then it adds Gaussians at its estimated depth, and all steps move
//! Gaussians, start and end poses, tone and response together.

use super::JointMapper;
use crate::config::Config;
use crate::mapping::gaussians::GaussianMapper;
use crate::mapping::keyframe::Keyframe;
use crate::mapping::localization::FrameLocator;
use crate::mapping::mapper::{Mapper, MappingContext};
use crate::reconstruction::{FrameEstimate, Map};
use crate::tracking::SequenceReadout;
use i2slam_geometry::{Camera, Image};
use i2slam_radiance::hashgrid::SettingsError;
use std::sync::Arc;

/// Gaussians that are refined together with keyframes.
pub(crate) struct JointGaussianMapper {
    mapper: GaussianMapper,
    locator: FrameLocator,
}

impl JointGaussianMapper {
    /// Times that all keyframes are found anew during the last steps.
    pub(crate) const SEARCHES: usize = 2;

    /// For keyframes of `camera`, taken from a video of `frame_rate` frames per second.
    pub(crate) fn new(config: &Config, camera: &Camera<f64>, frame_rate: f64) -> Self {
        let readout = SequenceReadout::new(&config.input);
        Self {
            mapper: GaussianMapper::new(config, camera),
            locator: FrameLocator::new(frame_rate, readout),
        }
    }

    /// Finds all keyframes anew, one after another; the gains of the first stay.
    fn relocate(&mut self, context: &mut MappingContext<'_>) {
        for keyframe in
            context.keyframes.iter().take_while(|_| !context.cancellation.is_cancelled())
        {
            let tone = context.frames[keyframe.frame].tone;
            self.find(context, keyframe);
            if keyframe.frame == context.gauge_frame(keyframe) {
                context.frames[keyframe.frame].tone = tone;
            }
        }
    }

    /// Finds a keyframe in the map as it is; one that is not found stays where it was.
    fn find(&mut self, context: &mut MappingContext<'_>, at: &Keyframe) {
        let mut estimate = context.frames[at.frame].clone();
        let before = at.adjacent.frame_before(&estimate);
        let others = &context.frames[..at.frame];
        let frame = (&mut estimate, &at.observation.colour);
        self.locator.locate(context, self.mapper.scene(), frame, before.as_ref(), others);
        context.frames[at.frame] = estimate;
    }
}

impl JointMapper for JointGaussianMapper {
    fn add(&mut self, context: &mut MappingContext<'_>) -> Result<(), SettingsError> {
        let Some((current, earlier)) = context.keyframes.split_last() else { return Ok(()) };
        let mut context = context.with_keyframes(earlier);
        let first = self.mapper.is_empty();
        if !first {
            self.find(&mut context, current);
        }
        self.mapper.add(&mut context, current);
        self.mapper.refine(&mut context, current, first);
        context.frames[current.frame].gaussians = self.mapper.gaussians();
        Ok(())
    }

    fn finish(
        &mut self,
        context: &mut MappingContext<'_>,
        on_step: &mut dyn FnMut(usize, usize) -> bool,
    ) -> Result<(), SettingsError> {
        if self.mapper.is_empty() {
            let reason =
                "the map is empty: no keyframe came with a depth, which Gaussians begin on";
            context.warnings.push(reason.into());
        }
        let steps = context.config.mapping.final_iterations;
        let part = steps.div_ceil(Self::SEARCHES + 1);
        for round in 0..=Self::SEARCHES {
            let done = (round * part).min(steps);
            let count = part.min(steps - done);
            if !self.mapper.refine_all(context, count, &mut |step| on_step(done + step, steps)) {
                break;
            }
            if round < Self::SEARCHES {
                self.relocate(context);
            }
        }
        Ok(())
    }

    fn locate(
        &mut self,
        context: &MappingContext<'_>,
        frame: (&mut FrameEstimate, &Arc<Image<f32>>),
        before: Option<&FrameEstimate>,
    ) -> bool {
        !self.mapper.is_empty()
            && self.locator.locate(context, self.mapper.scene(), frame, before, context.frames)
    }

    fn set_covered(&mut self, covered: Arc<Image<bool>>) {
        self.mapper.set_covered(covered);
    }

    fn map(&self) -> Map {
        self.mapper.map()
    }
}
