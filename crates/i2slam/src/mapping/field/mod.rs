//! Mapping with a radiance field in a hash grid.
//!
//! The field fills a cube around the first camera, sized by the first frame's depth. Rays are
//! sampled only in shells around observed surfaces, a dozen samples each. A frame that sees beyond
//! the cube starts a new field in a larger one, trained on the keyframes so far with poses and tone
//! fixed. With `hashgrid.bound` the cube keeps its size, and what lies outside is not mapped.

mod bounds;
mod shape;

pub(super) use bounds::{
    MIN_CUBE_GROWTH, chebyshev_distance, mark_cells, surface_distance, untrained_field,
};
pub(super) use shape::FieldShape;
pub(crate) use shape::largest_field;

use super::context::IterationBudget;
use super::context::{MappingContext, OnStep};
use super::depth_inpainting::placement_depth;
use super::frame_optimizer::{FrameOptimizers, ResponseGradients};
use super::keyframe::{Keyframe, observations};
use super::mapper::{ComparedMap, FinalRefinement, Growth, Mapper};
use super::window::{random_pixels, recent_window};
use crate::objective::{
    Evaluation, FrameObjective, FrameVariables, Observation, PixelBatch, RayObjective,
};
use crate::reconstruction::Map;
use crate::tracking::{TrackingContext, TrackingResult};
use crate::warning::Warning;
use i2slam_formation::{CameraResponse, Formation, ResponseCurve, TrajectoryScale};
use i2slam_geometry::{Camera, Image, Pose};
use i2slam_radiance::Render;
use i2slam_radiance::hashgrid::{
    FieldAdam, FieldGradient, FieldSettings, HashGridMap, SettingsError, decayed_rate,
};
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

/// Learning rate of a field (torch-ngp).
pub(super) const LEARNING_RATE: f32 = 1e-2;
/// λ_depth of measured depth, a mean over pixels.
pub(super) const DEPTH_WEIGHT: f32 = 1.0;
/// Largest share of a frame's pixels whose surface may lie outside of the cube.
const MAX_SHARE_OUTSIDE: f64 = 0.02;

/// A radiance field that is trained on tracked frames.
pub(crate) struct FieldMapper {
    camera: Camera<f32>,
    valid_mask: Option<Arc<Image<bool>>>,
    /// `None` until the first frame has sized the cube.
    field: Option<Field>,
    frames: FrameOptimizers,
    /// Steps of the field that a larger one has replaced since the last frame.
    lost_steps: usize,
    /// Whether the warning of surfaces outside was given.
    warned: bool,
}

/// A field with the state of its training.
struct Field {
    current: ComparedMap<HashGridMap>,
    batch: RayObjective,
    gradient: FieldGradient,
    adam: FieldAdam,
    /// Number of steps so far.
    steps: usize,
}

impl Field {
    fn new(map: HashGridMap, camera: Camera<f32>) -> Self {
        Self {
            batch: RayObjective::new(camera, map.march),
            gradient: FieldGradient::zeros(&map.field),
            adam: FieldAdam::new(),
            steps: 0,
            current: ComparedMap { objective: FrameObjective::new(camera, map.march), map },
        }
    }

    /// Replaces the map by an untrained one.
    fn replace(&mut self, map: HashGridMap) {
        self.gradient = FieldGradient::zeros(&map.field);
        self.adam = FieldAdam::new();
        // The objective renders with the march of the first map.
        self.current.map = HashGridMap { march: self.current.map.march, ..map };
    }
}

impl FieldMapper {
    pub(crate) fn new(camera: &Camera<f64>) -> Self {
        Self {
            camera: camera.cast(),
            valid_mask: None,
            field: None,
            frames: FrameOptimizers::default(),
            lost_steps: 0,
            warned: false,
        }
    }

    /// Starts a field in a cube around the camera that holds the frame's depth and a margin.
    fn start(
        &mut self,
        context: &mut MappingContext<'_>,
        pose: Pose<f64>,
        depth: &Image<f32>,
    ) -> Result<(), SettingsError> {
        let config = context.config;
        let shape = FieldShape::new(config);
        let bound = bounds::initial_bound(config, context.camera, depth);
        let map = untrained_field(&shape, pose.translation.to_array(), bound, config.seed)?;
        let field = self.field.insert(Field::new(map, self.camera));
        field.batch.set_time_jitter(config.parameters.field.moment_jitter);
        if let Some(valid_mask) = &self.valid_mask {
            field.current.objective.set_valid_mask(Arc::clone(valid_mask));
        }
        Ok(())
    }

