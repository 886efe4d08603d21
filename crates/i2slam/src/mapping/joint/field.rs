//! Joint optimisation of a radiance field and keyframes.
//!
//! Keyframes enter the training set one by one. A step forms random pixels of several keyframes,
//! compares them, and moves field, start and end poses, tone and response. Without depth, rays are
//! sampled where the field itself is dense. With estimated depth in most pixels they are sampled
//! only in shells around these surfaces: a tenth of the time, and no fog.

use super::field_sampling::{
    active_levels, blur_length_at_depth, contains_last_view, cube_of_keyframes, has_surfaces,
    mark_view, pixel_budget, sample_pixels, surface_shape, surface_shells,
};
use super::pose_optimizer::PoseOptimizers;
use super::trajectory_term::TrajectoryTerm;
use crate::config::{Config, Preconditioning};
use crate::mapping::context::{IterationBudget, MappingContext, OnStep};
use crate::mapping::field::{
    DEPTH_WEIGHT, FieldShape, LEARNING_RATE, MIN_CUBE_GROWTH, untrained_field,
};
use crate::mapping::frame_optimizer::{FrameOptimizers, ResponseGradients};
use crate::mapping::keyframe::{Keyframe, observations};
use crate::mapping::mapper::{ComparedMap, FinalRefinement, Growth, Mapper};
use crate::mapping::window::{random_window, recent_window};
use crate::objective::{Evaluation, FrameObjective, Observation, PixelBatch, RayObjective};
use crate::reconstruction::{Losses, Map};
use crate::tracking::{TrackingContext, TrackingResult};
use i2slam_formation::{CameraResponse, TrajectoryScale};
use i2slam_geometry::{Camera, Image, Pose};
use i2slam_radiance::Render;
use i2slam_radiance::hashgrid::{
    FieldAdam, FieldGradient, FieldRenderer, HashGridMap, Occupancy, SettingsError, decayed_rate,
};
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

/// Steps between refreshes of the occupancy grid (torch-ngp).
const OCCUPANCY_INTERVAL: usize = 16;
/// Refreshes for which all cells of the shells stay open after a relocalisation.
const REOPENED_REFRESHES: i32 = 24;
/// Part of the final optimisation in which transparent rays reopen cells: after the first
/// relocalisation, as wrong poses would fill them anywhere, and in time to train them again.
const REOPENING_PHASE: Range<f32> = 0.4..0.9;
/// Refreshes for which the cells along such a ray stay open.
const REOPENED_RAY_REFRESHES: i32 = 8;
/// Learning rate of poses where keyframes have estimated depth in most pixels (the paper's).
const SURFACE_CAMERA_RATE: f32 = 1e-4;
/// Near plane as a share of `keyframed.reach` (torch-ngp: 0.2 of 4).
const NEAR_SHARE: f32 = 0.05;
/// Pixels that the Jacobian of a preconditioner is computed from.
const JACOBIAN_PIXELS: usize = 96;

/// A radiance field that is optimised together with keyframe poses.
pub(crate) struct JointFieldMapper {
    camera: Camera<f32>,
    valid_mask: Option<Arc<Image<bool>>>,
    field: Option<Field>,
    frames: FrameOptimizers,
    poses: PoseOptimizers,
    trajectory: TrajectoryTerm,
    /// Steps since the field was started.
    steps: usize,
}

/// A field with the state of its training.
struct Field {
    current: ComparedMap<HashGridMap>,
    /// Cells around surfaces; `None` (all cells) without depth in most pixels of any keyframe.
    shells: Option<Occupancy>,
    batch: RayObjective,
    renderer: FieldRenderer,
    gradient: FieldGradient,
    adam: FieldAdam,
}

impl Field {
    /// Updates the pose preconditioner of a keyframe if due.
    fn update_preconditioner(
        &mut self,
        context: &mut MappingContext<'_>,
        poses: &mut PoseOptimizers,
        view: &PixelBatch<'_>,
        frame: usize,
    ) {
        let config = context.config;
        let interval = config.parameters.keyframed.preconditioning_interval;
        if !poses.is_preconditioner_due(frame, interval) {
            return;
        }
        let pixels = view.pixels.iter().copied().take(JACOBIAN_PIXELS).collect();
        let view = PixelBatch { pixels, ..*view };
        let hessian = self.batch.shutter_hessian(&self.current.map, &view, context.random);
        poses.precondition(frame, &hessian, config.keyframed.preconditioning);
    }
}

