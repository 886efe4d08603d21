//! How large a field has to be for what keyframes see.
//!
//! The cube lies around the middle of all cameras. It holds, in whatever direction a camera looks,
//! all depths of its keyframe but the farthest 1 %, or, without depth, what lies within `reach`.

use crate::mapping::field::{away, held_distance};
use crate::mapping::{Keyframe, Story};
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
    /// A cube for all keyframes of a story.
    pub(super) fn of(story: &Story<'_>) -> Self {
        let places: Vec<Vec3<f64>> = story.keyframes.iter().map(|k| place(story, k)).collect();
        let axis = |k: usize| {
            let along = places.iter().map(|p| p.to_array()[k]);
            let (low, high) =
                along.fold((f64::MAX, f64::MIN), |(low, high), x| (low.min(x), high.max(x)));
            if low > high { 0.0 } else { 0.5 * (low + high) }
        };
        let centre = [axis(0), axis(1), axis(2)];
        let settings = &story.config.hashgrid;
        if settings.bound > 0.0 {
            return Self { centre, bound: f64::from(settings.bound) };
        }
        let needs = story.keyframes.iter().map(|k| need(story, k, centre, 1.0));
        Self { centre, bound: f64::from(settings.margin) * needs.fold(1e-3, f64::max) }
    }
}

/// Whether a field holds what the last keyframe sees. One of a set size is never too small.
pub(super) fn holds(field: &FieldSettings, story: &Story<'_>) -> bool {
    let last = story.keyframes.last();
    story.config.hashgrid.bound > 0.0
        || last.is_none_or(|k| need(story, k, field.centre, ENOUGH) <= field.bound)
}

fn place(story: &Story<'_>, keyframe: &Keyframe) -> Vec3<f64> {
    story.frames[keyframe.frame].middle().translation
}

/// Half edge of the cube around `centre` that one keyframe needs, `share` of `reach` being enough.
fn need(story: &Story<'_>, keyframe: &Keyframe, centre: [f64; 3], share: f64) -> f64 {
    let away = away(place(story, keyframe), centre);
    let depth = &keyframe.observation.depth;
    let sees = held_distance(story.camera, depth);
    away + sees.unwrap_or(share * f64::from(story.config.keyframed.reach))
}
