//! Mapping with 3D Gaussians.

mod anchors;
mod density_control;
mod detail_evidence;
mod explained_error;
mod flat_gaussians;
mod merge;
mod optimizer;
mod partition;
mod picture_noise;
mod scale_bounds;
mod splitting;
mod view_dependence;
mod visibility;

use super::context::IterationBudget;
use super::context::{MappingContext, OnStep};
use super::depth_inpainting::placement_depth;
use super::keyframe::Keyframe;
use super::mapper::{ComparedMap, FinalRefinement, Growth, Mapper};
use super::window::overlapping_window;
use crate::config::Config;
use crate::objective::{FrameObjective, FrameVariables, Observation};
use crate::reconstruction::Map;
use crate::tracking::{TrackingContext, TrackingResult};
use anchors::Anchors;
use density_control::{
    SourceFrame, SurfaceVotes, max_scale, open_pixels, outside_surface, push_balls,
    unexplained_pixels, worth_keeping,
};
use detail_evidence::DetailEvidence;
use explained_error::{ExplainedError, PRUNE_PASSES, PredictionError, spread_frames};
use flat_gaussians::{partition, push_flat_gaussians};
use i2slam_formation::{CameraResponse, CentreVelocity, ResponseCurve, TrajectoryScale};
use i2slam_geometry::{Camera, Image, Pose};
use i2slam_radiance::Render;
use i2slam_radiance::gaussian::{ColourActivation, GaussianMap, RasterSettings, Shape};
use i2slam_radiance::hashgrid::SettingsError;
use merge::merge;
use optimizer::{GaussianOptimizer, StepScale, final_rate_share};
use scale_bounds::ScaleBounds;
use splitting::split_gaussians;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::Arc;
use view_dependence::ViewDependence;

/// Share of the capacity to which a full map is merged.
const MERGED_SHARE: f64 = 0.9;
/// Iteration at which SplaTAM prunes, besides the first.
const PRUNE_ITERATION: usize = 20;

/// A map of Gaussians that grows with the frames.
pub(crate) struct GaussianMapper {
    current: ComparedMap<GaussianMap>,
    optimizer: GaussianOptimizer,
    anchors: Anchors,
    scale_bounds: ScaleBounds,
    /// Standard deviation above which a Gaussian is removed [m].
    max_scale: f32,
    /// Whether the warning of a full map was given.
    is_full: bool,
    /// Keyframes whose turn is still to come in the final steps.
    order: Vec<usize>,
}

/// An empty map: log-radiance, or SplaTAM's raw colours with `tone` off.
fn empty_map(config: &Config) -> GaussianMap {
    let shape = if config.map.isotropic { Shape::Isotropic } else { Shape::Anisotropic };
    let activation = match config.formation.tone {
        true => ColourActivation::Exponential,
        false => ColourActivation::Linear,
    };
    GaussianMap::new(shape, activation)
}

impl GaussianMapper {
    /// Relocalisations of all keyframes during the final optimisation, where poses are refined.
    pub(crate) const RELOCALIZATIONS: usize = 2;

    pub(crate) fn new(config: &Config, camera: &Camera<f64>) -> Self {
        Self {
            current: ComparedMap {
                map: empty_map(config),
                objective: FrameObjective::new(camera.cast(), RasterSettings::default()),
            },
            optimizer: GaussianOptimizer::new(),
            anchors: Anchors::default(),
            scale_bounds: ScaleBounds::default(),
            max_scale: f32::INFINITY,
            is_full: false,
            order: Vec::new(),
        }
    }

    /// One step on a keyframe, with that share of the learning rates.
    fn step(&mut self, context: &mut MappingContext<'_>, keyframe: &Keyframe, share: f32) {
        let observation = keyframe.observation.get();
        let scale = StepScale { bounds: &self.scale_bounds, share };
        self.optimizer.step(context, &mut self.current, (keyframe, &observation), scale);
        self.scale_bounds.clamp(&mut self.current.map);
    }