/// Learning rates and depth weight of one step.
#[derive(Clone, Copy)]
struct StepWeights {
    field_rate: f32,
    camera_rate: f32,
    depth_weight: f32,
}

/// Settings of the final optimisation, which depend on whether surfaces are known.
struct Schedule {
    depth_weight: f32,
    /// Share of the depth weight at the last step.
    final_depth_share: f32,
    camera_rate: f32,
    /// Number of steps.
    steps: usize,
    /// Relocalisations of all keyframes during these steps.
    relocalizations: usize,
}

impl JointFieldMapper {
    fn schedule(&self, config: &Config) -> Schedule {
        let (keyframed, steps) = (&config.parameters.keyframed, config.hashgrid.final_iterations);
        match self.field.as_ref().is_some_and(|field| field.shells.is_some()) {
            true => Schedule {
                depth_weight: keyframed.surface_depth_weight,
                final_depth_share: keyframed.surface_depth_left,
                camera_rate: SURFACE_CAMERA_RATE,
                steps: (keyframed.surface_steps * steps as f32) as usize,
                relocalizations: keyframed.surface_searches,
            },
            false => Schedule {
                depth_weight: DEPTH_WEIGHT,
                final_depth_share: 1.0,
                camera_rate: keyframed.camera_rate,
                steps,
                relocalizations: 0,
            },
        }
    }

    /// For keyframes of `camera`, taken from a video of `frame_rate` frames per second.
    pub(crate) fn new(camera: &Camera<f64>, frame_rate: f64) -> Self {
        Self {
            camera: camera.cast(),
            valid_mask: None,
            field: None,
            frames: FrameOptimizers::default(),
            poses: PoseOptimizers::default(),
            trajectory: TrajectoryTerm::new(frame_rate),
            steps: 0,
        }
    }

    /// Starts an untrained field that holds what all keyframes see.
    fn start(&mut self, context: &mut MappingContext<'_>) -> Result<(), SettingsError> {
        let (centre, mut bound) = cube_of_keyframes(context);
        if let Some(field) = &self.field {
            bound = bound.max(MIN_CUBE_GROWTH * field.current.map.field.settings().bound);
        }
        let config = context.config;
        let settings = match has_surfaces(context) {
            true => surface_shape(context)
                .with_growth(bound, config.parameters.keyframed.surface_growth),
            false => FieldShape::new(config),
        };
        let empty = untrained_field(&settings, centre, bound, config.seed)?;
        let mut march = empty.march;
        march.near = NEAR_SHARE * config.keyframed.reach;
        let occupancy = Occupancy::new(*empty.occupancy.settings());
        let map = HashGridMap { occupancy, march, ..empty };
        let mut batch = RayObjective::new(self.camera, march);
        batch.set_depth_outlier(config.parameters.keyframed.depth_outlier);
        batch.set_time_jitter(config.parameters.field.moment_jitter);
        let mut objective = FrameObjective::new(self.camera, march);
        if let Some(valid_mask) = &self.valid_mask {
            objective.set_valid_mask(Arc::clone(valid_mask));
        }
        self.field = Some(Field {
            batch,
            renderer: FieldRenderer::new(march),
            gradient: FieldGradient::zeros(&map.field),
            adam: FieldAdam::new(),
            shells: None,
            current: ComparedMap { map, objective },
        });
        self.confine(context);
        // Moments and preconditioners belong to the gradients of the field before.
        self.poses = PoseOptimizers::default();
        self.frames = FrameOptimizers::default();
        self.steps = 0;
        Ok(())
    }

    /// Confines sampling to shells around the surfaces of all keyframes, if their depth is known.
    fn confine(&mut self, context: &MappingContext<'_>) {
        let Some(field) = &mut self.field else { return };
        field.shells = surface_shells(&field.current.map, &self.camera, context);
        if let Some(shells) = &field.shells {
            field.current.map.occupancy.restrict_to(shells);
        }
    }

    /// Reopens the cells of the shells: with worse poses some were emptied that hold surfaces.
    fn reopen(&mut self) {
        if let Some(field) = self.field.as_mut().filter(|field| field.shells.is_some()) {
            field.current.map.occupancy.reopen(REOPENED_REFRESHES);
        }
    }

