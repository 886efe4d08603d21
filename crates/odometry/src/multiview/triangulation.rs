//! Triangulation of landmarks from cameras with known poses.

use crate::multiview::landmark::{Landmark, reprojection_error};
use crate::multiview::robust_loss::{huber, length};
use crate::track::tracks::Observation;
use i2slam_compute::NormalEquations;
use i2slam_geometry::{Camera, Pose, Vec3};

const MAX_STEPS: usize = 10;
/// Relative decrease of the cost at which a landmark has converged.
const MIN_DECREASE: f64 = 1e-4;
/// Largest mean residual of a landmark [standard deviations].
const MAX_MEAN_ERROR: f64 = 4.0;

/// An observation and the pose of its camera.
pub(crate) type PosedObservation<'a> = (&'a Observation, Pose<f64>);

/// Triangulates at least two observations, or one with depth; the landmark originates in the first.
/// `None` if they are inconsistent, where residuals are `noise` times as large as their deviations
/// say.
pub(crate) fn triangulate(
    camera: &Camera<f64>,
    observations: &[PosedObservation<'_>],
    noise: f64,
) -> Option<Landmark> {
    let (first, rest) = observations.split_first()?;
    let on_ray = |inverse: f64| Landmark::on_ray(camera, first.1, first.0.at(), inverse);
    let by_depth = observations.iter().find_map(|o| measured_inverse_depth(camera, first.1, o));
    let by_depth =
        by_depth.and_then(|inverse| consistent(camera, on_ray(inverse), observations, noise));
    if by_depth.is_some() || rest.is_empty() {
        return by_depth;
    }
    let landmark = on_ray(inverse_depth(camera, &on_ray(0.0), rest).max(-1e-3));
    consistent(camera, landmark, observations, noise)
}

/// Inverse depth in the camera `first` of a point whose depth was measured in another.
fn measured_inverse_depth(
    camera: &Camera<f64>,
    first: Pose<f64>,
    (observation, pose): &PosedObservation<'_>,
) -> Option<f64> {
    let z = observation.depth()?.inverse.recip();
    let point =
        first.inverse() * (*pose * camera.unproject(observation.at()[0], observation.at()[1], z));
    (point.z > 0.0).then(|| point.z.recip())
}

/// The refined landmark, if its observations are consistent.
fn consistent(
    camera: &Camera<f64>,
    start: Landmark,
    observations: &[PosedObservation<'_>],
    noise: f64,
) -> Option<Landmark> {
    let landmark = refine_landmark(camera, start, observations)?;
    let sum = observations
        .iter()
        .map(|(o, pose)| reprojection_error(camera, pose, &(&landmark, *o)))
        .sum::<f64>();
    (sum / observations.len() as f64 <= MAX_MEAN_ERROR * noise).then_some(landmark)
}

/// Largest angle at a landmark between its origin and other cameras [rad].
pub(crate) fn parallax(landmark: &Landmark, poses: impl Iterator<Item = Pose<f64>>) -> f64 {
    let point = landmark.position();
    let first = point - landmark.origin;
    let angle = |pose: Pose<f64>| {
        let ray = point - pose.translation;
        first.cross(ray).norm().atan2(first.dot(ray))
    };
    poses.map(angle).fold(0.0, f64::max)
}

/// Inverse depth of least `Σ ‖x × Rᵀ (ρ (o - t) + d)‖²`.
fn inverse_depth(
    camera: &Camera<f64>,
    landmark: &Landmark,
    observations: &[PosedObservation<'_>],
) -> f64 {
    let direction = landmark.rotation * Vec3::new(landmark.values[0], landmark.values[1], 1.0);
    let (mut above, mut below) = (0.0, 1e-12);
    for (observation, pose) in observations {
        let x = camera.unproject(observation.at()[0], observation.at()[1], 1.0);
        let inverse = pose.rotation.inverse();
        let a = x.cross(inverse.rotate(landmark.origin - pose.translation));
        let b = x.cross(inverse.rotate(direction));
        above -= a.dot(b);
        below += a.dot(a);
    }
    above / below
}

/// The landmark of least cost near `start`; `None` where `start` is behind a camera.
pub(crate) fn refine_landmark(
    camera: &Camera<f64>,
    start: Landmark,
    observations: &[PosedObservation<'_>],
) -> Option<Landmark> {
    minimize_landmark(start, MAX_STEPS, |landmark| normal_equations(camera, landmark, observations))
}

/// Levenberg-Marquardt on a landmark alone, in up to `steps` steps, from its normal equations and their cost;
/// `None` where there are none at `start`.
#[inline(always)]
pub(crate) fn minimize_landmark(
    start: Landmark,
    steps: usize,
    normal_equations: impl Fn(&Landmark) -> Option<NormalEquations<3>>,
) -> Option<Landmark> {
    let (mut landmark, mut damping) = (start, 1e-4);
    let mut equations = normal_equations(&landmark)?;
    for _ in 0..steps {
        let Some(step) = equations.step(damping) else { break };
        let mut tried = landmark;
        (0..3).for_each(|i| tried.values[i] += step[i]);
        match normal_equations(&tried) {
            Some(next) if next.cost < equations.cost => {
                let has_converged = equations.cost - next.cost < MIN_DECREASE * equations.cost;
                (landmark, equations, damping) = (tried, next, damping * 0.2);
                if has_converged {
                    break;
                }
            }
            _ => damping *= 10.0,
        }
    }
    Some(landmark)
}

/// Sums over all observations; `None` where the landmark is behind a camera.
fn normal_equations(
    camera: &Camera<f64>,
    landmark: &Landmark,
    observations: &[PosedObservation<'_>],
) -> Option<NormalEquations<3>> {
    let mut sum = NormalEquations::default();
    let mut cost = 0.0;
    for (observation, pose) in observations {
        let mut p = landmark.project(camera, pose)?;
        let whitening = observation.whitening();
        let r = whitening.apply(std::array::from_fn(|i| p.at[i] - observation.at()[i]));
        p.whiten(whitening);
        let (weight, loss) = huber(length(r));
        cost += loss;
        for i in 0..2 {
            sum.add(&p.by_landmark[i], r[i], weight);
        }
        if let Some(depth) = &observation.depth() {
            let r = p.inverse_depth - depth.inverse;
            let (weight, loss) = huber(r.abs() / depth.sigma);
            cost += loss;
            sum.add(&p.by_landmark[2], r, weight / (depth.sigma * depth.sigma));
        }
    }
    sum.cost = cost;
    Some(sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::camera;
    use i2slam_geometry::Rotation;

    #[test]
    fn near_and_far_points_are_found_and_wrong_ones_refused() {
        let camera = camera();
        let pose = |i: usize| {
            let i = i as f64;
            Pose::new(Rotation::exp(Vec3::new(0.0, 0.02 * i, 0.0)), Vec3::new(0.1 * i, 0.0, 0.02))
        };
        for point in [Vec3::new(0.2, -0.1, 2.0), Vec3::new(1e4, 0.0, 1e5)] {
            let observation = |i: usize| {
                let (u, v) = camera.project(pose(i).inverse() * point);
                Observation::new(i, [u, v], 0.5)
            };
            let mut observations = [observation(0), observation(1), observation(2)];
            let posed = |s: &[Observation; 3]| {
                triangulate(&camera, &[0, 1, 2].map(|i| (&s[i], pose(i))), 1.0)
            };
            let found = posed(&observations).expect("observations agree");
            let (p, q) = (found.position(), point);
            assert!((p * p.z.recip() - q * q.z.recip()).norm() < 1e-4, "{p:?}");
            assert!((found.inverse_depth() - 1.0 / (pose(0).inverse() * point).z).abs() < 1e-6);
            let [u, v] = observations[1].at();
            observations[1] = observations[1].moved_to([u, v + 30.0]);
            assert!(posed(&observations).is_none());
        }
    }
}
