//! The prior's normal equations against its cost, and the measurement on known motions.

use super::*;
use crate::objective::Observation;
use crate::tracking::{SequenceReadout, TrackingContext};
use crate::{Config, FrameEstimate};
use i2slam_check::{assert_gradient, noise};
use i2slam_compute::CancellationToken;
use i2slam_formation::{FrameTone, ShutterPoses, TrajectoryScale};
use i2slam_geometry::{Camera, Image, Pose};

#[test]
fn normal_equations_are_half_the_derivative_of_the_cost() {
    let values = noise(3, 6);
    let prior = ReadoutPrior {
        pixels_per_unit: [130.0, 130.0, 130.0, 260.0, 260.0, 260.0],
        direction: [0.1, -0.7, 0.2, 0.5, 0.3, 0.35],
        length: 7.0,
        readout_ratio: 0.6,
        motion_sigma: 0.9,
        predicted_readout: 1.5,
        readout_sigma: 0.4,
        weight: 20.0,
    };
    let x: Vec<f64> = values.iter().map(|v| 0.02 * v).chain([2.3]).collect();
    let velocity = |x: &[f64]| Tangent::from_array(std::array::from_fn(|i| x[i]));
    let mut equations = Equations::default();
    prior.add_to(velocity(&x), x[6], &mut equations);
    let indices = (VELOCITY..VELOCITY + 6).chain([READOUT]);
    let gradient: Vec<f64> = indices.map(|i| 2.0 * equations.gradient[i]).collect();
    assert_gradient("readout prior", &x, &gradient, 1e-5, 1e-6, |x| prior.cost(velocity(x), x[6]));
}

const CAMERA: Camera<f64> =
    Camera { width: 64, height: 48, fx: 100.0, fy: 100.0, cx: 32.0, cy: 24.0 };
const RATE: f64 = 30.0;
/// Rows are read over half the frame interval, the shutter is open for a quarter.
const SHARE: f64 = 0.5;
const OPEN: f64 = 0.25;

/// The camera after a turn of `pixels`.
fn turned(pixels: f64) -> Pose<f64> {
    Pose::identity().retract(Tangent::from_array([0.0, 0.0, 0.0, 0.0, pixels / CAMERA.fx, 0.0]))
}

/// The readout as measured by the last of `frames`, each given by its time [frame intervals] and
/// rotation [px]; all earlier ones were tracked with the true readout. The last rotates by `speed` px
/// per frame interval while it is exposed.
fn measured(frames: &[(f64, f64)], speed: f64) -> Option<MeasuredReadout> {
    let config = Config::default();
    let (&(now, turn), before) = frames.split_last()?;
    let estimate = |(index, &(time, turn)): (usize, &(f64, f64))| {
        FrameEstimate::at_pose(index, time / RATE, ShutterPoses::still(turned(turn)))
    };
    let estimates: Vec<_> = before.iter().enumerate().map(estimate).collect();
    let observation = Observation::new(Image::new(64, 48, 3), Image::new(64, 48, 1));
    let mut input = config.input.clone();
    (input.optimise_rolling_shutter, input.rolling_shutter_readout) = (true, SHARE / RATE);
    let context = TrackingContext {
        tracking: &config.tracking,
        formation: &config.formation,
        parameters: &config.parameters,
        camera: &CAMERA,
        frame_rate: RATE,
        readout: SequenceReadout::new(&input),
        timestamps: (now / RATE, now / RATE),
        frames: &estimates,
        previous: estimates.last(),
        before_previous: estimates.len().checked_sub(2).map(|i| &estimates[i]),
        expected: None,
        keyframe: None,
        cancellation: &CancellationToken::default(),
    };
    let frame = FrameAlignment {
        context: &context,
        levels: Vec::new(),
        observation: &observation,
        curve: None,
        pixels_per_unit: [50.0, 50.0, 50.0, 100.0, 100.0, 100.0],
        previous_pose: estimates.last()?.middle(),
        predicted_white_balance: [0.0; 3],
        predicted_readout: SHARE / OPEN,
    };
    let velocity = Tangent::from_array([0.0, 0.0, 0.0, 0.0, OPEN * speed / CAMERA.fx, 0.0]);
    frame.measured_readout(&TrackingState {
        motion: CentreVelocity { centre: turned(turn), velocity },
        readout: SHARE / OPEN,
        tone: FrameTone::default(),
        response: None,
        scale: TrajectoryScale::from_frame_rate(RATE),
    })
}

#[test]
fn constant_speed_measures_nothing_even_with_gaps() {
    let even = |times: &[f64]| times.iter().map(|t| (*t, 10.0 * t)).collect::<Vec<_>>();
    for times in [[0.0, 1.0, 2.0, 3.0, 4.0], [0.0, 1.0, 3.0, 4.0, 5.0], [0.0, 1.0, 2.0, 3.0, 5.0]] {
        assert!(measured(&even(&times), 10.0).is_none(), "{times:?}");
    }
}

#[test]
fn a_change_of_speed_measures_the_readout_even_with_gaps() {
    let before = [(0.0, 0.0), (1.0, 10.0), (3.0, 30.0)];
    for (time, turn) in [(4.0, 50.0), (5.0, 70.0)] {
        let found = measured(&[&before[..], &[(time, turn)]].concat(), 20.0).expect("motion");
        assert!((found.seconds * RATE - SHARE).abs() < 1e-9, "{found:?}");
        let deviation = (MEASUREMENT_SIGMA_PX + MOTION_CHANGE_SIGMA_RATIO * 10.0) / 10.0;
        assert!((found.deviation * RATE - deviation).abs() < 1e-9, "{found:?}");
    }
}
