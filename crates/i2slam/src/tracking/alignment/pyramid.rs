//! Image pyramids: the observed frame, the rendered map and a keyframe's depth at several sizes.

use i2slam_geometry::{Camera, Image};
use i2slam_odometry::alignment::{
    FrameLevel, TargetLevel, halved_by_mean, halved_camera, halved_depth,
};
use i2slam_radiance::gaussian::Render;
use std::sync::Arc;

/// Least opacity at which the rendered map has a surface.
const MIN_OPACITY: f32 = 0.95;
/// Least distance of samples on the finest level [px].
const FINEST_STRIDE: usize = 2;
/// Samples of a large level, to a factor of two: more, which are not independent, hardly change the few
/// unknowns.
const SAMPLES: f64 = 20_000.0;

/// The observed frame, its colour without vignetting, at `levels` sizes, finest first.
pub(super) fn frame_levels(
    camera: &Camera<f64>,
    (colour, depth): (Arc<Image<f32>>, &Arc<Image<f32>>),
    levels: usize,
) -> Vec<FrameLevel> {
    let finest_stride = stride(depth).max(FINEST_STRIDE);
    let finest = FrameLevel::new(camera.cast(), colour, Arc::clone(depth), finest_stride);
    halve_repeatedly(finest, levels, |fine| {
        let colour = halved_by_mean(&fine.colour);
        let camera = halved_camera(&fine.camera, &colour);
        let depth = halved_depth(&fine.depth);
        let stride = stride(&depth);
        FrameLevel::new(camera, colour, depth, stride)
    })
}

/// Distance of samples with which a level has about [`SAMPLES`], or one at every pixel [px].
fn stride(depth: &Image<f32>) -> usize {
    ((depth.pixels() as f64 / SAMPLES).sqrt().round() as usize).max(1)
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

/// `levels` sizes from `finest` on, each made from the one before.
fn halve_repeatedly<L>(finest: L, levels: usize, halve: impl Fn(&L) -> L) -> Vec<L> {
    let mut all = vec![finest];
    while all.len() < levels {
        let next = halve(&all[all.len() - 1]);
        all.push(next);
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn large_pictures_have_as_many_samples_as_those_of_half_the_size() {
        let stride = |width, height| stride(&Image::new(width, height, 1));
        assert_eq!([stride(640, 480), stride(320, 240), stride(160, 120)], [4, 2, 1]);
        assert_eq!([stride(304, 224), stride(8, 6)], [2, 1]);
    }
}
