//! Keyframes with estimated depth on Gaussians, and the frames between them.

use super::super::*;
use crate::keyframes::EstimatedDepth;
use crate::reconstruction::Map;
use crate::session::tests::{CAMERA, frame};
use i2slam_check::noise;
use i2slam_geometry::{Rotation, Vec3};

/// World-from-camera of frame `index`; every second one is a keyframe.
fn pose(index: usize) -> Pose<f64> {
    let t = index as f64;
    let turn = Vec3::new(0.004 * t, 0.008 * t, 0.0);
    Pose::new(Rotation::exp(turn), Vec3::new(0.015 * t, -0.005 * t, 0.01 * t))
}

/// [`pose`] moved by up to a centimetre and half a degree.
fn moved(index: usize) -> Pose<f64> {
    let errors = noise(60 + index as u64, 6);
    pose(index).retract(Tangent::from_array(std::array::from_fn(|i| 0.01 * errors[i])))
}

fn posed(index: usize, with_depth: bool) -> PosedKeyframe {
    let frame = frame(index, pose(index));
    let mut variance = (*frame.depth).clone();
    variance.data.iter_mut().for_each(|v| *v = (0.01 * *v).powi(2));
    let depth =
        EstimatedDepth { depth: Arc::unwrap_or_clone(frame.depth), variance: Some(variance) };
    PosedKeyframe {
        index,
        timestamp: frame.timestamp,
        colour: frame.colour,
        world_from_camera: moved(index),
        after: None,
        before: index.checked_sub(1).map(|i| (i as f64 / 30.0, moved(i))),
        depth: with_depth.then_some(depth),
    }
}

fn session(with_depth: bool) -> KeyframeSession {
    rolling_session(with_depth, 0.0)
}

/// A finished session with a readout of `readout` [s].
fn rolling_session(with_depth: bool, readout: f64) -> KeyframeSession {
    let mut session = unfinished(with_depth, readout);
    session.finish(&mut |_, _| true);
    session
}

/// A session to which keyframes may still come.
fn unfinished(with_depth: bool, readout: f64) -> KeyframeSession {
    let mut config = Config::preset("default-rgb").expect("known");
    config = config.with_found_readout(readout);
    (config.mapping.iterations, config.mapping.final_iterations) = (15, 60);
    let mut session = KeyframeSession::new(config, CAMERA, 30.0);
    for index in [0, 2, 4, 6] {
        session.process(posed(index, with_depth)).expect("keyframes of one size");
    }
    session
}

/// Largest distance of a camera from where it is due beside the first one [m].
fn farthest(poses: &[(usize, Pose<f64>)]) -> f64 {
    let (first, placed) = (pose(poses[0].0).inverse(), poses[0].1.inverse());
    let off = |(index, estimate): &(usize, Pose<f64>)| {
        ((first * pose(*index)).translation - (placed * *estimate).translation).norm()
    };
    poses.iter().map(off).fold(0.0, f64::max)
}

/// Pictures as small and smooth as these hardly tell a turn from a step to the side, a degree of
/// the one being three centimetres of the other: cameras stay within a decimetre.
#[test]
fn every_frame_finds_its_place_in_order_of_time() {
    let mut session = session(true);
    assert!(matches!(session.reconstruction().map, Map::Gaussians(map) if map.len() > 500));
    for index in [1, 3, 5, 4] {
        session.locate(posed(index, false)).expect("a frame of that size");
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

/// Rows see the motion of their frame at times of their own.
#[test]
fn a_readout_reaches_every_frame_that_is_found() {
    let mut session = rolling_session(true, 0.01);
    session.locate(posed(3, false)).expect("a frame of that size");
    assert_eq!(session.reconstruction().rolling_shutter_readout, 0.01);
    assert!(session.frames().iter().filter(|f| f.tracked).all(|f| f.readout > 0.0));
    assert!(rolling_session(true, 0.0).frames().iter().all(|f| f.readout == 0.0));
}

#[test]
fn threads_do_not_matter() {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| session(true)).reconstruction()
    };
    let (one, three) = (run(1), run(3));
    assert!(one.map == three.map);
    for (a, b) in one.frames.iter().zip(&three.frames) {
        assert!(a.shutter == b.shutter && a.tone == b.tone);
    }
}

