//! The formal covariance against the scatter of alignments, and its noise terms.

use super::super::levenberg_marquardt::SolverProgress;
use super::super::residual::{FrameLevel, RobustScales, TargetLevel};
use super::super::target::AlignmentTarget;
use super::*;
use crate::config::Config;
use crate::objective::Observation;
use crate::tracking::{SequenceReadout, TrackingContext};
use i2slam_compute::{CancellationToken, Random};
use i2slam_formation::{CentreVelocity, FrameTone, TrajectoryScale};
use i2slam_geometry::{Camera, Image, Pose, Tangent};

const SIZE: (usize, usize) = (48, 36);
const CAMERA: Camera<f32> =
    Camera { width: 48, height: 36, fx: 45.0, fy: 45.0, cx: 24.0, cy: 18.0 };
fn picture(channels: usize, value: impl Fn(usize, f32, f32) -> f32) -> Image<f32> {
    let mut image = Image::new(SIZE.0, SIZE.1, channels);
    for (i, v) in image.data.iter_mut().enumerate() {
        let (channel, pixel) = (i / (SIZE.0 * SIZE.1), i % (SIZE.0 * SIZE.1));
        *v = value(channel, (pixel % SIZE.0) as f32, (pixel / SIZE.0) as f32);
    }
    image
}

/// Pictures moved by a part of a pixel: at pixel centres a bilinear picture has a kink.
fn radiance(shift: f32) -> Image<f32> {
    let moved = |u: f32, v: f32| (u + shift, v + 0.8 * shift);
    let wave = |c: usize, u: f32, v: f32| {
        0.5 + 0.2 * (0.4 * u + c as f32).sin() + 0.2 * (0.35 * v - 0.1 * u).cos()
    };
    picture(3, |c, u, v| wave(c, moved(u, v).0, moved(u, v).1))
}

fn depth(shift: f32) -> Image<f32> {
    picture(1, |_, u, v| 1.6 + 0.012 * (u + shift) - 0.009 * (v + 0.8 * shift))
}

fn noisy(image: &Image<f32>, sigma: f32, random: &mut Random) -> Image<f32> {
    let mut normal = || (0..12).map(|_| random.uniform() as f32).sum::<f32>() - 6.0;
    let data = image.data.iter().map(|v| v + sigma * normal()).collect();
    Image { data, ..image.clone() }
}

fn targets() -> Vec<AlignmentTarget> {
    vec![AlignmentTarget {
        levels: vec![TargetLevel::new(radiance(0.0), depth(0.0))],
        world_from_camera: Pose::identity(),
        scales: RobustScales { depth: 0.01, image: 0.05 },
        has_radiance: true,
    }]
}

/// Aligns a frame with `noise` of these standard deviations in depth [m] and picture. Returns the
/// final centre, its covariance, and whether the optimisation converged.
fn align(config: &Config, noise: (f32, f32), seed: u64) -> (Tangent<f64>, PoseCovariance, bool) {
    let mut random = Random::new(seed);
    let colour = noisy(&radiance(0.4), noise.1, &mut random);
    let depth = noisy(&depth(0.4), noise.0, &mut random);
    let observation = Observation::new(colour.clone(), depth.clone());
    let camera = CAMERA.cast();
    let context = TrackingContext {
        tracking: &config.tracking,
        formation: &config.formation,
        parameters: &config.parameters,
        camera: &camera,
        frame_rate: 30.0,
        readout: SequenceReadout::new(&config.input),
        timestamps: (0.0, 0.0),
        frames: &[],
        previous: None,
        before_previous: None,
        expected: None,
        keyframe: None,
        cancellation: &CancellationToken::default(),
    };
    let frame = FrameAlignment {
        context: &context,
        levels: vec![FrameLevel::new(CAMERA, colour, depth, 1)],
        observation: &observation,
        curve: None,
        pixels_per_unit: [25.0, 25.0, 25.0, 45.0, 45.0, 45.0],
        previous_pose: Pose::identity(),
        predicted_white_balance: [0.0; 3],
        predicted_readout: 0.0,
    };
    let mut state = TrackingState {
        motion: CentreVelocity { centre: Pose::identity(), velocity: Tangent::zero() },
        readout: 0.0,
        tone: FrameTone::default(),
        response: None,
        scale: TrajectoryScale { a: 1.0 },
    };
    let (mut targets, mut progress) = (targets(), SolverProgress::default());
    let sums = frame.minimize_level(&mut targets, 0, &mut state, &mut progress);
    let end = AlignmentOutcome { state, sums, progress, targets };
    let covariance = frame.covariance(&end).expect("a surface and a texture");
    let centre = Pose::identity().local(end.state.motion.centre);
    assert!(end.progress.steps > 1);
    (centre, covariance, end.progress.converged)
}