    /// Reopens cells along transparent rays: a surface of emptied cells would stay a hole.
    fn reopen_transparent_rays(&mut self) {
        if let Some(Field { current: ComparedMap { map, .. }, batch, shells: Some(_), .. }) =
            &mut self.field
        {
            for ray in batch.low_opacity_rays() {
                map.occupancy.reopen_along(&map.field, ray, REOPENED_RAY_REFRESHES);
            }
        }
    }

    /// Adds the cells of the last keyframe.
    fn mark_last_keyframe(&mut self, context: &MappingContext<'_>) {
        let (Some(field), Some(last)) = (&mut self.field, context.keyframes.last()) else { return };
        match &mut field.shells {
            Some(shells) => {
                mark_view(shells, &field.current.map, &self.camera, context, last);
                field.current.map.occupancy.restrict_to(shells);
            }
            None => self.confine(context),
        }
    }

    /// One step on random pixels of all `views`.
    fn step(&mut self, context: &mut MappingContext<'_>, views: &[Keyframe], weights: StepWeights) {
        let config = context.config;
        let curves = context.response_curves(views);
        let Some(field) = &mut self.field else { return };
        if self.steps.is_multiple_of(OCCUPANCY_INTERVAL) {
            let Field { current: ComparedMap { map, .. }, renderer, .. } = &mut *field;
            map.occupancy.refresh(&map.field, renderer, config.seed);
        }
        let samples =
            field.shells.as_ref().map_or(0, |_| config.parameters.keyframed.surface_samples);
        let limits = (config.hashgrid.rays, samples);
        let pixels = pixel_budget(limits, field.batch.samples_per_pixel()) / views.len().max(1);
        let observations = observations(views);
        let drawn: Vec<PixelBatch<'_>> = views
            .iter()
            .zip(&observations)
            .map(|(view, observation)| sample_pixels(context, (view, observation), &curves, pixels))
            .collect();
        let with_poses =
            weights.camera_rate > 0.0 && self.steps >= config.parameters.keyframed.pose_delay;
        if with_poses
            && config.formation.blur
            && config.keyframed.preconditioning != Preconditioning::Off
        {
            for (view, keyframe) in drawn.iter().zip(views) {
                field.update_preconditioner(context, &mut self.poses, view, keyframe.frame);
            }
        }
        let loss_weights = (config.parameters.field.image_weight, weights.depth_weight);
        let Field { current: ComparedMap { map, .. }, batch, gradient, adam, .. } = &mut *field;
        let evaluations =
            batch.map(map, &drawn, loss_weights, with_poses, context.random, gradient);
        for (view, index) in views.iter().zip(0..) {
            if let Some(depth) = batch.median_depth(index) {
                let estimate = &mut context.frames[view.frame];
                estimate.blur_length = blur_length_at_depth(context.camera, estimate, depth);
            }
        }
        let levels = map.field.settings().levels;
        gradient.keep_levels(
            &map.field,
            active_levels(self.steps, config.parameters.keyframed.coarse_steps, levels),
        );
        adam.step(&mut map.field, gradient, weights.field_rate);
        self.steps += 1;
        self.step_frames(context, views, evaluations, with_poses.then_some(weights.camera_rate));
    }

    /// Steps tone and poses of all `views`, and every response once.
    fn step_frames(
        &mut self,
        context: &mut MappingContext<'_>,
        views: &[Keyframe],
        evaluations: Vec<Evaluation>,
        camera_rate: Option<f32>,
    ) {
        let mut responses = ResponseGradients::default();
        let share = 1.0 / views.len().max(1) as f64;
        for (view, mut evaluation) in views.iter().zip(evaluations) {
            if let Some(d_curve) = evaluation.curve.take() {
                responses.add(context.frames[view.frame].response, d_curve);
            }
            let trajectory = self.trajectory.add(context, view, share, &mut evaluation);
            context.frames[view.frame].losses =
                Losses { image: evaluation.image, depth: evaluation.depth, trajectory };
            if context.config.formation.tone && view.frame != context.gauge_frame(view) {
                self.frames.step_tone(context, view.frame, &evaluation.tone);
            }
            if let Some(rate) = camera_rate {
                self.poses.step(context, view.frame, &evaluation.shutter, rate);
            }
        }
        self.trajectory.step_scale(context.config);
        self.frames.step_responses(context, responses);
    }
}

