//! Image pyramids: the observed frame, the rendered map and a keyframe's depth at several sizes.

use super::residual::{FrameLevel, TargetLevel, is_one_surface};
use crate::objective::Observation;
use i2slam_geometry::{Camera, Image};
use i2slam_radiance::gaussian::Render;
use std::sync::Arc;

/// Least opacity at which the rendered map has a surface.
const MIN_OPACITY: f32 = 0.95;
/// Distance of samples on the finest level [px]; coarser levels use every pixel.
const FINEST_STRIDE: usize = 2;

/// The observed frame at `levels` sizes, finest first.
pub(super) fn frame_levels(
    camera: &Camera<f64>,
    observation: &Observation,
    levels: usize,
) -> Vec<FrameLevel> {
    let finest = FrameLevel::new(
        camera.cast(),
        Arc::clone(&observation.colour),
        Arc::clone(&observation.depth),
        FINEST_STRIDE,
    );
    halve_repeatedly(finest, levels, |fine| {
        let colour = halved_by_mean(&fine.colour);
        let camera = halved_camera(&fine.camera, &colour);
        FrameLevel::new(camera, colour, halved_depth(&fine.depth), 1)
    })
}

/// A render of the map at `levels` sizes, finest first.
pub(super) fn map_levels(render: &Render, levels: usize) -> Vec<TargetLevel> {
    let finest = TargetLevel::new(render.radiance.clone(), render.surface(MIN_OPACITY));
    halve_repeatedly(finest, levels, |fine| {
        TargetLevel::new(halved_by_mean(&fine.radiance), halved_depth(&fine.depth))
    })
}

/// A depth picture at `levels` sizes, finest first, as a target without radiance.
pub(super) fn depth_levels(depth: &Image<f32>, levels: usize) -> Vec<TargetLevel> {
    halve_repeatedly(TargetLevel::new(Image::default(), depth.clone()), levels, |fine| {
        TargetLevel::new(Image::default(), halved_depth(&fine.depth))
    })
}

fn halve_repeatedly<L>(finest: L, levels: usize, halve: impl Fn(&L) -> L) -> Vec<L> {
    let mut all = vec![finest];
    while all.len() < levels {
        let next = halve(&all[all.len() - 1]);
        all.push(next);
    }
    all
}

/// Intrinsics at exactly half the scale, also where an odd last row or column is dropped.
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

/// The harmonic mean of a block that lies on one surface, otherwise no reading: an average over an
/// edge would be on neither surface.
fn halved_depth(depth: &Image<f32>) -> Image<f32> {
    halved(depth, |block| match is_one_surface(block) {
        true => 4.0 / block.iter().map(|d| 1.0 / d).sum::<f32>(),
        false => 0.0,
    })
}

/// Reduces blocks of 2 × 2 pixels; an odd last row or column is dropped.
fn halved(image: &Image<f32>, reduce: impl Fn([f32; 4]) -> f32) -> Image<f32> {
    let (width, height) = ((image.width / 2).max(1), (image.height / 2).max(1));
    let right = |c: usize| (2 * c + 1).min(image.width - 1);
    let below = |r: usize| (2 * r + 1).min(image.height - 1);
    Image::from_fn(width, height, image.channels, |channel, column, row| {
        reduce([
            image.at(channel, 2 * column, 2 * row),
            image.at(channel, right(column), 2 * row),
            image.at(channel, 2 * column, below(row)),
            image.at(channel, right(column), below(row)),
        ])
    })
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
}
