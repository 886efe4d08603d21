//! The viewer page of a scene.

use super::axes::Axes;
use super::error::ExportError;
use super::level::LEVEL_UP;
use super::scene::Scene;
use crate::viewer::ViewerPage;
use i2slam::FrameEstimate;
use i2slam::geometry::Image;

/// The page with its title, and what made it; `taken` loads the picture of a frame, if it is there.
///
/// # Errors
/// [`ExportError::Refused`] for a map that a page cannot show.
pub fn html(
    scene: &Scene,
    (title, generator): (&str, &str),
    taken: impl FnMut(&FrameEstimate) -> Option<Image<f32>>,
) -> Result<String, ExportError> {
    let page = ViewerPage {
        title,
        generator,
        reconstruction: &scene.reconstruction,
        frames: &scene.frames,
        files: &scene.files,
        up: scene.file_from_world(Axes::YDown).rotation.inverse().rotate(LEVEL_UP),
    };
    page.html(taken).map_err(|reason| ExportError::refused(format!("no 3D page: {reason}")))
}
