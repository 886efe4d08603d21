//! Samples of a jointly optimised field: pixels and levels of a step, the cube of the field, and the
//! shells that sampling is confined to.
//!
//! The cube is centred on the cameras' bounding box and holds 99 % of the depths of every keyframe in
//! any orientation, or `keyframed.reach` without depth. Where keyframes have estimated depth in most
//! pixels, only shells around their surfaces are sampled, thicker where depth is inpainted.

use crate::mapping::context::MappingContext;
use crate::mapping::depth_inpainting::inpaint_estimated;
use crate::mapping::field::{FieldShape, chebyshev_distance, mark_cells, surface_distance};
use crate::mapping::keyframe::Keyframe;
use crate::mapping::window::random_pixels;
use crate::objective::{
    BlurMethod, Exposure, FrameVariables, Observation, PixelBatch, Sampling, blur_length_at,
};
use crate::reconstruction::FrameEstimate;
use i2slam_compute::median;
use i2slam_formation::{Formation, ResponseCurve};
use i2slam_geometry::{Camera, Vec3};
use i2slam_radiance::hashgrid::{FieldSettings, HashGridMap, Occupancy};
use std::collections::BTreeMap;

/// Random pixels of a keyframe, at most `count`; each takes a ray per virtual camera.
pub(super) fn sample_pixels<'a, 'c: 'a>(
    context: &mut MappingContext<'c>,
    (keyframe, observation): (&Keyframe, &'a Observation),
    curves: &'a BTreeMap<usize, ResponseCurve<f32>>,
    count: usize,
) -> PixelBatch<'a> {
    let (estimate, formation) = (&context.frames[keyframe.frame], &context.config.formation);
    let exposure = Exposure {
        shutter: estimate.shutter,
        sampling: Sampling::with_method(BlurMethod::Exact, formation, estimate.blur_length, 0.0),
        readout: 0.0,
        depth_pose: None,
    };
    let vignetting = context.vignetting;
    let tone = curves.get(&estimate.response);
    let tone = tone.map(|curve| Formation { tone: estimate.tone, curve, vignetting });
    let variables = FrameVariables { exposure, tone };
    let size = observation.depth.pixels();
    let pixels = random_pixels(size, count.max(1), context.valid_mask, context.random);
    PixelBatch { observation, variables, pixels }
}

/// Blur length of a frame [px] if all surfaces lie at `depth`.
pub(super) fn blur_length_at_depth(
    camera: &Camera<f64>,
    estimate: &FrameEstimate,
    depth: f64,
) -> f64 {
    blur_length_at(camera, &estimate.shutter, |_, _| depth)
}

/// Pixels of a step: at most `pixels`, and about `samples` samples unless that is 0.
pub(super) fn pixel_budget((pixels, samples): (usize, usize), per_pixel: Option<f32>) -> usize {
    match (samples, per_pixel) {
        (0, _) | (_, None) => pixels,
        (samples, Some(per_pixel)) => pixels.min((samples as f32 / per_pixel) as usize),
    }
}

/// Grid levels trained at `step`: the coarse half from the start, then one after another.
pub(super) fn active_levels(step: usize, coarse_steps: usize, levels: usize) -> usize {
    let first = levels.div_ceil(2);
    match coarse_steps {
        0 => levels,
        steps => (first + (levels - first) * step / steps).min(levels),
    }
}

/// Share of `keyframed.reach` that a later camera without depth needs; a new cube grants all of it.
const MIN_REACH_SHARE: f64 = 0.5;

/// Centre and half edge of the cube for all keyframes [unit of the poses].
pub(super) fn cube_of_keyframes(context: &MappingContext<'_>) -> ([f64; 3], f64) {
    let positions: Vec<Vec3<f64>> =
        context.keyframes.iter().map(|k| position(context, k)).collect();
    let axis = |k: usize| {
        let along = positions.iter().map(|p| p.to_array()[k]);
        let (low, high) =
            along.fold((f64::MAX, f64::MIN), |(low, high), x| (low.min(x), high.max(x)));
        if low > high { 0.0 } else { 0.5 * (low + high) }
    };
    let centre = [axis(0), axis(1), axis(2)];
    let settings = &context.config.hashgrid;
    if settings.bound > 0.0 {
        return (centre, f64::from(settings.bound));
    }
    let extents = context.keyframes.iter().map(|k| required_extent(context, k, centre, 1.0));
    let margin = f64::from(context.config.parameters.field.margin);
    (centre, margin * extents.fold(1e-3, f64::max))
}

/// Whether a field holds what the last keyframe sees; always with `hashgrid.bound`.
pub(super) fn contains_last_view(field: &FieldSettings, context: &MappingContext<'_>) -> bool {
    let last = context.keyframes.last();
    context.config.hashgrid.bound > 0.0
        || last.is_none_or(|k| {
            required_extent(context, k, field.centre, MIN_REACH_SHARE) <= field.bound
        })
}

