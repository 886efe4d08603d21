//! Joint refinement of a radiance field and of keyframes that came with poses.
//!
//! Keyframes enter the training set one by one. A step draws pixels from several of them, forms
//! and compares them, and moves the field, start and end poses, exposure, white balance and
//! response together. Depth may be unknown: rays are sampled where the field itself has turned out
//! to be dense. Where keyframes come with estimated depth in most pixels, they are sampled only
//! around these surfaces, which takes a tenth of the time and leaves no fog.

mod batch;
mod extent;
mod locate;
mod poses;
mod preconditioner;
mod shells;
mod trajectory;

use super::field::{GROWTH, add, curves, untrained};
use super::frames::FrameOptimizers;
use super::round::Round;
use super::{Keyframe, PosedMapper, Story};
use crate::config::{Config, Preconditioning};

use crate::objective::{Evaluation, RayObjective, RayView};
use crate::reconstruction::{Losses, Map};
use batch::{affordable, any, blur_at, draw, open_levels, window};
use extent::Extent;
use i2slam_formation::CurveGradient;
use i2slam_geometry::Camera;
use i2slam_radiance::hashgrid::{
    FieldAdam, FieldGradient, FieldRenderer, HashGridMap, Occupancy, SettingsError, decayed_rate,
};
use locate::Finder;
use poses::PoseOptimizers;
use std::collections::BTreeMap;
use trajectory::TrajectoryTerm;

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
pub(crate) struct PosedField {
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
        story: &mut Story<'_>,
        poses: &mut PoseOptimizers,
        view: &RayView<'_>,
        frame: usize,
    ) {
        let settings = &story.config.keyframed;
        if !poses.is_due(frame, settings.preconditioning_interval) {
            return;
        }
        let pixels = view.pixels.iter().copied().take(JACOBIAN_PIXELS).collect();
        let view = RayView { pixels, ..*view };
        let gram = self.batch.gram(&self.map, &view, story.random);
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

impl PosedField {
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

    /// Takes in a keyframe, the last of the story: waits for the first few, then begins a field
    /// that holds what they see, and begins it anew in a larger cube where a keyframe sees farther.
    pub(crate) fn add(&mut self, story: &mut Story<'_>) -> Result<(), SettingsError> {
        let settings = &story.config.hashgrid;
        let first = match &self.field {
            None if story.keyframes.len() < story.config.keyframed.first_keyframes => return Ok(()),
            None => true,
            Some(field) => !extent::holds(field.map.field.settings(), story),
        };
        if first {
            self.begin(story)?;
        } else {
            self.hold_last(story);
        }
        let iterations = if first { settings.first_iterations } else { settings.iterations };
        let Plan { camera_rate, depth_weight, .. } = self.plan(story.config);
        let rates = Rates { field: settings.rate, camera: camera_rate, depth_weight };
        let round = Round::begin(story.config);
        for iteration in 0..iterations {
            if round.is_over(iteration, story.cancellation) {
                break;
            }
            let window = window(story);
            self.step(story, &window, rates);
        }
        Ok(())
    }

    /// An untrained field that holds what all keyframes see.
    fn begin(&mut self, story: &mut Story<'_>) -> Result<(), SettingsError> {
        let Extent { centre, mut bound } = Extent::of(story);
        if let Some(field) = &self.field {
            bound = bound.max(GROWTH * field.map.field.settings().bound);
        }
        let config = story.config;
        let settings = match shells::are_known(story) {
            true => shells::settings(story).with_growth(bound, config.keyframed.surface_growth),
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
        self.confine(story);
        // What was known of steps in the field before says nothing of this one.
        self.poses = PoseOptimizers::default();
        self.frames = FrameOptimizers::default();
        self.steps = 0;
        Ok(())
    }

    /// Samples around what all keyframes see from where they are now, if depth tells.
    fn confine(&mut self, story: &Story<'_>) {
        let Some(field) = &mut self.field else { return };
        field.shells = shells::shells(&field.map, &self.camera, story);
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
    fn hold_last(&mut self, story: &Story<'_>) {
        let (Some(field), Some(last)) = (&mut self.field, story.keyframes.last()) else { return };
        match &mut field.shells {
            Some(shells) => {
                shells::hold(shells, &field.map, &self.camera, story, last);
                field.map.occupancy.confine(shells);
            }
            None => self.confine(story),
        }
    }

    /// Finds all keyframes anew in the field as it is, one after another; the gains of the first
    /// stay.
    fn relocate(&mut self, story: &mut Story<'_>) {
        for keyframe in story.keyframes.iter().take_while(|_| !story.cancellation.is_cancelled()) {
            let mut estimate = story.frames[keyframe.frame].clone();
            let before = keyframe.beside.frame_before(&estimate);
            let last = || keyframe.frame.checked_sub(1).map(|i| story.frames[i].clone());
            let before = before.or_else(last);
            let frame = (&mut estimate, &keyframe.observation.colour);
            PosedMapper::locate(self, story, frame, before.as_ref());
            if keyframe.frame == story.gauge_frame(keyframe) {
                estimate.tone = story.frames[keyframe.frame].tone;
            }
            story.frames[keyframe.frame] = estimate;
        }
    }

    /// Steps over all keyframes after the last; `on_step(done, of)` says whether to go on.
    pub(crate) fn finish(
        &mut self,
        story: &mut Story<'_>,
        on_step: &mut dyn FnMut(usize, usize) -> bool,
    ) -> Result<(), SettingsError> {
        if self.field.is_none() {
            self.begin(story)?;
        }
        let rate = story.config.hashgrid.rate;
        let Plan { camera_rate, depth_weight, depth_left, steps, searches } =
            self.plan(story.config);
        let part = steps.div_ceil(1 + searches).max(1);
        self.confine(story);
        for step in 0..steps {
            if step > 0 && step.is_multiple_of(part) {
                self.relocate(story);
                self.confine(story);
                self.reopen();
            }
            let window = any(story, story.config.mapping.window);
            let decayed = |rate| decayed_rate(rate, step as i32, steps as i32);
            let rates = Rates {
                field: decayed(rate),
                camera: decayed(camera_rate),
                depth_weight: depth_weight * depth_left.powf(step as f32 / steps as f32),
            };
            self.step(story, &window, rates);
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
    fn step(&mut self, story: &mut Story<'_>, views: &[Keyframe], rates: Rates) {
        let config = story.config;
        let curves = curves(story, views);
        let Some(field) = &mut self.field else { return };
        if self.steps.is_multiple_of(LOOK) {
            let Field { map, looker, .. } = &mut *field;
            map.occupancy.refresh(&map.field, looker, config.seed);
        }
        let samples = field.shells.as_ref().map_or(0, |_| config.keyframed.surface_samples);
        let most = (config.hashgrid.rays, samples);
        let pixels = affordable(most, field.batch.samples_per_pixel()) / views.len().max(1);
        let drawn: Vec<RayView<'_>> =
            views.iter().map(|view| draw(story, view, &curves, pixels)).collect();
        let with_poses = rates.camera > 0.0 && self.steps >= config.keyframed.pose_delay;
        if with_poses
            && config.formation.blur
            && config.keyframed.preconditioning != Preconditioning::Off
        {
            for (view, keyframe) in drawn.iter().zip(views) {
                field.precondition(story, &mut self.poses, view, keyframe.frame);
            }
        }
        let weights = (config.hashgrid.image_weight, rates.depth_weight);
        let Field { map, batch, gradient, adam, .. } = &mut *field;
        let evaluations = batch.map(map, &drawn, weights, with_poses, story.random, gradient);
        for (view, index) in views.iter().zip(0..) {
            if let Some(depth) = batch.seen_depth(index) {
                let estimate = &mut story.frames[view.frame];
                estimate.blur_length = blur_at(story.camera, estimate, depth);
            }
        }
        let levels = map.field.settings().levels;
        gradient.keep_levels(
            &map.field,
            open_levels(self.steps, config.keyframed.coarse_steps, levels),
        );
        adam.step(&mut map.field, gradient, rates.field);
        self.steps += 1;
        self.step_frames(story, views, evaluations, with_poses.then_some(rates.camera));
    }

    /// Tone and poses of the keyframes that took part, and their responses, each once.
    fn step_frames(
        &mut self,
        story: &mut Story<'_>,
        views: &[Keyframe],
        evaluations: Vec<Evaluation>,
        camera_rate: Option<f32>,
    ) {
        let mut responses: BTreeMap<usize, CurveGradient<f32>> = BTreeMap::new();
        let share = 1.0 / views.len().max(1) as f64;
        for (view, mut evaluation) in views.iter().zip(evaluations) {
            let response = story.frames[view.frame].response;
            if let Some(d_curve) = evaluation.curve.take() {
                match responses.get_mut(&response) {
                    Some(sum) => add(sum, &d_curve),
                    None => drop(responses.insert(response, d_curve)),
                }
            }
            let trajectory = self.trajectory.add(story, view, share, &mut evaluation);
            story.frames[view.frame].losses =
                Losses { image: evaluation.image, depth: evaluation.depth, trajectory };
            if story.config.formation.tone && view.frame != story.gauge_frame(view) {
                self.frames.step_tone(story, view.frame, &evaluation.tone);
            }
            if let Some(rate) = camera_rate {
                self.poses.step(story, view.frame, &evaluation.shutter, rate);
            }
        }
        self.trajectory.step_scale(story.config);
        for (index, mut d_curve) in responses {
            self.frames.step_response(story, index, &mut d_curve);
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
