//! A few keyframes of a synthetic room, with poses that err.

use super::super::*;
use crate::keyframes::EstimatedDepth;
use crate::reconstruction::Map;
use crate::session::tests::{CAMERA, frame};
use i2slam_check::noise;
use i2slam_geometry::{Rotation, Vec3};

const KEYFRAMES: usize = 8;

/// World-from-camera of a camera that looks at the far wall from several places.
fn pose(index: usize) -> Pose<f64> {
    let t = index as f64 - 3.5;
    let place = Vec3::new(0.07 * t, 0.05 * (1.3 * t).sin(), 0.04 * (0.9 * t).cos());
    Pose::new(Rotation::exp(Vec3::new(0.02 * t.sin(), -0.04 * t, 0.01 * t)), place)
}

/// Poses moved by some centimetres and degrees.
fn moved(index: usize) -> Pose<f64> {
    let errors = noise(40 + index as u64, 6);
    pose(index).retract(Tangent::from_array(std::array::from_fn(|i| 0.03 * errors[i])))
}

fn keyframe(index: usize, world_from_camera: Pose<f64>) -> PosedKeyframe {
    let frame = frame(index, pose(index));
    PosedKeyframe {
        index,
        timestamp: frame.timestamp,
        colour: frame.colour,
        world_from_camera,
        before: None,
        after: None,
        depth: None,
    }
}

fn config() -> Config {
    let mut config = Config::preset("default-rgb").expect("known");
    config.map.kind = crate::config::MapKind::HashGrid;
    let parameters = &mut config.parameters.field;
    (parameters.levels, parameters.hidden_width, parameters.occupancy_cells) = (6, 16, 24);
    (parameters.step, parameters.step_min, parameters.moment_jitter) = (1.0 / 32.0, 0.05, 1.0);
    let field = &mut config.hashgrid;
    (field.log2_table, field.finest_cell) = (12, 0.05);
    (field.bound, field.rays) = (2.0, 256);
    (field.first_iterations, field.iterations, field.final_iterations) = (20, 5, 260);
    let keyframed = &mut config.parameters.keyframed;
    (keyframed.first_keyframes, keyframed.pose_delay, keyframed.coarse_steps) = (4, 20, 60);
    config
}

fn run(config: Config) -> KeyframeSession {
    let mut session = KeyframeSession::new(config, CAMERA, 30.0);
    for index in 0..KEYFRAMES {
        session.process(keyframe(index, moved(index))).expect("keyframes of one size");
    }
    session.finish(&mut |_, _| true);
    assert_eq!(session.take_warnings(), []);
    session
}

/// Root mean square errors of the motion between keyframes [m, rad].
fn errors(poses: &[Pose<f64>]) -> (f64, f64) {
    let (mut metres, mut radians) = (0.0, 0.0);
    for i in 1..KEYFRAMES {
        let due = pose(i - 1).inverse() * pose(i);
        let error = due.local(poses[i - 1].inverse() * poses[i]);
        metres += error.translation.norm_squared();
        radians += error.rotation.norm_squared();
    }
    let count = (KEYFRAMES - 1) as f64;
    ((metres / count).sqrt(), (radians / count).sqrt())
}

#[test]
fn poses_that_err_are_mended_by_colour_alone() {
    let before = errors(&(0..KEYFRAMES).map(moved).collect::<Vec<_>>());
    let session = run(config());
    let poses: Vec<Pose<f64>> = session.frames().iter().map(FrameEstimate::middle).collect();
    let after = errors(&poses);
    eprintln!("{before:?} -> {after:?}");
    assert!(after.0 < 0.6 * before.0 && after.1 < 0.6 * before.1, "{before:?} -> {after:?}");
    let reconstruction = session.reconstruction();
    assert!(matches!(reconstruction.map, Map::HashGrid(_)));
    assert!(reconstruction.frames.iter().all(|f| f.keyframe && f.tracked && f.losses.image > 0.0));
}

