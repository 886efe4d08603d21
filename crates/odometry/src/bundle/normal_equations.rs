//! Normal equations of a bundle, solved with the landmarks eliminated (Schur complement).
//!
//! Every block row of the reduced camera system is computed by one task, its landmarks in order, so
//! that the result does not depend on the number of threads and the matrix is kept once.

use super::relative_pose::LinearRelativePose;
use super::sparsity::BlockSparsity;
use super::{Bundle, BundleObservation, FreeIntrinsics, GLOBALS, LANDMARKS_PER_TASK};
use crate::multiview::landmark::Projection;
use crate::multiview::lens_distortion::CameraJacobian;
use crate::multiview::robust_loss::{HUBER_THRESHOLD, huber};
use i2slam_compute::{SkylineMatrix, reduce_in_order};
use i2slam_geometry::{Mat3, Vec3};
use pulp::Arch;
use rayon::prelude::*;

/// Damping that only fixes the gauge: scale is not observable.
pub(super) const GAUGE_DAMPING: f64 = 1e-7;

/// A change of all parameters.
pub(super) struct BundleStep {
    /// Tangent of every pose, zero for fixed ones.
    pub(super) poses: Vec<[f64; 6]>,
    pub(super) landmarks: Vec<[f64; 3]>,
    pub(super) globals: [f64; GLOBALS],
}

/// Normal equations: cameras (`U`), landmarks (`C`) and couplings (`E`).
pub(super) struct SchurSystem<'a> {
    pub(super) sparsity: &'a BlockSparsity,
    /// Number of adjusted global parameters.
    pub(super) globals: usize,
    pub(super) parts: Vec<LandmarkBlock>,
    pub(super) poses: Vec<PoseBlock>,
    /// Couplings of pairs of poses by relative poses: rows of the later block, columns of the
    /// earlier.
    relative: Vec<(usize, usize, [[f64; 6]; 6])>,
    pub(super) global: GlobalBlock,
}

impl<'a> SchurSystem<'a> {
    pub(super) fn new(bundle: &Bundle, sparsity: &'a BlockSparsity, curvature: Curvature) -> Self {
        let globals = bundle.free_intrinsics as usize;
        let landmarks = 0..bundle.landmarks.len();
        let arch = Arch::new();
        let landmark = |i: usize| {
            let observations = &sparsity.landmark_observations[i];
            arch.dispatch(|| landmark_block(bundle, i, observations, curvature))
        };
        let parts = landmarks.into_par_iter().map(landmark);
        let block = |block: usize| arch.dispatch(|| pose_block(bundle, sparsity, block, curvature));
        let poses = (0..sparsity.poses.len()).into_par_iter().map(block);
        let (parts, mut poses): (_, Vec<PoseBlock>) = (parts.collect(), poses.collect());
        let relative = relative_pose_blocks(bundle, sparsity, &mut poses);
        let global =
            if globals == 0 { GlobalBlock::default() } else { global_block(bundle, curvature) };
        Self { sparsity, globals, parts, poses, relative, global }
    }

    /// The Levenberg-Marquardt step; `None` if the damped system is not positive definite.
    pub(super) fn step(&self, damping: f64) -> Option<BundleStep> {
        let (mut matrix, mut solved) = self.reduced_camera_system(damping);
        matrix.solve(&mut solved).then(|| self.back_substitute(&solved, damping, 1.0))
    }

    /// Columns of the inverse for the global parameters; `None` where they are not determined.
    pub(super) fn inverse_columns(&self) -> Option<Vec<BundleStep>> {
        let (mut matrix, right) = self.reduced_camera_system(GAUGE_DAMPING);
        if !matrix.factorise() {
            return None;
        }
        let unit = |global: usize| {
            let mut unit = vec![0.0; right.len()];
            unit[6 * self.poses.len() + global] = 1.0;
            matrix.substitute(&mut unit);
            self.back_substitute(&unit, GAUGE_DAMPING, 0.0)
        };
        Some((0..self.globals).map(unit).collect())
    }