    /// Replaces the field by an untrained one in a cube of half edge `bound` [m], and marks the
    /// cells of all keyframes.
    fn grow(&mut self, context: &mut MappingContext<'_>, bound: f64) {
        let (shape, seed) = (FieldShape::new(context.config), context.config.seed);
        let Some(field) = &mut self.field else { return };
        // The same settings were valid before.
        let centre = field.current.map.field.settings().centre;
        let Ok(map) = bounds::untrained_field(&shape, centre, bound, seed) else { return };
        self.lost_steps += std::mem::take(&mut field.steps);
        field.replace(map);
        for keyframe in context.keyframes {
            let depth = placement_depth(
                &keyframe.observation.get(),
                context.config.mapping.fill_depth,
                context.valid_mask,
                None,
            );
            self.mark_surfaces(context, context.frames[keyframe.frame].depth_pose(), &depth);
        }
    }

    fn mark_surfaces(&mut self, context: &MappingContext<'_>, pose: Pose<f64>, depth: &Image<f32>) {
        let Some(Field { current, .. }) = &mut self.field else { return };
        let shell = context.config.parameters.field.shell;
        let HashGridMap { field, occupancy, .. } = &mut current.map;
        let range = |_, d| (d * (1.0 - shell), d * (1.0 + shell));
        mark_cells(occupancy, field, (&self.camera, pose), depth, range);
    }

    /// Grows the cube to hold the surfaces of a frame, or warns where its size is set.
    fn ensure_enclosed(
        &mut self,
        context: &mut MappingContext<'_>,
        frame: usize,
        pose: Pose<f64>,
        depth: &Image<f32>,
    ) {
        let Some(Field { current: ComparedMap { map, .. }, .. }) = &self.field else { return };
        let FieldSettings { centre, bound, .. } = *map.field.settings();
        let share = bounds::share_outside(map.field.settings(), context.camera, pose, depth);
        if share <= MAX_SHARE_OUTSIDE {
            return;
        }
        let settings = &context.config.hashgrid;
        if settings.bound == 0.0 {
            let required_extent = f64::from(context.config.parameters.field.margin)
                * bounds::required_extent(centre, context.camera, pose, depth);
            self.grow(context, required_extent.max(bounds::MIN_CUBE_GROWTH * bound));
        } else if !self.warned {
            self.warned = true;
            let outside = format!(
                "{:.0} % of its surfaces lie outside of the field's cube (±{bound:.1} m around the \
                 first camera) and are not mapped: without hashgrid.bound the cube grows",
                100.0 * share
            );
            context.warnings.push(Warning::of_frame(context.frames[frame].index, outside));
        }
    }

    /// One step on random pixels of all `views`, of the field `alone` or with tone.
    fn step(
        &mut self,
        context: &mut MappingContext<'_>,
        views: &[Keyframe],
        rate: f32,
        alone: bool,
    ) {
        let config = context.config;
        let curves = context.response_curves(views);
        let rays = config.hashgrid.rays / views.len().max(1);
        let observations = observations(views);
        let drawn: Vec<PixelBatch<'_>> = views
            .iter()
            .zip(&observations)
            .map(|(view, observation)| sample_rays(context, (view, observation), &curves, rays))
            .collect();
        let Some(field) = &mut self.field else { return };
        let evaluations = field.batch.map(
            &field.current.map,
            &drawn,
            (config.parameters.field.image_weight, DEPTH_WEIGHT),
            false,
            context.random,
            &mut field.gradient,
        );
        field.adam.step(&mut field.current.map.field, &mut field.gradient, rate);
        field.steps += 1;
        if !alone {
            self.step_frames(context, views, evaluations);
        }
    }

