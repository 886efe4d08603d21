//! Pixels, resolution levels and blur of one step of a jointly optimised field.

use crate::mapping::keyframe::Keyframe;
use crate::mapping::mapper::MappingContext;
use crate::mapping::window::random_pixels;
use crate::objective::{
    BlurMethod, Exposure, FrameVariables, PixelBatch, Sampling, Tone, blur_length_at,
};
use crate::reconstruction::FrameEstimate;
use i2slam_formation::ResponseCurve;
use i2slam_geometry::Camera;
use std::collections::BTreeMap;

/// Random pixels of a keyframe, at most `count`; each takes a ray per virtual camera.
pub(super) fn sample_pixels<'a>(
    context: &mut MappingContext<'_>,
    keyframe: &'a Keyframe,
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
    let tone = curves.get(&estimate.response).map(|curve| Tone { frame: estimate.tone, curve });
    let variables = FrameVariables { exposure, tone };
    let observation = &*keyframe.observation;
    let size = observation.depth.pixels();
    let pixels = random_pixels(size, count.max(1), context.covered, context.random);
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

/// Pixels of a step limited to `pixels` and, unless 0, to about `samples`, at `per_pixel` samples
/// as in the last step.
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
