//! Mapping with Gaussians: adding, refining, pruning.

use super::densify::{SceneScale, Source, add_gaussians, placement, prune, seed_map};
use super::merge::merge;
use super::round::Round;
use super::{Follower, Keyframe, MapOptimizer, Mapper, Story, Tracker, select_window};
use crate::config::Config;
use crate::objective::{FrameObjective, Observation, Tone};
use crate::reconstruction::Map;
use crate::tracking::{TrackingContext, TrackingResult, sampling, track};
use i2slam_formation::{CameraResponse, CentreVelocity, TrajectoryScale};
use i2slam_geometry::{Camera, Image};
use i2slam_radiance::gaussian::{ColourActivation, GaussianMap, RasterSettings, Shape};
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

/// The rasteriser's settings.
pub(crate) fn raster_settings(config: &Config) -> RasterSettings {
    RasterSettings { screen_variance: config.map.screen_variance, ..RasterSettings::default() }
}

impl GaussianMapper {
    /// An empty map for frames of `camera`.
    pub(crate) fn new(config: &Config, camera: &Camera<f64>) -> Self {
        Self {
            map: empty_map(config),
            objective: FrameObjective::new(camera.cast(), raster_settings(config)),
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
        story: &mut Story<'_>,
        steps: usize,
        on_step: &mut dyn FnMut(usize) -> bool,
    ) -> bool {
        let (mut order, mut goes_on): (Vec<usize>, bool) = (Vec::new(), true);
        for step in 0..steps {
            if order.is_empty() {
                order = (0..story.keyframes.len()).collect();
                story.random.shuffle(&mut order);
            }
            let Some(next) = order.pop() else { break };
            let keyframe = story.keyframes[next].clone();
            self.step(story, &keyframe);
            goes_on = on_step(step + 1);
            if !goes_on {
                break;
            }
        }
        self.prune(story);
        goes_on
    }

    fn step(&mut self, story: &mut Story<'_>, keyframe: &Keyframe) {
        let estimate = &story.frames[keyframe.frame];
        let exposed = (estimate.shutter, estimate.readout);
        let formation = &story.config.formation;
        let sampling = sampling(formation, story.camera, exposed, &keyframe.observation);
        let scene = (&mut self.map, &mut self.objective);
        self.optimizer.step(story, scene, keyframe, sampling);
    }

    fn prune(&mut self, story: &Story<'_>) {
        let keep = prune(&mut self.map, &story.config.mapping, self.scene);
        if keep.contains(&false) {
            self.optimizer.retain(&keep);
        }
    }

    /// Keeps the map within its capacity, and then with some room for the next frames.
    fn make_room(&mut self, story: &mut Story<'_>) {
        let capacity = story.config.map.capacity;
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
            story.warnings.push(full.into());
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

    fn follower(
        &self,
        config: &Config,
        camera: &Camera<f64>,
        covered: Option<Arc<Image<bool>>>,
        last: Option<Box<dyn Tracker>>,
    ) -> Option<Box<dyn Tracker>> {
        let objective = || FrameObjective::new(camera.cast(), raster_settings(config));
        (!self.map.is_empty()).then(|| Follower::update(last, &self.map, covered, objective))
    }

    fn add(&mut self, story: &mut Story<'_>, current: &Keyframe) {
        let config = story.config;
        let estimate = &story.frames[current.frame];
        let curve = config.formation.tone.then(|| story.responses[estimate.response].curve());
        let render = (!self.map.is_empty())
            .then(|| self.objective.render(&self.map, estimate.depth_pose()).clone());
        let (mapping, observation) = (&config.mapping, &current.observation);
        let source = Source {
            camera: story.camera,
            world_from_depth: estimate.depth_pose(),
            colour_from_depth: estimate.middle().inverse() * estimate.depth_pose(),
            velocity: CentreVelocity::from(estimate.shutter).velocity,
            readout: estimate.readout,
            observation,
            depth: placement(observation, mapping, story.covered, render.as_ref()),
            tone: curve.as_ref().map(|curve| Tone { frame: estimate.tone, curve }),
        };
        if let Some(render) = &render {
            add_gaussians(&mut self.map, (&config.map, mapping), &source, render);
        } else {
            self.scene = SceneScale::new(observation, mapping.scene_radius_ratio);
            seed_map(&mut self.map, &config.map, &source);
        }
        self.make_room(story);
    }

    fn refine(&mut self, story: &mut Story<'_>, current: &Keyframe, first: bool) {
        let mapping = &story.config.mapping;
        let iterations = if first { mapping.first_iterations } else { mapping.iterations };
        let fresh = mapping.fresh_optimizer;
        if fresh {
            self.optimizer.reset();
        }
        let window = select_window(
            story.keyframes,
            current,
            story.frames,
            story.camera,
            mapping.window,
            story.random,
        );
        let round = Round::begin(story.config);
        for iteration in 0..iterations {
            if round.is_over(iteration, story.cancellation) {
                break;
            }
            let chosen = &window[story.random.below(window.len())];
            self.step(story, chosen);
            if fresh && (iteration == 0 || iteration == PRUNE_STEP) {
                self.prune(story);
            }
        }
        if !fresh {
            self.prune(story);
        }
    }

    fn finish(&mut self, story: &mut Story<'_>, on_step: &mut dyn FnMut(usize, usize) -> bool) {
        let steps = story.config.mapping.final_iterations;
        self.refine_all(story, steps, &mut |step| on_step(step, steps));
    }

    fn map(&self) -> Map {
        Map::Gaussians(self.map.clone())
    }
}
