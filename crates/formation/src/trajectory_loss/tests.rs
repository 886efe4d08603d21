use super::{TrajectoryPair, TrajectoryScale};
use crate::shutter::{ShutterPoses, ShutterTangent};
use i2slam_check::{assert_gradient, noise};
use i2slam_geometry::{Pose, Rotation, Tangent, Vec3};

fn tangent(values: &[f64]) -> Tangent<f64> {
    Tangent::from_array(std::array::from_fn(|i| values[i]))
}

fn base() -> Pose<f64> {
    Pose::new(Rotation::exp(Vec3::new(-0.4, 1.9, 0.3)), Vec3::new(0.3, -1.0, 0.5))
}

fn pair(seed: u64, motion: f64) -> TrajectoryPair<f64> {
    let step = |k: u64| tangent(&noise(seed + k, 6)).scaled(motion);
    let start = base();
    let end = start.retract(step(0));
    let next = end.retract(step(1));
    TrajectoryPair {
        previous: ShutterPoses { start, end },
        current: ShutterPoses { start: next, end: next.retract(step(2)) },
        exposure_previous: 0.7,
        exposure_current: 1.3,
        scale: TrajectoryScale { a: 0.21 },
    }
}

/// `x`: tangents of both shutters (12 + 12), changes of both log exposures, change of `a`.
fn moved(pair: &TrajectoryPair<f64>, x: &[f64]) -> TrajectoryPair<f64> {
    let shutter = |from: usize| ShutterTangent::from_array(std::array::from_fn(|i| x[from + i]));
    TrajectoryPair {
        previous: pair.previous.retract(&shutter(0)),
        current: pair.current.retract(&shutter(12)),
        exposure_previous: pair.exposure_previous * x[24].exp(),
        exposure_current: pair.exposure_current * x[25].exp(),
        scale: TrajectoryScale { a: pair.scale.a + x[26] },
    }
}

#[test]
fn gradient_agrees_with_differences() {
    for (seed, motion) in [(1, 0.02), (5, 0.3), (9, 0.6)] {
        let pair = pair(seed, motion);
        let g = pair.loss_and_gradient().1;
        let mut gradient = g.previous.to_array().to_vec();
        gradient.extend(g.current.to_array());
        gradient.extend([g.log_exposure_previous, g.log_exposure_current, g.scale]);
        assert_gradient("trajectory loss", &[0.0; 27], &gradient, 1e-3, 1e-6, |x| {
            moved(&pair, x).loss_and_gradient().0.total()
        });
    }
}

/// A camera in steady motion at `f` frames per second, with the given exposures [s].
fn steady(f: f64, exposures: [f64; 2]) -> TrajectoryPair<f64> {
    let velocity = tangent(&[0.5, -0.2, 0.1, 0.2, 0.4, -0.3]);
    let at = |time: f64| Pose {
        rotation: base().rotation * Rotation::exp(velocity.rotation * time),
        translation: base().translation + velocity.translation * time,
    };
    let shutter = |middle: f64, exposure: f64| ShutterPoses {
        start: at(middle - 0.5 * exposure),
        end: at(middle + 0.5 * exposure),
    };
    TrajectoryPair {
        previous: shutter(0.0, exposures[0]),
        current: shutter(1.0 / f, exposures[1]),
        exposure_previous: exposures[0],
        exposure_current: exposures[1],
        scale: TrajectoryScale::from_frame_rate(f),
    }
}

#[test]
fn steady_motion_at_half_the_frame_rate_costs_nothing() {
    let pair = steady(25.0, [0.01, 0.03]);
    assert!(pair.loss_and_gradient().0.total() < 1e-24, "{:?}", pair.loss_and_gradient().0);
    let faster = TrajectoryPair { exposure_current: 0.02, ..pair };
    assert!(faster.loss_and_gradient().0.total() > 1e-6, "a wrong exposure is noticed");
}

#[test]
fn the_scale_absorbs_the_unit_of_time() {
    let seconds = steady(25.0, [0.01, 0.03]);
    let unit = seconds.exposure_previous;
    let relative = TrajectoryPair {
        exposure_previous: 1.0,
        exposure_current: seconds.exposure_current / unit,
        scale: TrajectoryScale::from_open_share(25.0 * unit),
        ..seconds
    };
    assert!(relative.loss_and_gradient().0.total() < 1e-24);
}

#[test]
fn the_loss_does_not_depend_on_the_world_frame() {
    let pair = pair(3, 0.4);
    let other = Pose::new(Rotation::exp(Vec3::new(2.0, 1.0, -0.7)), Vec3::new(5.0, 1.0, -9.0));
    let carried =
        |s: ShutterPoses<f64>| ShutterPoses { start: other * s.start, end: other * s.end };
    let elsewhere =
        TrajectoryPair { previous: carried(pair.previous), current: carried(pair.current), ..pair };
    let (here, there) = (pair.loss_and_gradient().0, elsewhere.loss_and_gradient().0);
    assert!((here.rotation - there.rotation).abs() < 1e-12);
    assert!((here.translation - there.translation).abs() < 1e-12);
    assert!(here.rotation > 1e-3 && here.translation > 1e-3);
}