    /// Back-substitutes the landmarks, whose own gradients have weight `gradient_weight`.
    fn back_substitute(&self, solved: &[f64], damping: f64, gradient_weight: f64) -> BundleStep {
        let pose = |block: &Option<usize>| {
            block.map_or([0.0; 6], |b| std::array::from_fn(|i| solved[6 * b + i]))
        };
        let mut globals = [0.0; GLOBALS];
        globals.iter_mut().zip(&solved[6 * self.poses.len()..]).for_each(|(g, s)| *g = *s);
        let landmark = |(part, cameras): (&LandmarkBlock, &Vec<(u32, u32)>)| {
            let mut right = part.gradient.map(|g| -gradient_weight * g);
            for i in 0..3 {
                for (e, (block, _)) in part.couplings.iter().zip(cameras) {
                    let tangent = &solved[6 * *block as usize..][..6];
                    right[i] -= (0..6).map(|a| e[i][a] * tangent[a]).sum::<f64>();
                }
                right[i] -= (0..self.globals).map(|g| part.globals[g][i] * globals[g]).sum::<f64>();
            }
            (part.damped_inverse(damping) * Vec3::from_array(right)).to_array()
        };
        let parts = self.parts.par_iter().zip(&self.sparsity.landmark_observations);
        let poses = self.sparsity.blocks.iter().map(pose).collect();
        BundleStep { poses, landmarks: parts.map(landmark).collect(), globals }
    }

    /// The reduced camera system `U - E C⁻¹ Eᵀ` and its right-hand side.
    pub(super) fn reduced_camera_system(&self, damping: f64) -> (SkylineMatrix, Vec<f64>) {
        let inverses: Vec<Mat3<f64>> =
            self.parts.par_iter().map(|p| p.damped_inverse(damping)).collect();
        let mut matrix = SkylineMatrix::new(self.sparsity.first_columns(self.globals));
        let rows = matrix.split((1..=self.poses.len()).map(|block| 6 * block));
        let arch = Arch::new();
        let fill = |(block, rows): (usize, &mut [f64])| {
            arch.dispatch(|| self.fill_block_rows(block, rows, &inverses, damping))
        };
        let sides: Vec<PoseBlock> = rows.into_par_iter().enumerate().map(fill).collect();
        for (later, earlier, coupling) in &self.relative {
            for (a, row) in coupling.iter().enumerate() {
                let columns = row.iter().enumerate();
                columns.for_each(|(b, v)| matrix.add(6 * later + a, 6 * earlier + b, *v));
            }
        }
        let mut right: Vec<f64> = sides.iter().flat_map(|side| side.gradient).collect();
        let begin = right.len();
        for (block, side) in sides.iter().enumerate() {
            for (a, row) in side.globals.iter().enumerate() {
                (0..self.globals).for_each(|g| matrix.add(begin + g, 6 * block + a, row[g]));
            }
        }
        let global = self.reduced_globals(&inverses, damping);
        for g in 0..self.globals {
            (0..=g).for_each(|h| matrix.add(begin + g, begin + h, global.hessian[g][h]));
            right.push(global.gradient[g]);
        }
        (matrix, right)
    }

