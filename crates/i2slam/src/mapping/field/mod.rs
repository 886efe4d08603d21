//! Mapping with a radiance field in a hash grid.
//!
//! The field fills a cube around the first camera, as large as the first frame's depth says. Depth
//! also tells where rays are sampled: a shell around every surface that a frame has seen, nothing
//! in between, so that a ray costs a dozen samples. Where a frame sees farther, a field in a larger
//! cube takes its place: it is trained anew on the keyframes so far, whose poses and tone stay. Of
//! a cube of a set size, what lies outside is not mapped.

mod bounds;

pub(super) use bounds::{GROWTH, chebyshev_distance, mark_cells, surface_distance, untrained};

use super::depth_inpainting::placement_depth;
use super::frame_optimizer::FrameOptimizers;
use super::iteration_budget::IterationBudget;
use super::keyframe::Keyframe;
use super::map_snapshot::{MapSnapshot, Tracker};
use super::mapper::{Mapper, MappingContext};
use crate::objective::{
    Evaluation, Exposure, FrameObjective, FrameVariables, Observation, RayObjective, RayView,
    Sampling, Tone,
};
use crate::reconstruction::Map;
use crate::tracking::{TrackingContext, TrackingResult, sampling, track};
use crate::warning::Warning;
use i2slam_compute::Random;
use i2slam_formation::{CameraResponse, CurveGradient, ResponseCurve, TrajectoryScale};
use i2slam_geometry::{Camera, Image, Pose};
use i2slam_radiance::hashgrid::{
    FieldAdam, FieldGradient, FieldSettings, HashGridMap, SettingsError, decayed_rate,
};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Share of a frame's surfaces outside of the cube that calls for a larger one.
const OUTSIDE: f64 = 0.02;

/// A field that is trained frame by frame.
pub(crate) struct FieldMapper {
    camera: Camera<f32>,
    covered: Option<Arc<Image<bool>>>,
    /// None until the first frame has told how large the scene is.
    field: Option<Field>,
    /// Why there is none after the first frame.
    failure: Option<SettingsError>,
    frames: FrameOptimizers,
    /// How many steps a field had that was begun anew since the last round; else none.
    lost_steps: usize,
    warned: bool,
}

/// A field and what trains it.
struct Field {
    map: HashGridMap,
    objective: FrameObjective<HashGridMap>,
    batch: RayObjective,
    gradient: FieldGradient,
    adam: FieldAdam,
    /// Number of steps so far.
    steps: usize,
}

impl Field {
    fn new(map: HashGridMap, camera: Camera<f32>) -> Self {
        Self {
            objective: FrameObjective::new(camera, map.march),
            batch: RayObjective::new(camera, map.march),
            gradient: FieldGradient::zeros(&map.field),
            adam: FieldAdam::new(),
            steps: 0,
            map,
        }
    }

    /// Puts an untrained map in the place of this one.
    fn renew(&mut self, map: HashGridMap) {
        self.gradient = FieldGradient::zeros(&map.field);
        self.adam = FieldAdam::new();
        // What draws the map has its march.
        self.map = HashGridMap { march: self.map.march, ..map };
    }
}

impl FieldMapper {
    /// For frames of `camera`.
    pub(crate) fn new(camera: &Camera<f64>) -> Self {
        Self {
            camera: camera.cast(),
            covered: None,
            field: None,
            failure: None,
            frames: FrameOptimizers::default(),
            lost_steps: 0,
            warned: false,
        }
    }

    /// Chooses the cube: around the camera, large enough for the frame's depth and a margin.
    fn begin(&mut self, context: &mut MappingContext<'_>, pose: Pose<f64>, depth: &Image<f32>) {
        let settings = &context.config.hashgrid;
        let bound = bounds::bound(settings, context.camera, depth);
        let seed = context.config.seed;
        match bounds::untrained(settings, pose.translation.to_array(), bound, seed) {
            Ok(map) => {
                let field = self.field.insert(Field::new(map, self.camera));
                field.batch.set_moment_jitter(settings.moment_jitter);
            }
            Err(error) => self.failure = Some(error),
        }
        if let (Some(field), Some(covered)) = (&mut self.field, &self.covered) {
            field.objective.set_covered(Arc::clone(covered));
        }
    }

    /// Begins the field anew, in a cube of half edge `bound` [m], with all keyframes before
    /// `current`.
    fn grow(&mut self, context: &mut MappingContext<'_>, bound: f64) {
        let (settings, seed) = (&context.config.hashgrid, context.config.seed);
        let Some(field) = &mut self.field else { return };
        // The settings have made a field before.
        let centre = field.map.field.settings().centre;
        let Ok(map) = bounds::untrained(settings, centre, bound, seed) else { return };
        self.lost_steps += std::mem::take(&mut field.steps);
        field.renew(map);
        for keyframe in context.keyframes {
            let depth = placement_depth(
                &keyframe.observation,
                &context.config.mapping,
                context.covered,
                None,
            );
            self.hold(context, context.frames[keyframe.frame].depth_pose(), &depth);
        }
    }

