//! Covariance of the aligned pose at mid-exposure (a sandwich estimator).
//!
//! The cost `Σ s_k ρ(r/σ)`, `ρ(z) = (ν+1) ln(1 + z²/ν)` with weights `w(z) = (ν+1)/(ν+z²)`, has the
//! reweighted sums `H_k = Σ s_k w j jᵀ / σ²` for depth (`s` = 1) and picture. Where residuals are
//! normal with spread `n` against their scales, noise of independent pixels moves the minimum with
//! the covariance
//!
//! ```text
//! C = B⁻¹ M B⁻¹,   B = Σ_k c_k H_k + priors,   M = Σ_k s_k m_k H_k
//! c = E[ρ''(z)/2] / E[w(z)],   m = E[w(z)² z²] / E[w(z)],   z ~ N(0, n²)
//! ```
//!
//! and `n` is the one whose expected cost `E[ρ(z)]` equals the mean cost of the residuals. Priors
//! stiffen `B` but are no noise in `M`. The result is formal: neighbouring pixels, the channels of
//! a pixel and all errors of the map are taken to be independent.

use super::levenberg_marquardt::{AlignmentOutcome, EvaluationMode};
use super::target::active_targets;
use super::{FrameAlignment, TrackingState};
use i2slam_compute::solve_positive_definite;
use i2slam_odometry::alignment::{DEGREES_OF_FREEDOM, Equations, ResidualSums, UNKNOWNS};

/// Number of unknowns of the pose at mid-exposure, which come first: ρ, then φ.
const POSE: usize = 6;

/// Samples of the normal density, over [`SIGMA_RANGE`] standard deviations to either side.
const SAMPLES: usize = 64;
const SIGMA_RANGE: f64 = 6.0;
/// Bounds of the spread `n`, between which it is found by bisection on a logarithmic scale.
const SPREAD_BOUNDS: (f64, f64) = (1e-3, 1e3);
const BISECTIONS: usize = 40;

/// A symmetric matrix over all unknowns.
type Matrix = [[f64; UNKNOWNS]; UNKNOWNS];

/// Covariance of (ρ, φ) at mid-exposure [m², m rad, rad²].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PoseCovariance(pub(super) [[f64; POSE]; POSE]);

impl PoseCovariance {
    /// `B⁻¹ M B⁻¹` from the upper triangles of `bread` (`B`) and `meat` (`M`); `None` where `bread`
    /// is not positive definite.
    pub(super) fn new(bread: &Matrix, meat: &Matrix) -> Option<Self> {
        let full = |m: &Matrix, a: usize, b: usize| if a <= b { m[a][b] } else { m[b][a] };
        let mut columns = [[0.0; UNKNOWNS]; POSE];
        for (k, column) in columns.iter_mut().enumerate() {
            let each = (0..UNKNOWNS * UNKNOWNS).map(|i| full(bread, i / UNKNOWNS, i % UNKNOWNS));
            let mut matrix: Vec<f64> = each.collect();
            column[k] = 1.0;
            if !solve_positive_definite(&mut matrix, column) {
                return None;
            }
        }
        let product = |a: usize, b: usize| {
            let row = |i| (0..UNKNOWNS).map(|j| full(meat, i, j) * columns[b][j]).sum::<f64>();
            (0..UNKNOWNS).map(|i| columns[a][i] * row(i)).sum::<f64>()
        };
        let all = std::array::from_fn(|a| std::array::from_fn(|b| product(a, b)));
        Some(Self(all))
    }

    /// Root of the summed variances of the three numbers from `first` on.
    fn deviation(&self, first: usize) -> f64 {
        (first..first + 3).map(|i| self.0[i][i].max(0.0)).sum::<f64>().sqrt()
    }

    /// Standard deviation of the position [m].
    pub(super) fn position(&self) -> f64 {
        self.deviation(0)
    }

    /// Standard deviation of the rotation [rad].
    pub(super) fn rotation(&self) -> f64 {
        self.deviation(3)
    }
}

impl FrameAlignment<'_> {
    /// The formal covariance at the end of an optimisation.
    pub(super) fn covariance(&self, end: &AlignmentOutcome) -> Option<PoseCovariance> {
        let (mut bread, mut meat) = (Equations::default(), [[0.0; UNKNOWNS]; UNKNOWNS]);
        let cameras = self.virtual_cameras(0, &end.state);
        for (_, target) in active_targets(&end.targets) {
            let share = f64::from(self.image_weight(target));
            let of = |mode| self.residuals(target, 0, &end.state, cameras, mode);
            let depth = of(EvaluationMode::DepthOnly);
            let all = if share > 0.0 { of(EvaluationMode::Full) } else { depth.clone() };
            let [by_depth, by_image] = noises(&depth, &all, share);
            for a in 0..UNKNOWNS {
                for b in a..UNKNOWNS {
                    let (d, sum) = (depth.equations.hessian[a][b], all.equations.hessian[a][b]);
                    let image = sum - d;
                    bread.hessian[a][b] += by_depth.curvature * d + by_image.curvature * image;
                    meat[a][b] += by_depth.spread * d + share * by_image.spread * image;
                }
            }
        }
        self.with_priors(&end.state, bread, meat)
    }

    /// Adds the priors and takes out the unknowns that are not free.
    fn with_priors(
        &self,
        state: &TrackingState,
        mut bread: Equations,
        mut meat: Matrix,
    ) -> Option<PoseCovariance> {
        self.add_priors(state, &mut bread);
        for i in 0..UNKNOWNS {
            let alone = (0..UNKNOWNS).all(|a| a == i || bread.hessian[a.min(i)][a.max(i)] == 0.0);
            if alone {
                // Frozen, or without influence.
                bread.hessian[i][i] = 1.0;
                (0..UNKNOWNS).for_each(|a| meat[a.min(i)][a.max(i)] = 0.0);
            }
        }
        PoseCovariance::new(&bread.hessian, &meat)
    }
}

