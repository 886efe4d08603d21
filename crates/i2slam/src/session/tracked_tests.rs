//! A few synthetic frames through a session that tracks them.

use super::*;
use crate::config::{Config, MapKind, TrackingMethod};
use crate::reconstruction::{Map, Reconstruction};
use crate::warning::Warning;
use i2slam_compute::CancellationToken;
use i2slam_dataset::{DepthPicture, Frame};
use i2slam_geometry::{Camera, Image, Pose, Rotation, Vec3};
use std::sync::Arc;

pub(super) const CAMERA: Camera<f64> =
    Camera { width: 48, height: 36, fx: 40.0, fy: 40.0, cx: 24.0, cy: 18.0 };
const FRAMES: usize = 5;

/// Half edges of the room [m].
const WALLS: [f64; 3] = [0.8, 0.6, 1.6];

/// Picture and depth of a room whose walls have a pattern each.
pub(super) fn frame(index: usize, pose: Pose<f64>) -> Frame {
    let mut colour = Image::new(CAMERA.width, CAMERA.height, 3);
    let mut depth = Image::new(CAMERA.width, CAMERA.height, 1);
    let origin = pose.translation.to_array();
    for row in 0..CAMERA.height {
        for column in 0..CAMERA.width {
            let (u, v) = Camera::<f64>::pixel_centre(column, row);
            let direction = pose.rotation.rotate(CAMERA.unproject(u, v, 1.0)).to_array();
            let wall = |k: usize| (WALLS[k] * direction[k].signum() - origin[k]) / direction[k];
            let axis = (0..3).min_by(|&a, &b| wall(a).total_cmp(&wall(b))).unwrap_or(0);
            let d = wall(axis);
            let place: [f64; 3] = std::array::from_fn(|k| origin[k] + d * direction[k]);
            let (a, b) = (place[(axis + 1) % 3], place[(axis + 2) % 3]);
            for c in 0..3 {
                let pattern = (5.0 * a + c as f64).sin() * (4.0 * b + axis as f64).cos();
                let value = 0.45 + 0.3 * pattern;
                colour.data[(c * CAMERA.height + row) * CAMERA.width + column] = value as f32;
            }
            depth.data[row * CAMERA.width + column] = d as f32;
        }
    }
    let timestamp = index as f64 / 30.0;
    let depth = Some(DepthPicture { image: Arc::new(depth), timestamp });
    Frame { depth, ..Frame::colour_only(index, timestamp, colour) }
}

/// World-from-camera of a frame; identity for the first.
fn pose(index: usize) -> Pose<f64> {
    let t = index as f64;
    let turn = Vec3::new(0.004 * t, 0.012 * t, 0.0);
    Pose::new(Rotation::exp(turn), Vec3::new(0.015 * t, -0.005 * t, 0.01 * t))
}

/// World-from-camera of a camera that rotates ever faster.
fn faster(index: usize) -> Pose<f64> {
    let t = index as f64;
    Pose::new(Rotation::exp(Vec3::new(0.0, 0.02 * t * t, 0.0)), Vec3::zero())
}

/// Settings of a map of balls, as frames have that are tracked against it.
fn balls() -> Config {
    let mut config = Config::default();
    config.map.isotropic = true;
    config
}

/// A field as of the paper's presets, whose keyframes keep their poses, with second-order tracking.
fn config() -> Config {
    let mut config = Config::default();
    config.map.kind = MapKind::HashGrid;
    config.mapping.window = 8;
    let parameters = &mut config.parameters;
    parameters.field = Config::preset("paper-scannet").expect("known").parameters.field;
    parameters.frames.white_balance_rate = 5e-4;
    parameters.tracking.keyframe_depth = true;
    let parameters = &mut parameters.field;
    (parameters.levels, parameters.hidden_width, parameters.occupancy_cells) = (6, 16, 48);
    let field = &mut config.hashgrid;
    (field.log2_table, field.finest_cell) = (12, 0.05);
    (field.rays, field.first_iterations, field.iterations) = (1024, 200, 20);
    field.final_iterations = 100;
    config
}

fn run(config: Config, pose: fn(usize) -> Pose<f64>) -> (Reconstruction, Vec<Warning>) {
    let mut session = Session::tracking(config, CAMERA, 30.0);
    for index in 0..FRAMES {
        session.track(&frame(index, pose(index))).expect("frames of one size");
    }
    session.finish(&mut |_, _| true);
    (session.reconstruction(), session.take_warnings())
}