#[test]
fn threads_do_not_matter() {
    let mut config = config();
    config.hashgrid.final_iterations = 10;
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| run(config.clone())).reconstruction()
    };
    let (one, three) = (run(1), run(3));
    assert!(one.map == three.map);
    for (a, b) in one.frames.iter().zip(&three.frames) {
        assert!(a.shutter == b.shutter && a.tone == b.tone);
    }
}

#[test]
fn without_the_module_poses_are_one() {
    let mut config = config();
    let formation = &mut config.formation;
    (formation.blur, formation.tone, formation.trajectory_loss) = (false, false, false);
    config.hashgrid.final_iterations = 4;
    let session = run(config);
    for (index, frame) in session.frames().iter().enumerate() {
        assert_eq!(frame.shutter.start, frame.shutter.end);
        assert_eq!(frame.tone, FrameTone::default());
        let source = moved(0).inverse() * moved(index);
        assert_ne!(frame.middle(), source);
    }
}

#[test]
fn the_cube_grows_with_what_keyframes_see() {
    let mut config = config();
    (config.hashgrid.bound, config.parameters.field.margin) = (0.0, 1.0);
    (config.hashgrid.first_iterations, config.hashgrid.iterations) = (1, 1);
    config.parameters.keyframed.first_keyframes = 2;
    let mut session = KeyframeSession::new(config, CAMERA, 30.0);
    let mut bounds = Vec::new();
    for (index, depth) in [1.0, 1.0, 1.2, 5.0].into_iter().enumerate() {
        let mut image = Image::new(CAMERA.width, CAMERA.height, 1);
        image.data.fill(depth);
        let variance = Some(image.clone());
        let depth = Some(EstimatedDepth { depth: image, variance });
        let keyframe = PosedKeyframe { depth, ..keyframe(index, pose(index)) };
        session.process(keyframe).expect("a keyframe");
        bounds.push(match session.reconstruction().map {
            Map::HashGrid(map) => map.field.settings().bound,
            Map::Gaussians(_) => 0.0,
        });
    }
    assert_eq!(bounds[0], 0.0);
    let grows = bounds[1] > 1.0 && bounds[2] >= bounds[1] && bounds[3] > 5.0;
    assert!(grows, "{bounds:?}");
}

/// With depth in most pixels the field is sampled around it alone, and frames are found in it.
#[test]
fn a_field_is_sampled_around_surfaces_where_they_are_known() {
    let mut config = config();
    (config.hashgrid.final_iterations, config.parameters.keyframed.surface_steps) = (20, 2.0);
    config.parameters.keyframed.surface_growth = 1.3;
    config.mapping.hold_out = 5;
    let asked = config.parameters.field.levels;
    let mut session = KeyframeSession::new(config, CAMERA, 30.0);
    let seen = |index: usize| {
        let depth = Arc::unwrap_or_clone(frame(index, pose(index)).depth);
        let mut variance = Image::new(CAMERA.width, CAMERA.height, 1);
        variance.data.fill(1e-4);
        let depth = Some(EstimatedDepth { depth, variance: Some(variance) });
        PosedKeyframe { depth, ..keyframe(index, pose(index)) }
    };
    let (held, mapped): (Vec<usize>, Vec<usize>) =
        (0..KEYFRAMES).partition(|&index| session.holds_out(index));
    assert_eq!(held, [5]);
    for index in mapped {
        session.process(seen(index)).expect("a keyframe");
    }
    let mut steps = 0;
    session.finish(&mut |_, of| {
        steps = of;
        true
    });
    assert_eq!(steps, 40);
    let estimate = session.locate(seen(5)).expect("a frame");
    assert!(estimate.held_out && !estimate.keyframe);
    let map = match session.reconstruction().map {
        Map::HashGrid(map) => map,
        Map::Gaussians(_) => unreachable!("a field was asked for"),
    };
    let share = map.occupancy.occupied_share();
    assert!(share > 0.001 && share < 0.3, "{share}");
    let field = map.field.settings();
    let finer = f64::from(field.finest_resolution) / f64::from(field.base_resolution);
    let ratio = finer.powf(1.0 / (field.levels - 1) as f64);
    assert!(field.levels > asked && ratio <= 1.3, "{} levels, {ratio}", field.levels);
    let free = pose(3) * Vec3::new(0.0, 0.0, 0.5);
    let at = |p: Vec3<f64>| {
        let settings = map.field.settings();
        let resolution = map.occupancy.settings().resolution as usize;
        let p = p.to_array();
        let cell = [0, 1, 2].map(|k| {
            let unit = (p[k] - settings.centre[k]) / (2.0 * settings.bound) + 0.5;
            (unit * resolution as f64) as usize
        });
        map.occupancy.densities()[(cell[2] * resolution + cell[1]) * resolution + cell[0]]
    };
    assert_eq!(at(pose(0).inverse() * free), 0.0);
}

