//! Keyframes of a synthetic room with disturbed poses, on both kinds of map.

use super::*;
use crate::keyframes::{EstimatedDepth, PosedKeyframe};
use crate::reconstruction::Map;
use crate::session::tracked_tests::{CAMERA, frame};
use i2slam_check::noise;
use i2slam_formation::FrameTone;
use i2slam_geometry::{Pose, Rotation, Tangent, Vec3};

const KEYFRAMES: usize = 8;

/// World-from-camera of a camera that looks at the far wall from several places.
pub(super) fn pose(index: usize) -> Pose<f64> {
    let t = index as f64 - 3.5;
    let place = Vec3::new(0.07 * t, 0.05 * (1.3 * t).sin(), 0.04 * (0.9 * t).cos());
    Pose::new(Rotation::exp(Vec3::new(0.02 * t.sin(), -0.04 * t, 0.01 * t)), place)
}

/// That pose disturbed by some centimetres and degrees.
fn moved(index: usize) -> Pose<f64> {
    let errors = noise(40 + index as u64, 6);
    pose(index).retract(Tangent::from_array(std::array::from_fn(|i| 0.03 * errors[i])))
}

pub(super) fn keyframe(index: usize, world_from_camera: Pose<f64>) -> PosedKeyframe {
    PosedKeyframe::from_frame(frame(index, pose(index)), world_from_camera)
}