/// Forty frames scatter about their mean as much as the covariance says, within a third.
#[test]
fn alignments_scatter_as_the_covariance_says() {
    let mut config = Config::default();
    (config.formation.blur, config.formation.tone) = (false, false);
    let mut ratios = Vec::new();
    for (image_weight, noise) in [(1.0, (1e-4, 0.02)), (0.15, (0.002, 0.02)), (0.5, (0.001, 0.01))]
    {
        config.parameters.tracking.image_weight = image_weight;
        let ends: Vec<_> = (0..40).map(|seed| align(&config, noise, seed)).collect();
        let count = ends.len() as f64;
        assert!(ends.iter().filter(|(_, _, converged)| *converged).count() > 30);
        let mean: [f64; 6] = std::array::from_fn(|i| {
            ends.iter().map(|(t, _, _)| t.to_array()[i]).sum::<f64>() / count
        });
        let variance = |i: usize| {
            let square = |t: &Tangent<f64>| (t.to_array()[i] - mean[i]).powi(2);
            ends.iter().map(|(t, _, _)| square(t)).sum::<f64>() / (count - 1.0)
        };
        let found = [0, 3].map(|from| (from..from + 3).map(variance).sum::<f64>().sqrt());
        let formal = |of: fn(&PoseCovariance) -> f64| {
            ends.iter().map(|(_, c, _)| of(c)).sum::<f64>() / count
        };
        let formal = [formal(PoseCovariance::position), formal(PoseCovariance::rotation)];
        for (found, formal) in found.into_iter().zip(formal) {
            ratios.push(formal / found);
        }
    }
    assert!(ratios.iter().all(|r| (0.75..1.33).contains(r)), "{ratios:?}");
}

/// A straight line through independent noise: `C = (jᵀj)⁻¹ σ²` for its two numbers.
#[test]
fn a_linear_problem_has_its_textbook_covariance() {
    let (mut bread, mut meat) = ([[0.0; UNKNOWNS]; UNKNOWNS], [[0.0; UNKNOWNS]; UNKNOWNS]);
    (0..UNKNOWNS).for_each(|i| bread[i][i] = 1.0);
    let (weight, variance) = (3.0, 0.25);
    (bread[0][0], bread[1][1]) = (0.0, 0.0);
    for i in 0..10 {
        let j = [1.0, f64::from(i)];
        for a in 0..2 {
            for b in a..2 {
                bread[a][b] += weight * j[a] * j[b];
                meat[a][b] += weight * weight * variance * j[a] * j[b];
            }
        }
    }
    let covariance = PoseCovariance::new(&bread, &meat).expect("positive definite");
    // 1/n + x̄²/S and 1/S times the variance, with x̄ = 4.5 and S = 82.5.
    let expected = [variance * (0.1 + 4.5 * 4.5 / 82.5), variance / 82.5];
    assert!((covariance.0[0][0] / expected[0] - 1.0).abs() < 1e-9, "{covariance:?}");
    assert!((covariance.0[1][1] / expected[1] - 1.0).abs() < 1e-9, "{covariance:?}");
    assert!((covariance.position() - (expected[0] + expected[1]).sqrt()).abs() < 1e-12);
    assert_eq!(covariance.rotation(), 0.0);
    bread[3][3] = 0.0;
    assert_eq!(PoseCovariance::new(&bread, &meat), None);
}

#[test]
fn small_residuals_are_least_squares() {
    let noise = ResidualNoise::of_mean_cost(1.2 * 0.01 * 0.01);
    assert!((noise.curvature - 1.0).abs() < 1e-3, "{noise:?}");
    assert!((noise.spread / (1.2 * 1e-4) - 1.0).abs() < 1e-3, "{noise:?}");
}

#[test]
fn the_cost_of_a_spread_leads_back_to_it() {
    let rho = |z: f64| 6.0 * (z * z / 5.0).ln_1p();
    for spread in [0.05, 0.4, 1.0, 3.0] {
        let cost = expected(spread, rho);
        let (found, expected) =
            (ResidualNoise::of_mean_cost(cost), ResidualNoise::of_spread(spread));
        assert!((found.spread / expected.spread - 1.0).abs() < 1e-6, "{spread}");
    }
    let odd = [0.0, f64::NAN, f64::INFINITY].map(ResidualNoise::of_mean_cost);
    assert!(odd.iter().all(|n| n.spread.is_finite() && n.curvature > 0.0));
}

#[test]
fn weights_and_curvature_of_unit_noise() {
    // By independent summation of E[36 z²/(5+z²)²], E[6 (5-z²)/(5+z²)²] and E[6/(5+z²)].
    let (mut a, mut b, mut e) = (0.0, 0.0, 0.0);
    for i in -8000..=8000_i32 {
        let z = f64::from(i) * 1e-3;
        let p = (-0.5 * z * z).exp();
        let d = 5.0 + z * z;
        a += p * 36.0 * z * z / (d * d);
        b += p * 6.0 * (5.0 - z * z) / (d * d);
        e += p * 6.0 / d;
    }
    let noise = ResidualNoise::of_spread(1.0);
    assert!((noise.spread - a / e).abs() < 1e-6 && (noise.curvature - b / e).abs() < 1e-6);
}