    /// Samples around the surfaces of a frame from now on.
    fn hold(&mut self, context: &MappingContext<'_>, pose: Pose<f64>, depth: &Image<f32>) {
        let Some(Field { map, .. }) = &mut self.field else { return };
        let shell = context.config.hashgrid.shell;
        let HashGridMap { field, occupancy, .. } = map;
        let between = |_, d| (d * (1.0 - shell), d * (1.0 + shell));
        mark_cells(occupancy, field, (&self.camera, pose), depth, between);
    }

    /// Sees to it that the cube holds what a frame sees, or warns.
    fn enclose(
        &mut self,
        context: &mut MappingContext<'_>,
        frame: usize,
        pose: Pose<f64>,
        depth: &Image<f32>,
    ) {
        let Some(Field { map, .. }) = &self.field else { return };
        let FieldSettings { centre, bound, .. } = *map.field.settings();
        let share = bounds::share_outside(map.field.settings(), context.camera, pose, depth);
        if share <= OUTSIDE {
            return;
        }
        let settings = &context.config.hashgrid;
        if settings.bound == 0.0 {
            let required_extent = f64::from(settings.margin)
                * bounds::required_extent(centre, context.camera, pose, depth);
            self.grow(context, required_extent.max(bounds::GROWTH * bound));
        } else if !self.warned {
            self.warned = true;
            let outside = format!(
                "{:.0} % of what it sees lies outside of the field's cube (±{bound:.1} m around the \
                 first camera) and is not mapped: without hashgrid.bound the cube grows",
                100.0 * share
            );
            context.warnings.push(Warning::of_frame(context.frames[frame].index, outside));
        }
    }

    /// One step on pixels of all `views`; poses and tone take part unless the field `alone` does.
    fn step(
        &mut self,
        context: &mut MappingContext<'_>,
        views: &[Keyframe],
        rate: f32,
        alone: bool,
    ) {
        let config = context.config;
        let curves = curves(context, views);
        let rays = config.hashgrid.rays / views.len().max(1);
        let drawn = views.iter().map(|view| self.draw(context, view, &curves, rays));
        let drawn: Vec<RayView<'_>> = drawn.collect();
        let Some(field) = &mut self.field else { return };
        let rates = &config.parameters.frames;
        let with_poses =
            !alone && (rates.pose_rotation_rate > 0.0 || rates.pose_translation_rate > 0.0);
        let evaluations = field.batch.map(
            &field.map,
            &drawn,
            (config.hashgrid.image_weight, config.hashgrid.depth_weight),
            with_poses,
            context.random,
            &mut field.gradient,
        );
        field.adam.step(&mut field.map.field, &mut field.gradient, rate);
        field.steps += 1;
        if !alone {
            self.step_frames(context, views, evaluations);
        }
    }

    /// Random pixels of a keyframe, about `rays` rays in all.
    fn draw<'a>(
        &self,
        context: &mut MappingContext<'_>,
        keyframe: &'a Keyframe,
        curves: &'a BTreeMap<usize, ResponseCurve<f32>>,
        rays: usize,
    ) -> RayView<'a> {
        let estimate = &context.frames[keyframe.frame];
        let observation = &*keyframe.observation;
        let formation = &context.config.formation;
        let exposed = (estimate.shutter, estimate.readout);
        let sampling = sampling(formation, context.camera, exposed, observation);
        // Rays are rendered, not looked up.
        let virtual_cameras = sampling.virtual_cameras.min(formation.virtual_cameras);
        let sampling = Sampling { virtual_cameras, ..sampling };
        let exposure = Exposure {
            shutter: estimate.shutter,
            sampling,
            readout: estimate.readout,
            depth_pose: estimate.depth_is_apart().then(|| estimate.depth_pose()),
        };
        let curve = curves.get(&estimate.response);
        let tone = curve.map(|curve| Tone { frame: estimate.tone, curve });
        let variables = FrameVariables { exposure, tone };
        let mut view = RayView { observation, variables, pixels: Vec::new() };
        let count = (rays / view.rays_per_pixel()).max(1);
        view.pixels = self.pixels(observation, count, context.random);
        view
    }

    /// Pixels drawn at random from those that the camera recorded.
    fn pixels(&self, observation: &Observation, count: usize, random: &mut Random) -> Vec<usize> {
        let all = observation.depth.pixels();
        let recorded = |p: &usize| self.covered.as_ref().is_none_or(|c| c.data[*p]);
        (0..count).map(|_| random.below(all)).filter(recorded).collect()
    }

    /// Tone and poses of the frames that took part, and their responses, each once.
    fn step_frames(
        &mut self,
        context: &mut MappingContext<'_>,
        views: &[Keyframe],
        evaluations: Vec<Evaluation>,
    ) {
        let mut responses: BTreeMap<usize, CurveGradient<f32>> = BTreeMap::new();
        for (view, mut evaluation) in views.iter().zip(evaluations) {
            let response = context.frames[view.frame].response;
            if let Some(d_curve) = evaluation.curve.take() {
                match responses.get_mut(&response) {
                    Some(sum) => add(sum, &d_curve),
                    None => drop(responses.insert(response, d_curve)),
                }
            }
            let gauge_frame = context.gauge_frame(view);
            if view.frame != gauge_frame {
                if context.config.formation.tone {
                    self.frames.step_tone(context, view.frame, &evaluation.tone);
                }
                self.frames.step_pose(context, view.frame, &evaluation.shutter);
            }
        }
        for (index, mut d_curve) in responses {
            self.frames.step_response(context, index, &mut d_curve);
        }
    }

    /// The current frame, the last keyframe, and others drawn at random from all.
    fn window(context: &mut MappingContext<'_>, current: &Keyframe) -> Vec<Keyframe> {
        let mut window = vec![current.clone()];
        let size = context.config.mapping.window;
        let mut others: Vec<&Keyframe> =
            context.keyframes.iter().filter(|k| k.frame != current.frame).collect();
        if size > 1 {
            window.extend(others.pop().cloned());
        }
        context.random.shuffle(&mut others);
        window.extend(others.into_iter().take(size.saturating_sub(2)).cloned());
        window
    }
}

