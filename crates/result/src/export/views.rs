//! Sharp pictures of a scene, with the detail of those taken, with masks, and surface points that they see.

use super::error::ExportError;
use super::scene::Scene;
use super::seed_points::{SeedPoints, View};
use super::watch::Watch;
use crate::pictures::{write_mask, write_picture, write_radiance};
use i2slam::FrameEstimate;
use i2slam::geometry::Image;
use i2slam_storage::OutputFolder;

/// Folder of the pictures.
pub(crate) const PICTURES: &str = "images";
/// Folder of the masks.
pub(crate) const MASKS: &str = "masks";

/// Least opacity of a pixel that counts as seen.
const SEEN: f32 = 0.5;

/// A loader of the picture taken of a frame, black beyond the picture of the camera; `None` where there
/// is none.
pub type LoadTaken<'a> = dyn FnMut(&FrameEstimate) -> Option<Image<f32>> + 'a;

/// Writes pictures of all frames, renders with the detail of the pictures taken, all with the exposure,
/// white balance and response that are typical of the run (or linear radiance), and masks: 255 where
/// the map is opaque, 0 where nothing was seen. `mask_name` makes the name of a mask from that of its
/// picture.
pub(crate) fn write_views(
    scene: &Scene,
    folder: &OutputFolder,
    mask_name: impl Fn(&str) -> String,
    taken: &mut LoadTaken<'_>,
    watch: &Watch<'_>,
) -> Result<SeedPoints, ExportError> {
    scene.require_map()?;
    let reconstruction = &scene.reconstruction;
    let mut viewer = reconstruction.viewer();
    let mut points = SeedPoints::new(reconstruction.camera);
    for (done, frame) in scene.frames.iter().enumerate() {
        watch.step("rendering", done, scene.frames.len())?;
        let pose = frame.middle();
        let shown = reconstruction.virtual_frame(frame.index, pose);
        let radiance = match scene.has_detail_of_pictures().then(|| taken(frame)).flatten() {
            Some(taken) => viewer.restored_hdr(frame, &taken, &shown),
            None => viewer.hdr(pose),
        };
        let picture = viewer.toned(&radiance, &shown);
        let (depth, opacity) = (viewer.depth(pose), viewer.opacity(pose));
        points.add(&View { pose, picture: &picture, depth: &depth, opacity: &opacity });
        let name = scene.picture_name(frame);
        let file = format!("{PICTURES}/{name}");
        match scene.linear {
            true => folder.write(&file, |out| write_radiance(out, &radiance))?,
            false => folder.write(&file, |out| write_picture(out, &picture))?,
        }
        let data = opacity.data.iter().map(|&o| f32::from(u8::from(o >= SEEN))).collect();
        let mask = Image { data, ..opacity };
        folder.write(&format!("{MASKS}/{}", mask_name(&name)), |out| write_mask(out, &mask))?;
    }
    Ok(points)
}