    fn prune(&mut self) {
        let keep = worth_keeping(&self.current.map, self.max_scale);
        self.retain(&keep);
    }

    /// Removes flat Gaussians that explain too little of the pictures.
    fn prune_by_explained_error(&mut self, context: &MappingContext<'_>) {
        if self.current.map.shape == Shape::Isotropic {
            return;
        }
        let is_running = || !context.cancellation.is_cancelled();
        let mut error = PredictionError::default();
        for keyframe in context.keyframes.iter().take_while(|_| is_running()) {
            let observation = keyframe.observation.get();
            let curve = response_curve(context, keyframe.frame);
            let prediction = self.predict(context, (keyframe, &observation), curve.as_ref());
            error.add(&prediction, &observation.colour, context.valid_mask);
        }
        let is_between = |place: &usize| context.is_between_keyframes(*place);
        let between = Vec::from_iter((0..context.frames.len()).filter(is_between));
        let keyframes = context.keyframes.iter().map(|keyframe| keyframe.frame);
        let others = spread_frames(&between, context.keyframes.len()).copied();
        let (places, tolerance) = (Vec::from_iter(keyframes.chain(others)), error.tolerance());
        for _ in 0..PRUNE_PASSES {
            let mut explained = ExplainedError::new(&self.current.map, tolerance);
            for &place in places.iter().take_while(|_| is_running()) {
                let curve = response_curve(context, place);
                let tone = curve.as_ref().map(|curve| context.formation(place, curve));
                let view = (context.camera, context.frames[place].middle());
                explained.add(view, tone.as_ref(), context.valid_mask);
            }
            // What not all pictures were asked about may explain the others.
            if is_running() {
                self.retain(&explained.keep());
            }
        }
    }

    /// Gives a view colour to the Gaussians whose colour depends on the direction.
    fn add_view_colours(&mut self, context: &MappingContext<'_>) {
        let mut dependence = ViewDependence::new(self.current.map.len());
        for keyframe in context.keyframes {
            let observation = keyframe.observation.get();
            let origin = context.frames[keyframe.frame].middle().translation.cast();
            let view = (keyframe, &*observation);
            let gradient = self.optimizer.gradient(context, &mut self.current, view);
            dependence.add(&self.current.map, gradient, origin);
        }
        self.current.map.view_colours = dependence.view_colours();
        self.optimizer.forget_view_colours();
    }

    /// Removes Gaussians, with their optimiser state, anchors and least sizes.
    fn retain(&mut self, keep: &[bool]) {
        if !keep.contains(&false) {
            return;
        }
        self.optimizer.retain(keep, &self.current.map.view_colours);
        self.current.map.retain(keep);
        self.anchors.retain(keep);
        self.scale_bounds.retain(keep);
    }

    /// The map at the pose of a keyframe's depth picture.
    fn render_at_depth(&mut self, context: &MappingContext<'_>, keyframe: &Keyframe) -> Render {
        let pose = context.frames[keyframe.frame].depth_pose();
        self.current.objective.render(&self.current.map, pose).clone()
    }

    /// The picture of a keyframe as the map predicts it.
    fn predict(
        &mut self,
        context: &MappingContext<'_>,
        (keyframe, observation): (&Keyframe, &Observation),
        curve: Option<&ResponseCurve<f32>>,
    ) -> Image<f32> {
        let variables = FrameVariables {
            exposure: context.exposure(keyframe.frame, observation),
            tone: curve.map(|curve| context.formation(keyframe.frame, curve)),
        };
        let ComparedMap { map, objective } = &mut self.current;
        objective.predict(map, &variables).clone()
    }

