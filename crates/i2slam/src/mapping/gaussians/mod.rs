//! Mapping with Gaussians: adding, refining, pruning.

mod density_control;
mod merge;
mod optimizer;

use super::depth_inpainting::placement_depth;
use super::iteration_budget::IterationBudget;
use super::keyframe::Keyframe;
use super::map_snapshot::{MapSnapshot, Tracker};
use super::mapper::{Mapper, MappingContext};
use super::window::select_window;
use crate::config::Config;
use crate::objective::{FrameObjective, Observation, Tone};
use crate::reconstruction::Map;
use crate::tracking::{TrackingContext, TrackingResult, sampling, track};
use density_control::{SceneScale, Source, add_gaussians, prune, seed_map};
use i2slam_formation::{CameraResponse, CentreVelocity, TrajectoryScale};
use i2slam_geometry::{Camera, Image};
use i2slam_radiance::gaussian::{ColourActivation, GaussianMap, RasterSettings, Shape};
use merge::merge;
use optimizer::MapOptimizer;
use std::sync::Arc;

/// Share of the capacity that is left when a full map was merged.
const ROOMY: f64 = 0.9;
/// SplaTAM prunes at this step of a round, beside the first.
const PRUNE_STEP: usize = 20;

/// A map of Gaussians that grows with the frames.
pub(crate) struct GaussianMapper {
    map: GaussianMap,
    objective: FrameObjective<GaussianMap>,
    optimizer: MapOptimizer,
    scene: SceneScale,
    full: bool,
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
    /// An empty map for frames of `camera`.
    pub(crate) fn new(config: &Config, camera: &Camera<f64>) -> Self {
        Self {
            map: empty_map(config),
            objective: FrameObjective::new(camera.cast(), RasterSettings::default()),
            optimizer: MapOptimizer::new(),
            scene: SceneScale { radius: f32::INFINITY },
            full: false,
        }
    }

    /// The map and what draws it.
    pub(super) fn scene(&mut self) -> (&GaussianMap, &mut FrameObjective<GaussianMap>) {
        (&self.map, &mut self.objective)
    }

    /// Steps over all keyframes in random order, each as often as the others, then prunes;
    /// `on_step(done)` says whether to go on. Returns whether it did.
    pub(super) fn refine_all(
        &mut self,
        context: &mut MappingContext<'_>,
        steps: usize,
        on_step: &mut dyn FnMut(usize) -> bool,
    ) -> bool {
        let (mut order, mut goes_on): (Vec<usize>, bool) = (Vec::new(), true);
        for step in 0..steps {
            if order.is_empty() {
                order = (0..context.keyframes.len()).collect();
                context.random.shuffle(&mut order);
            }
            let Some(next) = order.pop() else { break };
            let keyframe = context.keyframes[next].clone();
            self.step(context, &keyframe);
            goes_on = on_step(step + 1);
            if !goes_on {
                break;
            }
        }
        self.prune();
        goes_on
    }

    fn step(&mut self, context: &mut MappingContext<'_>, keyframe: &Keyframe) {
        let estimate = &context.frames[keyframe.frame];
        let exposed = (estimate.shutter, estimate.readout);
        let formation = &context.config.formation;
        let sampling = sampling(formation, context.camera, exposed, &keyframe.observation);
        let scene = (&mut self.map, &mut self.objective);
        self.optimizer.step(context, scene, keyframe, sampling);
    }

    fn prune(&mut self) {
        let keep = prune(&mut self.map, self.scene);
        if keep.contains(&false) {
            self.optimizer.retain(&keep);
        }
    }

