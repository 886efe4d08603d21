//! New flat Gaussians for rectangles of pixels.

use super::density_control::{SourceFrame, ball, logit};
use super::partition::{Partition, Rectangle};
use super::scale_bounds::ScaleBounds;
use crate::config::GaussianParameters;
use i2slam_geometry::{Mat3, Rotation, symmetric_eigen};
use i2slam_radiance::gaussian::{ColourActivation, Gaussian, GaussianMap};

/// Standard deviation along the edges of a rectangle, in edges: neighbours overlap without gaps.
pub(super) const EDGE_DEVIATION: f64 = 0.5;
/// Largest ratio of the deviations along the surface: what is seen at a grazing angle is not known
/// better.
const MAX_ELONGATION: f64 = 4.0;
/// Thickness over the mean of the deviations along the surface.
const THICKNESS: f64 = 0.1;
/// Opacity of a new Gaussian: a surface hides what is behind it.
const INITIAL_OPACITY: f32 = 0.95;

/// Adds a flat Gaussian for every rectangle of the marked pixels, a ball for single pixels.
pub(super) fn push_flat_gaussians(
    map: &mut GaussianMap,
    bounds: &mut ScaleBounds,
    parameters: &GaussianParameters,
    source: &SourceFrame<'_>,
    rectangles: &[Rectangle],
) {
    let focal = 0.5 * (source.camera.fx + source.camera.fy) as f32;
    for rectangle in rectangles {
        let gaussian = match rectangle.edges {
            [1, 1] => {
                let pixel = rectangle.row * source.camera.width + rectangle.column;
                ball(map.activation, parameters, source, pixel)
            }
            _ => disc(map.activation, source, rectangle),
        };
        if let Some(mut gaussian) = gaussian {
            gaussian.opacity_logit = logit(INITIAL_OPACITY);
            let pixel = 1.0 / (rectangle.inverse_depth[0] * focal);
            bounds.push(pixel, gaussian.log_scale);
            map.push(gaussian);
        }
    }
}

/// A flat Gaussian on the plane of a rectangle; `None` where no radiance is known.
fn disc(
    activation: ColourActivation,
    source: &SourceFrame<'_>,
    rectangle: &Rectangle,
) -> Option<Gaussian<f32>> {
    let colour = mean_colour(activation, source, rectangle)?;
    let (log_scale, rotation) = shape(source, rectangle);
    Some(Gaussian {
        mean: (source.world_from_depth * rectangle.centre(source.camera)).cast::<f32>().to_array(),
        log_scale,
        rotation,
        opacity_logit: logit(INITIAL_OPACITY),
        colour,
    })
}

/// Log standard deviations, largest first, and rotation: with `X_u` and `X_v` the derivatives of the
/// surface by pixel and `e` the deviations in pixels, the covariance is `e_u² X_u X_uᵀ + e_v² X_v X_vᵀ`.
fn shape(source: &SourceFrame<'_>, rectangle: &Rectangle) -> ([f32; 3], [f32; 4]) {
    let deviations = rectangle.edges.map(|edge| EDGE_DEVIATION * edge as f64);
    let [by_u, by_v] = rectangle.tangents(source.camera);
    let (by_u, by_v) = (by_u * deviations[0], by_v * deviations[1]);
    let (variances, axes) = symmetric_eigen(&(Mat3::outer(by_u, by_u) + Mat3::outer(by_v, by_v)));
    let second = variances.y.max(variances.x / (MAX_ELONGATION * MAX_ELONGATION));
    let thickness = (variances.x * second).sqrt() * THICKNESS * THICKNESS;
    let Rotation { w, v } = source.world_from_depth.rotation * Rotation::from_matrix(&axes);
    let log_scale = [variances.x, second, thickness].map(|variance| (0.5 * variance.ln()) as f32);
    (log_scale, [w, v.x, v.y, v.z].map(|q| q as f32))
}

/// Mean stored colour of the pixels of a rectangle at which radiance is known.
fn mean_colour(
    activation: ColourActivation,
    source: &SourceFrame<'_>,
    rectangle: &Rectangle,
) -> Option<[f32; 3]> {
    let pixel = |(column, row)| row * source.camera.width + column;
    let known = rectangle.pixels().filter_map(|at| source.surface_point(pixel(at)));
    let (mut sum, mut count) = ([0.0; 3], 0.0_f32);
    for (_, radiance) in known {
        let colour = activation.colour(radiance);
        (0..3).for_each(|c| sum[c] += colour[c]);
        count += 1.0;
    }
    (count > 0.0).then(|| sum.map(|v| v / count))
}

/// The rectangles of a frame's picture and depth.
pub(super) fn partition<'a>(source: &'a SourceFrame<'_>) -> Partition<'a> {
    let focal = 0.5 * (source.camera.fx + source.camera.fy) as f32;
    Partition::new(&source.observation.colour, &source.depth, focal)
}
