//! What a session on keyframes that come with poses asks of its map.

mod field;
mod field_extent;
mod field_step;
mod gaussians;
mod pose_optimizer;
mod surface_shells;
mod trajectory_term;

pub(crate) use field::JointFieldMapper;
pub(crate) use gaussians::JointGaussianMapper;

use super::mapper::MappingContext;
use crate::reconstruction::{FrameEstimate, Map};
use i2slam_geometry::Image;
use i2slam_radiance::hashgrid::SettingsError;
use std::sync::Arc;

/// A map that is refined together with keyframes that came with poses.
pub(crate) trait JointMapper: Send {
    /// Takes in a keyframe, the last of the context.
    fn add(&mut self, context: &mut MappingContext<'_>) -> Result<(), SettingsError>;

    /// Steps over all keyframes after the last; `on_step(done, of)` says whether to go on.
    fn finish(
        &mut self,
        context: &mut MappingContext<'_>,
        on_step: &mut dyn FnMut(usize, usize) -> bool,
    ) -> Result<(), SettingsError>;

    /// Moves a frame whose pose is roughly known to where its picture fits the map best, with the
    /// motion over its exposure and its gains, which start from those of the frame before it.
    /// Returns whether that was found; a frame that was not stays as it is.
    fn locate(
        &mut self,
        context: &MappingContext<'_>,
        frame: (&mut FrameEstimate, &Arc<Image<f32>>),
        before: Option<&FrameEstimate>,
    ) -> bool;

    /// Restricts the image terms to recorded pixels.
    fn set_covered(&mut self, covered: Arc<Image<bool>>);

    /// The map as it is now.
    fn map(&self) -> Map;
}
