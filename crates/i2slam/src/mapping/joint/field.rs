//! Joint refinement of a radiance field and of keyframes that came with poses.
//!
//! Keyframes enter the training set one by one. A step draws pixels from several of them, forms
//! and compares them, and moves the field, start and end poses, exposure, white balance and
//! response together. Depth may be unknown: rays are sampled where the field itself has turned out
//! to be dense. Where keyframes come with estimated depth in most pixels, they are sampled only
//! around these surfaces, which takes a tenth of the time and leaves no fog.

use super::JointMapper;
use super::field_extent::{self, Extent};
use super::field_step::{active_levels, any, blur_length_at_depth, draw, pixel_budget, window};
use super::pose_optimizer::PoseOptimizers;
use super::surface_shells as shells;
use super::trajectory_term::TrajectoryTerm;
use crate::config::{Config, Preconditioning};
use crate::mapping::field::{GROWTH, add, curves, untrained};
use crate::mapping::frame_optimizer::FrameOptimizers;
use crate::mapping::iteration_budget::IterationBudget;
use crate::mapping::keyframe::Keyframe;
use crate::mapping::localization::FrameLocator;
use crate::mapping::mapper::MappingContext;
use crate::objective::{Evaluation, FrameObjective, RayObjective, RayView};
use crate::reconstruction::{FrameEstimate, Losses, Map};
use crate::tracking::SequenceReadout;
use i2slam_formation::CurveGradient;
use i2slam_geometry::{Camera, Image};
use i2slam_radiance::hashgrid::{
    FieldAdam, FieldGradient, FieldRenderer, HashGridMap, Occupancy, SettingsError, decayed_rate,
};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Steps from one look at which cells are dense to the next (torch-ngp).
const LOOK: usize = 16;
/// Looks for which all cells around surfaces are sampled once keyframes were found anew.
const SECOND_LOOKS: i32 = 24;
/// Where keyframes are found anew, rays that met little are sampled again between these shares of
/// the steps after the last keyframe: from soon after the first search on, before which poses and
/// fog would have them filled wherever they happen to be, until what was opened can still be
/// trained or emptied.
const UNMET: std::ops::Range<f32> = 0.4..0.9;
/// Looks for which the cells along such a ray are sampled.
const UNMET_LOOKS: i32 = 8;
/// Share of `reach` that is not sampled before a camera (torch-ngp: 0.2 of 4).
const NEAR: f32 = 0.05;
/// Pixels of a Jacobian.
const JACOBIAN_PIXELS: usize = 96;

/// A field that is refined together with keyframes.
pub(crate) struct JointFieldMapper {
    camera: Camera<f32>,
    field: Option<Field>,
    frames: FrameOptimizers,
    poses: PoseOptimizers,
    trajectory: TrajectoryTerm,
    frame_rate: f64,
    finder: Option<Finder>,
    /// Steps since the field began.
    steps: usize,
}

/// A field and what trains it.
struct Field {
    map: HashGridMap,
    /// Where it may be sampled; everywhere if no keyframe has depth in most pixels.
    shells: Option<Occupancy>,
    batch: RayObjective,
    looker: FieldRenderer,
    gradient: FieldGradient,
    adam: FieldAdam,
}

impl Field {
    /// Renews how a keyframe is stepped where that is due.
    fn precondition(
        &mut self,
        context: &mut MappingContext<'_>,
        poses: &mut PoseOptimizers,
        view: &RayView<'_>,
        frame: usize,
    ) {
        let settings = &context.config.keyframed;
        if !poses.is_due(frame, settings.preconditioning_interval) {
            return;
        }
        let pixels = view.pixels.iter().copied().take(JACOBIAN_PIXELS).collect();
        let view = RayView { pixels, ..*view };
        let gram = self.batch.gram(&self.map, &view, context.random);
        poses.precondition(frame, &gram, settings);
    }
}

/// How far a step goes, and what depth weighs in it.
#[derive(Clone, Copy)]
struct Rates {
    field: f32,
    camera: f32,
    depth_weight: f32,
}

