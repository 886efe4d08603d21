//! Sharp pictures of a scene with masks, and surface points that they see.

use super::error::ExportError;
use super::scene::Scene;
use super::seed_points::{SeedPoints, View};
use super::watch::Watch;
use crate::pictures::{write_mask, write_picture, write_radiance};
use i2slam::geometry::Image;
use i2slam_storage::OutputFolder;

/// Folder of the pictures.
pub(crate) const PICTURES: &str = "images";
/// Folder of the masks.
pub(crate) const MASKS: &str = "masks";

/// Least opacity of a pixel that counts as seen.
const SEEN: f32 = 0.5;

/// Writes the pictures of all frames, all with the exposure, white balance and response that are
/// typical of the run (or linear radiance), and masks: 255 where the map is opaque, 0 where nothing
/// was seen. `mask_name` makes the name of a mask from that of its picture.
pub(crate) fn write_views(
    scene: &Scene,
    folder: &OutputFolder,
    mask_name: impl Fn(&str) -> String,
    watch: &Watch<'_>,
) -> Result<SeedPoints, ExportError> {
    let reconstruction = &scene.reconstruction;
    let mut viewer = reconstruction.viewer();
    let mut points = SeedPoints::new(reconstruction.camera);
    for (done, frame) in scene.frames.iter().enumerate() {
        watch.step("rendering", done, scene.frames.len())?;
        let pose = frame.middle();
        let picture = viewer.sharp(&reconstruction.virtual_frame(frame.index, pose));
        let (depth, opacity) = (viewer.depth(pose), viewer.opacity(pose));
        points.add(&View { pose, picture: &picture, depth: &depth, opacity: &opacity });
        let name = scene.picture_name(frame);
        let file = format!("{PICTURES}/{name}");
        match scene.linear {
            true => folder.write(&file, |out| write_radiance(out, &viewer.hdr(pose)))?,
            false => folder.write(&file, |out| write_picture(out, &picture))?,
        }
        let data = opacity.data.iter().map(|&o| f32::from(u8::from(o >= SEEN))).collect();
        let mask = Image { data, ..opacity };
        folder.write(&format!("{MASKS}/{}", mask_name(&name)), |out| write_mask(out, &mask))?;
    }
    Ok(points)
}