/// All frames are tracked, with errors below the limits [m, rad].
fn check_poses(
    reconstruction: &Reconstruction,
    pose: impl Fn(usize) -> Pose<f64>,
    limits: (f64, f64),
) {
    for (index, estimate) in reconstruction.frames.iter().enumerate() {
        let error = estimate.middle().local(pose(index));
        let (metres, radians) = (error.translation.norm(), error.rotation.norm());
        let is_close = metres < limits.0 && radians < limits.1;
        assert!(estimate.tracked && is_close, "{index}: {metres} m, {radians} rad");
    }
}

/// The mean depth error at a frame is below 5 cm.
fn check_depth(reconstruction: &Reconstruction, index: usize, true_pose: Pose<f64>) {
    let depth = reconstruction.viewer().depth(reconstruction.frames[index].middle());
    let truth = frame(0, true_pose);
    let truth = truth.depth_image().expect("depth");
    let errors = depth.data.iter().zip(&truth.data).map(|(a, b)| (a - b).abs());
    let error = errors.sum::<f32>() / depth.data.len() as f32;
    assert!(error < 0.05, "{error} m");
}

#[test]
fn a_camera_is_tracked_on_a_field_the_same_way_twice() {
    let (reconstruction, warnings) = run(config(), pose);
    assert!(reconstruction.map == run(config(), pose).0.map);
    assert!(warnings.is_empty(), "{warnings:?}");
    assert!(matches!(reconstruction.map, Map::HashGrid(_)));
    check_poses(&reconstruction, pose, (0.01, 0.004));
    let mut viewer = reconstruction.viewer();
    let last = &reconstruction.frames[FRAMES - 1];
    let truth = frame(0, pose(FRAMES - 1));
    let picture = viewer.sharp(last);
    let squared = picture.data.iter().zip(&truth.colour.data).map(|(a, b)| (a - b).powi(2));
    let psnr = -10.0 * (squared.sum::<f32>() / picture.data.len() as f32).log10();
    assert!(psnr > 24.0, "{psnr} dB");
    check_depth(&reconstruction, FRAMES - 1, pose(FRAMES - 1));
}

/// Pixels are 4 cm apart on the far wall, cells 2 cm.
#[test]
fn pixels_coarser_than_cells_leave_no_holes() {
    let mut config = config();
    config.parameters.field.occupancy_cells = 200;
    config.hashgrid.first_iterations = 80;
    let mut session = Session::tracking(config, CAMERA, 30.0);
    session.track(&frame(0, pose(0))).expect("a frame");
    let reconstruction = session.reconstruction();
    let turn = Vec3::new(0.5 / CAMERA.fy, 0.5 / CAMERA.fx, 0.0);
    let between = Pose::new(Rotation::exp(turn), Vec3::zero());
    let depth = reconstruction.viewer().depth(between);
    let seen = depth.data.iter().filter(|&&d| d > 0.0).count() as f64 / depth.data.len() as f64;
    assert!(seen > 0.9, "{seen}");
}

#[test]
fn a_scene_beyond_the_cube_is_warned_of() {
    let mut config = config();
    (config.hashgrid.bound, config.hashgrid.first_iterations) = (1.0, 1);
    let mut session = Session::tracking(config, CAMERA, 30.0);
    session.track(&frame(0, pose(0))).expect("a frame");
    let warnings = session.take_warnings();
    assert!(warnings.len() == 1 && warnings[0].text.contains("hashgrid.bound"), "{warnings:?}");
}

/// World-from-camera of a camera that rotates away from the near wall on its right.
fn turning(index: usize) -> Pose<f64> {
    let angle = std::f64::consts::FRAC_PI_2 - 0.1 * index as f64;
    Pose::new(Rotation::exp(Vec3::new(0.0, angle, 0.0)), Vec3::zero())
}

#[test]
fn the_cube_grows_with_what_is_seen() {
    let frames = 7;
    let mut session = Session::tracking(config(), CAMERA, 30.0);
    let mut bounds = Vec::new();
    for index in 0..frames {
        session.track(&frame(index, turning(index))).expect("frames of one size");
        let Map::HashGrid(map) = session.reconstruction().map else { panic!("not a field") };
        bounds.push(map.field.settings().bound);
    }
    assert_eq!(session.take_warnings(), []);
    assert!(bounds[0] < 1.2 && bounds[frames - 1] >= 1.5 * bounds[0], "{bounds:?}");
    let reconstruction = session.reconstruction();
    let world = turning(0).inverse();
    check_poses(&reconstruction, |index| world * turning(index), (0.04, 0.02));
    // Surfaces observed before the cube grew are still there.
    check_depth(&reconstruction, 0, turning(0));
}