    /// The evidence of all keyframes for detail within the Gaussians.
    fn detail_evidence(&mut self, context: &MappingContext<'_>) -> DetailEvidence {
        let mut evidence = DetailEvidence::new(&self.current.map, &self.scale_bounds);
        let parts = evidence.map_in_parts(&self.current.map);
        let whole = std::mem::replace(&mut self.current.map, parts);
        let keyframes = context.keyframes.iter();
        for keyframe in keyframes.take_while(|_| !context.cancellation.is_cancelled()) {
            let observation = keyframe.observation.get();
            let view = (keyframe, &*observation);
            evidence.add(self.optimizer.gradient(context, &mut self.current, view));
        }
        self.current.map = whole;
        self.optimizer.release_gradient();
        evidence
    }

    /// Splits flat Gaussians that are larger than a keyframe asks for where it is not predicted.
    fn split(
        &mut self,
        context: &MappingContext<'_>,
        keyframe: &Keyframe,
        evidence: &mut DetailEvidence,
    ) {
        let render = self.render_at_depth(context, keyframe);
        let (observation, curve) =
            (keyframe.observation.get(), response_curve(context, keyframe.frame));
        let prediction = self.predict(context, (keyframe, &observation), curve.as_ref());
        let source = source_frame(context, keyframe, &observation, curve.as_ref(), Some(&render));
        let (map, bounds) = (&mut self.current.map, &mut self.scale_bounds);
        source.surface(&render).lower_bounds(map, bounds);
        let views = (&render, &prediction);
        let origins = split_gaussians(map, bounds, &source, views, &partition(&source), evidence);
        evidence.inherit(&origins);
        self.anchors.inherit(&origins);
    }

    /// Adds Gaussians where a keyframe sees more than the map, but not at `closed` pixels.
    fn extend(&mut self, context: &mut MappingContext<'_>, current: &Keyframe, closed: &[bool]) {
        let parameters = &context.config.parameters.gaussians;
        let render = (!self.is_empty()).then(|| self.render_at_depth(context, current));
        let (observation, curve) =
            (current.observation.get(), response_curve(context, current.frame));
        let source = source_frame(context, current, &observation, curve.as_ref(), render.as_ref());
        let mut wanted = match &render {
            Some(render) => unexplained_pixels(self.current.map.shape, &source, render),
            None => {
                let farthest = observation.depth.data.iter().copied().fold(0.0, f32::max);
                self.max_scale =
                    max_scale(self.current.map.shape, parameters, context.camera, farthest);
                vec![true; observation.depth.data.len()]
            }
        };
        wanted.iter_mut().zip(closed).for_each(|(wanted, closed)| *wanted &= !closed);
        if !current.fills_depth {
            let readings = wanted.iter_mut().zip(&observation.depth.data);
            readings.for_each(|(wanted, depth)| *wanted &= *depth > 0.0);
        }
        let is_keyframe = context.is_keyframe(current.frame);
        let map = &mut self.current.map;
        match map.shape {
            Shape::Isotropic => push_balls(map, parameters, &source, &wanted),
            Shape::Anisotropic => {
                let (rectangles, bounds) =
                    (partition(&source).rectangles(&wanted), &mut self.scale_bounds);
                if let Some(render) = render.as_ref().filter(|_| is_keyframe) {
                    source.surface(render).lower_bounds(map, bounds);
                }
                push_flat_gaussians(map, bounds, parameters, &source, &rectangles);
            }
        }
        self.anchors.extend_to(self.current.map.len(), context.frames[current.frame].index);
        self.enforce_capacity(context);
    }

    /// Merges Gaussians of a map beyond its capacity, with room for the next frames.
    fn enforce_capacity(&mut self, context: &mut MappingContext<'_>) {
        let capacity = context.config.map.capacity;
        if self.current.map.len() <= capacity {
            return;
        }
        let target = (MERGED_SHARE * capacity as f64) as usize;
        let keep = merge(&mut self.current.map, target..=capacity);
        self.retain(&keep);
        self.scale_bounds.include(&self.current.map);
        if !self.is_full {
            self.is_full = true;
            let warning = format!(
                "the map is full: from now on similar neighbours are merged to keep it at \
                 {capacity} Gaussians; map.capacity sets the limit"
            );
            context.warnings.push(warning.into());
        }
    }
}