/// The response curves of all `views`.
pub(in crate::mapping) fn curves(
    context: &MappingContext<'_>,
    views: &[Keyframe],
) -> BTreeMap<usize, ResponseCurve<f32>> {
    if !context.config.formation.tone {
        return BTreeMap::new();
    }
    let indices = views.iter().map(|view| context.frames[view.frame].response);
    indices.map(|index| (index, context.responses[index].curve())).collect()
}

/// Adds the derivative of another batch.
pub(in crate::mapping) fn add(sum: &mut CurveGradient<f32>, other: &CurveGradient<f32>) {
    for (sum, other) in sum.values.iter_mut().flatten().zip(other.values.iter().flatten()) {
        *sum += other;
    }
}

impl Tracker for FieldMapper {
    fn track(
        &mut self,
        context: &TrackingContext<'_>,
        observation: &Observation,
        response: Option<&CameraResponse<f32>>,
        scale: TrajectoryScale<f64>,
    ) -> TrackingResult {
        let Some(Field { map, objective, .. }) = &mut self.field else {
            return TrackingResult::lost(context, response, scale);
        };
        track(context, objective, map, observation, response, scale)
    }
}

impl Mapper for FieldMapper {
    fn is_empty(&self) -> bool {
        self.field.is_none()
    }

    fn failure(&self) -> Option<SettingsError> {
        self.failure
    }

    fn gaussians(&self) -> usize {
        0
    }

    fn set_covered(&mut self, covered: Arc<Image<bool>>) {
        if let Some(field) = &mut self.field {
            field.objective.set_covered(Arc::clone(&covered));
        }
        self.covered = Some(covered);
    }

    fn snapshot(
        &self,
        _camera: &Camera<f64>,
        covered: Option<Arc<Image<bool>>>,
        last: Option<Box<dyn Tracker>>,
    ) -> Option<Box<dyn Tracker>> {
        let map = &self.field.as_ref()?.map;
        let objective = || FrameObjective::new(self.camera, map.march);
        Some(MapSnapshot::update(last, map, covered, objective))
    }

    fn add(&mut self, context: &mut MappingContext<'_>, current: &Keyframe) {
        let depth =
            placement_depth(&current.observation, &context.config.mapping, context.covered, None);
        let pose = context.frames[current.frame].depth_pose();
        if self.field.is_none() {
            self.begin(context, pose, &depth);
        }
        self.enclose(context, current.frame, pose, &depth);
        self.hold(context, pose, &depth);
    }

    fn refine(&mut self, context: &mut MappingContext<'_>, current: &Keyframe, first: bool) {
        let settings = &context.config.hashgrid;
        let lost = std::mem::take(&mut self.lost_steps);
        let steps = if first { settings.first_iterations } else { settings.iterations };
        let round = IterationBudget::begin(context.config);
        for iteration in 0..lost + steps {
            if round.is_over(iteration, context.cancellation) {
                break;
            }
            let window = Self::window(context, current);
            self.step(context, &window, settings.rate, iteration < lost);
        }
    }

    fn finish(
        &mut self,
        context: &mut MappingContext<'_>,
        on_step: &mut dyn FnMut(usize, usize) -> bool,
    ) {
        let settings = &context.config.hashgrid;
        let (steps, rate) = (settings.final_iterations, settings.rate);
        let mut order: Vec<usize> = (0..context.keyframes.len()).collect();
        for step in 0..steps {
            context.random.shuffle(&mut order);
            let chosen = order.iter().take(context.config.mapping.window);
            let window: Vec<Keyframe> = chosen.map(|&k| context.keyframes[k].clone()).collect();
            self.step(context, &window, decayed_rate(rate, step as i32, steps as i32), false);
            if !on_step(step + 1, steps) {
                break;
            }
        }
    }

    fn map(&self) -> Map {
        match &self.field {
            Some(field) => Map::HashGrid(Box::new(field.map.clone())),
            None => Map::default(),
        }
    }
}