/// The noise of depth and image residuals, from the costs of depth alone and of both.
fn noises(depth: &ResidualSums, all: &ResidualSums, share: f64) -> [ResidualNoise; 2] {
    let (depth, all) = (&depth.equations, &all.equations);
    let mean = |cost: f64, count: usize| if count > 0 { cost / count as f64 } else { 0.0 };
    let share = if share > 0.0 { share } else { 1.0 };
    let image = mean((all.cost - depth.cost) / share, all.count - depth.count);
    [mean(depth.cost, depth.count), image].map(ResidualNoise::of_mean_cost)
}

/// Noise terms of normal residuals under the cost `ρ`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ResidualNoise {
    /// `E[ρ''(z)/2] / E[w(z)]`.
    curvature: f64,
    /// `E[w(z)² z²] / E[w(z)]`.
    spread: f64,
}

impl ResidualNoise {
    /// For the spread whose expected cost `E[ρ(z)]` is `cost`.
    fn of_mean_cost(cost: f64) -> Self {
        let freedom = f64::from(DEGREES_OF_FREEDOM);
        let rho = |z: f64| (freedom + 1.0) * (z * z / freedom).ln_1p();
        let (mut low, mut high) = (SPREAD_BOUNDS.0.ln(), SPREAD_BOUNDS.1.ln());
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + high);
            match expected(middle.exp(), rho) < cost {
                true => low = middle,
                false => high = middle,
            }
        }
        Self::of_spread(low.exp())
    }

    /// For residuals with `spread` times their scale as standard deviation.
    fn of_spread(spread: f64) -> Self {
        let freedom = f64::from(DEGREES_OF_FREEDOM);
        let weight = |z: f64| (freedom + 1.0) / (freedom + z * z);
        let bend = |z: f64| weight(z) * (freedom - z * z) / (freedom + z * z);
        let sum = expected(spread, weight);
        // Residuals beyond the turning point of the cost would make its curvature negative.
        let curvature = (expected(spread, bend) / sum).max(0.05);
        Self { curvature, spread: expected(spread, |z| (weight(z) * z).powi(2)) / sum }
    }
}

/// `E[f(z)]` for `z ~ N(0, spread²)`.
fn expected(spread: f64, f: impl Fn(f64) -> f64) -> f64 {
    let place = |i: usize| SIGMA_RANGE * ((2 * i + 1) as f64 / SAMPLES as f64 - 1.0);
    let (mut sum, mut total) = (0.0, 0.0);
    for x in (0..SAMPLES).map(place) {
        let density = (-0.5 * x * x).exp();
        sum += density * f(spread * x);
        total += density;
    }
    sum / total
}

#[cfg(test)]
mod tests {
    use super::super::levenberg_marquardt::SolverProgress;
    use super::super::target::AlignmentTarget;
    use super::*;
    use crate::config::Config;
    use crate::objective::Observation;
    use crate::tracking::{SequenceReadout, TrackingContext};
    use i2slam_compute::{CancellationToken, Random};
    use i2slam_formation::{CentreVelocity, FrameTone, TrajectoryScale};
    use i2slam_geometry::{Camera, Image, Pose, Tangent};
    use i2slam_odometry::alignment::{FrameLevel, RobustScales, TargetLevel};

    const CAMERA: Camera<f32> =
        Camera { width: 48, height: 36, fx: 45.0, fy: 45.0, cx: 24.0, cy: 18.0 };

    fn picture(channels: usize, value: impl Fn(usize, f32, f32) -> f32) -> Image<f32> {
        Image::from_fn(CAMERA.width, CAMERA.height, channels, |channel, column, row| {
            value(channel, column as f32, row as f32)
        })
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

    /// Aligns a frame with `noise` of these standard deviations in depth [m] and picture. Returns
    /// the final centre, its covariance, and whether the optimisation converged.
    fn align(
        config: &Config,
        noise: (f32, f32),
        seed: u64,
    ) -> (Tangent<f64>, PoseCovariance, bool) {
        let mut random = Random::new(seed);
        let colour = noisy(&radiance(0.4), noise.1, &mut random);
        let depth = noisy(&depth(0.4), noise.0, &mut random);
        let observation = Observation::new(colour.clone(), depth.clone());
        let camera = CAMERA.cast();
        let context = TrackingContext {
            config,
            camera: &camera,
            frame_rate: 30.0,
            readout: SequenceReadout::new(&config.input),
            timestamps: (0.0, 0.0),
            frames: &[],
            previous: None,
            before_previous: None,
            exposure_motion: None,
            expected: None,
            keyframe: None,
            white_balance: config.formation.white_balance,
            vignetting: None,
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
        for (image_weight, noise) in
            [(1.0, (1e-4, 0.02)), (0.15, (0.002, 0.02)), (0.5, (0.001, 0.01))]
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
}
