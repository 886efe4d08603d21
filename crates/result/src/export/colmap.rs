//! A COLMAP model with undistorted sharp pictures: `images/`, `masks/`, `sparse/0/` in binary and text.
//!
//! Layout after COLMAP's documentation of its output format. COLMAP puts the centre of the first pixel at
//! 0.5 as this project does, and its poses are camera from world with the same axes.

use super::axes::Axes;
use super::error::ExportError;
use super::scene::Scene;
use super::seed_points::SeedPoints;
use super::views::{LoadTaken, MASKS, PICTURES, write_views};
use super::watch::Watch;
use i2slam::geometry::{Camera, Pose};
use i2slam_storage::OutputFolder;
use std::io::{self, Write};

/// First parts of the paths that are written.
pub const NAMES: &[&str] = &[PICTURES, MASKS, "sparse"];

/// COLMAP's number of the pinhole camera with two focal lengths.
const PINHOLE: i32 = 1;
/// Number of the only camera.
const CAMERA: u32 = 1;

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
    // COLMAP looks for masks under the name of the picture with another ending behind it.
    let seeds = write_views(scene, folder, |name| format!("{name}.png"), taken, watch)?;
    let model = Model::new(scene, seeds);
    folder.write("sparse/0/cameras.bin", |out| model.cameras_binary(out))?;
    folder.write("sparse/0/images.bin", |out| model.images_binary(out))?;
    folder.write("sparse/0/points3D.bin", |out| model.points_binary(out))?;
    folder.write("sparse/0/cameras.txt", |out| model.cameras_text(out))?;
    folder.write("sparse/0/images.txt", |out| model.images_text(out))?;
    folder.write("sparse/0/points3D.txt", |out| model.points_text(out))?;
    Ok(model.points.len())
}

/// A model as COLMAP counts: from 1.
struct Model {
    camera: Camera<f64>,
    images: Vec<ModelImage>,
    points: Vec<ModelPoint>,
}

struct ModelImage {
    camera_from_world: Pose<f64>,
    name: String,
    /// Column and row [px], and number of the point.
    observations: Vec<(f64, f64, u64)>,
}

struct ModelPoint {
    position: [f64; 3],
    colour: [u8; 3],
    /// Numbers of images, and places among their observations, which count from 0.
    track: Vec<(u32, u32)>,
}

impl Model {
    fn new(scene: &Scene, seeds: SeedPoints) -> Self {
        let file_from_world = scene.file_from_world(Axes::YDown);
        let images = scene.frames.iter().zip(seeds.observations);
        let images = images.map(|(frame, observations)| ModelImage {
            camera_from_world: scene.pose(frame, Axes::YDown).inverse(),
            name: scene.picture_name(frame),
            observations: observations
                .into_iter()
                .map(|o| (o.at.0, o.at.1, o.point as u64 + 1))
                .collect(),
        });
        let points = seeds.points.into_iter().map(|point| ModelPoint {
            position: (file_from_world * point.position).to_array(),
            colour: point.colour,
            track: point.track.iter().map(|&(i, n)| (i as u32 + 1, n as u32)).collect(),
        });
        let camera = scene.reconstruction.camera;
        Self { camera, images: images.collect(), points: points.collect() }
    }

    fn cameras_binary(&self, out: &mut dyn Write) -> io::Result<()> {
        let Camera { width, height, fx, fy, cx, cy } = self.camera;
        out.write_all(&1_u64.to_le_bytes())?;
        out.write_all(&CAMERA.to_le_bytes())?;
        out.write_all(&PINHOLE.to_le_bytes())?;
        out.write_all(&(width as u64).to_le_bytes())?;
        out.write_all(&(height as u64).to_le_bytes())?;
        write_f64s(out, &[fx, fy, cx, cy])
    }

    fn images_binary(&self, out: &mut dyn Write) -> io::Result<()> {
        out.write_all(&(self.images.len() as u64).to_le_bytes())?;
        for (number, image) in (1_u32..).zip(&self.images) {
            out.write_all(&number.to_le_bytes())?;
            write_f64s(out, &pose_numbers(image.camera_from_world))?;
            out.write_all(&CAMERA.to_le_bytes())?;
            out.write_all(image.name.as_bytes())?;
            out.write_all(&[0])?;
            out.write_all(&(image.observations.len() as u64).to_le_bytes())?;
            for &(u, v, point) in &image.observations {
                write_f64s(out, &[u, v])?;
                out.write_all(&point.to_le_bytes())?;
            }
        }
        Ok(())
    }

    fn points_binary(&self, out: &mut dyn Write) -> io::Result<()> {
        out.write_all(&(self.points.len() as u64).to_le_bytes())?;
        for (number, point) in (1_u64..).zip(&self.points) {
            out.write_all(&number.to_le_bytes())?;
            write_f64s(out, &point.position)?;
            out.write_all(&point.colour)?;
            // The mean error of its observations, which are projections.
            write_f64s(out, &[0.0])?;
            out.write_all(&(point.track.len() as u64).to_le_bytes())?;
            for (image, place) in &point.track {
                out.write_all(&image.to_le_bytes())?;
                out.write_all(&place.to_le_bytes())?;
            }
        }
        Ok(())
    }

    fn cameras_text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Camera { width, height, fx, fy, cx, cy } = self.camera;
        writeln!(out, "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]")?;
        writeln!(out, "{CAMERA} PINHOLE {width} {height} {fx} {fy} {cx} {cy}")
    }

    fn images_text(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME")?;
        writeln!(out, "# POINTS2D[] as (X, Y, POINT3D_ID)")?;
        for (number, image) in (1_u32..).zip(&self.images) {
            write!(out, "{number}")?;
            for value in pose_numbers(image.camera_from_world) {
                write!(out, " {value}")?;
            }
            writeln!(out, " {CAMERA} {}", image.name)?;
            for (i, (u, v, point)) in image.observations.iter().enumerate() {
                write!(out, "{}{u:.3} {v:.3} {point}", if i == 0 { "" } else { " " })?;
            }
            writeln!(out)?;
        }
        Ok(())
    }

    fn points_text(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)")?;
        for (number, point) in (1_u64..).zip(&self.points) {
            let ([x, y, z], [r, g, b]) = (point.position, point.colour);
            write!(out, "{number} {x} {y} {z} {r} {g} {b} 0")?;
            for (image, place) in &point.track {
                write!(out, " {image} {place}")?;
            }
            writeln!(out)?;
        }
        Ok(())
    }
}

/// `QW QX QY QZ TX TY TZ`
fn pose_numbers(pose: Pose<f64>) -> [f64; 7] {
    let Pose { rotation: q, translation: t } = pose;
    [q.w, q.v.x, q.v.y, q.v.z, t.x, t.y, t.z]
}

fn write_f64s(out: &mut dyn Write, values: &[f64]) -> io::Result<()> {
    values.iter().try_for_each(|value| out.write_all(&value.to_le_bytes()))
}