    /// Fills the six rows of a block; returns its right-hand side and coupling with the globals.
    #[inline(always)]
    fn fill_block_rows(
        &self,
        block: usize,
        rows: &mut [f64],
        inverses: &[Mat3<f64>],
        damping: f64,
    ) -> PoseBlock {
        let mut side = self.poses[block].clone();
        side.gradient = side.gradient.map(|g| -g);
        let first = self.sparsity.first[block];
        let width = 6 * (block - first);
        // Rows grow by one column each.
        let row_at = |a: usize| a * width + a * (a + 1) / 2;
        for a in 0..6 {
            let row = &mut rows[row_at(a)..][width..=width + a];
            row.copy_from_slice(&side.hessian[a][..=a]);
            row[a] += damping * row[a] + 1e-9;
        }
        // Blocks one after another: a landmark's products with six entries of six rows far apart
        // would wait for memory.
        let mut couplings = vec![[[0.0; 6]; 6]; block - first];
        for (landmark, k) in &self.sparsity.block_observations[block] {
            let (landmark, k) = (*landmark as usize, *k as usize);
            let (part, inverse) = (&self.parts[landmark], &inverses[landmark]);
            let cameras = &self.sparsity.landmark_observations[landmark][..k];
            let own = &part.couplings[k];
            let weighted: [Vec3<f64>; 6] =
                std::array::from_fn(|a| *inverse * Vec3::new(own[0][a], own[1][a], own[2][a]));
            for ((other, _), coupling) in cameras.iter().zip(&part.couplings) {
                let sums = &mut couplings[*other as usize - first];
                for a in 0..6 {
                    subtract_products(&mut sums[a], weighted[a], coupling);
                }
            }
            for (a, weighted) in weighted.iter().enumerate() {
                side.gradient[a] += weighted.dot(Vec3::from_array(part.gradient));
                for g in 0..self.globals {
                    side.globals[a][g] -= weighted.dot(Vec3::from_array(part.globals[g]));
                }
                subtract_products(&mut rows[row_at(a) + width..][..=a], *weighted, own);
            }
        }
        for a in 0..6 {
            let row = rows[row_at(a)..][..width].chunks_exact_mut(6);
            row.zip(&couplings).for_each(|(entries, sums)| entries.copy_from_slice(&sums[a]));
        }
        side
    }

    fn reduced_globals(&self, inverses: &[Mat3<f64>], damping: f64) -> GlobalBlock {
        let mut out = self.global;
        for g in 0..self.globals {
            out.hessian[g][g] += damping * out.hessian[g][g] + 1e-9;
            out.gradient[g] = -out.gradient[g];
        }
        for (part, inverse) in self.parts.iter().zip(inverses) {
            for g in 0..self.globals {
                let weighted = *inverse * Vec3::from_array(part.globals[g]);
                out.gradient[g] += weighted.dot(Vec3::from_array(part.gradient));
                for h in 0..self.globals {
                    out.hessian[g][h] -= weighted.dot(Vec3::from_array(part.globals[h]));
                }
            }
        }
        out
    }

    /// Half the cost's gradient by the first free pose, a landmark and the globals.
    #[cfg(test)]
    pub(super) fn half_gradient(&self, landmark: usize) -> Vec<f64> {
        let mut out = self.poses[0].gradient.to_vec();
        out.extend(self.parts[landmark].gradient);
        out.extend(self.global.gradient);
        out
    }

    /// Variance of every inverse depth with poses and globals fixed.
    pub(super) fn inverse_depth_variances(&self) -> Vec<Option<f64>> {
        let variance = |p: &LandmarkBlock| Some(p.damped_inverse(0.0)[(2, 2)]).filter(|v| *v > 0.0);
        self.parts.iter().map(variance).collect()
    }
}

/// Approximation of the robust cost's curvature.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Curvature {
    /// For steps: iteratively reweighted squares, which bound the cost from above.
    Majorizing,
    /// For covariances: `w I`, and beyond the Huber threshold `w (I - r rᵀ/‖r‖²)`.
    Exact,
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

/// A weighted residual with its derivatives: the image position, and the inverse depth if measured.
pub(super) struct WeightedResidual {
    pub(super) projection: Projection,
    camera_jacobian: CameraJacobian,
    pub(super) residual: [f64; 3],
    /// Weights of the rows of the residual.
    pub(super) weights: [f64; 3],
    /// Number of rows: 2, or 3 with depth.
    pub(super) rows: usize,
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
    landmark: usize,
    observation: &BundleObservation,
    curvature: Curvature,
) -> Option<WeightedResidual> {
    let pose = &bundle.poses[observation.pose];
    let projection = bundle.landmarks[landmark].project(&bundle.camera, pose)?;
    let seen = observation.corrected(bundle.camera_change);
    let mut residual = [projection.at[0] - seen[0], projection.at[1] - seen[1], 0.0];
    let length = residual[0].hypot(residual[1]) / observation.sigma;
    let weight = huber(length).0 / (observation.sigma * observation.sigma);
    let (mut weights, mut rows) = ([weight, weight, 0.0], 2);
    if let Some(depth) = &observation.depth {
        residual[2] = projection.inverse_depth - depth.inverse;
        let off = residual[2].abs() / depth.sigma;
        let is_flat = curvature == Curvature::Exact && off > HUBER_THRESHOLD;
        weights[2] = if is_flat { 0.0 } else { huber(off).0 / (depth.sigma * depth.sigma) };
        rows = 3;
    }
    let camera_jacobian = observation.camera_jacobian;
    let mut out = WeightedResidual { projection, camera_jacobian, residual, weights, rows };
    if curvature == Curvature::Exact && length > HUBER_THRESHOLD {
        out.project_across_residual();
    }
    Some(out)
}