/// What the settings ask for, which depends on whether surfaces are known.
struct Plan {
    depth_weight: f32,
    /// Share of it that is left at the last step.
    depth_left: f32,
    camera_rate: f32,
    /// Steps after the last keyframe.
    steps: usize,
    /// Times during them that all keyframes are found anew.
    searches: usize,
}

impl JointFieldMapper {
    /// The plan for the field as it is.
    fn plan(&self, config: &Config) -> Plan {
        let (keyframed, steps) = (&config.keyframed, config.hashgrid.final_iterations);
        match self.field.as_ref().is_some_and(|field| field.shells.is_some()) {
            true => Plan {
                depth_weight: keyframed.surface_depth_weight,
                depth_left: keyframed.surface_depth_left,
                camera_rate: keyframed.surface_camera_rate,
                steps: (keyframed.surface_steps * steps as f32) as usize,
                searches: keyframed.surface_searches,
            },
            false => Plan {
                depth_weight: config.hashgrid.depth_weight,
                depth_left: 1.0,
                camera_rate: keyframed.camera_rate,
                steps,
                searches: 0,
            },
        }
    }

    /// For keyframes of `camera`, taken from a video of `frame_rate` frames per second.
    pub(crate) fn new(camera: &Camera<f64>, frame_rate: f64) -> Self {
        Self {
            camera: camera.cast(),
            field: None,
            frames: FrameOptimizers::default(),
            poses: PoseOptimizers::default(),
            trajectory: TrajectoryTerm::new(frame_rate),
            frame_rate,
            finder: None,
            steps: 0,
        }
    }

    /// Takes in a keyframe, the last of the context: waits for the first few, then begins a field
    /// that holds what they see, and begins it anew in a larger cube where a keyframe sees farther.
    pub(crate) fn add(&mut self, context: &mut MappingContext<'_>) -> Result<(), SettingsError> {
        let settings = &context.config.hashgrid;
        let first = match &self.field {
            None if context.keyframes.len() < context.config.keyframed.first_keyframes => {
                return Ok(());
            }
            None => true,
            Some(field) => !field_extent::contains(field.map.field.settings(), context),
        };
        if first {
            self.begin(context)?;
        } else {
            self.hold_last(context);
        }
        let iterations = if first { settings.first_iterations } else { settings.iterations };
        let Plan { camera_rate, depth_weight, .. } = self.plan(context.config);
        let rates = Rates { field: settings.rate, camera: camera_rate, depth_weight };
        let round = IterationBudget::begin(context.config);
        for iteration in 0..iterations {
            if round.is_over(iteration, context.cancellation) {
                break;
            }
            let window = window(context);
            self.step(context, &window, rates);
        }
        Ok(())
    }

    /// An untrained field that holds what all keyframes see.
    fn begin(&mut self, context: &mut MappingContext<'_>) -> Result<(), SettingsError> {
        let Extent { centre, mut bound } = Extent::of(context);
        if let Some(field) = &self.field {
            bound = bound.max(GROWTH * field.map.field.settings().bound);
        }
        let config = context.config;
        let settings = match shells::are_known(context) {
            true => shells::settings(context).with_growth(bound, config.keyframed.surface_growth),
            false => config.hashgrid.clone(),
        };
        let empty = untrained(&settings, centre, bound, config.seed)?;
        let mut march = empty.march;
        march.near = NEAR * config.keyframed.reach;
        let occupancy = Occupancy::new(*empty.occupancy.settings());
        let map = HashGridMap { occupancy, march, ..empty };
        let mut batch = RayObjective::new(self.camera, march);
        batch.set_depth_outlier(config.keyframed.depth_outlier);
        batch.set_moment_jitter(settings.moment_jitter);
        self.field = Some(Field {
            batch,
            looker: FieldRenderer::new(march),
            gradient: FieldGradient::zeros(&map.field),
            adam: FieldAdam::new(),
            shells: None,
            map,
        });
        self.confine(context);
        // What was known of steps in the field before says nothing of this one.
        self.poses = PoseOptimizers::default();
        self.frames = FrameOptimizers::default();
        self.steps = 0;
        Ok(())
    }

