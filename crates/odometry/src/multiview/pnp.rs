//! Perspective-n-point: the pose of a picture from known landmarks.

use crate::multiview::landmark::{
    MAX_INLIER_ERROR, Match, registration_error, registration_whitening,
};
use crate::multiview::robust_loss::{cauchy, length};
use i2slam_compute::{NormalEquations, Random};
use i2slam_geometry::{Camera, Pose, Tangent};

/// Widths of the Cauchy loss in turn [standard deviations]: wide converges, narrow rejects.
const LOSS_WIDTHS: [f64; 3] = [40.0, 12.0, 3.0];
const MAX_STEPS: usize = 12;
/// Hypotheses of RANSAC, and matches of each.
const HYPOTHESES: usize = 300;
const SAMPLE_SIZE: usize = 4;
/// Samples of inliers alone after which RANSAC ends: positions are noisy, and the best of several samples is
/// near enough to all inliers for the adjustment that follows.
const GOOD_SAMPLES: f64 = 20.0;
/// Residual at which the RANSAC cost is truncated, also of inliers [standard deviations].
const MAX_RANSAC_ERROR: f64 = 3.0;
/// Inliers of the RANSAC pose, and their ratio of all matches.
const MIN_RANSAC_INLIERS: usize = 12;
const MIN_RANSAC_INLIER_RATIO: f64 = 0.25;

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
        pose = minimize(camera, pose, (matches, noise), |n| cauchy(n, width));
    }
    let inliers = matches
        .iter()
        .filter(|m| registration_error(camera, &pose, m, noise) < MAX_INLIER_ERROR)
        .count();
    pose.is_finite().then_some(PnpSolution { world_from_camera: pose, inliers })
}

/// The pose of least truncated cost among those of random samples, each found from `start` on; `None` where
/// too few matches agree with it.
pub(crate) fn solve_pnp_ransac(
    camera: &Camera<f64>,
    start: Pose<f64>,
    matches: &[Match<'_>],
) -> Option<Pose<f64>> {
    if matches.len() < MIN_RANSAC_INLIERS {
        return None;
    }
    let (pose, inliers) = pose_of_samples(camera, &[start], matches, HYPOTHESES)?;
    let enough = inliers.len() >= MIN_RANSAC_INLIERS
        && inliers.len() as f64 >= MIN_RANSAC_INLIER_RATIO * matches.len() as f64;
    enough.then(|| solve_pnp(camera, pose, &inliers, 1.0).map(|r| r.world_from_camera)).flatten()
}

/// The pose of least truncated cost among those of random samples, each found from one of `starts` on, and
/// the matches that agree with it.
pub(crate) fn pose_of_samples<'a>(
    camera: &Camera<f64>,
    starts: &[Pose<f64>],
    matches: &[Match<'a>],
    hypotheses: usize,
) -> Option<(Pose<f64>, Vec<Match<'a>>)> {
    if matches.len() < SAMPLE_SIZE || starts.is_empty() {
        return None;
    }
    let mut random = Random::new(matches.len() as u64);
    let mut best: Option<(f64, Pose<f64>)> = None;
    let (mut hypothesis, mut sufficient) = (0, hypotheses);
    while hypothesis < sufficient {
        let chosen = random.distinct_below(matches.len(), SAMPLE_SIZE);
        let sample: Vec<Match<'_>> = chosen.iter().map(|i| matches[*i]).collect();
        let pose = solve_pnp_minimal(camera, starts[hypothesis % starts.len()], &sample);
        hypothesis += 1;
        let errors = matches.iter().map(|m| registration_error(camera, &pose, m, 1.0));
        let (cost, agreeing) = errors.fold((0.0, 0), |(cost, agreeing), error| {
            let is_agreeing = error < MAX_RANSAC_ERROR;
            (cost + error.min(MAX_RANSAC_ERROR).powi(2), agreeing + usize::from(is_agreeing))
        });
        if pose.is_finite() && best.is_none_or(|(least, _)| cost < least) {
            best = Some((cost, pose));
            // Every start may be the only one near enough.
            let of_each = sufficient_samples(agreeing, matches.len(), hypotheses);
            sufficient = (of_each * starts.len()).min(hypotheses);
        }
    }
    let pose = best?.1;
    let agrees = |m: &&Match<'_>| registration_error(camera, &pose, m, 1.0) < MAX_RANSAC_ERROR;
    Some((pose, matches.iter().filter(agrees).copied().collect()))
}

/// Number of samples among which [`GOOD_SAMPLES`] without an outlier are expected, where so many of the matches
/// (no fewer than a sample has) are known to agree; at most `most`.
fn sufficient_samples(agreeing: usize, matches: usize, most: usize) -> usize {
    let share = |drawn: usize| agreeing.saturating_sub(drawn) as f64 / (matches - drawn) as f64;
    // Fewer agreeing ones than a sample has give infinity, which is more than `most`.
    (GOOD_SAMPLES / (0..SAMPLE_SIZE).map(share).product::<f64>()).min(most as f64) as usize
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
/// deviations behind the camera.
fn normal_equations(
    camera: &Camera<f64>,
    pose: &Pose<f64>,
    (matches, noise): (&[Match<'_>], f64),
    loss: &impl Fn(f64) -> (f64, f64),
) -> NormalEquations<6> {
    let mut sum = NormalEquations::default();
    let mut cost = 0.0;
    for (landmark, observation) in matches {
        let Some(mut p) = landmark.project(camera, pose) else {
            cost += loss(100.0).1;
            continue;
        };
        let whitening = registration_whitening(observation, noise);
        let r = whitening.apply(std::array::from_fn(|i| p.at[i] - observation.at()[i]));
        p.whiten(&whitening);
        let (weight, of_position) = loss(length(r));
        cost += of_position;
        for i in 0..2 {
            sum.add(&p.by_pose[i], r[i], weight);
        }
        if let Some(depth) = &observation.depth() {
            let r = p.inverse_depth - depth.inverse;
            let (weight, of_depth) = loss(r.abs() / depth.sigma);
            cost += of_depth;
            sum.add(&p.by_pose[2], r, weight / (depth.sigma * depth.sigma));
        }
    }
    sum.cost = cost;
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_compute::Random;

    #[test]
    fn as_many_good_samples_as_asked_for_are_drawn_on_average() {
        let mut random = Random::new(3);
        for agreeing in [100, 70, 40] {
            let samples = sufficient_samples(agreeing, 100, 100_000);
            let mut is_good =
                || random.distinct_below(100, SAMPLE_SIZE).iter().all(|i| *i < agreeing);
            let good = (0..200 * samples).filter(|_| is_good()).count() as f64 / 200.0;
            assert!((good - GOOD_SAMPLES).abs() < 0.05 * GOOD_SAMPLES, "{agreeing}: {good}");
        }
        assert_eq!(sufficient_samples(0, 100, 300), 300);
        assert_eq!(sufficient_samples(30, 100, 300), 300);
    }
}
