//! Which parts of the field may be sampled where keyframes come with estimated depth in most
//! pixels: a shell around every surface, a thicker one where depth is only guessed, nothing in
//! between.

use crate::config::HashGridConfig;
use crate::mapping::depth_inpainting::inpaint_estimated;
use crate::mapping::field::mark_cells;
use crate::mapping::{Keyframe, MappingContext};
use crate::objective::Observation;
use i2slam_compute::median;
use i2slam_geometry::Camera;
use i2slam_radiance::hashgrid::{HashGridMap, Occupancy};

/// Half thickness in standard deviations of the depth, but at least the settings' share of it.
const DEVIATIONS: f32 = 3.0;
/// The same where depth is a guess, as a factor of it.
const GUESSED: f32 = 1.3;

/// Whether any keyframe of a context has estimated depth in most pixels.
pub(super) fn are_known(context: &MappingContext<'_>) -> bool {
    context.keyframes.iter().any(|keyframe| has_surfaces(&keyframe.observation))
}

/// The settings of a field around known surfaces: there is less to sample, and so it is sampled more
/// densely, with cells for what pictures resolve.
pub(super) fn settings(context: &MappingContext<'_>) -> HashGridConfig {
    let keyframed = &context.config.keyframed;
    let finer = context.config.hashgrid.finer(keyframed.surface_detail);
    let depth = if keyframed.surface_cell > 0.0 { median_depth(context) } else { None };
    match depth {
        Some(depth) => finer.with_cells(keyframed.surface_cell * depth / context.camera.fx as f32),
        None => finer,
    }
}

/// The median depth of keyframes, taken from some of their pixels; none if these have none.
fn median_depth(context: &MappingContext<'_>) -> Option<f32> {
    let depths = context.keyframes.iter().flat_map(|k| k.observation.depth.data.iter().step_by(7));
    median(&mut depths.copied().filter(|&depth| depth > 0.0).collect::<Vec<f32>>())
}

/// The shells of all keyframes of a context; none if none of them has estimated depth in most pixels.
pub(super) fn shells(
    map: &HashGridMap,
    camera: &Camera<f32>,
    context: &MappingContext<'_>,
) -> Option<Occupancy> {
    are_known(context).then(|| {
        let mut shells = Occupancy::empty(*map.occupancy.settings());
        context.keyframes.iter().for_each(|k| hold(&mut shells, map, camera, context, k));
        shells
    })
}

/// Adds those of one keyframe. Where one has depth in few pixels, all that it sees is sampled.
pub(super) fn hold(
    shells: &mut Occupancy,
    map: &HashGridMap,
    camera: &Camera<f32>,
    context: &MappingContext<'_>,
    keyframe: &Keyframe,
) {
    let (observation, pose) = (&*keyframe.observation, context.frames[keyframe.frame].middle());
    let filled = inpaint_estimated(&observation.depth, None);
    let everywhere = !has_surfaces(observation);
    let shell = context.config.hashgrid.shell;
    let between = |pixel: usize, depth: f32| match observation.depth.data[pixel] > 0.0 {
        _ if everywhere => (map.march.near, f32::MAX),
        true => {
            let variance = observation.depth_variance.as_ref().map_or(0.0, |v| v.data[pixel]);
            let half = (DEVIATIONS * variance.sqrt()).max(shell * depth);
            ((depth - half).max(map.march.near), depth + half)
        }
        false => (depth / GUESSED, depth * GUESSED),
    };
    mark_cells(shells, &map.field, (camera, pose), &filled, between);
}

/// Whether an observation has estimated depth in most pixels.
fn has_surfaces(observation: &Observation) -> bool {
    observation.is_estimated() && 2 * observation.valid_depths() > observation.depth.pixels()
}