    /// Keeps the map within its capacity, and then with some room for the next frames.
    fn make_room(&mut self, context: &mut MappingContext<'_>) {
        let capacity = context.config.map.capacity;
        if self.map.len() <= capacity {
            return;
        }
        let aim = (ROOMY * capacity as f64) as usize;
        let keep = merge(&mut self.map, aim..=capacity);
        self.optimizer.retain(&keep);
        if !self.full {
            self.full = true;
            let full = format!(
                "the map is full: from now on similar neighbours are merged to keep it at \
                 {capacity} Gaussians; map.capacity sets the limit"
            );
            context.warnings.push(full.into());
        }
    }
}

impl Tracker for GaussianMapper {
    fn track(
        &mut self,
        context: &TrackingContext<'_>,
        observation: &Observation,
        response: Option<&CameraResponse<f32>>,
        scale: TrajectoryScale<f64>,
    ) -> TrackingResult {
        track(context, &mut self.objective, &self.map, observation, response, scale)
    }
}

impl Mapper for GaussianMapper {
    fn is_empty(&self) -> bool {
        self.map.is_empty()
    }

    fn gaussians(&self) -> usize {
        self.map.len()
    }

    fn set_covered(&mut self, covered: Arc<Image<bool>>) {
        self.objective.set_covered(covered);
    }

    fn snapshot(
        &self,
        camera: &Camera<f64>,
        covered: Option<Arc<Image<bool>>>,
        last: Option<Box<dyn Tracker>>,
    ) -> Option<Box<dyn Tracker>> {
        let objective = || FrameObjective::new(camera.cast(), RasterSettings::default());
        (!self.map.is_empty()).then(|| MapSnapshot::update(last, &self.map, covered, objective))
    }

    fn add(&mut self, context: &mut MappingContext<'_>, current: &Keyframe) {
        let config = context.config;
        let estimate = &context.frames[current.frame];
        let curve = config.formation.tone.then(|| context.responses[estimate.response].curve());
        let render = (!self.map.is_empty())
            .then(|| self.objective.render(&self.map, estimate.depth_pose()).clone());
        let (parameters, observation) = (&config.parameters.gaussians, &current.observation);
        let source = Source {
            camera: context.camera,
            world_from_depth: estimate.depth_pose(),
            colour_from_depth: estimate.middle().inverse() * estimate.depth_pose(),
            velocity: CentreVelocity::from(estimate.shutter).velocity,
            readout: estimate.readout,
            observation,
            depth: placement_depth(observation, &config.mapping, context.covered, render.as_ref()),
            tone: curve.as_ref().map(|curve| Tone { frame: estimate.tone, curve }),
        };
        if let Some(render) = &render {
            add_gaussians(&mut self.map, parameters, &source, render);
        } else {
            self.scene = SceneScale::new(observation, parameters.scene_radius_ratio);
            seed_map(&mut self.map, parameters, &source);
        }
        self.make_room(context);
    }

    fn refine(&mut self, context: &mut MappingContext<'_>, current: &Keyframe, first: bool) {
        let mapping = &context.config.mapping;
        let iterations = if first { mapping.first_iterations } else { mapping.iterations };
        let fresh = context.config.parameters.gaussians.reset_adam;
        if fresh {
            self.optimizer.reset();
        }
        let window = select_window(
            context.keyframes,
            current,
            context.frames,
            context.camera,
            mapping.window,
            context.random,
        );
        let round = IterationBudget::begin(context.config);
        for iteration in 0..iterations {
            if round.is_over(iteration, context.cancellation) {
                break;
            }
            let chosen = &window[context.random.below(window.len())];
            self.step(context, chosen);
            if fresh && (iteration == 0 || iteration == PRUNE_STEP) {
                self.prune();
            }
        }
        if !fresh {
            self.prune();
        }
    }

    fn finish(
        &mut self,
        context: &mut MappingContext<'_>,
        on_step: &mut dyn FnMut(usize, usize) -> bool,
    ) {
        let steps = context.config.mapping.final_iterations;
        self.refine_all(context, steps, &mut |step| on_step(step, steps));
    }

    fn map(&self) -> Map {
        Map::Gaussians(self.map.clone())
    }
}
