//! Pictures at several sizes: the observed frame, and the model rendered at one pose.

use super::residual::{Samples, Surface, Texels};
use crate::objective::Observation;
use i2slam_compute::median;
use i2slam_geometry::{Camera, Image};
use i2slam_radiance::gaussian::Render;
use std::sync::Arc;

/// Rendered opacity below which the model says nothing.
const OPAQUE: f32 = 0.95;
/// Relative depth difference of neighbours that still belong to one surface.
const SURFACE: f32 = 0.05;

/// Pixels between two samples of the finest level.
const FINEST_STRIDE: usize = 2;

/// One level of the observed frame.
pub(super) struct Observed {
    pub(super) camera: Camera<f32>,
    pub(super) colour: Arc<Image<f32>>,
    pub(super) depth: Arc<Image<f32>>,
    pub(super) samples: Samples,
    pub(super) texels: Texels,
}

/// One level of the model: radiance and depth seen from the model's pose.
pub(super) struct Model {
    /// Linear radiance, three planes.
    pub(super) radiance: Image<f32>,
    /// Depth divided by opacity [m]; 0 where the model is not opaque.
    pub(super) depth: Image<f32>,
    pub(super) surface: Surface,
    pub(super) texels: Texels,
    /// Standard deviation of the depth [m at 1 m], from its relief.
    pub(super) noise: f32,
}

impl Model {
    pub(super) fn new(radiance: Image<f32>, depth: Image<f32>) -> Self {
        let relief = relief(&depth);
        Self {
            noise: noise(&depth, &relief),
            surface: Surface::new(&depth, &relief, one_surface),
            texels: Texels::new(&radiance),
            radiance,
            depth,
        }
    }
}

impl Observed {
    /// With a sample at every `stride`-th pixel.
    pub(super) fn new(
        camera: Camera<f32>,
        colour: impl Into<Arc<Image<f32>>>,
        depth: impl Into<Arc<Image<f32>>>,
        stride: usize,
    ) -> Self {
        let (colour, depth) = (colour.into(), depth.into());
        let samples = Samples::new(&camera, &depth, &relief(&depth), stride);
        Self { camera, samples, texels: Texels::new(&colour), colour, depth }
    }
}

/// The observed frame at `levels` sizes, finest first.
pub(super) fn observed_levels(
    camera: &Camera<f64>,
    observation: &Observation,
    levels: usize,
) -> Vec<Observed> {
    let finest = Observed::new(
        camera.cast(),
        Arc::clone(&observation.colour),
        Arc::clone(&observation.depth),
        FINEST_STRIDE,
    );
    halve_repeatedly(finest, levels, |fine| {
        let colour = halved_by_mean(&fine.colour);
        let camera = halved_camera(&fine.camera, &colour);
        Observed::new(camera, colour, halved_depth(&fine.depth), 1)
    })
}

/// A render at `levels` sizes, finest first.
pub(super) fn model_levels(render: &Render, levels: usize) -> Vec<Model> {
    let finest = Model::new(render.radiance.clone(), render.surface(OPAQUE));
    halve_repeatedly(finest, levels, |fine| {
        Model::new(halved_by_mean(&fine.radiance), halved_depth(&fine.depth))
    })
}

/// A depth picture at `levels` sizes, finest first, as a model without radiance.
pub(super) fn depth_levels(depth: &Image<f32>, levels: usize) -> Vec<Model> {
    halve_repeatedly(Model::new(Image::default(), depth.clone()), levels, |fine| {
        Model::new(Image::default(), halved_depth(&fine.depth))
    })
}

/// How far each pixel is off the line through its neighbours [m], the worse of row and column,
/// with depth interpolated as on a plane. Large at edges and beside holes; 0 where there is no
/// depth.
pub(super) fn relief(depth: &Image<f32>) -> Image<f32> {
    let (width, height) = (depth.width, depth.height);
    let inverse: Vec<f32> =
        depth.data.iter().map(|&d| if d > 0.0 { 1.0 / d } else { 0.0 }).collect();
    let mut out = Image::new(width, height, 1);
    for row in 0..height {
        for column in 0..width {
            let i = row * width + column;
            let bend = |a: usize, b: usize| (inverse[a] + inverse[b] - 2.0 * inverse[i]).abs();
            let inside = |at: usize, size: usize| at > 0 && at + 1 < size;
            let along = if inside(column, width) { bend(i - 1, i + 1) } else { 0.0 };
            let across = if inside(row, height) { bend(i - width, i + width) } else { 0.0 };
            out.data[i] = along.max(across) * depth.data[i] * depth.data[i];
        }
    }
    out
}

