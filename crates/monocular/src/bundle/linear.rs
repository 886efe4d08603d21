//! The normal equations of a bundle, and their solution with the landmarks eliminated.

use super::cholesky::solve;
use super::{Bundle, CHUNK, Sight};
use crate::robust::huber;
use i2slam_compute::reduce_in_order;
use i2slam_geometry::{Mat3, Vec3};

/// A change of all unknowns.
pub(super) struct Step {
    /// Tangent of every pose, zero for fixed ones.
    pub(super) poses: Vec<[f64; 6]>,
    pub(super) landmarks: Vec<[f64; 3]>,
    pub(super) log_focal: f64,
}

/// What one landmark brings: `C`, its gradient, and its coupling with every camera that sees it.
#[derive(Default)]
struct Part {
    hessian: [[f64; 3]; 3],
    gradient: [f64; 3],
    /// First column of the pose, coupling `E`.
    couplings: Vec<(usize, [[f64; 3]; 6])>,
    focal_coupling: [f64; 3],
}

/// Normal equations: cameras (`U`, dense), landmarks (`C`, blocks) and couplings (`E`).
pub(super) struct Linear {
    /// First column of every pose; `None` for fixed ones.
    columns: Vec<Option<usize>>,
    size: usize,
    has_focal: bool,
    cameras: Vec<f64>,
    gradient: Vec<f64>,
    parts: Vec<Part>,
}

/// Camera entries of some landmarks: per pose the block, its gradient and its coupling with the
/// focal length; then the focal length's own.
struct CameraSums {
    blocks: Vec<[[f64; 8]; 6]>,
    focal: [f64; 2],
}

impl Linear {
    pub(super) fn new(bundle: &Bundle) -> Self {
        let mut size = 0;
        let columns: Vec<Option<usize>> = (bundle.fixed.iter())
            .map(|fixed| {
                let column = size;
                size += if *fixed { 0 } else { 6 };
                (!fixed).then_some(column)
            })
            .collect();
        let focal_column = size;
        size += usize::from(bundle.adjust_focal);
        let mut out = Self {
            columns,
            size,
            has_focal: bundle.adjust_focal,
            cameras: vec![0.0; size * size],
            gradient: vec![0.0; size],
            parts: Vec::with_capacity(bundle.landmarks.len()),
        };
        let columns = out.columns.clone();
        let part = |range: std::ops::Range<usize>| {
            let mut sums =
                CameraSums { blocks: vec![[[0.0; 8]; 6]; bundle.poses.len()], focal: [0.0; 2] };
            let parts: Vec<Part> =
                range.map(|i| linearised(bundle, i, &columns, &mut sums)).collect();
            (parts, sums)
        };
        reduce_in_order(bundle.landmarks.len(), CHUNK, part, |(parts, sums)| {
            out.parts.extend(parts);
            out.add(&sums, focal_column);
        });
        out
    }

    fn add(&mut self, sums: &CameraSums, focal_column: usize) {
        let n = self.size;
        for (column, block) in self.columns.iter().zip(&sums.blocks) {
            let Some(c) = *column else { continue };
            for a in 0..6 {
                (0..6).for_each(|b| self.cameras[(c + a) * n + c + b] += block[a][b]);
                self.gradient[c + a] += block[a][6];
                if self.has_focal {
                    self.cameras[focal_column * n + c + a] += block[a][7];
                }
            }
        }
        if self.has_focal {
            self.cameras[n * n - 1] += sums.focal[0];
            self.gradient[n - 1] += sums.focal[1];
        }
    }

    /// The Levenberg-Marquardt step; `None` if the damped system is not positive definite.
    pub(super) fn step(&self, damping: f64) -> Option<Step> {
        let (mut matrix, mut cameras) = self.reduced(damping);
        if !solve(&mut matrix, &mut cameras) {
            return None;
        }
        let pose = |column: &Option<usize>| {
            column.map_or([0.0; 6], |c| std::array::from_fn(|i| cameras[c + i]))
        };
        let log_focal = if self.has_focal { cameras[self.size - 1] } else { 0.0 };
        let landmark = |part: &Part| {
            let mut right = part.gradient.map(|g| -g);
            for i in 0..3 {
                for (c, e) in &part.couplings {
                    right[i] -= (0..6).map(|a| e[a][i] * cameras[c + a]).sum::<f64>();
                }
                right[i] -= part.focal_coupling[i] * log_focal;
            }
            (part.damped_inverse(damping) * Vec3::from_array(right)).to_array()
        };
        let landmarks = self.parts.iter().map(landmark).collect();
        Some(Step { poses: self.columns.iter().map(pose).collect(), landmarks, log_focal })
    }

    /// The cameras' system, `U - E C⁻¹ Eᵀ` (lower triangle), and its right side.
    fn reduced(&self, damping: f64) -> (Vec<f64>, Vec<f64>) {
        let n = self.size;
        let mut matrix = self.cameras.clone();
        for i in 0..n {
            matrix[i * n + i] += damping * matrix[i * n + i] + 1e-9;
        }
        let mut right: Vec<f64> = self.gradient.iter().map(|g| -g).collect();
        let task = |range: std::ops::Range<usize>| {
            let (mut matrix, mut right) = (vec![0.0; n * n], vec![0.0; n]);
            for part in &self.parts[range] {
                part.eliminate(damping, self.has_focal, n, &mut matrix, &mut right);
            }
            (matrix, right)
        };
        reduce_in_order(self.parts.len(), 4 * CHUNK, task, |(m, r)| {
            matrix.iter_mut().zip(m).for_each(|(a, b)| *a -= b);
            right.iter_mut().zip(r).for_each(|(a, b)| *a += b);
        });
        (matrix, right)
    }