fn config() -> Config {
    let mut config = Config::preset("default-rgb").expect("known");
    config.map.kind = MapKind::HashGrid;
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

fn run(config: Config) -> Session {
    let mut session = Session::refining(config, CAMERA, 30.0);
    for index in 0..KEYFRAMES {
        session.add_keyframe(keyframe(index, moved(index))).expect("keyframes of one size");
    }
    session.finish(&mut |_, _| true);
    assert_eq!(session.take_warnings(), []);
    session
}

/// [`config`] whose steps move the poses at mid-exposure, too, as those of `paper-rgb` do.
fn config_with_moving_poses() -> Config {
    let mut config = config();
    config.parameters.frames.keeps_middle = false;
    config
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
fn disturbed_poses_are_refined_by_colour_alone() {
    let before = errors(&(0..KEYFRAMES).map(moved).collect::<Vec<_>>());
    let session = run(config_with_moving_poses());
    let poses: Vec<Pose<f64>> = session.frames().iter().map(FrameEstimate::middle).collect();
    let after = errors(&poses);
    assert!(after.0 < 0.6 * before.0 && after.1 < 0.6 * before.1, "{before:?} -> {after:?}");
    let reconstruction = session.reconstruction();
    assert!(matches!(reconstruction.map, Map::HashGrid(_)));
    assert!(reconstruction.frames.iter().all(|f| f.keyframe && f.tracked && f.losses.image > 0.0));
}

#[test]
fn without_blur_and_tone_both_poses_are_one() {
    let mut config = config_with_moving_poses();
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
    let mut session = Session::refining(config, CAMERA, 30.0);
    let mut bounds = Vec::new();
    for (index, depth) in [1.0, 1.0, 1.2, 5.0].into_iter().enumerate() {
        let mut image = Image::new(CAMERA.width, CAMERA.height, 1);
        image.data.fill(depth);
        let variance = Some(image.clone());
        let depth = Some(EstimatedDepth { depth: image, variance });
        let keyframe = PosedKeyframe { depth, ..keyframe(index, pose(index)) };
        session.add_keyframe(keyframe).expect("a keyframe");
        bounds.push(match session.reconstruction().map {
            Map::HashGrid(map) => map.field.settings().bound,
            Map::Gaussians(_) => 0.0,
        });
    }
    assert_eq!(bounds[0], 0.0);
    let grows = bounds[1] > 1.0 && bounds[2] >= bounds[1] && bounds[3] > 5.0;
    assert!(grows, "{bounds:?}");
}

/// A frame between keyframes extends the map, and no later step is taken on it.
#[test]
fn a_frame_between_keyframes_is_mapped_and_not_kept() {
    let mut config = Config::preset("default").expect("known");
    (config.mapping.first_iterations, config.mapping.iterations) = (20, 4);
    let mut session = Session::refining(config, CAMERA, 30.0);
    let seen = |index: usize, is_keyframe: bool| {
        let depth = frame(index, pose(index)).depth_image().expect("depth").clone();
        let depth = Some(EstimatedDepth { depth, variance: None });
        PosedKeyframe { depth, is_keyframe, ..keyframe(index, pose(index)) }
    };
    session.add_keyframe(seen(0, true)).expect("a keyframe");
    let before = session.frames()[0].gaussians;
    let between = session.add_keyframe(seen(4, false)).expect("a frame");
    assert!(!between.keyframe && !between.held_out && between.tracked);
    assert!(between.gaussians > before, "{before} -> {}", between.gaussians);
    assert_eq!(session.state.keyframes.len(), 1);
}

/// With depth in most pixels the field is sampled around it alone, and frames are found in it.
#[test]
fn a_field_is_sampled_around_surfaces_where_they_are_known() {
    let mut config = config();
    (config.hashgrid.final_iterations, config.parameters.keyframed.surface_steps) = (20, 2.0);
    config.parameters.keyframed.surface_growth = 1.3;
    config.mapping.hold_out = 5;
    let asked = config.parameters.field.levels;
    let mut session = Session::refining(config, CAMERA, 30.0);
    let seen = |index: usize| {
        let depth = frame(index, pose(index)).depth_image().expect("depth").clone();
        let mut variance = Image::new(CAMERA.width, CAMERA.height, 1);
        variance.data.fill(1e-4);
        let depth = Some(EstimatedDepth { depth, variance: Some(variance) });
        PosedKeyframe { depth, ..keyframe(index, pose(index)) }
    };
    let (held, mapped): (Vec<usize>, Vec<usize>) =
        (0..KEYFRAMES).partition(|&index| session.holds_out(index, index));
    assert_eq!(held, [5]);
    for index in mapped {
        session.add_keyframe(seen(index)).expect("a keyframe");
    }
    let mut steps = 0;
    session.finish(&mut |_, of| {
        steps = of;
        true
    });
    assert_eq!(steps, 40);
    let estimate = session.localize(seen(5)).expect("a frame");
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

fn black_keyframe(index: usize) -> PosedKeyframe {
    let mut keyframe = keyframe(index, pose(index));
    Arc::make_mut(&mut keyframe.colour).data.fill(0.0);
    keyframe
}

type Damage = fn(&mut PosedKeyframe);

#[test]
fn unusable_keyframes_are_refused() {
    let mut session = Session::refining(config(), CAMERA, 30.0);
    let cases: [(Damage, &str); 6] = [
        (|k| k.colour = Arc::new(Image::new(10, 10, 3)), "its colour is (10, 10) pixels"),
        (|k| k.colour = Arc::new(Image::new(CAMERA.width, CAMERA.height, 1)), "3 channels"),
        (|k| Arc::make_mut(&mut k.colour).data.truncate(5), "its colour holds 5 numbers"),
        (|k| k.world_from_camera.translation.x = f64::NAN, "not finite"),
        (|k| k.timestamp = f64::NAN, "time stamp"),
        (|k| k.timestamp = f64::INFINITY, "time stamp"),
    ];
    for (damage, part) in cases {
        let mut damaged = keyframe(7, pose(0));
        damage(&mut damaged);
        let error = session.add_keyframe(damaged).expect_err("damaged").to_string();
        assert!(error.contains("frame 7") && error.contains(part), "{error}");
    }
    assert!(session.frames().is_empty());
    session.add_keyframe(black_keyframe(2)).expect("a picture all the same");
    let warnings = session.take_warnings();
    assert!(warnings.len() == 1 && warnings[0].text.contains("black"), "{warnings:?}");
    assert!(!session.frames()[0].tracked, "nothing of the map was found in it");
    session.finish(&mut |_, _| true);
    assert!(session.reconstruction().map == Map::default());
}

#[test]
fn the_first_exposure_is_initialised_from_a_black_second() {
    let mut session = Session::refining(config(), CAMERA, 30.0);
    session.add_keyframe(keyframe(0, pose(0))).expect("a keyframe");
    session.add_keyframe(black_keyframe(1)).expect("a picture all the same");
    let first = session.frames()[0].shutter;
    assert_ne!(first.start, first.end);
}

#[test]
fn an_unused_quadrature_is_warned_of() {
    let mut config = config();
    config.formation.quadrature = crate::config::Quadrature::Endpoints;
    let warnings = Session::refining(config, CAMERA, 30.0).take_warnings();
    assert!(matches!(&warnings[..], [one] if one.text.contains("quadrature")), "{warnings:?}");
}

#[test]
fn invalid_settings_of_a_field_end_the_session() {
    let mut config = config();
    config.parameters.field.levels = 0;
    let mut session = Session::refining(config, CAMERA, 30.0);
    let error = (0..5).find_map(|i| session.add_keyframe(keyframe(i, pose(i))).err());
    let message = error.expect("a field of no levels").to_string();
    assert!(message.contains("cannot be started") && message.contains("levels"), "{message}");
}

/// World-from-camera of frame `index`; every second one is a keyframe.
pub(super) fn path_pose(index: usize) -> Pose<f64> {
    let t = index as f64;
    let turn = Vec3::new(0.004 * t, 0.008 * t, 0.0);
    Pose::new(Rotation::exp(turn), Vec3::new(0.015 * t, -0.005 * t, 0.01 * t))
}

/// [`pose`] moved by up to a centimetre and half a degree.
fn moved_on_path(index: usize) -> Pose<f64> {
    let errors = noise(60 + index as u64, 6);
    path_pose(index).retract(Tangent::from_array(std::array::from_fn(|i| 0.01 * errors[i])))
}

pub(super) fn posed_on_path(index: usize, with_depth: bool) -> PosedKeyframe {
    let frame = frame(index, path_pose(index));
    let depth = (*frame.depth.as_ref().expect("depth").image).clone();
    let mut variance = depth.clone();
    variance.data.iter_mut().for_each(|v| *v = (0.01 * *v).powi(2));
    let depth = EstimatedDepth { depth, variance: Some(variance) };
    PosedKeyframe {
        before: index.checked_sub(1).map(|i| (i as f64 / 30.0, moved_on_path(i))),
        depth: with_depth.then_some(depth),
        ..PosedKeyframe::from_frame(frame, moved_on_path(index))
    }
}

fn gaussian_session(with_depth: bool) -> Session {
    rolling_session(with_depth, 0.0)
}

/// A finished session with a readout of `readout` [s].
fn rolling_session(with_depth: bool, readout: f64) -> Session {
    let mut session = unfinished(with_depth, readout);
    session.finish(&mut |_, _| true);
    session
}

/// A session before its final optimisation.
pub(super) fn unfinished(with_depth: bool, readout: f64) -> Session {
    let mut config = Config::preset("default-rgb").expect("known");
    config = config.with_found_readout(readout);
    (config.mapping.iterations, config.mapping.final_iterations) = (15, 60);
    let mut session = Session::refining(config, CAMERA, 30.0);
    for index in [0, 2, 4, 6] {
        session.add_keyframe(posed_on_path(index, with_depth)).expect("keyframes of one size");
    }
    session
}

/// Largest position error of a camera relative to the first one [m].
fn farthest(poses: &[(usize, Pose<f64>)]) -> f64 {
    let (first, placed) = (path_pose(poses[0].0).inverse(), poses[0].1.inverse());
    let off = |(index, estimate): &(usize, Pose<f64>)| {
        ((first * path_pose(*index)).translation - (placed * *estimate).translation).norm()
    };
    poses.iter().map(off).fold(0.0, f64::max)
}

/// Small pictures hardly tell rotation from sideways translation: a decimetre of error is allowed.
#[test]
fn frames_are_localised_and_sorted_by_time() {
    let mut session = gaussian_session(true);
    assert!(matches!(session.reconstruction().map, Map::Gaussians(map) if map.len() > 300));
    for index in [1, 3, 5, 4] {
        session.localize(posed_on_path(index, false)).expect("a frame of that size");
    }
    assert_eq!(session.take_warnings(), []);
    let frames = session.frames();
    assert!(frames.iter().map(|f| f.index).eq(0..7), "in order of time, each once");
    for (place, frame) in frames.iter().enumerate() {
        assert!(frame.tracked && frame.keyframe == (place % 2 == 0), "{place}");
    }
    let found: Vec<_> = frames.iter().map(|f| (f.index, f.middle())).collect();
    let off = farthest(&found);
    assert!(off < 0.1, "{off} m");
}

#[test]
fn a_readout_reaches_every_frame_that_is_found() {
    let mut session = rolling_session(true, 0.01);
    session.localize(posed_on_path(3, false)).expect("a frame of that size");
    assert_eq!(session.reconstruction().rolling_shutter_readout, 0.01);
    assert!(session.frames().iter().filter(|f| f.tracked).all(|f| f.readout > 0.0));
    assert!(rolling_session(true, 0.0).frames().iter().all(|f| f.readout == 0.0));
}

/// Metres and radians between two poses.
fn pose_distance(a: Pose<f64>, b: Pose<f64>) -> f64 {
    let off = a.local(b);
    off.translation.norm() + off.rotation.norm()
}

#[test]
fn unrefined_frames_keep_their_pose_relative_to_keyframes() {
    let mut session = gaussian_session(true);
    assert!(!session.insert_unrefined(2, 2.0 / 30.0, moved_on_path(2)), "it is there");
    assert!([5, 1, 3].into_iter().all(|i| session.insert_unrefined(
        i,
        i as f64 / 30.0,
        moved_on_path(i)
    )));
    assert!(!session.insert_unrefined(8, f64::NAN, moved_on_path(8)));
    let frames = session.frames();
    assert!(frames.iter().map(|f| f.index).eq(0..7), "in order, each once");
    assert!([1, 3, 5].iter().all(|i| frames[*i].held_out && !frames[*i].keyframe));
    assert!(frames.iter().all(|frame| frame.refined == frame.index.is_multiple_of(2)));
    for (frame, keyframe) in [(1, 0), (3, 2), (5, 4)] {
        let near = [keyframe, frame + 1].map(|k| moved_on_path(k).inverse() * moved_on_path(frame));
        let there =
            [keyframe, frame + 1].map(|k| frames[k].middle().inverse() * frames[frame].middle());
        let off = |i: usize| pose_distance(near[i], there[i]);
        assert!(off(0).min(off(1)) < 1e-9, "{frame}: {} {}", off(0), off(1));
    }
    session.localize(posed_on_path(3, false)).expect("it is there");
    assert_eq!(session.take_warnings(), []);
    let mut none = Session::refining(Config::default(), CAMERA, 30.0);
    assert!(
        none.insert_unrefined(4, 0.1, moved_on_path(4))
            && none.insert_unrefined(5, 0.2, moved_on_path(5))
    );
    let way = none.frames()[0].middle().inverse() * none.frames()[1].middle();
    assert!(pose_distance(way, moved_on_path(4).inverse() * moved_on_path(5)) < 1e-9);
}

#[test]
fn cancellation_leaves_one_step_per_keyframe() {
    let mapped = |steps: usize, cancellation: CancellationToken| {
        let mut config = Config::preset("default-rgb").expect("known");
        (config.mapping.first_iterations, config.mapping.iterations) = (steps, steps);
        let mut session = Session::refining(config, CAMERA, 30.0);
        session.set_cancellation(cancellation);
        for index in [0, 2] {
            session.add_keyframe(posed_on_path(index, true)).expect("keyframes of one size");
        }
        session.reconstruction().map
    };
    let ended = mapped(30, CancellationToken::when(|| true));
    assert!(
        ended == mapped(1, CancellationToken::default())
            && ended != mapped(30, CancellationToken::default())
    );
}

#[test]
fn a_keyframe_that_is_not_found_is_warned_of() {
    let mut session = unfinished(true, 0.0);
    let away = Tangent::from_array([0.0, 0.0, 0.0, 0.0, 2.0, 0.0]);
    let frame = posed_on_path(8, false);
    let turned = PosedKeyframe { world_from_camera: path_pose(8).retract(away), ..frame };
    session.add_keyframe(turned).expect("a keyframe of that size");
    session.finish(&mut |_, _| true);
    let tracked: Vec<bool> = session.frames().iter().map(|f| f.tracked).collect();
    assert_eq!(tracked, [true, true, true, true, false]);
    let warnings = session.take_warnings();
    let [warning] = &warnings[..] else { panic!("{warnings:?}") };
    assert!(warning.frame == Some(8) && warning.text.contains("not found"), "{warning:?}");
}

#[test]
fn without_any_depth_the_map_stays_empty_with_a_warning() {
    let mut session = gaussian_session(false);
    let warnings = session.take_warnings();
    assert!(
        warnings.iter().any(|w| w.text.contains("no keyframe came with a depth")),
        "{warnings:?}"
    );
    let frame = session.localize(posed_on_path(1, false)).expect("a frame all the same");
    assert!(!frame.tracked && !frame.keyframe);
}

#[test]
fn results_do_not_depend_on_threads() {
    let mut config = config();
    config.hashgrid.final_iterations = 10;
    let field = || run(config.clone()).reconstruction();
    let gaussians = || gaussian_session(true).reconstruction();
    let runs: [&(dyn Fn() -> Reconstruction + Sync); 2] = [&field, &gaussians];
    for run in runs {
        let [one, three] = [1, 3].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            pool.expect("threads").install(run)
        });
        assert!(one.map == three.map);
        for (a, b) in one.frames.iter().zip(&three.frames) {
            assert!(a.shutter == b.shutter && a.tone == b.tone);
        }
    }
}

/// Gaussians of the second keyframe move with it; those of the first stay.
#[test]
fn a_map_of_gaussians_follows_corrected_poses() {
    let mut config = Config::preset("default-rgb").expect("known");
    // Flat ones of the first would be split by the second.
    config.map.isotropic = true;
    (config.mapping.first_iterations, config.mapping.iterations) = (1, 1);
    let mut session = Session::refining(config, CAMERA, 30.0);
    let mut counts = Vec::new();
    for index in [0, 6] {
        let depth = frame(index, pose(index)).depth.expect("measured").image;
        let depth = Some(EstimatedDepth { depth: (*depth).clone(), variance: None });
        let keyframe = PosedKeyframe { depth, ..keyframe(index, pose(index)) };
        counts.push(session.add_keyframe(keyframe).expect("a keyframe").gaussians);
    }
    let means = |session: &Session| match session.reconstruction().map {
        Map::Gaussians(map) => map.means,
        Map::HashGrid(_) => Vec::new(),
    };
    let (before, was) = (means(&session), session.frames()[1].clone());
    assert!(counts[1] > counts[0]);
    session.correct(&BTreeMap::from([(6, moved(6)), (9, moved(1))]));
    let (after, now) = (means(&session), &session.frames()[1]);
    let off = |a: Pose<f64>, b: Pose<f64>| {
        let off = a.local(b);
        off.translation.norm() + off.rotation.norm()
    };
    assert!(off(now.middle(), pose(0).inverse() * moved(6)) < 1e-9);
    let motion = now.middle() * was.middle().inverse();
    assert!(motion.translation.norm() > 1e-3);
    assert!(off(now.shutter.start, motion * was.shutter.start) < 1e-9);
    assert_eq!(before[..counts[0]], after[..counts[0]]);
    for (before, after) in before.iter().zip(&after).skip(counts[0]) {
        let due = motion * Vec3::from_array(*before).cast::<f64>();
        assert!((Vec3::from_array(*after).cast::<f64>() - due).norm() < 1e-5);
    }
}
