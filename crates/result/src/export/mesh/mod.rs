//! A mesh of a scene: rendered depth of all frames, fused to a signed distance field, whose surface is
//! made of triangles with the colours of the pictures.

mod cases;
mod clean;
mod extract;
mod file;
mod volume;

pub use file::{write_glb, write_ply};

use super::error::ExportError;
use super::scene::Scene;
use super::watch::Watch;
use crate::numbers::significant;
use i2slam::geometry::{Image, Vec3};
use volume::{DepthView, Volume};

/// Triangles with colours.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// Places of the vertices in the world of the result [m].
    pub(crate) positions: Vec<Vec3<f64>>,
    /// Colours of the vertices as in a picture, 0 to 1.
    pub(crate) colours: Vec<[f32; 3]>,
    /// Numbers of vertices, counter-clockwise seen from outside.
    pub(crate) triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Number of triangles.
    pub fn triangles(&self) -> usize {
        self.triangles.len()
    }
}

/// Frames whose depth sets the size of voxels.
const MEASURED_FRAMES: usize = 8;

/// Makes the mesh with voxels of this edge [m]; by default that of a pixel at the median depth. Returns
/// the edge, too.
///
/// # Errors
/// [`ExportError::Refused`] where no surface is seen, or the scene has too many voxels;
/// [`ExportError::Cancelled`].
pub fn build(
    scene: &Scene,
    voxel: Option<f64>,
    watch: &Watch<'_>,
) -> Result<(Mesh, f64), ExportError> {
    let reconstruction = &scene.reconstruction;
    let mut viewer = reconstruction.viewer();
    let voxel = match voxel {
        Some(voxel) => voxel,
        None => pixel_at_median_depth(scene).ok_or_else(no_surface)?,
    };
    let mut volume = Volume::new(voxel);
    for (done, frame) in scene.frames.iter().enumerate() {
        watch.step("fusing depth", done, scene.frames.len())?;
        let pose = frame.middle();
        let colour: Image<f32> = viewer.sharp(&reconstruction.virtual_frame(frame.index, pose));
        let is_added = volume.add(&DepthView {
            camera: &reconstruction.camera,
            world_from_camera: pose,
            depth: &viewer.depth(pose),
            colour: &colour,
        });
        if !is_added {
            return Err(too_many_voxels(voxel, pixel_at_median_depth(scene)));
        }
    }
    watch.step("making triangles", 0, 0)?;
    let mesh = clean::without_specks(&extract::surface(&volume));
    if mesh.triangles.is_empty() { Err(without_triangles(scene, voxel)) } else { Ok((mesh, voxel)) }
}

fn no_surface() -> ExportError {
    ExportError::refused("the map shows no surface from its frames, of which a mesh could be made")
}

/// Refusal of voxels of this edge [m], with the size of a pixel at the median depth.
fn too_many_voxels(voxel: f64, pixel: Option<f64>) -> ExportError {
    let larger = pixel.unwrap_or(0.0).max(2.0 * voxel);
    let [voxel, larger] = [voxel, larger].map(significant);
    ExportError::refused(format!(
        "the scene is too large for voxels of {voxel}: choose larger ones as in --voxel {larger}, or a part of \
         it with --crop"
    ))
}

/// Reason why voxels of this edge [m] give no triangle.
fn without_triangles(scene: &Scene, voxel: f64) -> ExportError {
    match pixel_at_median_depth(scene) {
        Some(pixel) if voxel > pixel => ExportError::refused(format!(
            "voxels of {voxel} are too large for a triangle of what the map shows: choose smaller ones as in \
             --voxel {pixel:.4}, the size of a pixel at the median depth"
        )),
        _ => no_surface(),
    }
}

/// What a pixel measures at the median depth of some frames [m].
fn pixel_at_median_depth(scene: &Scene) -> Option<f64> {
    let mut viewer = scene.reconstruction.viewer();
    let step = scene.frames.len().div_ceil(MEASURED_FRAMES).max(1);
    let mut depths: Vec<f32> = Vec::new();
    for frame in scene.frames.iter().step_by(step) {
        depths.extend(viewer.depth(frame.middle()).data.iter().filter(|z| **z > 0.0));
    }
    let middle = depths.len() / 2;
    if depths.is_empty() {
        return None;
    }
    let (_, median, _) = depths.select_nth_unstable_by(middle, f32::total_cmp);
    let camera = scene.reconstruction.camera;
    Some(f64::from(*median) / (0.5 * (camera.fx + camera.fy)))
}

#[cfg(test)]
mod tests;
