//! Response of an adjusted bundle to gradients: how far they move the minimum.

use super::blocks::{Curvature, weighted_residual};
use super::normal_equations::{GAUGE_DAMPING, SchurSystem};
use super::sparsity::BlockSparsity;
use super::{Bundle, GLOBALS};
use i2slam_compute::SkylineMatrix;
use i2slam_geometry::{Mat3, Vec3};
use rayon::prelude::*;

impl SchurSystem<'_> {
    /// The factorised system; `None` where it is not positive definite.
    pub(super) fn solver(&self) -> Option<Solver> {
        let (mut matrix, _) = self.reduced_camera_system(GAUGE_DAMPING);
        let inverses = self.parts.par_iter().map(|p| p.damped_inverse(GAUGE_DAMPING)).collect();
        matrix.factorise().then_some(Solver { matrix, inverses })
    }

    /// A gradient of zero.
    pub(super) fn zero_gradient(&self) -> Gradient {
        Gradient {
            poses: vec![[0.0; 6]; self.poses.len()],
            landmarks: vec![[0.0; 3]; self.parts.len()],
            globals: [0.0; GLOBALS],
        }
    }

    /// The gradient of the cost, halved.
    pub(super) fn gradient(&self) -> Gradient {
        Gradient {
            poses: self.poses.iter().map(|block| block.gradient).collect(),
            landmarks: self.parts.iter().map(|part| part.gradient).collect(),
            globals: self.global.gradient,
        }
    }

    /// Tangents of all poses by which a gradient moves the minimum: `-H⁻¹ g`.
    pub(super) fn respond(&self, solver: &Solver, gradient: &Gradient) -> Vec<[f64; 6]> {
        let moved = |(inverse, g): (&Mat3<f64>, &[f64; 3])| *inverse * Vec3::from_array(*g);
        let moved: Vec<Vec3<f64>> =
            solver.inverses.iter().zip(&gradient.landmarks).map(moved).collect();
        let mut right = Vec::with_capacity(6 * self.poses.len() + self.globals);
        for (block, g) in gradient.poses.iter().enumerate() {
            let mut side = g.map(|v| -v);
            for (landmark, k) in &self.sparsity.block_observations[block] {
                let (landmark, k) = (*landmark as usize, *k as usize);
                let [x, y, z] = &self.parts[landmark].couplings[k];
                for (a, side) in side.iter_mut().enumerate() {
                    *side += Vec3::new(x[a], y[a], z[a]).dot(moved[landmark]);
                }
            }
            right.extend(side);
        }
        for g in 0..self.globals {
            let parts = self.parts.iter().zip(&moved);
            let by_landmarks: f64 =
                parts.map(|(part, m)| Vec3::from_array(part.globals[g]).dot(*m)).sum();
            right.push(by_landmarks - gradient.globals[g]);
        }
        solver.matrix.substitute(&mut right);
        let pose = |block: &Option<usize>| {
            block.map_or([0.0; 6], |b| std::array::from_fn(|i| right[6 * b + i]))
        };
        self.sparsity.blocks.iter().map(pose).collect()
    }
}

/// The reduced camera system after factorisation, and the inverses of the landmarks' blocks.
pub(super) struct Solver {
    matrix: SkylineMatrix,
    inverses: Vec<Mat3<f64>>,
}

/// A gradient by all parameters: free poses by block, landmarks, globals.
pub(super) struct Gradient {
    poses: Vec<[f64; 6]>,
    landmarks: Vec<[f64; 3]>,
    globals: [f64; GLOBALS],
}

/// Half the derivative of one observation's cost by its parameters.
pub(super) struct ObservationGradient {
    pub(super) landmark: usize,
    /// Factor by which the fit of the landmark's three numbers has shortened its residuals.
    pub(super) correction: f64,
    block: Option<usize>,
    by_pose: [f64; 6],
    by_landmark: [f64; 3],
    by_globals: [f64; GLOBALS],
}

impl Gradient {
    /// Adds `weight` times the gradient of an observation.
    pub(super) fn add(&mut self, g: &ObservationGradient, weight: f64) {
        if let Some(block) = g.block {
            (0..6).for_each(|i| self.poses[block][i] += weight * g.by_pose[i]);
        }
        (0..3).for_each(|i| self.landmarks[g.landmark][i] += weight * g.by_landmark[i]);
        (0..GLOBALS).for_each(|i| self.globals[i] += weight * g.by_globals[i]);
    }

    /// Adds gradients by two poses, where they are free.
    pub(super) fn add_to_poses(
        &mut self,
        sparsity: &BlockSparsity,
        poses: [usize; 2],
        gradients: [[f64; 6]; 2],
    ) {
        for (pose, gradient) in poses.into_iter().zip(gradients) {
            let Some(block) = sparsity.blocks[pose] else { continue };
            (0..6).for_each(|i| self.poses[block][i] += gradient[i]);
        }
    }
}

/// Gradients of all observations in front of their cameras.
pub(super) fn observation_gradients(
    bundle: &Bundle,
    sparsity: &BlockSparsity,
) -> Vec<ObservationGradient> {
    let of_landmark = |landmark: usize| {
        let observations = &bundle.observations[landmark];
        let rows: usize = observations.iter().map(|o| 2 + usize::from(o.depth.is_some())).sum();
        let correction = (rows as f64 / rows.saturating_sub(3).max(1) as f64).sqrt();
        observations.iter().filter_map(move |o| {
            let point = &bundle.landmarks[landmark];
            let w = weighted_residual(bundle, point, o, Curvature::Majorizing)?;
            let sum = |slope: &dyn Fn(usize) -> f64| -> f64 {
                (0..w.rows).map(|row| w.weights[row] * w.residual[row] * slope(row)).sum()
            };
            Some(ObservationGradient {
                landmark,
                correction,
                block: sparsity.blocks[o.pose],
                by_pose: std::array::from_fn(|i| sum(&|row| w.projection.by_pose[row][i])),
                by_landmark: std::array::from_fn(|i| sum(&|row| w.projection.by_landmark[row][i])),
                by_globals: std::array::from_fn(|i| sum(&|row| w.by_globals(row)[i])),
            })
        })
    };
    (0..bundle.landmarks.len()).flat_map(of_landmark).collect()
}