impl Mapper for JointFieldMapper {
    fn is_empty(&self) -> bool {
        self.field.is_none()
    }

    fn set_valid_mask(&mut self, valid_mask: Arc<Image<bool>>) {
        if let Some(field) = &mut self.field {
            field.current.objective.set_valid_mask(Arc::clone(&valid_mask));
        }
        self.valid_mask = Some(valid_mask);
    }

    fn track(
        &mut self,
        context: &TrackingContext<'_>,
        observation: &Observation,
        response: Option<&CameraResponse<f32>>,
        scale: TrajectoryScale<f64>,
    ) -> Option<TrackingResult> {
        Some(self.field.as_mut()?.current.track(context, observation, response, scale))
    }

    fn render(&mut self, world_from_camera: Pose<f64>) -> Option<Render> {
        Some(self.field.as_mut()?.current.render(world_from_camera))
    }

    /// Waits for the first few keyframes, then starts a field that holds what they see, and starts
    /// it again in a larger cube for a keyframe that sees farther.
    fn add(
        &mut self,
        context: &mut MappingContext<'_>,
        _current: &Keyframe,
    ) -> Result<Growth, SettingsError> {
        let first_keyframes = context.config.parameters.keyframed.first_keyframes;
        match &self.field {
            None if context.keyframes.len() < first_keyframes => Ok(Growth::Waiting),
            Some(field) if contains_last_view(field.current.map.field.settings(), context) => {
                self.mark_last_keyframe(context);
                Ok(Growth::Extended)
            }
            _ => self.start(context).map(|()| Growth::Started),
        }
    }

    fn refine(&mut self, context: &mut MappingContext<'_>, _current: &Keyframe, growth: Growth) {
        let settings = &context.config.hashgrid;
        let iterations = match growth {
            Growth::Started => settings.first_iterations,
            _ => settings.iterations,
        };
        let Schedule { camera_rate, depth_weight, .. } = self.schedule(context.config);
        let weights = StepWeights { field_rate: LEARNING_RATE, camera_rate, depth_weight };
        let budget = IterationBudget::start(context.config);
        for iteration in 0..iterations {
            if budget.is_exhausted(iteration, context.cancellation) {
                break;
            }
            let size = context.config.mapping.window;
            let window = recent_window(context.keyframes, None, size, context.random);
            self.step(context, &window, weights);
        }
    }

    fn plan_final(
        &mut self,
        context: &mut MappingContext<'_>,
    ) -> Result<FinalRefinement, SettingsError> {
        if self.field.is_none() {
            self.start(context)?;
        }
        let Schedule { steps, relocalizations, .. } = self.schedule(context.config);
        self.confine(context);
        Ok(FinalRefinement { steps, relocalizations })
    }

    fn refine_all(
        &mut self,
        context: &mut MappingContext<'_>,
        (steps, total): (Range<usize>, usize),
        on_step: OnStep<'_>,
    ) -> bool {
        let Schedule { camera_rate, depth_weight, final_depth_share, relocalizations, .. } =
            self.schedule(context.config);
        for step in steps {
            let size = context.config.mapping.window;
            let window = random_window(context.keyframes, size, context.random);
            let decayed = |rate| decayed_rate(rate, step as i32, total as i32);
            let done = step as f32 / total as f32;
            let weights = StepWeights {
                field_rate: decayed(LEARNING_RATE),
                camera_rate: decayed(camera_rate),
                depth_weight: depth_weight * final_depth_share.powf(done),
            };
            self.step(context, &window, weights);
            if relocalizations > 0 && REOPENING_PHASE.contains(&done) {
                self.reopen_transparent_rays();
            }
            if !on_step(context.taken((step + 1, total), &|| self.map())) {
                return false;
            }
        }
        true
    }

    /// Moves the shells with their keyframes, and reopens their cells.
    fn correct(&mut self, context: &MappingContext<'_>, _motions: &BTreeMap<usize, Pose<f64>>) {
        self.confine(context);
        self.reopen();
    }

    fn map(&self) -> Map {
        match &self.field {
            Some(field) => Map::HashGrid(Box::new(field.current.map.clone())),
            None => Map::default(),
        }
    }
}
