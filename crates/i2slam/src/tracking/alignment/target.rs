//! Alignment targets: the rendered map, and the last keyframe's depth.

use super::FrameAlignment;
use super::pyramid::{depth_levels, map_levels};
use crate::objective::FrameObjective;
use i2slam_geometry::Pose;
use i2slam_odometry::alignment::{AbsoluteErrors, RobustScales, TargetLevel};
use i2slam_radiance::RadianceMap;

/// Robust scales of the first iteration.
const INITIAL_SCALES: RobustScales = RobustScales { depth: 0.02, image: 0.08 };

/// Smallest scale of the depth residuals [m at 1 m].
const MIN_DEPTH_SCALE: f32 = 3e-5;

/// Smallest scale of the image residuals [picture values].
const MIN_IMAGE_SCALE: f32 = 0.01;

/// Least ratio of the map's depth residuals to the noise of the keyframe's depth from which the
/// keyframe counts.
const KEYFRAME_NOISE_RATIO: f32 = 3.0;

/// Scale that gives depth residuals no weight [m at 1 m].
const DISABLED_SCALE: f32 = 1e4;

/// Scale of the depth residuals [m at 1 m] from which pictures have their full weight.
const FULL_WEIGHT_DEPTH_SCALE: f32 = 1.5e-3;

/// Standard deviation of a normal distribution over its mean absolute value.
const SIGMA_PER_MEAN: f32 = 1.25;

/// Something a frame is aligned to: the rendered map (radiance and depth), or the last keyframe's
/// own depth, which has no radiance but edges that no splat has softened.
pub(super) struct AlignmentTarget {
    pub(super) levels: Vec<TargetLevel>,
    pub(super) world_from_camera: Pose<f64>,
    pub(super) scales: RobustScales,
    pub(super) has_radiance: bool,
}

impl AlignmentTarget {
    /// The map seen from `world_from_camera`, rendered unless the frame is expected there.
    pub(super) fn from_map<M: RadianceMap>(
        frame: &FrameAlignment<'_>,
        objective: &mut FrameObjective<M>,
        map: &M,
        world_from_camera: Pose<f64>,
    ) -> Self {
        let expected = frame.context.expected;
        let known = expected.filter(|view| view.world_from_camera == world_from_camera);
        let render = match known {
            Some(view) => view.render,
            None => objective.render(map, world_from_camera),
        };
        Self {
            levels: map_levels(render, frame.levels.len()),
            world_from_camera,
            scales: INITIAL_SCALES,
            has_radiance: true,
        }
    }

    /// The last keyframe's depth, where there is one and the settings ask for it.
    pub(super) fn from_keyframe(frame: &FrameAlignment<'_>) -> Option<Self> {
        let (observation, world_from_camera) = frame.context.keyframe?;
        if !frame.context.config.parameters.tracking.keyframe_depth
            || frame.observation.is_estimated()
        {
            return None;
        }
        Some(Self {
            levels: depth_levels(&observation.depth, frame.levels.len()),
            world_from_camera,
            scales: INITIAL_SCALES,
            has_radiance: false,
        })
    }

    /// Sets the robust scales from the mean absolute residuals, no lower than their floors.
    pub(super) fn update_scales(&mut self, errors: &AbsoluteErrors) {
        let scale = |sum: f64, count: usize| SIGMA_PER_MEAN * (sum / count as f64) as f32;
        if errors.depth_count > 0 {
            self.scales.depth = scale(errors.depth, errors.depth_count).max(MIN_DEPTH_SCALE);
        }
        if errors.image_count > 0 {
            self.scales.image = scale(errors.image, errors.image_count).max(MIN_IMAGE_SCALE);
        }
    }
}

impl FrameAlignment<'_> {
    /// Robust scales. Estimated depth re-projects pixels but gives no residuals: it was computed
    /// from the poses.
    pub(super) fn scales(&self, target: &AlignmentTarget) -> RobustScales {
        match self.observation.is_estimated() {
            true => RobustScales { depth: DISABLED_SCALE, ..target.scales },
            false => target.scales,
        }
    }

    /// Weight of image residuals: in full where depth gives no residuals, reduced where depth is
    /// exact: the errors of pictures are not independent (a map that is still soft is wrong
    /// everywhere in the same way), so they must not outvote depth residuals below a millimetre at
    /// a metre.
    pub(super) fn image_weight(&self, target: &AlignmentTarget) -> f32 {
        let weight = self.context.config.parameters.tracking.image_weight;
        match (target.has_radiance, self.observation.is_estimated()) {
            (false, _) => 0.0,
            (true, true) => weight,
            (true, false) => {
                weight * (target.scales.depth / FULL_WEIGHT_DEPTH_SCALE).clamp(0.05, 1.0)
            }
        }
    }
}