    /// Steps the tone of all `views`, and every response once.
    fn step_frames(
        &mut self,
        context: &mut MappingContext<'_>,
        views: &[Keyframe],
        evaluations: Vec<Evaluation>,
    ) {
        let mut responses = ResponseGradients::default();
        for (view, mut evaluation) in views.iter().zip(evaluations) {
            if let Some(d_curve) = evaluation.curve.take() {
                responses.add(context.frames[view.frame].response, d_curve);
            }
            if context.config.formation.tone && view.frame != context.gauge_frame(view) {
                self.frames.step_tone(context, view.frame, &evaluation.tone);
            }
        }
        self.frames.step_responses(context, responses);
    }
}

/// Rays of a keyframe for about `rays` rays in all: random pixels, a ray per virtual camera.
fn sample_rays<'a, 'c: 'a>(
    context: &mut MappingContext<'c>,
    (keyframe, observation): (&Keyframe, &'a Observation),
    curves: &'a BTreeMap<usize, ResponseCurve<f32>>,
    rays: usize,
) -> PixelBatch<'a> {
    let estimate = &context.frames[keyframe.frame];
    let mut exposure = context.exposure(keyframe.frame, observation);
    // Every virtual camera costs a render per ray: no more of them than configured.
    let cameras = &mut exposure.sampling.virtual_cameras;
    *cameras = (*cameras).min(context.config.formation.virtual_cameras);
    let curve = curves.get(&estimate.response);
    let tone =
        curve.map(|curve| Formation { tone: estimate.tone, curve, vignetting: context.vignetting });
    let variables = FrameVariables { exposure, tone };
    let mut view = PixelBatch { observation, variables, pixels: Vec::new() };
    let count = (rays / view.rays_per_pixel()).max(1);
    let size = observation.depth.pixels();
    view.pixels = random_pixels(size, count, context.valid_mask, context.random);
    view
}

impl Mapper for FieldMapper {
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

    fn add(
        &mut self,
        context: &mut MappingContext<'_>,
        current: &Keyframe,
    ) -> Result<Growth, SettingsError> {
        let depth = placement_depth(
            &current.observation.get(),
            context.config.mapping.fill_depth,
            context.valid_mask,
            None,
        );
        let pose = context.frames[current.frame].depth_pose();
        let growth = if self.field.is_none() { Growth::Started } else { Growth::Extended };
        if growth == Growth::Started {
            self.start(context, pose, &depth)?;
        }
        self.ensure_enclosed(context, current.frame, pose, &depth);
        self.mark_surfaces(context, pose, &depth);
        Ok(growth)
    }

    fn refine(&mut self, context: &mut MappingContext<'_>, current: &Keyframe, growth: Growth) {
        let settings = &context.config.hashgrid;
        let lost = std::mem::take(&mut self.lost_steps);
        let steps = match growth {
            Growth::Started => settings.first_iterations,
            _ => settings.iterations,
        };
        let budget = IterationBudget::start(context.config);
        for iteration in 0..lost + steps {
            if budget.is_exhausted(iteration, context.cancellation) {
                break;
            }
            let size = context.config.mapping.window;
            let window = recent_window(context.keyframes, Some(current), size, context.random);
            self.step(context, &window, LEARNING_RATE, iteration < lost);
        }
    }

    fn plan_final(
        &mut self,
        context: &mut MappingContext<'_>,
    ) -> Result<FinalRefinement, SettingsError> {
        let steps = context.config.hashgrid.final_iterations;
        Ok(FinalRefinement { steps, relocalizations: 0 })
    }

    fn refine_all(
        &mut self,
        context: &mut MappingContext<'_>,
        (steps, total): (Range<usize>, usize),
        on_step: OnStep<'_>,
    ) -> bool {
        let mut order: Vec<usize> = (0..context.keyframes.len()).collect();
        for step in steps {
            context.random.shuffle(&mut order);
            let chosen = order.iter().take(context.config.mapping.window);
            let window: Vec<Keyframe> = chosen.map(|&k| context.keyframes[k].clone()).collect();
            let rate = decayed_rate(LEARNING_RATE, step as i32, total as i32);
            self.step(context, &window, rate, false);
            if !on_step(context.taken((step + 1, total), &|| self.map())) {
                return false;
            }
        }
        true
    }

    fn map(&self) -> Map {
        match &self.field {
            Some(field) => Map::HashGrid(Box::new(field.current.map.clone())),
            None => Map::default(),
        }
    }
}
