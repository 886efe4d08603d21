//! Runtime of the parts of a run on this machine, measured on one of its pictures.

use super::Session;
use crate::config::{Config, MapKind};
use crate::keyframes::{EstimatedDepth, PosedKeyframe};
use crate::mapping::GaussianMapper;
use i2slam_geometry::{Camera, Image, Pose, Rotation, Vec3};
use i2slam_odometry::{DenseDepthEstimator, KeyframePictures, PosedView};
use std::sync::Arc;
use std::time::Instant;

/// Optimisation steps per keyframe that are timed.
const TIMED_STEPS: usize = 6;
/// Factor by which each side of the picture is reduced to time dense depth.
const REDUCTION: usize = 4;
/// Shorter side of photographs below which dense depth is not timed [px]: it has too few levels there to be
/// extrapolated.
const MIN_PHOTOGRAPH_SIDE: usize = 60;
/// Keyframes in the timed dense depth, of a film and of photographs: one and those that it is matched with.
const VIEWS: [usize; 2] = [6, 9];
/// Time of a step on Gaussians over that of a timed one, when a keyframe is added and at the end: a room
/// seen from many sides covers itself more than the timed wall, is blurred, and in the end has colours
/// that depend on direction. Measured 1.1 to 1.9 and 2 to 4 on dining-room (with and without half the
/// size) and tum_fr1_rpy_fast.
const ROOM_STEP: [f64; 2] = [1.6, 3.0];
/// Depth of the timed keyframes, typical of a room [m].
const DEPTH: f32 = 2.0;

/// Times of the parts of a run [s].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RuntimeEstimate {
    /// Dense depth of a keyframe.
    pub dense_depth: f64,
    /// A keyframe apart from dense depth and steps.
    pub keyframe: f64,
    /// One step on map and poses.
    pub step: f64,
    /// Localisation of one frame in the map.
    pub frame: f64,
}

impl RuntimeEstimate {
    /// Times a short session on copies of one picture at the depth of a room; larger scenes need
    /// finer fields and more time. Depth is that of photographs if `is_unordered`. `None` if the settings
    /// give no map.
    pub fn measure(
        config: &Config,
        camera: &Camera<f64>,
        frame_rate: f64,
        (colour, is_unordered): (&Arc<Image<f32>>, bool),
    ) -> Option<Self> {
        let mut session = Session::refining(few_steps(config), *camera, frame_rate);
        session.add_keyframe(test_keyframe(camera, colour, 0)).ok()?;
        let clock = Instant::now();
        session.add_keyframe(test_keyframe(camera, colour, 2)).ok()?;
        let second_keyframe = clock.elapsed().as_secs_f64();
        let mut times = Vec::new();
        session.finish(&mut |_, _| {
            times.push(Instant::now());
            times.len() < TIMED_STEPS
        });
        let duration = *times.last()? - *times.first()?;
        let step = duration.as_secs_f64() / (times.len() - 1).max(1) as f64;
        let clock = Instant::now();
        session.localize(test_keyframe(camera, colour, 1)).ok()?;
        let frame = clock.elapsed().as_secs_f64();
        let keyframe = (second_keyframe - TIMED_STEPS as f64 * step).max(frame);
        Some(Self { dense_depth: dense_depth(camera, colour, is_unordered), keyframe, step, frame })
    }

    /// Time of mapping `frames` frames whose poses are known, `dense` of them with dense depth, with the steps
    /// of the keyframes of the path [s].
    pub fn mapping(
        &self,
        config: &Config,
        (path_keyframes, dense): (usize, usize),
        frames: usize,
    ) -> f64 {
        let (per_keyframe, _) = steps(config, path_keyframes);
        let stepping = path_keyframes as f64 * per_keyframe * self.step;
        stepping + dense as f64 * self.dense_depth + frames as f64 * self.keyframe
    }

    /// Time after `keyframes` keyframes among `frames` frames were mapped [s].
    pub fn finish(&self, config: &Config, keyframes: usize, frames: usize) -> f64 {
        let (_, last) = steps(config, keyframes);
        let (keyframes, frames) = (keyframes as f64, frames as f64);
        let localizations =
            relocalizations(config) as f64 * keyframes + (frames - keyframes).max(0.0);
        last * self.step + localizations * self.frame
    }
}

