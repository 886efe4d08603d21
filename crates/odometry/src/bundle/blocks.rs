//! Blocks of the normal equations: sums over the observations of a landmark, of a pose, and of all.

use super::relative_pose::LinearRelativePose;
use super::sparsity::BlockSparsity;
use super::{Bundle, BundleObservation, FreeIntrinsics, GLOBALS, LANDMARKS_PER_TASK};
use crate::multiview::landmark::{Landmark, Projection};
use crate::multiview::lens_distortion::CameraJacobian;
use crate::multiview::robust_loss::{HUBER_THRESHOLD, huber, length};
use i2slam_compute::reduce_in_order;
use i2slam_geometry::{Mat3, Vec3};

/// Least curvature along a residual, which is divided by its root.
const MIN_CURVATURE: f64 = 1e-3;

/// Approximation of the robust cost's curvature: the weight `w` across a residual `r`, and along it `p`,
/// `w (I - r rᵀ/‖r‖²) + p r rᵀ/‖r‖²`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Curvature {
    /// For steps, `p = w`: iteratively reweighted squares, which bound the cost from above.
    Majorizing,
    /// For the covariance of intrinsics, which all residuals share: `p` is 1 up to the Huber threshold,
    /// and (nearly) 0 beyond.
    Exact,
    /// For that of poses: `p` averaged over unit noise, `Φ(k - n)` for a residual of length `n` and the
    /// threshold `k` (approximated as by Lin 1989). Exactly, a pose that few residuals hold would seem
    /// free where they all happen to be longer.
    Smoothed,
}

impl Curvature {
    /// The curvature along a residual of length `n` [standard deviations].
    fn along(self, n: f64) -> f64 {
        let beyond = n - HUBER_THRESHOLD;
        let tail = || 0.5 * (-0.717 * beyond.abs() - 0.416 * beyond * beyond).exp();
        match (self, beyond > 0.0) {
            (Self::Majorizing, _) => huber(n).0,
            (Self::Exact, false) => 1.0,
            (Self::Exact, true) => MIN_CURVATURE,
            (Self::Smoothed, false) => 1.0 - tail(),
            (Self::Smoothed, true) => tail().max(MIN_CURVATURE),
        }
    }
}

/// Blocks of one landmark: `C`, its gradient, and its couplings with the cameras that observe it.
pub(super) struct LandmarkBlock {
    pub(super) hessian: [[f64; 3]; 3],
    pub(super) gradient: [f64; 3],
    /// Couplings `Eᵀ` with every free pose, in the order of the structure: a row for every value of
    /// the landmark, so that six products of a row are formed at once.
    pub(super) couplings: Vec<[[f64; 6]; 3]>,
    pub(super) globals: [[f64; 3]; GLOBALS],
}

/// Blocks of one pose: its part of `U`, its gradient and its coupling with the globals.
#[derive(Clone)]
pub(super) struct PoseBlock {
    pub(super) hessian: [[f64; 6]; 6],
    pub(super) gradient: [f64; 6],
    pub(super) globals: [[f64; GLOBALS]; 6],
}

/// Block of the global parameters.
#[derive(Clone, Copy, Default)]
pub(super) struct GlobalBlock {
    pub(super) hessian: [[f64; GLOBALS]; GLOBALS],
    pub(super) gradient: [f64; GLOBALS],
}

/// A weighted residual with its derivatives: the image position in standard deviations, and the inverse depth
/// if measured. With another curvature than the majorizing one it is scaled, so that gradients are right still.
pub(super) struct WeightedResidual {
    pub(super) projection: Projection,
    camera_jacobian: CameraJacobian,
    pub(super) residual: [f64; 3],
    /// Weights of the rows of the residual.
    pub(super) weights: [f64; 3],
    /// Number of rows: 2, or 3 with depth.
    pub(super) rows: usize,
    /// Robust cost of all rows.
    pub(super) cost: f64,
}

impl LandmarkBlock {
    pub(super) fn damped_inverse(&self, damping: f64) -> Mat3<f64> {
        let mut rows = self.hessian;
        (0..3).for_each(|i| rows[i][i] += damping * rows[i][i] + 1e-9);
        inverse(&Mat3 { rows })
    }
}

