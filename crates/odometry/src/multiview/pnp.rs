//! Perspective-n-point: the pose of a picture from known landmarks.

use crate::multiview::landmark::{MAX_INLIER_ERROR, Match, reprojection_error};
use crate::multiview::robust_loss::{cauchy, length};
use i2slam_compute::NormalEquations;
use i2slam_geometry::{Camera, Pose, Tangent};

/// Widths of the Cauchy loss in turn [standard deviations]: wide converges, narrow rejects.
const LOSS_WIDTHS: [f64; 3] = [40.0, 12.0, 3.0];
const MAX_STEPS: usize = 12;
/// A pose with its support.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PnpSolution {
    pub(crate) world_from_camera: Pose<f64>,
    /// Matches within [`MAX_INLIER_ERROR`].
    pub(crate) inliers: usize,
}

/// The pose of least robust cost from `start` on; residuals of positions are `noise` times as large as their
/// deviations say. `None` for fewer than six matches.
pub(crate) fn solve_pnp(
    camera: &Camera<f64>,
    start: Pose<f64>,
    matches: &[Match<'_>],
    noise: f64,
) -> Option<PnpSolution> {
    if matches.len() < 6 {
        return None;
    }
    let mut pose = start;
    for width in LOSS_WIDTHS {
        pose = minimize(camera, pose, (matches, noise), |n| cauchy(n, noise * width));
    }
    let inliers = matches
        .iter()
        .filter(|m| reprojection_error(camera, &pose, m) < MAX_INLIER_ERROR * noise)
        .count();
    pose.is_finite().then_some(PnpSolution { world_from_camera: pose, inliers })
}

/// The least-squares pose of a minimal sample of matches, from `start` on.
pub(crate) fn solve_pnp_minimal(
    camera: &Camera<f64>,
    start: Pose<f64>,
    matches: &[Match<'_>],
) -> Pose<f64> {
    minimize(camera, start, (matches, 1.0), |n| (1.0, n * n))
}

/// The pose of least Cauchy loss of some width [standard deviations], from `start` on.
pub(crate) fn refine_pnp(
    camera: &Camera<f64>,
    start: Pose<f64>,
    matches: &[Match<'_>],
    width: f64,
) -> Pose<f64> {
    minimize(camera, start, (matches, 1.0), |n| cauchy(n, width))
}

/// Levenberg-Marquardt on the six parameters of a pose.
fn minimize(
    camera: &Camera<f64>,
    start: Pose<f64>,
    (matches, noise): (&[Match<'_>], f64),
    loss: impl Fn(f64) -> (f64, f64),
) -> Pose<f64> {
    let (mut pose, mut damping) = (start, 1e-4);
    let mut equations = normal_equations(camera, &pose, (matches, noise), &loss);
    for _ in 0..MAX_STEPS {
        let Some(step) = equations.step(damping) else { break };
        let tried = pose.retract(Tangent::from_array(step));
        let next = normal_equations(camera, &tried, (matches, noise), &loss);
        if next.cost < equations.cost {
            let gained = equations.cost - next.cost;
            (pose, equations, damping) = (tried, next, damping * 0.2);
            if gained < 1e-7 * equations.cost {
                break;
            }
        } else {
            damping *= 10.0;
            if damping > 1e3 {
                break;
            }
        }
    }
    pose
}

/// Sums over positions and measured depths of all matches with the loss as cost, that of 100
/// deviations behind the camera. Positions are `noise` times as far off as their deviations say,
/// depths as far as theirs.
fn normal_equations(
    camera: &Camera<f64>,
    pose: &Pose<f64>,
    (matches, noise): (&[Match<'_>], f64),
    loss: &impl Fn(f64) -> (f64, f64),
) -> NormalEquations<6> {
    let mut sum = NormalEquations::default();
    let mut cost = 0.0;
    for (landmark, observation) in matches {
        let Some(p) = landmark.project(camera, pose) else {
            cost += loss(100.0).1;
            continue;
        };
        let r: [f64; 2] = std::array::from_fn(|i| p.at[i] - observation.at()[i]);
        let (weight, of_position) = loss(length(r) / observation.sigma());
        cost += of_position;
        for i in 0..2 {
            sum.add(&p.by_pose[i], r[i], weight / (observation.sigma() * observation.sigma()));
        }
        if let Some(depth) = &observation.depth() {
            let (r, sigma) = (p.inverse_depth - depth.inverse, depth.sigma / noise);
            let (weight, of_depth) = loss(r.abs() / sigma);
            cost += of_depth;
            sum.add(&p.by_pose[2], r, weight / (sigma * sigma));
        }
    }
    sum.cost = cost;
    sum
}
