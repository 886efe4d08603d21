//! Pictures at several sizes: the observed frame, and the model rendered at one pose.

use crate::objective::Observation;
use i2slam_geometry::{Camera, Image};
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

/// The four pixels around an image position and their bilinear weights.
#[derive(Clone, Copy)]
pub(super) struct Tap {
    index: usize,
    width: usize,
    du: f32,
    dv: f32,
}

/// The tap at `(u, v)`, or `None` outside the pixel centres.
pub(super) fn tap(image: &Image<f32>, u: f32, v: f32) -> Option<Tap> {
    let (x, y) = (u - 0.5, v - 0.5);
    let inside = x >= 0.0
        && y >= 0.0
        && x < (image.width - 1) as f32
        && y < (image.height - 1) as f32;
    if !inside {
        return None;
    }
    let (column, row) = (x as usize, y as usize);
    Some(Tap {
        index: row * image.width + column,
        width: image.width,
        du: x - column as f32,
        dv: y - row as f32,
    })
}

impl Tap {
    /// Value and derivative by `u` and `v` of one plane.
    pub(super) fn sample(self, plane: &[f32]) -> (f32, f32, f32) {
        let [a, b, c, d] = self.values(plane);
        let (top, bottom) = (a + (b - a) * self.du, c + (d - c) * self.du);
        let by_u = (b - a) + ((d - c) - (b - a)) * self.dv;
        (top + (bottom - top) * self.dv, by_u, bottom - top)
    }

    /// As [`sample`](Self::sample), where the four depths lie on one surface.
    pub(super) fn surface(self, plane: &[f32]) -> Option<(f32, f32, f32)> {
        let values = self.values(plane);
        let least = values.iter().copied().fold(f32::INFINITY, f32::min);
        let most = values.iter().copied().fold(0.0, f32::max);
        (least > 0.0 && most - least < SURFACE * least).then(|| self.sample(plane))
    }

    fn values(self, plane: &[f32]) -> [f32; 4] {
        let (i, w) = (self.index, self.width);
        [plane[i], plane[i + 1], plane[i + w], plane[i + w + 1]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tap_reproduces_a_plane_and_its_slope() {
        let mut image = Image::new(6, 5, 1);
        for row in 0..5 {
            for column in 0..6 {
                image.data[row * 6 + column] = 2.0 * column as f32 - 3.0 * row as f32;
            }
        }
        let (value, by_u, by_v) = tap(&image, 3.2, 2.9).expect("inside").sample(&image.data);
        assert!((value - (2.0 * 2.7 - 3.0 * 2.4)).abs() < 1e-5);
        assert!((by_u - 2.0).abs() < 1e-5 && (by_v + 3.0).abs() < 1e-5);
        assert!(tap(&image, 0.4, 2.0).is_none() && tap(&image, 5.6, 2.0).is_none());
    }

    #[test]
    fn depth_is_not_averaged_over_edges() {
        let image = |data| Image { width: 2, height: 2, channels: 1, data };
        assert_eq!(halved_depth(&image(vec![1.0, 1.0, 2.0, 2.0])).data, vec![0.0]);
        assert_eq!(halved_depth(&image(vec![1.0, 1.0, 0.0, 1.0])).data, vec![0.0]);
        assert_eq!(halved_depth(&image(vec![1.0, 1.02, 1.0, 1.02])).data, vec![1.01]);
    }
}
