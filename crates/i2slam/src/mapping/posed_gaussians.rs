//! Joint refinement of Gaussians and of keyframes that came with poses.
//!
//! Each keyframe is first found in the map that those before it made, which tells the motion over
//! its exposure and its gains; then it adds Gaussians at its estimated depth, and all steps move
//! Gaussians, start and end poses, tone and response together.

use super::gaussians::GaussianMapper;
use super::locate::Locator;
use super::{Keyframe, Mapper, PosedMapper, Story};
use crate::config::Config;
use crate::reconstruction::{FrameEstimate, Map};
use crate::tracking::SequenceReadout;
use i2slam_geometry::{Camera, Image};
use i2slam_radiance::hashgrid::SettingsError;
use std::sync::Arc;

/// Gaussians that are refined together with keyframes.
pub(crate) struct PosedGaussians {
    mapper: GaussianMapper,
    locator: Locator,
}

impl PosedGaussians {
    /// Times that all keyframes are found anew during the last steps.
    pub(crate) const SEARCHES: usize = 2;

    /// For keyframes of `camera`, taken from a video of `frame_rate` frames per second.
    pub(crate) fn new(config: &Config, camera: &Camera<f64>, frame_rate: f64) -> Self {
        let readout = SequenceReadout::new(&config.input);
        Self {
            mapper: GaussianMapper::new(config, camera),
            locator: Locator::new(frame_rate, readout),
        }
    }

    /// Finds all keyframes anew, one after another; the gains of the first stay.
    fn relocate(&mut self, story: &mut Story<'_>) {
        for keyframe in story.keyframes.iter().take_while(|_| !story.cancellation.is_cancelled()) {
            let tone = story.frames[keyframe.frame].tone;
            self.find(story, keyframe);
            if keyframe.frame == story.gauge_frame(keyframe) {
                story.frames[keyframe.frame].tone = tone;
            }
        }
    }

    /// Finds a keyframe in the map as it is; one that is not found stays where it was.
    fn find(&mut self, story: &mut Story<'_>, at: &Keyframe) {
        let mut estimate = story.frames[at.frame].clone();
        let before = at.beside.frame_before(&estimate);
        let others = &story.frames[..at.frame];
        let frame = (&mut estimate, &at.observation.colour);
        self.locator.locate(story, self.mapper.scene(), frame, before.as_ref(), others);
        story.frames[at.frame] = estimate;
    }
}

impl PosedMapper for PosedGaussians {
    fn add(&mut self, story: &mut Story<'_>) -> Result<(), SettingsError> {
        let Some((current, earlier)) = story.keyframes.split_last() else { return Ok(()) };
        let mut story = story.with_keyframes(earlier);
        let first = self.mapper.is_empty();
        if !first {
            self.find(&mut story, current);
        }
        self.mapper.add(&mut story, current);
        self.mapper.refine(&mut story, current, first);
        story.frames[current.frame].gaussians = self.mapper.gaussians();
        Ok(())
    }

    fn finish(
        &mut self,
        story: &mut Story<'_>,
        on_step: &mut dyn FnMut(usize, usize) -> bool,
    ) -> Result<(), SettingsError> {
        if self.mapper.is_empty() {
            let reason =
                "the map is empty: no keyframe came with a depth, which Gaussians begin on";
            story.warnings.push(reason.into());
        }
        let steps = story.config.mapping.final_iterations;
        let part = steps.div_ceil(Self::SEARCHES + 1);
        for round in 0..=Self::SEARCHES {
            let done = (round * part).min(steps);
            let count = part.min(steps - done);
            if !self.mapper.refine_all(story, count, &mut |step| on_step(done + step, steps)) {
                break;
            }
            if round < Self::SEARCHES {
                self.relocate(story);
            }
        }
        Ok(())
    }

    fn locate(
        &mut self,
        story: &Story<'_>,
        frame: (&mut FrameEstimate, &Image<f32>),
        before: Option<&FrameEstimate>,
    ) -> bool {
        !self.mapper.is_empty()
            && self.locator.locate(story, self.mapper.scene(), frame, before, story.frames)
    }

    fn set_covered(&mut self, covered: Arc<Image<bool>>) {
        self.mapper.set_covered(covered);
    }

    fn map(&self) -> Map {
        self.mapper.map()
    }
}
