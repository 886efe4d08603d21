//! How long a job by colour alone will take here, measured on one of its pictures.

use super::KeyframeSession;
use crate::config::{Config, MapKind};
use crate::keyframes::{EstimatedDepth, PosedKeyframe};
use crate::mapping::JointGaussianMapper;
use i2slam_geometry::{Camera, Image, Pose, Rotation, Vec3};
use i2slam_odometry::{DenseDepthEstimator, PosedView};
use std::sync::Arc;
use std::time::Instant;

/// Steps of a round that are taken to see how long one takes.
const STEPS: usize = 6;
/// Dense depth is found in pictures so many times smaller a side.
const SMALLER: usize = 4;
/// Keyframes whose depth is found: one and those that it is matched with.
const VIEWS: usize = 6;
/// Depth that all of the picture is given, that of a room.
const DEPTH: f32 = 2.0;

/// Seconds of the parts of a job.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RuntimeEstimate {
    /// Dense depth of a keyframe.
    pub dense_depth: f64,
    /// All that a keyframe takes beside that and the steps.
    pub keyframe: f64,
    /// One step on map and poses.
    pub step: f64,
    /// Finding one frame in the map.
    pub frame: f64,
}

impl RuntimeEstimate {
    /// Does a little of everything with a picture, of which no more than its size and texture
    /// matter, as in a room: larger scenes take fields of more grids, and longer. `None` if these
    /// settings give no map.
    pub fn measure(
        config: &Config,
        camera: &Camera<f64>,
        frame_rate: f64,
        colour: &Arc<Image<f32>>,
    ) -> Option<Self> {
        let mut session = KeyframeSession::new(quick(config), *camera, frame_rate);
        session.process(standing(camera, colour, 0)).ok()?;
        let clock = Instant::now();
        session.process(standing(camera, colour, 2)).ok()?;
        let second = clock.elapsed().as_secs_f64();
        let mut moments = Vec::new();
        session.finish(&mut |_, _| {
            moments.push(Instant::now());
            moments.len() < STEPS
        });
        let lasted = *moments.last()? - *moments.first()?;
        let step = lasted.as_secs_f64() / (moments.len() - 1).max(1) as f64;
        let clock = Instant::now();
        session.locate(standing(camera, colour, 1)).ok()?;
        let frame = clock.elapsed().as_secs_f64();
        let keyframe = (second - STEPS as f64 * step).max(frame);
        Some(Self { dense_depth: dense_depth(camera, colour), keyframe, step, frame })
    }

    /// Seconds for so many keyframes of so many frames, once their path is known.
    pub fn total(&self, config: &Config, keyframes: usize, frames: usize) -> f64 {
        let (round, last) = steps(config);
        let (keyframes, frames) = (keyframes as f64, frames as f64);
        let mapping = keyframes * (self.dense_depth + self.keyframe + round * self.step);
        let finding = searches(config) as f64 * keyframes + (frames - keyframes).max(0.0);
        mapping + last * self.step + finding * self.frame
    }
}

/// Steps for every keyframe, and after the last.
fn steps(config: &Config) -> (f64, f64) {
    let (mapping, field) = (&config.mapping, &config.hashgrid);
    match config.map.kind {
        MapKind::Gaussian => (mapping.iterations as f64, mapping.final_iterations as f64),
        MapKind::HashGrid => {
            let share = f64::from(config.keyframed.surface_steps);
            (field.iterations as f64, share * field.final_iterations as f64)
        }
    }
}

/// Times that all keyframes are found anew at the end.
fn searches(config: &Config) -> usize {
    match config.map.kind {
        MapKind::Gaussian => JointGaussianMapper::RELOCALIZATIONS,
        MapKind::HashGrid => config.keyframed.surface_searches,
    }
}

/// The same settings with rounds of a few steps.
fn quick(config: &Config) -> Config {
    let mut quick = config.clone();
    let (mapping, field) = (&mut quick.mapping, &mut quick.hashgrid);
    (mapping.first_iterations, mapping.iterations) = (STEPS, STEPS);
    (field.first_iterations, field.iterations) = (STEPS, STEPS);
    (mapping.final_iterations, field.final_iterations) = (4 * STEPS, 4 * STEPS);
    (quick.keyframed.first_keyframes, quick.keyframed.surface_steps) = (1, 1.0);
    quick
}

/// The picture as a keyframe that has hardly moved, before a wall.
fn standing(camera: &Camera<f64>, colour: &Arc<Image<f32>>, index: usize) -> PosedKeyframe {
    let constant = |value: f32| {
        let mut image = Image::new(camera.width, camera.height, 1);
        image.data.fill(value);
        image
    };
    let variance = Some(constant((0.01 * DEPTH).powi(2)));
    let turn = Rotation::exp(Vec3::new(0.0, 1e-3 * index as f64, 0.0));
    PosedKeyframe {
        index,
        timestamp: index as f64 / 30.0,
        colour: Arc::clone(colour),
        world_from_camera: Pose::new(turn, Vec3::zero()),
        before: None,
        after: None,
        depth: Some(EstimatedDepth { depth: constant(DEPTH), variance }),
    }
}

/// Seconds for the dense depth of one keyframe.
fn dense_depth(camera: &Camera<f64>, colour: &Image<f32>) -> f64 {
    let (width, height) = (camera.width / SMALLER, camera.height / SMALLER);
    if width.min(height) < 16 {
        return 0.0;
    }
    let small = Arc::new(colour.resized_by_area(width, height));
    let view = |i: usize| PosedView {
        world_from_camera: Pose::new(Rotation::identity(), Vec3::new(0.05 * i as f64, 0.0, 0.0)),
        landmarks: vec![1.0, 2.0, 4.0],
    };
    let views = (0..VIEWS).map(view).collect();
    let mut depths = DenseDepthEstimator::new(camera.resized(width, height), views);
    let clock = Instant::now();
    depths.estimate(0, &mut |_| Some(Arc::clone(&small)));
    clock.elapsed().as_secs_f64() * (SMALLER * SMALLER) as f64 / VIEWS as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::tests::{CAMERA, frame};

    #[test]
    fn a_job_takes_its_parts() {
        let mut gaussians = Config::preset("default-rgb").expect("known");
        let mut config = gaussians.clone();
        config.map.kind = MapKind::HashGrid;
        (gaussians.mapping.iterations, gaussians.mapping.final_iterations) = (10, 100);
        let pace = RuntimeEstimate { dense_depth: 1.0, keyframe: 0.5, step: 0.02, frame: 0.1 };
        // 5 (1 + 0.5 + 10 · 0.02) + 100 · 0.02 + (2 · 5 + 45) 0.1
        assert!((pace.total(&gaussians, 5, 50) - 16.0).abs() < 1e-9);
        let picture = frame(0, Pose::identity()).colour;
        for config in [config, gaussians] {
            let pace = RuntimeEstimate::measure(&config, &CAMERA, 30.0, &picture).expect("a map");
            let all = [pace.keyframe, pace.step, pace.frame];
            assert!(all.iter().all(|s| *s > 0.0 && *s < 60.0), "{pace:?}");
        }
    }
}