/// Response curve of a frame; none with `tone` off.
fn response_curve(context: &MappingContext<'_>, frame: usize) -> Option<ResponseCurve<f32>> {
    let response = context.frames[frame].response;
    context.config.formation.tone.then(|| context.responses[response].curve())
}

/// A keyframe as a source of Gaussians.
fn source_frame<'a>(
    context: &'a MappingContext<'_>,
    keyframe: &Keyframe,
    observation: &'a Observation,
    curve: Option<&'a ResponseCurve<f32>>,
    render: Option<&Render>,
) -> SourceFrame<'a> {
    let estimate = &context.frames[keyframe.frame];
    // A surface without a reading may have one in the next frames: keyframes alone guess it.
    let is_filled = context.config.mapping.fill_depth && context.is_keyframe(keyframe.frame);
    SourceFrame {
        camera: context.camera,
        world_from_depth: estimate.depth_pose(),
        colour_from_depth: estimate.middle().inverse() * estimate.depth_pose(),
        velocity: CentreVelocity::from(estimate.shutter).velocity,
        readout: estimate.readout,
        observation,
        depth: placement_depth(observation, is_filled, context.valid_mask, render),
        tone: curve.map(|curve| context.formation(keyframe.frame, curve)),
    }
}

impl Mapper for GaussianMapper {
    fn is_empty(&self) -> bool {
        self.current.map.is_empty()
    }

    fn gaussians(&self) -> usize {
        self.current.map.len()
    }

    fn set_valid_mask(&mut self, valid_mask: Arc<Image<bool>>) {
        self.current.objective.set_valid_mask(valid_mask);
    }

    fn track(
        &mut self,
        context: &TrackingContext<'_>,
        observation: &Observation,
        response: Option<&CameraResponse<f32>>,
        scale: TrajectoryScale<f64>,
    ) -> Option<TrackingResult> {
        (!self.is_empty()).then(|| self.current.track(context, observation, response, scale))
    }

    fn render(&mut self, world_from_camera: Pose<f64>) -> Option<Render> {
        (!self.is_empty()).then(|| self.current.render(world_from_camera))
    }

    fn add(
        &mut self,
        context: &mut MappingContext<'_>,
        current: &Keyframe,
    ) -> Result<Growth, SettingsError> {
        let growth = if self.is_empty() { Growth::Started } else { Growth::Extended };
        self.extend(context, current, &[]);
        Ok(growth)
    }

    fn refine(&mut self, context: &mut MappingContext<'_>, current: &Keyframe, growth: Growth) {
        let mapping = &context.config.mapping;
        let iterations = match growth {
            Growth::Started => mapping.first_iterations,
            _ => mapping.iterations,
        };
        let fresh = context.config.parameters.gaussians.reset_adam;
        if fresh {
            self.optimizer.reset();
        }
        let window = overlapping_window(
            context.keyframes,
            current,
            context.frames,
            context.camera,
            mapping.window,
            context.random,
        );
        let budget = IterationBudget::start(context.config);
        for iteration in 0..iterations {
            if budget.is_exhausted(iteration, context.cancellation) {
                break;
            }
            let chosen = &window[context.random.below(window.len())];
            self.step(context, chosen, 1.0);
            if fresh && (iteration == 0 || iteration == PRUNE_ITERATION) {
                self.prune();
            }
        }
        if !fresh {
            self.prune();
        }
    }

    fn plan_final(
        &mut self,
        context: &mut MappingContext<'_>,
    ) -> Result<FinalRefinement, SettingsError> {
        let steps = context.config.mapping.final_steps(context.keyframes.len());
        Ok(FinalRefinement { steps, relocalizations: Self::RELOCALIZATIONS })
    }