    /// Samples around what all keyframes see from where they are now, if depth tells.
    fn confine(&mut self, context: &MappingContext<'_>) {
        let Some(field) = &mut self.field else { return };
        field.shells = shells::shells(&field.map, &self.camera, context);
        if let Some(shells) = &field.shells {
            field.map.occupancy.confine(shells);
        }
    }

    /// Samples again what was emptied around surfaces before poses were as good as they are now.
    fn reopen(&mut self) {
        if let Some(field) = self.field.as_mut().filter(|field| field.shells.is_some()) {
            field.map.occupancy.reopen(SECOND_LOOKS);
        }
    }

    /// Samples again along the rays of the last step that met little: where all cells around a
    /// surface were emptied too early, a hole would stay.
    fn reopen_unmet(&mut self) {
        if let Some(Field { map, batch, shells: Some(_), .. }) = &mut self.field {
            for ray in batch.unmet() {
                map.occupancy.reopen_along(&map.field, ray, UNMET_LOOKS);
            }
        }
    }

    /// Samples around what the last keyframe sees too.
    fn hold_last(&mut self, context: &MappingContext<'_>) {
        let (Some(field), Some(last)) = (&mut self.field, context.keyframes.last()) else { return };
        match &mut field.shells {
            Some(shells) => {
                shells::hold(shells, &field.map, &self.camera, context, last);
                field.map.occupancy.confine(shells);
            }
            None => self.confine(context),
        }
    }

    /// Finds all keyframes anew in the field as it is, one after another; the gains of the first
    /// stay.
    fn relocate(&mut self, context: &mut MappingContext<'_>) {
        for keyframe in
            context.keyframes.iter().take_while(|_| !context.cancellation.is_cancelled())
        {
            let mut estimate = context.frames[keyframe.frame].clone();
            let before = keyframe.adjacent.frame_before(&estimate);
            let last = || keyframe.frame.checked_sub(1).map(|i| context.frames[i].clone());
            let before = before.or_else(last);
            let frame = (&mut estimate, &keyframe.observation.colour);
            JointMapper::locate(self, context, frame, before.as_ref());
            if keyframe.frame == context.gauge_frame(keyframe) {
                estimate.tone = context.frames[keyframe.frame].tone;
            }
            context.frames[keyframe.frame] = estimate;
        }
    }

    /// Steps over all keyframes after the last; `on_step(done, of)` says whether to go on.
    pub(crate) fn finish(
        &mut self,
        context: &mut MappingContext<'_>,
        on_step: &mut dyn FnMut(usize, usize) -> bool,
    ) -> Result<(), SettingsError> {
        if self.field.is_none() {
            self.begin(context)?;
        }
        let rate = context.config.hashgrid.rate;
        let Plan { camera_rate, depth_weight, depth_left, steps, searches } =
            self.plan(context.config);
        let part = steps.div_ceil(1 + searches).max(1);
        self.confine(context);
        for step in 0..steps {
            if step > 0 && step.is_multiple_of(part) {
                self.relocate(context);
                self.confine(context);
                self.reopen();
            }
            let window = any(context, context.config.mapping.window);
            let decayed = |rate| decayed_rate(rate, step as i32, steps as i32);
            let rates = Rates {
                field: decayed(rate),
                camera: decayed(camera_rate),
                depth_weight: depth_weight * depth_left.powf(step as f32 / steps as f32),
            };
            self.step(context, &window, rates);
            if searches > 0 && UNMET.contains(&(step as f32 / steps as f32)) {
                self.reopen_unmet();
            }
            if !on_step(step + 1, steps) {
                break;
            }
        }
        Ok(())
    }