    /// Half the cost's gradient: first free pose, a landmark, focal length.
    #[cfg(test)]
    pub(super) fn half_gradient(&self, landmark: usize) -> Vec<f64> {
        let mut out = self.gradient[..6].to_vec();
        out.extend(self.parts[landmark].gradient);
        out.push(self.gradient[self.size - 1]);
        out
    }

    /// Variance of the logarithm of the focal length.
    pub(super) fn focal_variance(&self) -> Option<f64> {
        let (mut matrix, mut unit) = self.reduced(1e-7);
        unit.fill(0.0);
        *unit.last_mut().filter(|_| self.has_focal)? = 1.0;
        let solved = solve(&mut matrix, &mut unit);
        unit.last().copied().filter(|v| solved && *v > 0.0)
    }

    /// Variance of every inverse depth, poses and focal length fixed.
    pub(super) fn inverse_depth_variances(&self) -> Vec<Option<f64>> {
        let variance = |p: &Part| Some(p.damped_inverse(0.0)[(2, 2)]).filter(|v| *v > 0.0);
        self.parts.iter().map(variance).collect()
    }
}

impl Part {
    fn damped_inverse(&self, damping: f64) -> Mat3<f64> {
        let mut rows = self.hessian;
        (0..3).for_each(|i| rows[i][i] += damping * rows[i][i] + 1e-9);
        inverse(&Mat3 { rows })
    }

    /// Adds `E C⁻¹ Eᵀ` to the lower triangle of `matrix` and `E C⁻¹ g` to `right`.
    fn eliminate(
        &self,
        damping: f64,
        has_focal: bool,
        n: usize,
        matrix: &mut [f64],
        right: &mut [f64],
    ) {
        let inverse = self.damped_inverse(damping);
        let gradient = Vec3::from_array(self.gradient);
        let weighted = |row: &[f64; 3]| inverse * Vec3::from_array(*row);
        for (k, (column, coupling)) in self.couplings.iter().enumerate() {
            for (a, row) in coupling.iter().enumerate() {
                let weighted = weighted(row);
                right[column + a] += weighted.dot(gradient);
                let line = &mut matrix[(column + a) * n..(column + a + 1) * n];
                for (other, rows) in &self.couplings[..=k] {
                    for (b, row) in rows.iter().enumerate() {
                        line[other + b] += weighted.dot(Vec3::from_array(*row));
                    }
                }
            }
        }
        if has_focal {
            let weighted = weighted(&self.focal_coupling);
            right[n - 1] += weighted.dot(gradient);
            for (column, rows) in &self.couplings {
                for (b, row) in rows.iter().enumerate() {
                    matrix[(n - 1) * n + column + b] += weighted.dot(Vec3::from_array(*row));
                }
            }
            matrix[n * n - 1] += weighted.dot(Vec3::from_array(self.focal_coupling));
        }
    }
}

/// Derivatives of all sights of a landmark; what concerns cameras alone is added to `sums`.
fn linearised(
    bundle: &Bundle,
    index: usize,
    columns: &[Option<usize>],
    sums: &mut CameraSums,
) -> Part {
    let mut part = Part::default();
    for sight in &bundle.sights[index] {
        add_sight(bundle, index, sight, columns, sums, &mut part);
    }
    part
}

fn add_sight(
    bundle: &Bundle,
    index: usize,
    sight: &Sight,
    columns: &[Option<usize>],
    sums: &mut CameraSums,
    part: &mut Part,
) {
    let pose = &bundle.poses[sight.pose];
    let Some(p) = bundle.landmarks[index].project(&bundle.camera, pose) else { return };
    let r: [f64; 2] = std::array::from_fn(|i| p.at[i] - sight.at[i]);
    let weight = huber(r[0].hypot(r[1]) / sight.sigma).0 / (sight.sigma * sight.sigma);
    let mut coupling = [[0.0; 3]; 6];
    for i in 0..2 {
        let (jp, jl, jf) = (&p.by_pose[i], &p.by_landmark[i], p.by_focal[i]);
        for a in 0..3 {
            part.gradient[a] += weight * jl[a] * r[i];
            (0..3).for_each(|b| part.hessian[a][b] += weight * jl[a] * jl[b]);
            if bundle.adjust_focal {
                part.focal_coupling[a] += weight * jf * jl[a];
            }
        }
        for a in 0..6 {
            let w = weight * jp[a];
            (0..3).for_each(|b| coupling[a][b] += w * jl[b]);
            let row = &mut sums.blocks[sight.pose][a];
            (0..6).for_each(|b| row[b] += w * jp[b]);
            row[6] += w * r[i];
            row[7] += w * jf;
        }
        sums.focal[0] += weight * jf * jf;
        sums.focal[1] += weight * jf * r[i];
    }
    if let Some(column) = columns[sight.pose] {
        part.couplings.push((column, coupling));
    }
}

/// The inverse of a symmetric positive definite matrix, by its cofactors.
fn inverse(m: &Mat3<f64>) -> Mat3<f64> {
    let [a, b, c] = m.rows.map(Vec3::from_array);
    let columns = [b.cross(c), c.cross(a), a.cross(b)];
    let determinant = a.dot(columns[0]);
    Mat3 { rows: columns.map(Vec3::to_array) }.transpose().scaled(1.0 / determinant)
}