/// The weighted residual of an observation; `None` behind the camera.
#[inline(always)]
pub(super) fn weighted_residual(
    bundle: &Bundle,
    landmark: &Landmark,
    observation: &BundleObservation,
    curvature: Curvature,
) -> Option<WeightedResidual> {
    let pose = &bundle.poses[observation.pose];
    let mut projection = landmark.project(&bundle.camera, pose)?;
    let seen = observation.corrected(bundle.camera_change);
    let whitening = &observation.whitening;
    let [x, y] = whitening.apply([projection.at[0] - seen[0], projection.at[1] - seen[1]]);
    projection.whiten(whitening);
    let mut residual = [x, y, 0.0];
    let length = length([x, y]);
    let (weight, mut cost) = huber(length);
    let (mut weights, mut rows) = ([weight, weight, 0.0], 2);
    if let Some(depth) = &observation.depth {
        residual[2] = projection.inverse_depth - depth.inverse;
        let off = residual[2].abs() / depth.sigma;
        let (weight, cost_of_depth) = huber(off);
        weights[2] = weight / (depth.sigma * depth.sigma);
        cost += cost_of_depth;
        if curvature != Curvature::Majorizing {
            let change = curvature.along(off) / weight;
            weights[2] *= change;
            residual[2] /= change;
        }
        rows = 3;
    }
    let camera_jacobian = observation.camera_jacobian.map(|by| whitening.apply(by));
    let mut out = WeightedResidual { projection, camera_jacobian, residual, weights, rows, cost };
    if curvature != Curvature::Majorizing && length > 0.0 {
        out.scale_along_residual((curvature.along(length) / weight).sqrt());
    }
    Some(out)
}

/// Sums over the observations of a landmark; `landmark_observations` are those by free poses.
#[inline(always)]
pub(super) fn landmark_block(
    bundle: &Bundle,
    landmark: usize,
    landmark_observations: &[(u32, u32)],
    curvature: Curvature,
) -> LandmarkBlock {
    let (observations, landmark) =
        (bundle.observations[landmark].iter(), &bundle.landmarks[landmark]);
    let all: Vec<Option<WeightedResidual>> =
        observations.map(|s| weighted_residual(bundle, landmark, s, curvature)).collect();
    let has_globals = bundle.free_intrinsics != FreeIntrinsics::None;
    let (mut hessian, mut gradient, mut globals) = ([[0.0; 3]; 3], [0.0; 3], [[0.0; 3]; GLOBALS]);
    for w in all.iter().flatten() {
        for i in 0..w.rows {
            let (row, weight) = (&w.projection.by_landmark[i], w.weights[i]);
            for a in 0..3 {
                gradient[a] += weight * row[a] * w.residual[i];
                (0..3).for_each(|b| hessian[a][b] += weight * row[a] * row[b]);
                if has_globals {
                    let by_globals = w.by_globals(i);
                    (0..GLOBALS).for_each(|g| globals[g][a] += weight * by_globals[g] * row[a]);
                }
            }
        }
    }
    let coupling = |(_, observation): &(u32, u32)| {
        let Some(w) = &all[*observation as usize] else { return [[0.0; 6]; 3] };
        let product = |i: usize, a: usize, b: usize| {
            w.projection.by_pose[i][a] * w.projection.by_landmark[i][b]
        };
        let entry = |a: usize, b: usize| {
            w.weights[0] * (product(0, a, b) + product(1, a, b)) + w.weights[2] * product(2, a, b)
        };
        std::array::from_fn(|b| std::array::from_fn(|a| entry(a, b)))
    };
    LandmarkBlock {
        hessian,
        gradient,
        couplings: landmark_observations.iter().map(coupling).collect(),
        globals,
    }
}

/// Sums over the observations of a block's pose.
#[inline(always)]
pub(super) fn pose_block(
    bundle: &Bundle,
    sparsity: &BlockSparsity,
    block: usize,
    curvature: Curvature,
) -> PoseBlock {
    let has_globals = bundle.free_intrinsics != FreeIntrinsics::None;
    let mut out =
        PoseBlock { hessian: [[0.0; 6]; 6], gradient: [0.0; 6], globals: [[0.0; GLOBALS]; 6] };
    for (landmark, k) in &sparsity.block_observations[block] {
        let landmark = *landmark as usize;
        let observation = &bundle.observations[landmark]
            [sparsity.landmark_observations[landmark][*k as usize].1 as usize];
        let landmark = &bundle.landmarks[landmark];
        let Some(w) = weighted_residual(bundle, landmark, observation, curvature) else { continue };
        for i in 0..w.rows {
            let row = &w.projection.by_pose[i];
            for a in 0..6 {
                let slope = w.weights[i] * row[a];
                (0..6).for_each(|b| out.hessian[a][b] += slope * row[b]);
                out.gradient[a] += slope * w.residual[i];
                if has_globals {
                    let by_globals = w.by_globals(i);
                    (0..GLOBALS).for_each(|g| out.globals[a][g] += slope * by_globals[g]);
                }
            }
        }
    }
    out
}