    /// Steps over all keyframes in random order, each equally often, then prunes. First, flat Gaussians
    /// that explain too little are removed, and the others are split where at least a third of all
    /// steps is left to fit the parts. View colours begin with the second part, when exposures have
    /// settled, which they would explain otherwise.
    fn refine_all(
        &mut self,
        context: &mut MappingContext<'_>,
        (steps, total): (Range<usize>, usize),
        on_step: OnStep<'_>,
    ) -> bool {
        let splits = 3 * steps.start < 2 * total;
        if !steps.is_empty() {
            self.prune_by_explained_error(context);
        }
        if splits && self.current.map.shape == Shape::Anisotropic {
            let mut evidence = self.detail_evidence(context);
            for keyframe in context.keyframes {
                self.split(context, keyframe, &mut evidence);
            }
            self.enforce_capacity(context);
            if context.config.map.view_dependent && steps.start > 0 {
                self.add_view_colours(context);
            }
        }
        let mut continues = true;
        if steps.start == 0 {
            self.order.clear();
        }
        for step in steps {
            if self.order.is_empty() {
                self.order = (0..context.keyframes.len()).collect();
                context.random.shuffle(&mut self.order);
            }
            let Some(next) = self.order.pop() else { break };
            let keyframe = context.keyframes[next].clone();
            let share = match self.current.map.shape {
                Shape::Isotropic => 1.0,
                Shape::Anisotropic => final_rate_share(step, total),
            };
            self.step(context, &keyframe, share);
            continues = on_step(context.taken((step + 1, total), &|| self.map()));
            if !continues {
                break;
            }
        }
        self.prune();
        continues
    }

    fn correct(&mut self, _context: &MappingContext<'_>, motions: &BTreeMap<usize, Pose<f64>>) {
        self.anchors.apply_motions(motions, &mut self.current.map, &mut self.optimizer);
    }

    fn forget(&mut self, frames: &BTreeSet<usize>) {
        let keep = self.anchors.outside(frames);
        self.retain(&keep);
    }

    fn replace_surface(
        &mut self,
        context: &mut MappingContext<'_>,
        keyframe: &Keyframe,
        depth: &Image<f32>,
    ) {
        let camera_from_world = context.frames[keyframe.frame].depth_pose().inverse();
        let observation = keyframe.observation.get();
        let (map, depths) = (&self.current.map, [depth, &*observation.depth]);
        let keep = outside_surface(map, context.camera, camera_from_world, depths);
        if !keep.contains(&false) {
            return;
        }
        let was_open = open_pixels(map.shape, &self.render_at_depth(context, keyframe));
        self.retain(&keep);
        self.extend(context, keyframe, &was_open);
    }

    fn remove_contradicted(&mut self, context: &MappingContext<'_>) {
        let mut votes = SurfaceVotes::new(self.current.map.len());
        for keyframe in context.keyframes {
            let camera_from_world = context.frames[keyframe.frame].depth_pose().inverse();
            let observation = keyframe.observation.get();
            let view = (context.camera, camera_from_world, &*observation.depth);
            votes.add(&self.current.map, view);
        }
        let keep = votes.keep();
        self.retain(&keep);
    }

    fn change_radiance(
        &mut self,
        context: &MappingContext<'_>,
        change: &dyn Fn(usize, [f32; 3]) -> [f32; 3],
        stretch: f32,
    ) -> bool {
        let frames = context.frames.iter().enumerate();
        let places = frames.map(|(place, frame)| (frame.index, place)).collect();
        self.anchors.change_colours(&places, &mut self.current.map, change);
        let by_direction = self.current.map.view_colours.coefficients_mut();
        by_direction.iter_mut().flatten().for_each(|value| *value *= stretch);
        self.optimizer.forget_tone();
        true
    }

    fn map(&self) -> Map {
        Map::Gaussians(self.current.map.clone())
    }
}
