//! Two-view geometry: rotation alone, or rotation and direction of translation.

use crate::multiview::robust_loss::cauchy;
use i2slam_compute::{NormalEquations, Random, median};
use i2slam_geometry::{Camera, Pose, Rotation, Vec3};

/// Hypotheses of RANSAC.
const HYPOTHESES: usize = 300;
/// Points per hypothesis.
const SAMPLE_SIZE: usize = 5;
/// Epipolar distance at which the RANSAC cost is truncated [px].
const MAX_RANSAC_ERROR: f64 = 2.0;
/// Largest angle between two views of a scene whose points can be matched [rad].
const MAX_ORBIT_ANGLE: f64 = 1.2;
/// Smallest number of shared points.
const MIN_SHARED: usize = 24;

/// Rays of one point in both cameras, third component 1.
pub(crate) type RayPair = (Vec3<f64>, Vec3<f64>);

/// Relative pose of two cameras up to scale.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RelativePose {
    /// Rotation and direction of the translation (length 1).
    pub(crate) second_from_first: Pose<f64>,
    /// Ratio of points that fit and lie in front of both cameras.
    pub(crate) inlier_ratio: f64,
}

/// Rays of shared points.
pub(crate) fn ray_pairs(camera: &Camera<f64>, pairs: &[([f64; 2], [f64; 2])]) -> Vec<RayPair> {
    let ray = |at: [f64; 2]| camera.unproject(at[0], at[1], 1.0);
    pairs.iter().map(|(first, second)| (ray(*first), ray(*second))).collect()
}

/// Fits a rotation; also the median residual [px], small if the camera only turned.
pub(crate) fn fit_rotation(focal: f64, ray_pairs: &[RayPair]) -> Option<(Rotation<f64>, f64)> {
    if ray_pairs.len() < MIN_SHARED {
        return None;
    }
    let mut rotation = Rotation::identity();
    for width in [40.0, 40.0, 40.0, 10.0, 10.0, 10.0, 3.0, 3.0, 3.0, 3.0] {
        let mut sum = NormalEquations::<3>::default();
        for (first, second) in ray_pairs {
            let q = rotation.rotate(*first);
            if q.z <= 1e-3 {
                continue;
            }
            let r = [q.x / q.z - second.x, q.y / q.z - second.y];
            let weight = cauchy(r[0].hypot(r[1]) * focal, width).0;
            let iz = 1.0 / q.z;
            let rows = [Vec3::new(iz, 0.0, -q.x * iz * iz), Vec3::new(0.0, iz, -q.y * iz * iz)];
            for (g, r) in rows.into_iter().zip(r) {
                // R Exp(φ) x = R x + R (φ × x): the derivative is x × Rᵀ g.
                let j = first.cross(rotation.inverse().rotate(g));
                sum.add(&j.to_array(), r, weight);
            }
        }
        let step = sum.step(1e-6)?;
        rotation = rotation * Rotation::exp(Vec3::from_array(step));
    }
    let mut residual: Vec<f64> = ray_pairs
        .iter()
        .map(|(first, second)| {
            let q = rotation.rotate(*first);
            focal * (q.x / q.z - second.x).hypot(q.y / q.z - second.y)
        })
        .collect();
    median(&mut residual).map(|m| (rotation, m))
}

/// Estimates the relative pose by RANSAC: samples of five points, each solved by iteration (Lui and
/// Drummond 2013) from a pose of `start` on; the best one is refined on all points.
pub(crate) fn estimate_relative_pose(
    focal: f64,
    ray_pairs: &[RayPair],
    mut start: impl FnMut(&mut Random) -> Pose<f64>,
) -> Option<RelativePose> {
    if ray_pairs.len() < MIN_SHARED {
        return None;
    }
    let mut random = Random::new(ray_pairs.len() as u64);
    let mut best: Option<(f64, Pose<f64>)> = None;
    for _ in 0..HYPOTHESES {
        let chosen = random.distinct_below(ray_pairs.len(), SAMPLE_SIZE);
        let sample: Vec<RayPair> = chosen.iter().map(|i| ray_pairs[*i]).collect();
        let start = start(&mut random);
        let Some(found) = refine_relative_pose(&sample, start, 12, |_| 1.0) else { continue };
        let cost = ray_pairs.iter().map(|r| sampson(&found, r).powi(2) * focal * focal);
        let cost: f64 = cost.map(|c| c.min(MAX_RANSAC_ERROR * MAX_RANSAC_ERROR)).sum();
        if best.is_none_or(|(least, _)| cost < least) {
            best = Some((cost, found));
        }
    }
    let weight = |r: f64| {
        if r.abs() * focal < 2.0 * MAX_RANSAC_ERROR { cauchy(r * focal, 0.7).0 } else { 0.0 }
    };
    let refined = refine_relative_pose(ray_pairs, best?.1, 20, weight)?;
    Some(resolve_cheirality(focal, ray_pairs, refined))
}