/// The targets that count, with their indices: the map, and the keyframe where its depth is far
/// less noisy than the map's residuals. That holds for exact depth, not for a sensor's, which the
/// map has averaged. Far from the solution, where the map fits badly, a noisy keyframe counts too.
pub(super) fn active_targets(
    targets: &[AlignmentTarget],
) -> impl Iterator<Item = (usize, &AlignmentTarget)> {
    let map_scale = targets[0].scales.depth;
    let counts = move |r: &AlignmentTarget| {
        r.has_radiance || KEYFRAME_NOISE_RATIO * r.levels[0].noise < map_scale
    };
    targets.iter().enumerate().filter(move |(_, target)| counts(target))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Config;
    use crate::objective::Observation;
    use crate::tracking::{ExpectedView, SequenceReadout, TrackingContext};
    use i2slam_compute::CancellationToken;
    use i2slam_geometry::{Camera, Image, Tangent};
    use i2slam_radiance::Render;
    use i2slam_radiance::gaussian::{
        ColourActivation, Gaussian, GaussianMap, RasterSettings, Shape,
    };
    use std::sync::Arc;

    const CAMERA: Camera<f64> =
        Camera { width: 32, height: 24, fx: 30.0, fy: 30.0, cx: 16.0, cy: 12.0 };

    fn ball() -> GaussianMap {
        let mut map = GaussianMap::new(Shape::Isotropic, ColourActivation::Linear);
        map.push(Gaussian {
            mean: [0.0, 0.0, 2.0],
            log_scale: [-1.0; 3],
            rotation: [1.0, 0.0, 0.0, 0.0],
            opacity_logit: 5.0,
            colour: [0.3, 0.5, 0.7],
        });
        map
    }

    /// Radiance of the target at a pose, where the view at the origin is expected to be `render`.
    fn radiance_at(pose: Pose<f64>, render: &Render) -> Image<f32> {
        let (config, cancellation) = (Config::default(), CancellationToken::default());
        let observation = Observation::new(Image::new(32, 24, 3), Image::new(32, 24, 1));
        let context = TrackingContext {
            config: &config,
            camera: &CAMERA,
            frame_rate: 30.0,
            readout: SequenceReadout::new(&config.input),
            timestamps: (0.0, 0.0),
            frames: &[],
            previous: None,
            before_previous: None,
            exposure_motion: None,
            expected: Some(ExpectedView { world_from_camera: Pose::identity(), render }),
            keyframe: None,
            white_balance: config.formation.white_balance,
            vignetting: None,
            cancellation: &cancellation,
        };
        let frame = FrameAlignment {
            context: &context,
            levels: super::super::pyramid::frame_levels(
                &CAMERA,
                (Arc::clone(&observation.colour), &observation.depth),
                2,
            ),
            observation: &observation,
            curve: None,
            pixels_per_unit: [15.0; 6],
            previous_pose: Pose::identity(),
            predicted_white_balance: [0.0; 3],
            predicted_readout: 0.0,
        };
        let mut objective = FrameObjective::new(CAMERA.cast(), RasterSettings::default());
        let target = AlignmentTarget::from_map(&frame, &mut objective, &ball(), pose);
        assert_eq!((target.levels.len(), target.world_from_camera), (2, pose));
        target.levels[0].radiance.clone()
    }

    #[test]
    fn the_map_is_rendered_where_its_view_is_not_known() {
        let mut objective = FrameObjective::new(CAMERA.cast(), RasterSettings::default());
        let mut fresh = |pose| objective.render(&ball(), pose).clone();
        let away = Pose::identity().retract(Tangent::from_array([0.1, 0.0, 0.0, 0.0, 0.02, 0.0]));
        let (here, there) = (fresh(Pose::identity()), fresh(away));
        assert_eq!(radiance_at(Pose::identity(), &here), here.radiance);
        assert_eq!(radiance_at(away, &here), there.radiance);
        assert_ne!(here.radiance, there.radiance);
        let mut known = here.clone();
        known.radiance.data.fill(0.25);
        assert_eq!(radiance_at(Pose::identity(), &known), known.radiance);
    }
}
