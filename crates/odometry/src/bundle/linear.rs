//! The normal equations of a bundle, and their solution with the landmarks eliminated.
//!
//! Every row of the cameras' system is computed by one task, its landmarks in order, so that the
//! system is kept once, however many tasks there are.

use super::parts::{Curvature, GlobalPart, Part, PosePart, global_part, part, pose_part};
use super::structure::Structure;
use super::{Bundle, GLOBALS};
use crate::skyline::Skyline;
use i2slam_geometry::{Mat3, Vec3};
use rayon::prelude::*;

/// Damping that only keeps the unit of length, which nothing tells, where it is.
const UNDAMPED: f64 = 1e-7;

/// A change of all unknowns.
pub(super) struct Step {
    /// Tangent of every pose, zero for fixed ones.
    pub(super) poses: Vec<[f64; 6]>,
    pub(super) landmarks: Vec<[f64; 3]>,
    pub(super) globals: [f64; GLOBALS],
}

/// Normal equations: cameras (`U`), landmarks (`C`) and couplings (`E`).
pub(super) struct Linear<'a> {
    structure: &'a Structure,
    /// How many of the globals are unknown.
    globals: usize,
    parts: Vec<Part>,
    poses: Vec<PosePart>,
    global: GlobalPart,
}

impl<'a> Linear<'a> {
    pub(super) fn new(bundle: &Bundle, structure: &'a Structure, curvature: Curvature) -> Self {
        let globals = bundle.globals();
        let landmarks = 0..bundle.landmarks.len();
        let landmark = |i: usize| part(bundle, i, &structure.cameras[i], curvature);
        let parts = landmarks.into_par_iter().map(landmark);
        let block = |block: usize| pose_part(bundle, structure, block, curvature);
        let poses = (0..structure.poses.len()).into_par_iter().map(block);
        let (parts, poses) = (parts.collect(), poses.collect());
        let global =
            if globals == 0 { GlobalPart::default() } else { global_part(bundle, curvature) };
        Self { structure, globals, parts, poses, global }
    }

    /// The Levenberg-Marquardt step; `None` if the damped system is not positive definite.
    pub(super) fn step(&self, damping: f64) -> Option<Step> {
        let (mut matrix, mut solved) = self.reduced(damping);
        matrix.solve(&mut solved).then(|| self.spread(&solved, damping, 1.0))
    }

    /// How all unknowns answer a unit force on each of those that all sights share: columns of the
    /// inverse of the whole system. `None` where they are not determined.
    pub(super) fn responses(&self) -> Option<Vec<Step>> {
        let (mut matrix, right) = self.reduced(UNDAMPED);
        if !matrix.factorise() {
            return None;
        }
        let unit = |global: usize| {
            let mut unit = vec![0.0; right.len()];
            unit[6 * self.poses.len() + global] = 1.0;
            matrix.substitute(&mut unit);
            self.spread(&unit, UNDAMPED, 0.0)
        };
        Some((0..self.globals).map(unit).collect())
    }

    /// What the landmarks do when the cameras do what was solved, `pulled` by their own gradients.
    fn spread(&self, solved: &[f64], damping: f64, pulled: f64) -> Step {
        let pose = |block: &Option<usize>| {
            block.map_or([0.0; 6], |b| std::array::from_fn(|i| solved[6 * b + i]))
        };
        let mut globals = [0.0; GLOBALS];
        globals.iter_mut().zip(&solved[6 * self.poses.len()..]).for_each(|(g, s)| *g = *s);
        let landmark = |(part, cameras): (&Part, &Vec<(u32, u32)>)| {
            let mut right = part.gradient.map(|g| -pulled * g);
            for i in 0..3 {
                for (e, (block, _)) in part.couplings.iter().zip(cameras) {
                    let tangent = &solved[6 * *block as usize..][..6];
                    right[i] -= (0..6).map(|a| e[a][i] * tangent[a]).sum::<f64>();
                }
                right[i] -= (0..self.globals).map(|g| part.globals[g][i] * globals[g]).sum::<f64>();
            }
            (part.damped_inverse(damping) * Vec3::from_array(right)).to_array()
        };
        let parts = self.parts.par_iter().zip(&self.structure.cameras);
        let poses = self.structure.blocks.iter().map(pose).collect();
        Step { poses, landmarks: parts.map(landmark).collect(), globals }
    }

    /// The cameras' system, `U - E C⁻¹ Eᵀ`, and its right side.
    fn reduced(&self, damping: f64) -> (Skyline, Vec<f64>) {
        let inverses: Vec<Mat3<f64>> =
            self.parts.par_iter().map(|p| p.damped_inverse(damping)).collect();
        let mut matrix = Skyline::new(self.structure.first_columns(self.globals));
        let rows = matrix.split((1..=self.poses.len()).map(|block| 6 * block));
        let fill = |(block, rows): (usize, &mut [f64])| self.fill(block, rows, &inverses, damping);
        let sides: Vec<PosePart> = rows.into_par_iter().enumerate().map(fill).collect();
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

    /// The six rows of a block; returns its right side and its entries in the globals' rows.
    fn fill(
        &self,
        block: usize,
        rows: &mut [f64],
        inverses: &[Mat3<f64>],
        damping: f64,
    ) -> PosePart {
        let mut side = self.poses[block].clone();
        side.gradient = side.gradient.map(|g| -g);
        let first = self.structure.first[block];
        let width = 6 * (block - first);
        // Rows grow by one column each.
        let row_at = |a: usize| a * width + a * (a + 1) / 2;
        for a in 0..6 {
            let row = &mut rows[row_at(a)..][width..=width + a];
            row.copy_from_slice(&side.hessian[a][..=a]);
            row[a] += damping * row[a] + 1e-9;
        }
        for (landmark, k) in &self.structure.seen[block] {
            let (landmark, k) = (*landmark as usize, *k as usize);
            let (part, inverse) = (&self.parts[landmark], &inverses[landmark]);
            let cameras = &self.structure.cameras[landmark][..k];
            for a in 0..6 {
                let weighted = *inverse * Vec3::from_array(part.couplings[k][a]);
                side.gradient[a] += weighted.dot(Vec3::from_array(part.gradient));
                for g in 0..self.globals {
                    side.globals[a][g] -= weighted.dot(Vec3::from_array(part.globals[g]));
                }
                let line = &mut rows[row_at(a)..][..=width + a];
                for ((other, _), coupling) in cameras.iter().zip(&part.couplings) {
                    let entries = &mut line[6 * (*other as usize - first)..][..6];
                    for (entry, row) in entries.iter_mut().zip(coupling) {
                        *entry -= weighted.dot(Vec3::from_array(*row));
                    }
                }
                for (entry, row) in line[width..].iter_mut().zip(&part.couplings[k]) {
                    *entry -= weighted.dot(Vec3::from_array(*row));
                }
            }
        }
        side
    }

    fn reduced_globals(&self, inverses: &[Mat3<f64>], damping: f64) -> GlobalPart {
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

    /// Half the cost's gradient: first free pose, a landmark, globals.
    #[cfg(test)]
    pub(super) fn half_gradient(&self, landmark: usize) -> Vec<f64> {
        let mut out = self.poses[0].gradient.to_vec();
        out.extend(self.parts[landmark].gradient);
        out.extend(self.global.gradient);
        out
    }

    /// Variance of every inverse depth, poses and globals fixed.
    pub(super) fn inverse_depth_variances(&self) -> Vec<Option<f64>> {
        let variance = |p: &Part| Some(p.damped_inverse(0.0)[(2, 2)]).filter(|v| *v > 0.0);
        self.parts.iter().map(variance).collect()
    }
}
