//! How large a field has to be for what keyframes see.
//!
//! The cube lies around the middle of all cameras. It holds, in whatever direction a camera looks,
//! all depths of its keyframe but the farthest 1 %, or, without depth, what lies within `reach`.

use crate::mapping::field::{chebyshev_distance, surface_distance};
use crate::mapping::{Keyframe, MappingContext};
use i2slam_geometry::Vec3;
use i2slam_radiance::hashgrid::FieldSettings;

/// Share of `reach` that a camera without depth must have before it; at first it has all.
const ENOUGH: f64 = 0.5;

/// A cube: its middle, and half of its edge [unit of the poses].
pub(super) struct Extent {
    pub(super) centre: [f64; 3],
    pub(super) bound: f64,
}

impl Extent {
    /// A cube for all keyframes of a context.
    pub(super) fn of(context: &MappingContext<'_>) -> Self {
        let places: Vec<Vec3<f64>> = context.keyframes.iter().map(|k| place(context, k)).collect();
        let axis = |k: usize| {
            let along = places.iter().map(|p| p.to_array()[k]);
            let (low, high) =
                along.fold((f64::MAX, f64::MIN), |(low, high), x| (low.min(x), high.max(x)));
            if low > high { 0.0 } else { 0.5 * (low + high) }
        };
        let centre = [axis(0), axis(1), axis(2)];
        let settings = &context.config.hashgrid;
        if settings.bound > 0.0 {
            return Self { centre, bound: f64::from(settings.bound) };
        }
        let needs = context.keyframes.iter().map(|k| required_extent(context, k, centre, 1.0));
        Self { centre, bound: f64::from(settings.margin) * needs.fold(1e-3, f64::max) }
    }
}

/// Whether a field holds what the last keyframe sees. One of a set size is never too small.
pub(super) fn contains(field: &FieldSettings, context: &MappingContext<'_>) -> bool {
    let last = context.keyframes.last();
    context.config.hashgrid.bound > 0.0
        || last.is_none_or(|k| required_extent(context, k, field.centre, ENOUGH) <= field.bound)
}

fn place(context: &MappingContext<'_>, keyframe: &Keyframe) -> Vec3<f64> {
    context.frames[keyframe.frame].middle().translation
}

/// Half edge of the cube around `centre` that one keyframe needs, `share` of `reach` being enough.
fn required_extent(
    context: &MappingContext<'_>,
    keyframe: &Keyframe,
    centre: [f64; 3],
    share: f64,
) -> f64 {
    let from_centre = chebyshev_distance(place(context, keyframe), centre);
    let depth = &keyframe.observation.depth;
    let sees = surface_distance(context.camera, depth);
    from_centre + sees.unwrap_or(share * f64::from(context.config.keyframed.reach))
}