/// Derivative of one observation's cost along a change of all parameters.
pub(super) fn gradient_along(
    bundle: &Bundle,
    landmark: usize,
    observation: &BundleObservation,
    step: &BundleStep,
) -> f64 {
    let bounding = Curvature::Majorizing;
    let Some(w) = weighted_residual(bundle, landmark, observation, bounding) else { return 0.0 };
    let product = |row: &[f64], change: &[f64]| -> f64 {
        row.iter().zip(change).map(|(slope, change)| slope * change).sum()
    };
    let along = |i: usize| {
        product(&w.projection.by_pose[i], &step.poses[observation.pose])
            + product(&w.projection.by_landmark[i], &step.landmarks[landmark])
            + product(&w.by_globals(i), &step.globals)
    };
    (0..w.rows).map(|i| w.weights[i] * w.residual[i] * along(i)).sum()
}

/// Sums over the observations of a landmark; `landmark_observations` are those by free poses.
#[inline(always)]
pub(super) fn landmark_block(
    bundle: &Bundle,
    landmark: usize,
    landmark_observations: &[(u32, u32)],
    curvature: Curvature,
) -> LandmarkBlock {
    let observations = bundle.observations[landmark].iter();
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
fn relative_pose_blocks(
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
        for (landmark, observation) in
            range.flat_map(|l| bundle.observations[l].iter().map(move |s| (l, s)))
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
    /// Keeps the derivatives across the residual: along it the Huber cost has no curvature.
    fn project_across_residual(&mut self) {
        let length = self.residual[0].hypot(self.residual[1]);
        let across = [-self.residual[1] / length, self.residual[0] / length];
        let keep = |[x, y]: [&mut f64; 2]| {
            let slope = across[0] * *x + across[1] * *y;
            (*x, *y) = (across[0] * slope, across[1] * slope);
        };
        let [x, y, _] = &mut self.projection.by_pose;
        x.iter_mut().zip(y).for_each(|(x, y)| keep([x, y]));
        let [x, y, _] = &mut self.projection.by_landmark;
        x.iter_mut().zip(y).for_each(|(x, y)| keep([x, y]));
        let [x, y, _] = &mut self.projection.by_focal;
        keep([x, y]);
        self.camera_jacobian.iter_mut().for_each(|by| keep(by.each_mut()));
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

/// Subtracts `weightedᵀ · coupling` from up to six entries of a row.
#[inline(always)]
fn subtract_products(entries: &mut [f64], weighted: Vec3<f64>, coupling: &[[f64; 6]; 3]) {
    for (b, entry) in entries.iter_mut().enumerate() {
        *entry -=
            weighted.x * coupling[0][b] + weighted.y * coupling[1][b] + weighted.z * coupling[2][b];
    }
}

/// Inverse of a symmetric positive definite matrix by cofactors.
fn inverse(m: &Mat3<f64>) -> Mat3<f64> {
    let [a, b, c] = m.rows.map(Vec3::from_array);
    let columns = [b.cross(c), c.cross(a), a.cross(b)];
    let determinant = a.dot(columns[0]);
    Mat3 { rows: columns.map(Vec3::to_array) }.transpose().scaled(1.0 / determinant)
}
