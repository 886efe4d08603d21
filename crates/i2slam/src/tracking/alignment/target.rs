//! Pictures of the map that a frame is aligned to.

use super::Frame;
use super::pyramid::{Model, depth_levels, model_levels};
use super::residual::{Errors, Scales};
use crate::config::TrackingParameters;
use crate::objective::{FrameObjective, SceneMap};
use i2slam_geometry::Pose;

/// Robust scales before anything is known: depth [m at 1 m] and picture.
const FIRST_SCALES: Scales = Scales { depth: 0.02, image: 0.08 };

/// Smallest scale of the depth residual [m at 1 m].
const MIN_DEPTH_SCALE: f32 = 3e-5;

/// Smallest scale of the image residual [display units].
const MIN_IMAGE_SCALE: f32 = 0.01;

/// How many times less noise than the model's residuals a keyframe's own depth must have.
const CLEANER: f32 = 3.0;

/// Scale of depth residuals that do not count.
const SILENT: f32 = 1e4;

/// Scale of the depth residual [m at 1 m] from which pictures have their full weight.
const COARSE_DEPTH: f32 = 1.5e-3;

/// The rendered model (radiance and depth), or the last keyframe's own depth, which has no
/// radiance but edges that no splat has softened.
pub(super) struct Reference {
    pub(super) levels: Vec<Model>,
    pub(super) world_from_camera: Pose<f64>,
    pub(super) scales: Scales,
    pub(super) has_radiance: bool,
}

impl Reference {
    /// The map as it is seen from `world_from_camera`.
    pub(super) fn model<M: SceneMap>(
        frame: &Frame<'_>,
        objective: &mut FrameObjective<M>,
        map: &M,
        world_from_camera: Pose<f64>,
    ) -> Self {
        let render = objective.render(map, world_from_camera);
        Self {
            levels: model_levels(render, frame.observed.len()),
            world_from_camera,
            scales: FIRST_SCALES,
            has_radiance: true,
        }
    }

    /// The last keyframe's depth, where it is wanted and there is one.
    pub(super) fn keyframe(frame: &Frame<'_>) -> Option<Self> {
        let (observation, world_from_camera) = frame.context.keyframe?;
        if !frame.context.parameters.tracking.keyframe_depth || frame.observation.is_estimated() {
            return None;
        }
        Some(Self {
            levels: depth_levels(&observation.depth, frame.observed.len()),
            world_from_camera,
            scales: FIRST_SCALES,
            has_radiance: false,
        })
    }

    /// Robust scales follow the mean absolute residual, down to their floors.
    pub(super) fn update_scales(&mut self, errors: &Errors) {
        if errors.depth_count > 0 {
            let mean = (errors.depth / errors.depth_count as f64) as f32;
            self.scales.depth = (1.25 * mean).max(MIN_DEPTH_SCALE);
        }
        if errors.image_count > 0 {
            let mean = (errors.image / errors.image_count as f64) as f32;
            self.scales.image = (1.25 * mean).max(MIN_IMAGE_SCALE);
        }
    }

    /// Weight of image residuals: what is left of it where depth is exact. The errors of pictures
    /// are not independent (a map that is still soft is wrong everywhere in the same way), so they
    /// must not outvote a depth that knows better than a millimetre at a metre.
    pub(super) fn image_weight(&self, parameters: &TrackingParameters) -> f32 {
        match self.has_radiance {
            true => parameters.image_weight * (self.scales.depth / COARSE_DEPTH).clamp(0.05, 1.0),
            false => 0.0,
        }
    }
}

impl Frame<'_> {
    /// The scales of residuals. An estimated depth says where pixels are seen from elsewhere, and
    /// nothing of where the camera is.
    pub(super) fn scales(&self, reference: &Reference) -> Scales {
        match self.observation.is_estimated() {
            true => Scales { depth: SILENT, ..reference.scales },
            false => reference.scales,
        }
    }

    /// The weight of image residuals: all of it where no depth counts.
    pub(super) fn image_weight(&self, reference: &Reference) -> f32 {
        let parameters = &self.context.parameters.tracking;
        match self.observation.is_estimated() && reference.has_radiance {
            true => parameters.image_weight,
            false => reference.image_weight(parameters),
        }
    }
}

/// Which of `references` count: the model, and the keyframe where its own depth is far less noisy
/// than the model is wrong: true of an exact depth, not of a sensor's, which the model has
/// averaged.
///
/// The keyframe is judged by the noise of its depth, not by how well it fits at the present pose.
/// Far from the pose that is looked for, where the model fits badly, a noisy one counts too.
pub(super) fn cleanest(references: &[Reference]) -> impl Iterator<Item = (usize, &Reference)> {
    let model = references[0].scales.depth;
    let counts = move |r: &Reference| r.has_radiance || CLEANER * r.levels[0].noise < model;
    references.iter().enumerate().filter(move |(_, reference)| counts(reference))
}
