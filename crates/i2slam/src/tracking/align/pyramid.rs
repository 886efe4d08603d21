//! Pictures at several sizes: the observed frame, and the model rendered at one pose.

use crate::objective::Observation;
use i2slam_geometry::{Camera, Image, Tap};
use i2slam_radiance::gaussian::Render;

/// Rendered opacity below which the model says nothing.
const OPAQUE: f32 = 0.95;
/// Relative depth difference of neighbours that still belong to one surface.
const SURFACE: f32 = 0.05;

/// One level of the observed frame.
pub(super) struct Observed {
    pub(super) camera: Camera<f32>,
    pub(super) colour: Image<f32>,
    pub(super) depth: Image<f32>,
}

/// One level of the model: radiance and depth seen from the model's pose.
pub(super) struct Model {
    /// Linear radiance, three planes.
    pub(super) radiance: Image<f32>,
    /// Depth divided by opacity [m]; 0 where the model is not opaque.
    pub(super) depth: Image<f32>,
}

/// The observed frame at `levels` sizes, finest first.
pub(super) fn observed_levels(
    camera: &Camera<f64>,
    observation: &Observation,
    levels: usize,
) -> Vec<Observed> {
    let finest = Observed {
        camera: camera.cast(),
        colour: observation.colour.clone(),
        depth: observation.depth.clone(),
    };
    halve_repeatedly(finest, levels, |fine| {
        let colour = halved_by_mean(&fine.colour);
        let camera = fine.camera.resized(colour.width, colour.height);
        Observed { camera, depth: halved_depth(&fine.depth), colour }
    })
}

/// A render at `levels` sizes, finest first.
pub(super) fn model_levels(render: &Render, levels: usize) -> Vec<Model> {
    let mut depth = render.depth.clone();
    for (d, &opacity) in depth.data.iter_mut().zip(&render.opacity.data) {
        *d = if opacity > OPAQUE { *d / opacity } else { 0.0 };
    }
    let finest = Model { radiance: render.radiance.clone(), depth };
    halve_repeatedly(finest, levels, |fine| Model {
        radiance: halved_by_mean(&fine.radiance),
        depth: halved_depth(&fine.depth),
    })
}

/// A depth picture at `levels` sizes, finest first, as a model without radiance.
pub(super) fn depth_levels(depth: &Image<f32>, levels: usize) -> Vec<Model> {
    let finest = Model { radiance: Image::default(), depth: depth.clone() };
    halve_repeatedly(finest, levels, |fine| Model {
        radiance: Image::default(),
        depth: halved_depth(&fine.depth),
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

fn halved_by_mean(image: &Image<f32>) -> Image<f32> {
    halved(image, |block| block.iter().sum::<f32>() * 0.25)
}

/// The mean depth of a block that lies on one surface, otherwise no reading.
fn halved_depth(depth: &Image<f32>) -> Image<f32> {
    halved(depth, |block| {
        let least = block.iter().copied().fold(f32::INFINITY, f32::min);
        let most = block.iter().copied().fold(0.0, f32::max);
        let one_surface = least > 0.0 && most - least < SURFACE * least;
        if one_surface { block.iter().sum::<f32>() * 0.25 } else { 0.0 }
    })
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

/// Value and derivatives of a depth plane at a tap whose four pixels lie on one surface.
pub(super) fn surface(tap: Tap<f32>, plane: &[f32]) -> Option<(f32, f32, f32)> {
    let values = tap.values(plane);
    let least = values.iter().copied().fold(f32::INFINITY, f32::min);
    let most = values.iter().copied().fold(0.0, f32::max);
    (least > 0.0 && most - least < SURFACE * least).then(|| tap.sample(plane))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_is_not_averaged_over_edges() {
        let image = |data| Image { width: 2, height: 2, channels: 1, data };
        assert_eq!(halved_depth(&image(vec![1.0, 1.0, 2.0, 2.0])).data, vec![0.0]);
        assert_eq!(halved_depth(&image(vec![1.0, 1.0, 0.0, 1.0])).data, vec![0.0]);
        assert_eq!(halved_depth(&image(vec![1.0, 1.02, 1.0, 1.02])).data, vec![1.01]);
    }
}
