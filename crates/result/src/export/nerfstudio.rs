//! A folder for nerfstudio: `transforms.json`, `images/`, `masks/` and `points.ply` to start from.
//!
//! Poses are world from camera with OpenGL's camera axes (y up, z backward); z is up in the world.

use super::axes::Axes;
use super::error::ExportError;
use super::scene::Scene;
use super::seed_points::SeedPoint;
use super::views::{LoadTaken, MASKS, PICTURES, write_views};
use super::watch::Watch;
use i2slam::geometry::{Camera, Pose};
use i2slam_storage::OutputFolder;
use serde_json::{Value, json};
use std::io::{self, Write};

/// First parts of the paths that are written.
pub const NAMES: &[&str] = &[PICTURES, MASKS, TRANSFORMS, POINTS];

const TRANSFORMS: &str = "transforms.json";
const POINTS: &str = "points.ply";

/// Writes the folder; returns the number of points.
///
/// # Errors
/// Those of the system; [`ExportError::Cancelled`].
pub fn write(
    scene: &Scene,
    folder: &OutputFolder,
    taken: &mut LoadTaken<'_>,
    watch: &Watch<'_>,
) -> Result<usize, ExportError> {
    let mask_of = |name: &str| format!("{}.png", &name[..name.len() - 4]);
    let seeds = write_views(scene, folder, mask_of, taken, watch)?;
    let file_from_world = scene.file_from_world(Axes::ZUp);
    folder.write(POINTS, |out| write_points(out, &seeds.points, file_from_world))?;
    let frames: Vec<Value> = scene
        .frames
        .iter()
        .map(|frame| {
            let name = scene.picture_name(frame);
            json!({
                "file_path": format!("{PICTURES}/{name}"),
                "mask_path": format!("{MASKS}/{}", mask_of(&name)),
                "transform_matrix": matrix(scene.pose(frame, Axes::ZUp)),
            })
        })
        .collect();
    let Camera { width, height, fx, fy, cx, cy } = scene.reconstruction.camera;
    let transforms = json!({
        "camera_model": "OPENCV",
        "w": width, "h": height,
        "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy,
        "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0,
        "ply_file_path": POINTS,
        "frames": frames,
    });
    folder.write(TRANSFORMS, |out| {
        serde_json::to_writer_pretty(&mut *out, &transforms)?;
        writeln!(out)
    })?;
    Ok(seeds.points.len())
}

/// The 4 x 4 matrix of a pose whose camera looks along -z, y up.
fn matrix(world_from_camera: Pose<f64>) -> [[f64; 4]; 4] {
    let Pose { rotation, translation: t } = world_from_camera;
    let rows = (rotation * Axes::YUp.rotation()).matrix().rows;
    let row = |i: usize, t| [rows[i][0], rows[i][1], rows[i][2], t];
    [row(0, t.x), row(1, t.y), row(2, t.z), [0.0, 0.0, 0.0, 1.0]]
}

/// Coloured points, binary PLY.
fn write_points(
    out: &mut dyn Write,
    points: &[SeedPoint],
    file_from_world: Pose<f64>,
) -> io::Result<()> {
    writeln!(out, "ply\nformat binary_little_endian 1.0\nelement vertex {}", points.len())?;
    for property in ["float x", "float y", "float z", "uchar red", "uchar green", "uchar blue"] {
        writeln!(out, "property {property}")?;
    }
    writeln!(out, "end_header")?;
    for point in points {
        for value in (file_from_world * point.position).to_array() {
            out.write_all(&(value as f32).to_le_bytes())?;
        }
        out.write_all(&point.colour)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam::geometry::Vec3;

    #[test]
    fn a_level_camera_looks_along_y_with_z_up() {
        let level = Pose::new(Axes::ZUp.rotation(), Vec3::new(1.0, 2.0, 3.0));
        let m = matrix(level);
        let column = |c: usize| [m[0][c], m[1][c], m[2][c]];
        let is = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12);
        // Right, up, backward, place.
        assert!(is(column(0), [1.0, 0.0, 0.0]) && is(column(1), [0.0, 0.0, 1.0]));
        assert!(is(column(2), [0.0, -1.0, 0.0]) && is(column(3), [1.0, 2.0, 3.0]));
    }
}