    /// One step on pixels of all `views`.
    fn step(&mut self, context: &mut MappingContext<'_>, views: &[Keyframe], rates: Rates) {
        let config = context.config;
        let curves = curves(context, views);
        let Some(field) = &mut self.field else { return };
        if self.steps.is_multiple_of(LOOK) {
            let Field { map, looker, .. } = &mut *field;
            map.occupancy.refresh(&map.field, looker, config.seed);
        }
        let samples = field.shells.as_ref().map_or(0, |_| config.keyframed.surface_samples);
        let most = (config.hashgrid.rays, samples);
        let pixels = pixel_budget(most, field.batch.samples_per_pixel()) / views.len().max(1);
        let drawn: Vec<RayView<'_>> =
            views.iter().map(|view| draw(context, view, &curves, pixels)).collect();
        let with_poses = rates.camera > 0.0 && self.steps >= config.keyframed.pose_delay;
        if with_poses
            && config.formation.blur
            && config.keyframed.preconditioning != Preconditioning::Off
        {
            for (view, keyframe) in drawn.iter().zip(views) {
                field.precondition(context, &mut self.poses, view, keyframe.frame);
            }
        }
        let weights = (config.hashgrid.image_weight, rates.depth_weight);
        let Field { map, batch, gradient, adam, .. } = &mut *field;
        let evaluations = batch.map(map, &drawn, weights, with_poses, context.random, gradient);
        for (view, index) in views.iter().zip(0..) {
            if let Some(depth) = batch.seen_depth(index) {
                let estimate = &mut context.frames[view.frame];
                estimate.blur_length = blur_length_at_depth(context.camera, estimate, depth);
            }
        }
        let levels = map.field.settings().levels;
        gradient.keep_levels(
            &map.field,
            active_levels(self.steps, config.keyframed.coarse_steps, levels),
        );
        adam.step(&mut map.field, gradient, rates.field);
        self.steps += 1;
        self.step_frames(context, views, evaluations, with_poses.then_some(rates.camera));
    }

    /// Tone and poses of the keyframes that took part, and their responses, each once.
    fn step_frames(
        &mut self,
        context: &mut MappingContext<'_>,
        views: &[Keyframe],
        evaluations: Vec<Evaluation>,
        camera_rate: Option<f32>,
    ) {
        let mut responses: BTreeMap<usize, CurveGradient<f32>> = BTreeMap::new();
        let share = 1.0 / views.len().max(1) as f64;
        for (view, mut evaluation) in views.iter().zip(evaluations) {
            let response = context.frames[view.frame].response;
            if let Some(d_curve) = evaluation.curve.take() {
                match responses.get_mut(&response) {
                    Some(sum) => add(sum, &d_curve),
                    None => drop(responses.insert(response, d_curve)),
                }
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
        for (index, mut d_curve) in responses {
            self.frames.step_response(context, index, &mut d_curve);
        }
    }

    /// The map as it is now.
    pub(crate) fn map(&self) -> Map {
        match &self.field {
            Some(field) => Map::HashGrid(Box::new(field.map.clone())),
            None => Map::default(),
        }
    }
}

/// What frames are found with once the field is finished.
struct Finder {
    locator: FrameLocator,
    objective: FrameObjective<HashGridMap>,
}

impl JointMapper for JointFieldMapper {
    fn add(&mut self, context: &mut MappingContext<'_>) -> Result<(), SettingsError> {
        Self::add(self, context)
    }

    fn finish(
        &mut self,
        context: &mut MappingContext<'_>,
        on_step: &mut dyn FnMut(usize, usize) -> bool,
    ) -> Result<(), SettingsError> {
        Self::finish(self, context, on_step)
    }

    fn locate(
        &mut self,
        context: &MappingContext<'_>,
        frame: (&mut FrameEstimate, &Arc<Image<f32>>),
        before: Option<&FrameEstimate>,
    ) -> bool {
        let Some(field) = &self.field else { return false };
        let map = &field.map;
        let finder = self.finder.get_or_insert_with(|| Finder {
            locator: FrameLocator::new(
                self.frame_rate,
                SequenceReadout::new(&context.config.input),
            ),
            objective: FrameObjective::new(self.camera, map.march),
        });
        let scene = (map, &mut finder.objective);
        finder.locator.locate(context, scene, frame, before, context.frames)
    }

    fn set_covered(&mut self, _covered: Arc<Image<bool>>) {}

    fn map(&self) -> Map {
        Self::map(self)
    }
}