#[test]
fn keyframes_that_cannot_be_used_are_told_of() {
    let mut session = KeyframeSession::new(config(), CAMERA, 30.0);
    let mut small = keyframe(0, pose(0));
    small.colour = Arc::new(Image::new(10, 10, 3));
    let error = session.process(small).expect_err("too small").to_string();
    assert!(error.contains("colour") && error.contains("10"), "{error}");
    let mut lost = keyframe(7, pose(0));
    lost.world_from_camera.translation.x = f64::NAN;
    let error = session.process(lost).expect_err("no pose").to_string();
    assert!(error.contains("frame 7") && error.contains("not finite"), "{error}");
    let mut grey = keyframe(8, pose(0));
    grey.colour = Arc::new(Image::new(CAMERA.width, CAMERA.height, 1));
    let error = session.process(grey).expect_err("one channel").to_string();
    assert!(error.contains("frame 8") && error.contains("3 channels"), "{error}");
    let mut short = keyframe(9, pose(0));
    Arc::make_mut(&mut short.colour).data.pop();
    let error = session.process(short).expect_err("a number too few").to_string();
    assert!(error.contains("frame 9") && error.contains("colour"), "{error}");
    for stamp in [f64::NAN, f64::INFINITY] {
        let late = PosedKeyframe { timestamp: stamp, ..keyframe(4, pose(0)) };
        let error = session.process(late).expect_err("no time").to_string();
        assert!(error.contains("frame 4") && error.contains("time stamp"), "{error}");
    }
    assert!(session.frames().is_empty());
    let mut black = keyframe(2, pose(0));
    Arc::make_mut(&mut black.colour).data.fill(0.0);
    session.process(black).expect("a picture all the same");
    let warnings = session.take_warnings();
    assert!(warnings.len() == 1 && warnings[0].text.contains("black"), "{warnings:?}");
    session.finish(&mut |_, _| true);
    assert!(session.reconstruction().map == Map::default());
}

#[test]
fn the_first_keyframe_moves_though_the_second_is_black() {
    let mut session = KeyframeSession::new(config(), CAMERA, 30.0);
    session.process(keyframe(0, pose(0))).expect("a keyframe");
    let mut black = keyframe(1, pose(1));
    Arc::make_mut(&mut black.colour).data.fill(0.0);
    session.process(black).expect("a picture all the same");
    let first = session.frames()[0].shutter;
    assert_ne!(first.start, first.end);
}

#[test]
fn a_quadrature_that_is_asked_for_is_told_to_say_nothing() {
    let mut config = config();
    config.formation.quadrature = crate::config::Quadrature::Endpoints;
    let warnings = KeyframeSession::new(config, CAMERA, 30.0).take_warnings();
    assert!(matches!(&warnings[..], [one] if one.text.contains("quadrature")), "{warnings:?}");
}

#[test]
fn a_field_that_cannot_begin_ends_the_session() {
    let mut config = config();
    config.parameters.field.levels = 0;
    let mut session = KeyframeSession::new(config, CAMERA, 30.0);
    let error = (0..5).find_map(|i| session.process(keyframe(i, pose(i))).err());
    let message = error.expect("a field of no levels").to_string();
    assert!(message.contains("cannot be started") && message.contains("levels"), "{message}");
}
