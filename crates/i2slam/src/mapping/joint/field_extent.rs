//! Cube of a jointly optimised field: centred on the cameras' bounding box, and large enough to hold
//! 99 % of the depths of every keyframe in any orientation, or `keyframed.reach` without depth.

use crate::mapping::field::{chebyshev_distance, surface_distance};
use crate::mapping::keyframe::Keyframe;
use crate::mapping::mapper::MappingContext;
use i2slam_geometry::Vec3;
use i2slam_radiance::hashgrid::FieldSettings;

/// Share of `keyframed.reach` that a later camera without depth needs; a new cube grants all of it.
const MIN_REACH_SHARE: f64 = 0.5;

/// A cube: centre and half edge [unit of the poses].
pub(super) struct Extent {
    pub(super) centre: [f64; 3],
    pub(super) bound: f64,
}

impl Extent {
    /// The cube for all keyframes.
    pub(super) fn of_keyframes(context: &MappingContext<'_>) -> Self {
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
            return Self { centre, bound: f64::from(settings.bound) };
        }
        let extents = context.keyframes.iter().map(|k| required_extent(context, k, centre, 1.0));
        Self { centre, bound: f64::from(settings.margin) * extents.fold(1e-3, f64::max) }
    }
}

/// Whether a field holds what the last keyframe sees; always with `hashgrid.bound`.
pub(super) fn contains(field: &FieldSettings, context: &MappingContext<'_>) -> bool {
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

/// Half edge of the cube around `centre` that a keyframe needs, with `share` of the reach where it
/// has no depth.
fn required_extent(
    context: &MappingContext<'_>,
    keyframe: &Keyframe,
    centre: [f64; 3],
    share: f64,
) -> f64 {
    let from_centre = chebyshev_distance(position(context, keyframe), centre);
    let depth = &keyframe.observation.depth;
    let view_distance = surface_distance(context.camera, depth);
    from_centre + view_distance.unwrap_or(share * f64::from(context.config.keyframed.reach))
}