/// Optimisation steps per keyframe, and after the last, counted in timed ones.
fn steps(config: &Config, keyframes: usize) -> (f64, f64) {
    let (mapping, field) = (&config.mapping, &config.hashgrid);
    match config.map.kind {
        MapKind::Gaussian => {
            let [added, last] = ROOM_STEP;
            let final_steps = mapping.final_steps(keyframes) as f64;
            (added * mapping.iterations as f64, last * final_steps)
        }
        MapKind::HashGrid => {
            let share = f64::from(config.parameters.keyframed.surface_steps);
            (field.iterations as f64, share * field.final_iterations as f64)
        }
    }
}

/// Relocalisations of all keyframes at the end.
fn relocalizations(config: &Config) -> usize {
    match config.map.kind {
        MapKind::Gaussian => GaussianMapper::RELOCALIZATIONS,
        MapKind::HashGrid => config.parameters.keyframed.surface_searches,
    }
}

/// The settings with few optimisation steps.
fn few_steps(config: &Config) -> Config {
    let mut few = config.clone();
    let (mapping, field) = (&mut few.mapping, &mut few.hashgrid);
    (mapping.first_iterations, mapping.iterations) = (TIMED_STEPS, TIMED_STEPS);
    (field.first_iterations, field.iterations) = (TIMED_STEPS, TIMED_STEPS);
    (mapping.final_iterations, field.final_iterations) = (4 * TIMED_STEPS, 4 * TIMED_STEPS);
    let keyframed = &mut few.parameters.keyframed;
    (keyframed.first_keyframes, keyframed.surface_steps) = (1, 1.0);
    few
}

/// The picture as a keyframe that has hardly moved in front of a wall.
fn test_keyframe(camera: &Camera<f64>, colour: &Arc<Image<f32>>, index: usize) -> PosedKeyframe {
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
        exposure_motion: None,
        depth: Some(EstimatedDepth { depth: constant(DEPTH), variance }),
        is_keyframe: true,
        fills_depth: true,
    }
}

/// Time of the dense depth of one keyframe [s].
fn dense_depth(camera: &Camera<f64>, colour: &Image<f32>, is_unordered: bool) -> f64 {
    let shorter = camera.width.min(camera.height);
    let reduction = match is_unordered {
        true => (shorter / MIN_PHOTOGRAPH_SIDE).clamp(1, REDUCTION),
        false => REDUCTION,
    };
    let (width, height) = (camera.width / reduction, camera.height / reduction);
    if width.min(height) < 16 {
        return 0.0;
    }
    let small = Arc::new(colour.resized_by_area(width, height));
    let view = |i: usize| PosedView {
        world_from_camera: Pose::new(Rotation::identity(), Vec3::new(0.05 * i as f64, 0.0, 0.0)),
        landmarks: vec![1.0, 2.0, 4.0],
    };
    let count = VIEWS[usize::from(is_unordered)];
    let views = (0..count).map(view).collect();
    let depths = DenseDepthEstimator::new(camera.resized(width, height), views);
    let mut depths = if is_unordered { depths.with_any_order() } else { depths };
    let clock = Instant::now();
    depths.estimate(0, &mut |_| Some(KeyframePictures::colour_only(Arc::clone(&small))));
    clock.elapsed().as_secs_f64() * (reduction * reduction) as f64 / count as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::tracked_tests::{CAMERA, frame};

    #[test]
    fn a_run_takes_the_time_of_its_parts() {
        let mut gaussians = Config::preset("default-rgb").expect("known");
        let mut config = gaussians.clone();
        config.map.kind = MapKind::HashGrid;
        (gaussians.mapping.iterations, gaussians.mapping.final_iterations) = (10, 100);
        let estimate = RuntimeEstimate { dense_depth: 1.0, keyframe: 0.5, step: 0.02, frame: 0.1 };
        // 5 (1 + 1.6 · 10 · 0.02) + 8 · 0.5, and 3 · 100 · 0.02 + (2 · 5 + 45) 0.1
        assert!((estimate.mapping(&gaussians, (5, 5), 8) - 10.6).abs() < 1e-9);
        assert!((estimate.finish(&gaussians, 5, 50) - 11.5).abs() < 1e-9);
        let picture = frame(0, Pose::identity()).colour;
        for config in [config, gaussians] {
            let estimate =
                RuntimeEstimate::measure(&config, &CAMERA, 30.0, (&picture, false)).expect("a map");
            let all = [estimate.keyframe, estimate.step, estimate.frame];
            assert!(all.iter().all(|s| *s > 0.0), "{estimate:?}");
        }
    }
}
