//! Joint optimisation of a map and of keyframes whose poses are only roughly known.

mod field;
mod field_sampling;
mod gaussians;
mod localization;
mod pose_optimizer;
mod trajectory_term;

pub(crate) use field::JointFieldMapper;
pub(crate) use gaussians::JointGaussianMapper;

use super::context::{MappingContext, OnStep};
use crate::reconstruction::{FrameEstimate, Map};
use i2slam_geometry::Image;
use i2slam_radiance::hashgrid::SettingsError;
use std::sync::Arc;

/// A map that is optimised together with the poses of its keyframes.
pub(crate) trait JointMapper: Send {
    /// Adds the last keyframe and optimises for some steps; fails by settings that allow no map.
    fn add(&mut self, context: &mut MappingContext<'_>) -> Result<(), SettingsError>;

    /// Final optimisation, until `on_step(done, total)` returns false; fails as [`add`](Self::add).
    fn finish(
        &mut self,
        context: &mut MappingContext<'_>,
        on_step: OnStep<'_>,
    ) -> Result<(), SettingsError>;

    /// Localises a frame from its roughly known pose, with motion during exposure and tone starting
    /// from `previous`. Returns whether it was found; a frame that was not stays.
    fn locate(
        &mut self,
        context: &MappingContext<'_>,
        frame: (&mut FrameEstimate, &Arc<Image<f32>>),
        previous: Option<&FrameEstimate>,
    ) -> bool;

    /// Restricts the image terms to recorded pixels.
    fn set_valid_mask(&mut self, _valid_mask: Arc<Image<bool>>) {}

    fn map(&self) -> Map;
}
