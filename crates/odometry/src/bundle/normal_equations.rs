//! Normal equations of a bundle, solved with the landmarks eliminated (Schur complement).
//!
//! Every block row of the reduced camera system is computed by one task, its landmarks in order, so
//! that the result does not depend on the number of threads and the matrix is kept once.

use super::blocks::{
    Curvature, GlobalBlock, LandmarkBlock, PoseBlock, global_block, landmark_block, pose_block,
    relative_pose_blocks, weighted_residual,
};
use super::sparsity::BlockSparsity;
use super::{Bundle, BundleObservation, GLOBALS};
use i2slam_compute::SkylineMatrix;
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

/// Derivative of one observation's cost along a change of all parameters.
pub(super) fn gradient_along(
    bundle: &Bundle,
    landmark: usize,
    observation: &BundleObservation,
    step: &BundleStep,
) -> f64 {
    let (bounding, point) = (Curvature::Majorizing, &bundle.landmarks[landmark]);
    let Some(w) = weighted_residual(bundle, point, observation, bounding) else { return 0.0 };
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

/// Subtracts `weightedᵀ · coupling` from up to six entries of a row.
#[inline(always)]
fn subtract_products(entries: &mut [f64], weighted: Vec3<f64>, coupling: &[[f64; 6]; 3]) {
    for (b, entry) in entries.iter_mut().enumerate() {
        *entry -=
            weighted.x * coupling[0][b] + weighted.y * coupling[1][b] + weighted.z * coupling[2][b];
    }
}