/// Camera position of a keyframe.
fn position(context: &MappingContext<'_>, keyframe: &Keyframe) -> Vec3<f64> {
    context.frames[keyframe.frame].middle().translation
}

/// Half edge of the cube around `centre` that a keyframe needs; without depth `share` of reach.
fn required_extent(
    context: &MappingContext<'_>,
    keyframe: &Keyframe,
    centre: [f64; 3],
    share: f64,
) -> f64 {
    let from_centre = chebyshev_distance(position(context, keyframe), centre);
    let depth = &keyframe.observation.get().depth;
    let view_distance = surface_distance(context.camera, depth);
    from_centre + view_distance.unwrap_or(share * f64::from(context.config.keyframed.reach))
}

/// Half thickness [standard deviations of the depth]; at least the field's share of the depth.
const DEVIATIONS: f32 = 3.0;
/// Factor between an inpainted depth and the bounds of its shell.
const INPAINTED_RANGE: f32 = 1.3;

/// Whether any keyframe has estimated depth in most pixels.
pub(super) fn has_surfaces(context: &MappingContext<'_>) -> bool {
    context.keyframes.iter().any(|keyframe| has_surface_depth(&keyframe.observation.get()))
}

/// Settings of a field around known surfaces: denser samples, and cells as fine as pictures.
pub(super) fn surface_shape(context: &MappingContext<'_>) -> FieldShape {
    let keyframed = &context.config.parameters.keyframed;
    let finer = FieldShape::new(context.config).finer(keyframed.surface_detail);
    let depth = if keyframed.surface_cell > 0.0 { median_depth(context) } else { None };
    match depth {
        Some(depth) => finer.with_cells(keyframed.surface_cell * depth / context.camera.fx as f32),
        None => finer,
    }
}

/// Median depth of all keyframes, from every seventh pixel; `None` without depth.
fn median_depth(context: &MappingContext<'_>) -> Option<f32> {
    let mut depths = Vec::new();
    for keyframe in context.keyframes {
        let depth = &keyframe.observation.get().depth.data;
        depths.extend(depth.iter().step_by(7).filter(|depth| **depth > 0.0));
    }
    median(&mut depths)
}

/// Shells of all keyframes; `None` if none has estimated depth in most pixels.
pub(super) fn surface_shells(
    map: &HashGridMap,
    camera: &Camera<f32>,
    context: &MappingContext<'_>,
) -> Option<Occupancy> {
    has_surfaces(context).then(|| {
        let mut shells = Occupancy::empty(*map.occupancy.settings());
        context.keyframes.iter().for_each(|k| mark_view(&mut shells, map, camera, context, k));
        shells
    })
}

/// Marks the shells of one keyframe; without depth in most pixels, all that it sees.
pub(super) fn mark_view(
    shells: &mut Occupancy,
    map: &HashGridMap,
    camera: &Camera<f32>,
    context: &MappingContext<'_>,
    keyframe: &Keyframe,
) {
    let (observation, pose) = (keyframe.observation.get(), context.frames[keyframe.frame].middle());
    let inpainted = inpaint_estimated(&observation.depth, None);
    let everywhere = !has_surface_depth(&observation);
    let shell = context.config.parameters.field.shell;
    let range = |pixel: usize, depth: f32| match observation.depth.data[pixel] > 0.0 {
        _ if everywhere => (map.march.near, f32::MAX),
        true => {
            let variance = observation.depth_variance.as_ref().map_or(0.0, |v| v.data[pixel]);
            let half = (DEVIATIONS * variance.sqrt()).max(shell * depth);
            ((depth - half).max(map.march.near), depth + half)
        }
        false => (depth / INPAINTED_RANGE, depth * INPAINTED_RANGE),
    };
    mark_cells(shells, &map.field, (camera, pose), &inpainted, range);
}

/// Whether an observation has estimated depth in most pixels.
fn has_surface_depth(observation: &Observation) -> bool {
    observation.is_estimated() && 2 * observation.valid_depths() > observation.depth.pixels()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn expensive_pixels_are_fewer() {
        let pixels = |samples, each| pixel_budget((500, samples), each);
        assert_eq!(
            [pixels(0, Some(400.0)), pixels(9000, None), pixels(9000, Some(10.0))],
            [500; 3]
        );
        assert_eq!(pixels(9000, Some(90.0)), 100);
    }

    #[test]
    fn levels_open_from_coarse_to_fine() {
        let open: Vec<usize> = [0, 9, 10, 55, 60, 99].map(|s| active_levels(s, 60, 12)).to_vec();
        assert_eq!(open, [6, 6, 7, 11, 12, 12]);
        assert_eq!((active_levels(0, 0, 12), active_levels(0, 5, 1)), (12, 1));
    }
}
