//! Pictures of a lit room: radiance over an exposure, radiance and depth at an instant.

use crate::camera_path::CameraPath;
use crate::light::{LitScene, Sample};
use crate::rgb::{Rgb, plus};
use crate::scene::{Ray, Vec3};
use i2slam_geometry::{Camera, Image, Mat3, Pose};
use rayon::prelude::*;

/// Distance of the near plane [m].
const NEAR_PLANE: f32 = 0.02;

/// Timing of a frame's exposure.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shutter {
    /// The frame's stamp: mid-exposure of the middle row [s].
    pub(crate) stamp: f64,
    /// Exposure time [s].
    pub(crate) open: f64,
    /// Time from the first row to the last [s].
    pub(crate) readout: f64,
}

impl Shutter {
    /// The time at share `u` in `[0, 1]` of the exposure of a row.
    fn time(&self, row: usize, height: usize, u: f64) -> f64 {
        let row = (row as f64 + 0.5) / height as f64 - 0.5;
        self.stamp + row * self.readout + (u - 0.5) * self.open
    }
}

/// A camera at one pose, in single precision.
struct View {
    origin: Vec3,
    rotation: Mat3<f32>,
    camera: Camera<f32>,
}

impl View {
    fn new(camera: &Camera<f64>, world_from_camera: Pose<f64>) -> Self {
        let pose = world_from_camera.cast::<f32>();
        Self { origin: pose.translation, rotation: pose.rotation.matrix(), camera: camera.cast() }
    }

    /// The ray through an image position; its `t` is depth.
    #[inline]
    fn ray(&self, u: f32, v: f32) -> Ray {
        let direction = self.rotation * self.camera.unproject(u, v, 1.0);
        Ray { origin: self.origin, direction, from: NEAR_PLANE, to: f32::INFINITY }
    }

    #[inline]
    fn radiance(&self, lit: &LitScene, u: f32, v: f32, sample: &Sample) -> Rgb {
        let pixel = [u as usize, v as usize];
        let ray = self.ray(u, v);
        let hit = lit.scene.first_hit(&ray);
        hit.map_or([0.0; 3], |hit| {
            lit.radiance((&ray, &hit), hit.t / self.camera.fx, sample, pixel)
        })
    }
}

/// The samples of a pixel.
fn samples_of_a_pixel(samples: usize) -> Vec<Sample> {
    let sample = |number| Sample::new(number, samples, r2_sample(number + 7)[1] - 0.5);
    (0..samples).map(sample).collect()
}

/// Low-discrepancy positions in the unit square (R2 sequence, Roberts 2018).
fn r2_sample(sample: usize) -> [f32; 2] {
    let n = sample as f64;
    [(0.5 + 0.754_877_666_2 * n).fract() as f32, (0.5 + 0.569_840_291 * n).fract() as f32]
}

fn image_from_rows(camera: &Camera<f64>, rows: Vec<Vec<Rgb>>) -> Image<f32> {
    let mut image = Image::new(camera.width, camera.height, 3);
    let pixels = image.pixels();
    for (i, colour) in rows.into_iter().flatten().enumerate() {
        for (channel, value) in colour.into_iter().enumerate() {
            image.data[channel * pixels + i] = value;
        }
    }
    image
}

/// Average radiance over an exposure, `samples` instants at the middles of equal parts.
pub(crate) fn exposed(
    lit: &LitScene,
    camera: &Camera<f64>,
    path: &CameraPath,
    shutter: Shutter,
    samples: usize,
) -> Image<f32> {
    let choices = samples_of_a_pixel(samples);
    let rows = (0..camera.height).into_par_iter().map(|row| {
        let mut sums = vec![[0.0; 3]; camera.width];
        for (sample, choice) in choices.iter().enumerate() {
            let u = (sample as f64 + 0.5) / samples as f64;
            let time = shutter.time(row, camera.height, u);
            let view = View::new(camera, path.world_from_camera(time));
            let [dx, dy] = r2_sample(sample);
            for (column, sum) in sums.iter_mut().enumerate() {
                let (x, y) = (column as f32 + dx, row as f32 + dy);
                *sum = plus(*sum, view.radiance(lit, x, y, choice));
            }
        }
        sums.iter_mut().for_each(|sum| *sum = sum.map(|v| v / samples as f32));
        sums
    });
    image_from_rows(camera, rows.collect())
}

/// Radiance at an instant, `side²` samples a pixel.
pub(crate) fn sharp(
    lit: &LitScene,
    camera: &Camera<f64>,
    world_from_camera: Pose<f64>,
    side: usize,
) -> Image<f32> {
    let view = View::new(camera, world_from_camera);
    let samples = side * side;
    let choices = samples_of_a_pixel(samples);
    let rows = (0..camera.height).into_par_iter().map(|row| {
        let pixel = |column: usize| {
            let mut sum = [0.0; 3];
            for (sample, choice) in choices.iter().enumerate() {
                let dx = ((sample % side) as f32 + 0.5) / side as f32;
                let dy = ((sample / side) as f32 + 0.5) / side as f32;
                let (x, y) = (column as f32 + dx, row as f32 + dy);
                sum = plus(sum, view.radiance(lit, x, y, choice));
            }
            sum.map(|v| v / samples as f32)
        };
        (0..camera.width).map(pixel).collect()
    });
    image_from_rows(camera, rows.collect())
}

/// Depth at pixel centres [m], 0 where there is nothing within `maximum`.
pub(crate) fn depth(
    lit: &LitScene,
    camera: &Camera<f64>,
    world_from_camera: Pose<f64>,
    maximum: f64,
) -> Image<f32> {
    let view = View::new(camera, world_from_camera);
    let rows = (0..camera.height).into_par_iter().map(|row| {
        let pixel = |column: usize| {
            let hit = lit.scene.first_hit(&view.ray(column as f32 + 0.5, row as f32 + 0.5));
            hit.map_or(0.0, |hit| hit.t)
        };
        (0..camera.width).map(pixel).collect::<Vec<f32>>()
    });
    let rows: Vec<Vec<f32>> = rows.collect();
    let depths = rows.into_iter().flatten();
    let data = depths.map(|z| if f64::from(z) <= maximum { z } else { 0.0 }).collect();
    Image { width: camera.width, height: camera.height, channels: 1, data }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_exposed_one_after_another_around_the_stamp() {
        let shutter = Shutter { stamp: 2.0, open: 0.02, readout: 0.03 };
        let middle = |row: usize| shutter.time(row, 10, 0.5);
        assert!((middle(9) - middle(0) - 0.027).abs() < 1e-12);
        assert!((0.5 * (middle(9) + middle(0)) - 2.0).abs() < 1e-12);
        assert!((shutter.time(3, 10, 1.0) - shutter.time(3, 10, 0.0) - 0.02).abs() < 1e-12);
    }

    #[test]
    fn samples_fill_the_pixel() {
        let mut cells = [0; 16];
        for [x, y] in (0..64).map(r2_sample) {
            cells[(4.0 * x) as usize + 4 * (4.0 * y) as usize] += 1;
        }
        assert!(cells.iter().all(|&n| (2..=6).contains(&n)), "{cells:?}");
    }
}
