//! Shells around surfaces that a field is confined to where keyframes have estimated depth in most
//! pixels; thicker where depth is inpainted.

use crate::config::HashGridConfig;
use crate::mapping::depth_inpainting::inpaint_estimated;
use crate::mapping::field::mark_cells;
use crate::mapping::keyframe::Keyframe;
use crate::mapping::mapper::MappingContext;
use crate::objective::Observation;
use i2slam_compute::median;
use i2slam_geometry::Camera;
use i2slam_radiance::hashgrid::{HashGridMap, Occupancy};

/// Half thickness [standard deviations of the depth]; at least `hashgrid.shell` of the depth.
const DEVIATIONS: f32 = 3.0;
/// Factor between an inpainted depth and the bounds of its shell.
const INPAINTED_RANGE: f32 = 1.3;

/// Whether any keyframe has estimated depth in most pixels.
pub(super) fn are_known(context: &MappingContext<'_>) -> bool {
    context.keyframes.iter().any(|keyframe| has_surfaces(&keyframe.observation))
}

/// Settings of a field around known surfaces: the smaller volume allows denser samples, and cells as
/// fine as pictures resolve.
pub(super) fn surface_settings(context: &MappingContext<'_>) -> HashGridConfig {
    let keyframed = &context.config.keyframed;
    let finer = context.config.hashgrid.finer(keyframed.surface_detail);
    let depth = if keyframed.surface_cell > 0.0 { median_depth(context) } else { None };
    match depth {
        Some(depth) => finer.with_cells(keyframed.surface_cell * depth / context.camera.fx as f32),
        None => finer,
    }
}

/// Median depth of all keyframes, from every seventh pixel; `None` without depth.
fn median_depth(context: &MappingContext<'_>) -> Option<f32> {
    let depths = context.keyframes.iter().flat_map(|k| k.observation.depth.data.iter().step_by(7));
    median(&mut depths.copied().filter(|&depth| depth > 0.0).collect::<Vec<f32>>())
}

/// Shells of all keyframes; `None` if none has estimated depth in most pixels.
pub(super) fn shells(
    map: &HashGridMap,
    camera: &Camera<f32>,
    context: &MappingContext<'_>,
) -> Option<Occupancy> {
    are_known(context).then(|| {
        let mut shells = Occupancy::empty(*map.occupancy.settings());
        context.keyframes.iter().for_each(|k| mark_keyframe(&mut shells, map, camera, context, k));
        shells
    })
}

/// Marks the shells of one keyframe; without depth in most pixels, all that it sees.
pub(super) fn mark_keyframe(
    shells: &mut Occupancy,
    map: &HashGridMap,
    camera: &Camera<f32>,
    context: &MappingContext<'_>,
    keyframe: &Keyframe,
) {
    let (observation, pose) = (&*keyframe.observation, context.frames[keyframe.frame].middle());
    let inpainted = inpaint_estimated(&observation.depth, None);
    let everywhere = !has_surfaces(observation);
    let shell = context.config.hashgrid.shell;
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
fn has_surfaces(observation: &Observation) -> bool {
    observation.is_estimated() && 2 * observation.valid_depths() > observation.depth.pixels()
}