/// Adds the relative poses of a bundle to the blocks of their poses; returns the couplings of
/// pairs that are both free.
pub(super) fn relative_pose_blocks(
    bundle: &Bundle,
    sparsity: &BlockSparsity,
    blocks: &mut [PoseBlock],
) -> Vec<(usize, usize, [[f64; 6]; 6])> {
    let mut couplings = Vec::new();
    for factor in bundle.relative_poses.iter() {
        let LinearRelativePose { hessians, gradients, coupling } = factor.linearize(&bundle.poses);
        let places = [factor.first, factor.second].map(|pose| sparsity.blocks[pose]);
        for (side, place) in places.into_iter().enumerate() {
            let Some(place) = place else { continue };
            let block = &mut blocks[place];
            for a in 0..6 {
                block.gradient[a] += gradients[side][a];
                (0..6).for_each(|b| block.hessian[a][b] += hessians[side][a][b]);
            }
        }
        if let [Some(first), Some(second)] = places {
            couplings.push(match first > second {
                true => (first, second, coupling),
                false => (second, first, transposed(&coupling)),
            });
        }
    }
    couplings
}

fn transposed(m: &[[f64; 6]; 6]) -> [[f64; 6]; 6] {
    std::array::from_fn(|a| std::array::from_fn(|b| m[b][a]))
}

pub(super) fn global_block(bundle: &Bundle, curvature: Curvature) -> GlobalBlock {
    let task = |range: std::ops::Range<usize>| {
        let mut sum = GlobalBlock::default();
        for (landmark, observation) in range
            .flat_map(|l| bundle.observations[l].iter().map(move |s| (&bundle.landmarks[l], s)))
        {
            let Some(w) = weighted_residual(bundle, landmark, observation, curvature) else {
                continue;
            };
            for i in 0..2 {
                let (row, weight) = (w.by_globals(i), w.weights[i]);
                for g in 0..GLOBALS {
                    sum.gradient[g] += weight * row[g] * w.residual[i];
                    (0..GLOBALS).for_each(|h| sum.hessian[g][h] += weight * row[g] * row[h]);
                }
            }
        }
        sum
    };
    let mut out = GlobalBlock::default();
    reduce_in_order(bundle.landmarks.len(), LANDMARKS_PER_TASK, task, |sum| {
        for g in 0..GLOBALS {
            out.gradient[g] += sum.gradient[g];
            (0..GLOBALS).for_each(|h| out.hessian[g][h] += sum.hessian[g][h]);
        }
    });
    out
}

impl WeightedResidual {
    /// Scales the derivatives along the position's residual, and this by the inverse: gradients stay.
    fn scale_along_residual(&mut self, scale: f64) {
        let length = length([self.residual[0], self.residual[1]]);
        let along = [self.residual[0] / length, self.residual[1] / length];
        let keep = |[x, y]: [&mut f64; 2]| {
            let lost = (1.0 - scale) * (along[0] * *x + along[1] * *y);
            *x -= along[0] * lost;
            *y -= along[1] * lost;
        };
        let [x, y, _] = &mut self.projection.by_pose;
        x.iter_mut().zip(y).for_each(|(x, y)| keep([x, y]));
        let [x, y, _] = &mut self.projection.by_landmark;
        x.iter_mut().zip(y).for_each(|(x, y)| keep([x, y]));
        let [x, y, _] = &mut self.projection.by_focal;
        keep([x, y]);
        self.camera_jacobian.iter_mut().for_each(|by| keep(by.each_mut()));
        self.residual[0] /= scale;
        self.residual[1] /= scale;
    }

    /// Derivatives by the global parameters.
    pub(super) fn by_globals(&self, row: usize) -> [f64; GLOBALS] {
        if row == 2 {
            return [0.0; GLOBALS];
        }
        [
            self.projection.by_focal[row],
            -self.camera_jacobian[0][row],
            -self.camera_jacobian[1][row],
        ]
    }
}

/// Inverse of a symmetric positive definite matrix by cofactors.
fn inverse(m: &Mat3<f64>) -> Mat3<f64> {
    let [a, b, c] = m.rows.map(Vec3::from_array);
    let columns = [b.cross(c), c.cross(a), a.cross(b)];
    let determinant = a.dot(columns[0]);
    Mat3 { rows: columns.map(Vec3::to_array) }.transpose().scaled(1.0 / determinant)
}