#[test]
fn invalid_settings_of_a_field_end_the_session() {
    let mut config = config();
    config.parameters.field.levels = 0;
    let mut session = Session::tracking(config, CAMERA, 30.0);
    let error = session.track(&frame(0, pose(0))).expect_err("a field of no levels").to_string();
    assert!(error.contains("cannot be started") && error.contains("levels"), "{error}");
    session.finish(&mut |_, _| panic!("there is no map to refine"));
    assert_eq!(session.take_warnings(), []);
}

#[test]
fn frames_that_start_a_map_which_stays_empty_are_not_tracked() {
    let mut config = balls();
    // Every Gaussian is larger than the scene, and pruned.
    config.parameters.gaussians.initial_scale = 1e30;
    let (reconstruction, _) = run(config.clone(), pose);
    assert!(reconstruction.map.is_empty());
    let tracked = reconstruction.frames.iter().filter(|f| f.tracked).count();
    assert_eq!((tracked, reconstruction.frames.len()), (0, FRAMES));
    config.parameters.gaussians.initial_scale = 0.5;
    assert!(run(config, pose).0.frames.iter().all(|f| f.tracked));
}

#[test]
fn frames_without_a_depth_picture_are_predicted_and_told_once() {
    let mut session = Session::tracking(balls(), CAMERA, 30.0);
    for index in 0..FRAMES {
        let with = frame(index, pose(index));
        let given = if index % 2 == 0 { with } else { Frame { depth: None, ..with } };
        session.track(&given).expect("a frame with or without depth");
    }
    let tracked: Vec<bool> = session.frames().iter().map(|frame| frame.tracked).collect();
    assert_eq!(tracked, [true, false, true, false, true]);
    let told = session.take_warnings();
    let told: Vec<_> = told.iter().filter(|w| w.text.contains("no depth picture")).collect();
    assert!(told.len() == 1 && told[0].frame == Some(1), "{told:?}");
}

#[test]
fn results_do_not_depend_on_threads() {
    let mut config = config();
    config.map.kind = MapKind::Gaussian;
    config.mapping.final_iterations = 5;
    let [one, three] = [1, 3].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| run(config.clone(), pose)).0
    });
    assert!(one.map == three.map);
    for (a, b) in one.frames.iter().zip(&three.frames) {
        assert!(a.tracked && a.shutter == b.shutter && a.gaussians > 0);
    }
}

#[test]
fn first_order_steps_keep_the_convergence_of_alignment() {
    let mut config = balls();
    config.tracking.iterations = 1;
    config.mapping.final_iterations = 1;
    config.input.optimise_rolling_shutter = true;
    config.input.rolling_shutter_readout = 0.01;
    let (reconstruction, _) = run(config, faster);
    for estimate in &reconstruction.frames[1..] {
        let found = estimate.convergence;
        assert!(estimate.tracked && found.iterations > 0, "{}: {found:?}", estimate.index);
        assert!(found.position_deviation.is_some() && found.rotation_deviation.is_some());
    }
    assert_ne!(reconstruction.rolling_shutter_readout, 0.01);
}

#[test]
fn a_still_camera_shows_no_readout() {
    let mut config = balls();
    config.input.optimise_rolling_shutter = true;
    config.mapping.first_iterations = 10;
    let is_missing = |path: fn(usize) -> Pose<f64>, optimise: bool| {
        let mut config = config.clone();
        config.input.optimise_rolling_shutter = optimise;
        let mut session = Session::tracking(config, CAMERA, 30.0);
        (0..FRAMES).for_each(|i| drop(session.track(&frame(i, path(i)))));
        session.is_readout_missing()
    };
    assert!(is_missing(|_| Pose::identity(), true));
    assert!(!is_missing(|_| Pose::identity(), false) && !is_missing(faster, true));
}

/// Pose of the second frame after first-order tracking, cancelled or not.
fn pose_after_steps(iterations: usize, cancelled: bool) -> Pose<f64> {
    let mut config = balls();
    let frames = &mut config.parameters.frames;
    (frames.motion_rotation_rate, frames.motion_translation_rate) = (0.0, 0.0);
    config.tracking.method = TrackingMethod::Adam;
    config.tracking.iterations = iterations;
    let mut session = Session::tracking(config, CAMERA, 30.0);
    session.track(&frame(0, pose(0))).expect("a frame");
    if cancelled {
        session.set_cancellation(CancellationToken::when(|| true));
    }
    session.track(&frame(1, pose(1))).expect("a frame").middle()
}

#[test]
fn first_order_steps_can_be_cancelled() {
    assert_eq!(pose_after_steps(8, true), pose_after_steps(1, false));
    assert_ne!(pose_after_steps(8, true), pose_after_steps(8, false));
}
