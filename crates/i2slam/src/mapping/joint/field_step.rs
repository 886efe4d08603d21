//! What a step is made of.

use crate::mapping::{Keyframe, MappingContext};
use crate::objective::{
    BlurRoute, Exposure, FrameVariables, RayView, Sampling, Tone, blur_length_at,
};
use crate::reconstruction::FrameEstimate;
use i2slam_formation::ResponseCurve;
use i2slam_geometry::Camera;
use std::collections::BTreeMap;

/// `count` random pixels of a keyframe; each takes a ray for every virtual camera.
pub(super) fn draw<'a>(
    context: &mut MappingContext<'_>,
    keyframe: &'a Keyframe,
    curves: &'a BTreeMap<usize, ResponseCurve<f32>>,
    count: usize,
) -> RayView<'a> {
    let (estimate, formation) = (&context.frames[keyframe.frame], &context.config.formation);
    let exposure = Exposure {
        shutter: estimate.shutter,
        sampling: Sampling::by_route(BlurRoute::Exact, formation, estimate.blur_length, 0.0),
        readout: 0.0,
        depth_pose: None,
    };
    let tone = curves.get(&estimate.response).map(|curve| Tone { frame: estimate.tone, curve });
    let variables = FrameVariables { exposure, tone };
    let observation = &*keyframe.observation;
    let all = observation.depth.pixels();
    let recorded = |p: &usize| context.covered.is_none_or(|c| c.data[*p]);
    let random = &mut *context.random;
    let pixels = (0..count.max(1)).map(|_| random.below(all)).filter(recorded).collect();
    RayView { observation, variables, pixels }
}

/// The last keyframe and others drawn at random from all.
pub(super) fn window(context: &mut MappingContext<'_>) -> Vec<Keyframe> {
    let size = context.config.mapping.window;
    let mut others: Vec<&Keyframe> = context.keyframes.iter().collect();
    let mut window: Vec<Keyframe> = others.pop().into_iter().cloned().collect();
    context.random.shuffle(&mut others);
    window.extend(others.into_iter().take(size.saturating_sub(1)).cloned());
    window
}

/// Keyframes drawn at random from all.
pub(super) fn any(context: &mut MappingContext<'_>, size: usize) -> Vec<Keyframe> {
    let mut order: Vec<&Keyframe> = context.keyframes.iter().collect();
    context.random.shuffle(&mut order);
    order.into_iter().take(size).cloned().collect()
}

/// Length of a frame's streaks [px], all of its surfaces being at one depth.
pub(super) fn blur_length_at_depth(
    camera: &Camera<f64>,
    estimate: &FrameEstimate,
    depth: f64,
) -> f64 {
    blur_length_at(camera, &estimate.shutter, |_, _| depth)
}

/// Pixels of a step that is to have at most so many pixels and, unless that is 0, about so many
/// samples, if each takes as many as those of the last step.
pub(super) fn pixel_budget((pixels, samples): (usize, usize), each: Option<f32>) -> usize {
    match (samples, each) {
        (0, _) | (_, None) => pixels,
        (samples, Some(each)) => pixels.min((samples as f32 / each) as usize),
    }
}

/// Grids that are trained: half of them from the start, the others one after another.
pub(super) fn active_levels(step: usize, coarse_steps: usize, levels: usize) -> usize {
    let first = levels.div_ceil(2);
    match coarse_steps {
        0 => levels,
        steps => (first + (levels - first) * step / steps).min(levels),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fog_is_seen_through_by_fewer_pixels() {
        let pixels = |samples, each| pixel_budget((500, samples), each);
        assert_eq!(
            [pixels(0, Some(400.0)), pixels(9000, None), pixels(9000, Some(10.0))],
            [500; 3]
        );
        assert_eq!(pixels(9000, Some(90.0)), 100);
    }

    #[test]
    fn grids_come_in_from_coarse_to_fine() {
        let open: Vec<usize> = [0, 9, 10, 55, 60, 99].map(|s| active_levels(s, 60, 12)).to_vec();
        assert_eq!(open, [6, 6, 7, 11, 12, 12]);
        assert_eq!((active_levels(0, 0, 12), active_levels(0, 5, 1)), (12, 1));
    }
}