/// The second difference of independent noise has `√6` times its standard deviation, and the
/// median of the larger of two such has about that size; most of a picture is no edge.
fn noise(depth: &Image<f32>, relief: &Image<f32>) -> f32 {
    let pixels = depth.data.iter().zip(&relief.data).step_by(5);
    let mut all: Vec<f32> =
        pixels.filter(|(d, _)| **d > 0.0).map(|(d, r)| r / (d * d.max(1.0))).collect();
    median(&mut all).map_or(f32::INFINITY, |relief| relief / 6.0_f32.sqrt())
}

fn halve_repeatedly<L>(finest: L, levels: usize, halve: impl Fn(&L) -> L) -> Vec<L> {
    let mut all = vec![finest];
    while all.len() < levels {
        let next = halve(&all[all.len() - 1]);
        all.push(next);
    }
    all
}

/// An odd last row or column is dropped, so that the scale is a half for any size.
fn halved_camera(camera: &Camera<f32>, picture: &Image<f32>) -> Camera<f32> {
    Camera {
        width: picture.width,
        height: picture.height,
        fx: 0.5 * camera.fx,
        fy: 0.5 * camera.fy,
        cx: 0.5 * camera.cx,
        cy: 0.5 * camera.cy,
    }
}

fn halved_by_mean(image: &Image<f32>) -> Image<f32> {
    halved(image, |block| block.iter().sum::<f32>() * 0.25)
}

/// The depth at the middle of a block that lies on one surface, otherwise no reading.
fn halved_depth(depth: &Image<f32>) -> Image<f32> {
    halved(depth, |block| match one_surface(block) {
        true => 4.0 / block.iter().map(|d| 1.0 / d).sum::<f32>(),
        false => 0.0,
    })
}

pub(super) fn one_surface(depths: [f32; 4]) -> bool {
    let least = depths.iter().copied().fold(f32::INFINITY, f32::min);
    let most = depths.iter().copied().fold(0.0, f32::max);
    least > 0.0 && most - least < SURFACE * least
}

/// Half the size; an odd last row or column is dropped.
fn halved(image: &Image<f32>, reduce: impl Fn([f32; 4]) -> f32) -> Image<f32> {
    let (width, height) = ((image.width / 2).max(1), (image.height / 2).max(1));
    let mut out = Image::new(width, height, image.channels);
    let right = |c: usize| (2 * c + 1).min(image.width - 1);
    let below = |r: usize| (2 * r + 1).min(image.height - 1);
    for channel in 0..image.channels {
        for row in 0..height {
            for column in 0..width {
                out.data[(channel * height + row) * width + column] = reduce([
                    image.at(channel, 2 * column, 2 * row),
                    image.at(channel, right(column), 2 * row),
                    image.at(channel, 2 * column, below(row)),
                    image.at(channel, right(column), below(row)),
                ]);
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_is_not_averaged_over_edges() {
        let image = |data| Image { width: 2, height: 2, channels: 1, data };
        assert_eq!(halved_depth(&image(vec![1.0, 1.0, 2.0, 2.0])).data, vec![0.0]);
        assert_eq!(halved_depth(&image(vec![1.0, 1.0, 0.0, 1.0])).data, vec![0.0]);
        let middle = halved_depth(&image(vec![1.0, 1.02, 1.0, 1.02])).data[0];
        assert!((middle - 2.04 / 2.02).abs() < 1e-6);
    }

    #[test]
    fn noise_is_told_from_the_shape_of_the_scene() {
        let mut random = i2slam_compute::Random::new(3);
        let sigma = 0.004;
        let mut plane = Image::new(60, 40, 1);
        for (i, d) in plane.data.iter_mut().enumerate() {
            let edge = if i % 60 < 30 { 0.3 } else { 0.0 };
            *d = 1.0 / (0.8 + edge + 0.004 * (i / 60) as f32);
        }
        let clean = Model::new(Image::default(), plane.clone()).noise;
        plane
            .data
            .iter_mut()
            .for_each(|d| *d += sigma * (12.0_f64.sqrt() * (random.uniform() - 0.5)) as f32);
        let noisy = Model::new(Image::default(), plane).noise;
        assert!(clean < 1e-5 && (0.7..1.4).contains(&(noisy / sigma)), "{clean} {noisy}");
    }
}