/// Metres and radians between two poses.
fn distance(a: Pose<f64>, b: Pose<f64>) -> f64 {
    let off = a.local(b);
    off.translation.norm() + off.rotation.norm()
}

/// A session that ends early keeps what its source knew of the path.
#[test]
fn frames_that_were_not_reached_are_placed_beside_their_keyframes() {
    let mut session = session(true);
    assert!(!session.insert_unrefined(2, 2.0 / 30.0, moved(2)), "it is there");
    assert!([5, 1, 3].into_iter().all(|i| session.insert_unrefined(i, i as f64 / 30.0, moved(i))));
    assert!(!session.insert_unrefined(8, f64::NAN, moved(8)));
    let frames = session.frames();
    assert!(frames.iter().map(|f| f.index).eq(0..7), "in order, each once");
    assert!([1, 3, 5].iter().all(|i| frames[*i].held_out && !frames[*i].keyframe));
    for (frame, keyframe) in [(1, 0), (3, 2), (5, 4)] {
        let near = [keyframe, frame + 1].map(|k| moved(k).inverse() * moved(frame));
        let there =
            [keyframe, frame + 1].map(|k| frames[k].middle().inverse() * frames[frame].middle());
        let off = |i: usize| distance(near[i], there[i]);
        assert!(off(0).min(off(1)) < 1e-9, "{frame}: {} {}", off(0), off(1));
    }
    session.locate(posed(3, false)).expect("it is there");
    assert_eq!(session.take_warnings(), []);
    let mut none = KeyframeSession::new(Config::default(), CAMERA, 30.0);
    assert!(none.insert_unrefined(4, 0.1, moved(4)) && none.insert_unrefined(5, 0.2, moved(5)));
    let way = none.frames()[0].middle().inverse() * none.frames()[1].middle();
    assert!(distance(way, moved(4).inverse() * moved(5)) < 1e-9);
}

/// A wish to end leaves one step of every round.
#[test]
fn a_round_ends_early_where_that_is_wished() {
    let mapped = |steps: usize, cancellation: CancellationToken| {
        let mut config = Config::preset("default-rgb").expect("known");
        (config.mapping.first_iterations, config.mapping.iterations) = (steps, steps);
        let mut session = KeyframeSession::new(config, CAMERA, 30.0);
        session.set_cancellation(cancellation);
        for index in [0, 2] {
            session.process(posed(index, true)).expect("keyframes of one size");
        }
        session.reconstruction().map
    };
    let ended = mapped(30, CancellationToken::when(|| true));
    assert!(
        ended == mapped(1, CancellationToken::default())
            && ended != mapped(30, CancellationToken::default())
    );
}

/// A keyframe that looks away from all others, and shows no depth, is in the map nowhere.
#[test]
fn a_keyframe_that_is_not_found_is_told_of() {
    let mut session = unfinished(true, 0.0);
    let away = Tangent::from_array([0.0, 0.0, 0.0, 0.0, 2.0, 0.0]);
    let frame = posed(8, false);
    let turned = PosedKeyframe { world_from_camera: pose(8).retract(away), ..frame };
    session.process(turned).expect("a keyframe of that size");
    session.finish(&mut |_, _| true);
    let tracked: Vec<bool> = session.frames().iter().map(|f| f.tracked).collect();
    assert_eq!(tracked, [true, true, true, true, false]);
    let warnings = session.take_warnings();
    let [warning] = &warnings[..] else { panic!("{warnings:?}") };
    assert!(warning.frame == Some(8) && warning.text.contains("not found"), "{warning:?}");
}

#[test]
fn without_any_depth_the_map_stays_empty_and_says_so() {
    let mut session = session(false);
    let warnings = session.take_warnings();
    assert!(
        warnings.iter().any(|w| w.text.contains("no keyframe came with a depth")),
        "{warnings:?}"
    );
    let frame = session.locate(posed(1, false)).expect("a frame all the same");
    assert!(!frame.tracked && !frame.keyframe);
}
