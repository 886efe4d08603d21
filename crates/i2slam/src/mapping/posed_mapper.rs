//! What a session on keyframes that come with poses asks of its map.

use super::Story;
use crate::reconstruction::{FrameEstimate, Map};
use i2slam_geometry::Image;
use i2slam_radiance::hashgrid::SettingsError;
use std::sync::Arc;

/// A map that is refined together with keyframes that came with poses.
pub(crate) trait PosedMapper: Send {
    /// Takes in a keyframe, the last of the story.
    fn add(&mut self, story: &mut Story<'_>) -> Result<(), SettingsError>;

    /// Steps over all keyframes after the last; `on_step(done, of)` says whether to go on.
    fn finish(
        &mut self,
        story: &mut Story<'_>,
        on_step: &mut dyn FnMut(usize, usize) -> bool,
    ) -> Result<(), SettingsError>;

    /// Moves a frame whose pose is roughly known to where its picture fits the map best, with the
    /// motion over its exposure and its gains, which start from those of the frame before it.
    /// Returns whether that was found; a frame that was not stays as it is.
    fn locate(
        &mut self,
        story: &Story<'_>,
        frame: (&mut FrameEstimate, &Image<f32>),
        before: Option<&FrameEstimate>,
    ) -> bool;

    /// Restricts the image terms to recorded pixels.
    fn set_covered(&mut self, covered: Arc<Image<bool>>);

    /// The map as it is now.
    fn map(&self) -> Map;
}
