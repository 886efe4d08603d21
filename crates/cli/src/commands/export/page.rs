//! The map in 3D as a page for a browser.

use super::arguments::Export;
use super::{mark, write_text};
use crate::console::counted;
use crate::failure::Failure;
use crate::taken_pictures::{sequence_of, taken_pictures};
use i2slam_result::export::{Scene, html};

/// Writes the viewer page, with the pictures of the dataset where it is still there.
pub(super) fn write(arguments: &Export, scene: &Scene) -> Result<String, Failure> {
    let sequence = sequence_of(&arguments.result, "the page has no pictures as filmed");
    let name = std::path::absolute(&arguments.result).unwrap_or_default();
    let name = name.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let title = sequence.as_ref().map_or(name, |sequence| sequence.name.clone());
    let mut taken = sequence.as_ref().map(taken_pictures);
    let generator = mark("html");
    let page =
        html(scene, (&title, &generator), |frame| taken.as_mut().and_then(|load| load(frame)))?;
    write_text(&arguments.out, &page)?;
    Ok(format!("{}, {:.1} MB", counted(scene.gaussians(), "Gaussian"), page.len() as f64 * 1e-6))
}