/// Poses of a camera that turns by `rotation`, in random directions.
pub(crate) fn poses_turned_by(rotation: Rotation<f64>) -> impl FnMut(&mut Random) -> Pose<f64> {
    move |random| Pose::new(rotation, random_direction(random))
}

/// Poses of a camera that moves around what both pictures show: by a random angle about a random axis
/// through the point in the middle of the shared ones.
pub(crate) fn orbit_poses(ray_pairs: &[RayPair]) -> impl FnMut(&mut Random) -> Pose<f64> {
    let sum = ray_pairs.iter().fold((Vec3::zero(), Vec3::zero()), |s, r| (s.0 + r.0, s.1 + r.1));
    let middle = |v: Vec3<f64>| v * v.norm().max(1e-12).recip();
    let (first, second) = (middle(sum.0), middle(sum.1));
    let axis = first.cross(second);
    let angle = axis.norm().atan2(first.dot(second));
    let facing = Rotation::exp(axis * (angle / axis.norm().max(1e-12)));
    move |random| {
        let turn = random_direction(random) * (MAX_ORBIT_ANGLE * random.uniform());
        let rotation = Rotation::exp(turn) * facing;
        let moved = second - rotation.rotate(first);
        let direction = match moved.norm() > 1e-6 {
            true => moved * moved.norm().recip(),
            false => random_direction(random),
        };
        Pose::new(rotation, direction)
    }
}

/// A uniformly random direction.
pub(crate) fn random_direction(random: &mut Random) -> Vec3<f64> {
    let z = 2.0 * random.uniform() - 1.0;
    let (sine, cosine) = (std::f64::consts::TAU * random.uniform()).sin_cos();
    let r = (1.0 - z * z).max(0.0).sqrt();
    Vec3::new(r * cosine, r * sine, z)
}

/// Epipolar distance to first order (Sampson; Hartley and Zisserman, eq. 11.9), in rays.
pub(crate) fn sampson(pose: &Pose<f64>, pair: &RayPair) -> f64 {
    let (e, norm) = epipolar(pose, pair);
    e / norm
}

/// `e = x₂ᵀ [t]× R x₁` and the length of its gradient by both image positions.
fn epipolar(pose: &Pose<f64>, (first, second): &RayPair) -> (f64, f64) {
    let line_in_second = pose.translation.cross(pose.rotation.rotate(*first));
    let line_in_first = pose.rotation.inverse().rotate(second.cross(pose.translation));
    let squares = line_in_second.x.powi(2) + line_in_second.y.powi(2);
    let squares = squares + line_in_first.x.powi(2) + line_in_first.y.powi(2);
    (second.dot(line_in_second), squares.sqrt().max(1e-12))
}

/// Gauss-Newton on rotation and direction, the gradient's length kept fixed within a step.
pub(crate) fn refine_relative_pose(
    ray_pairs: &[RayPair],
    start: Pose<f64>,
    steps: usize,
    weight: impl Fn(f64) -> f64,
) -> Option<Pose<f64>> {
    let mut pose = start;
    for _ in 0..steps {
        let t = pose.translation;
        let side =
            if t.x.abs() < 0.7 { Vec3::new(1.0, 0.0, 0.0) } else { Vec3::new(0.0, 1.0, 0.0) };
        let b1 = t.cross(side);
        let b1 = b1 * b1.norm().recip();
        let b2 = t.cross(b1);
        let mut sum = NormalEquations::<5>::default();
        for pair in ray_pairs {
            let (e, norm) = epipolar(&pose, pair);
            let turned = pose.rotation.rotate(pair.0);
            let line_in_first = pose.rotation.inverse().rotate(pair.1.cross(t));
            let by_rotation = pair.0.cross(line_in_first);
            let by_translation = turned.cross(pair.1);
            let j = [
                by_rotation.x,
                by_rotation.y,
                by_rotation.z,
                by_translation.dot(b1),
                by_translation.dot(b2),
            ];
            sum.add(&j.map(|v| v / norm), e / norm, weight(e / norm));
        }
        let s = sum.step(1e-6)?;
        let moved = t + b1 * s[3] + b2 * s[4];
        pose = Pose::new(
            pose.rotation * Rotation::exp(Vec3::new(s[0], s[1], s[2])),
            moved * moved.norm().recip(),
        );
    }
    pose.is_finite().then_some(pose)
}

/// Chooses among the four poses of one epipolar geometry, of which two are turned by half a turn about the
/// translation, the one that puts most points in front of both cameras.
pub(crate) fn resolve_cheirality(
    focal: f64,
    ray_pairs: &[RayPair],
    pose: Pose<f64>,
) -> RelativePose {
    let t = pose.translation;
    let half_turn = Rotation::exp(t * (std::f64::consts::PI / t.norm().max(1e-12)));
    let twisted = half_turn * pose.rotation;
    let count = |pose: &Pose<f64>| {
        let fits = |r: &&RayPair| sampson(pose, r).abs() * focal < MAX_RANSAC_ERROR;
        let back = pose.inverse();
        let is_before = |r: &&RayPair| {
            has_positive_depth(pose, r, focal) && has_positive_depth(&back, &(r.1, r.0), focal)
        };
        ray_pairs.iter().filter(fits).filter(is_before).count()
    };
    let rotations = [pose.rotation, twisted];
    let all = rotations.into_iter().flat_map(|r| [Pose::new(r, t), Pose::new(r, -t)]);
    let first = (count(&pose), pose);
    let (most, pose) = all
        .map(|pose| (count(&pose), pose))
        .fold(first, |best, next| if next.0 > best.0 { next } else { best });
    RelativePose { second_from_first: pose, inlier_ratio: most as f64 / ray_pairs.len() as f64 }
}

/// Whether the inverse depth in the first camera is above minus one pixel of disparity.
fn has_positive_depth(pose: &Pose<f64>, (first, second): &RayPair, focal: f64) -> bool {
    // x₂ × (R x₁ + ρ t) = 0.
    let (a, b) = (second.cross(pose.translation), second.cross(pose.rotation.rotate(*first)));
    let rho = -a.dot(b) / a.norm_squared().max(1e-12);
    rho * a.norm() * focal > -1.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::noise;

    fn scene(pose: Pose<f64>) -> Vec<RayPair> {
        let numbers = noise(5, 600);
        let point = |n: &[f64]| Vec3::new(n[0], n[1], 2.5 + n[2]);
        let ray = |p: Vec3<f64>| Vec3::new(p.x / p.z, p.y / p.z, 1.0);
        numbers
            .chunks_exact(3)
            .enumerate()
            .map(|(i, n)| {
                // Every fifth match is wrong.
                let other =
                    if i % 5 == 0 { point(&numbers[3 * (199 - i)..][..3]) } else { point(n) };
                (ray(point(n)), ray(pose * other))
            })
            .collect()
    }

    #[test]
    fn motion_is_found_among_wrong_matches() {
        let random_direction = Vec3::new(0.6, -0.3, 0.5);
        let random_direction = random_direction * (1.0 / random_direction.norm());
        let pose = Pose::new(Rotation::exp(Vec3::new(0.05, -0.1, 0.08)), random_direction * 0.2);
        let ray_pairs = scene(pose);
        let (rotation, residual) = fit_rotation(250.0, &ray_pairs).expect("enough points");
        assert!(residual > 3.0, "a moving camera does not only turn: {residual}");
        let found = estimate_relative_pose(250.0, &ray_pairs, poses_turned_by(rotation));
        let found = found.expect("enough points");
        let off = (found.second_from_first.translation - random_direction).norm();
        // Some wrong matches lie near their epipolar lines and pull.
        assert!(off < 0.1, "{off}");
        let error = found.second_from_first.rotation.inverse() * pose.rotation;
        assert!(error.log().norm() < 0.01, "{error:?}");
        assert!((0.75..0.9).contains(&found.inlier_ratio), "{}", found.inlier_ratio);
    }

    #[test]
    fn turning_alone_is_recognised() {
        let pose = Pose::new(Rotation::exp(Vec3::new(0.05, -0.1, 0.08)), Vec3::zero());
        let (rotation, residual) = fit_rotation(250.0, &scene(pose)).expect("enough points");
        let off = (rotation.inverse() * pose.rotation).log().norm();
        assert!(residual < 0.05 && off < 1e-3, "{residual} {off}");
    }
}
