//! Measured relative poses as terms of a bundle adjustment.

use crate::alignment::cholesky;
use crate::multiview::robust_loss::huber;
use i2slam_geometry::{Mat3, Pose, Tangent, right_jacobian_inverse};

/// Length of a six-dimensional residual up to which it counts as noise [standard deviations]: 95 %
/// of normally distributed ones.
const USUAL_LENGTH: f64 = 3.55;

/// A measured pose of one camera in another, `first_from_second`, with the information of its
/// tangent at the second camera (order as [`Pose::retract`]).
#[derive(Clone, Copy, Debug)]
pub(crate) struct RelativePoseFactor {
    /// Indices of the poses.
    pub(crate) first: usize,
    pub(crate) second: usize,
    pub(crate) first_from_second: Pose<f64>,
    pub(crate) information: [[f64; 6]; 6],
}

/// Normal equations of a relative pose: blocks of both poses, and rows of the first with columns of
/// the second.
pub(super) struct LinearRelativePose {
    pub(super) hessians: [[[f64; 6]; 6]; 2],
    pub(super) gradients: [[f64; 6]; 2],
    pub(super) coupling: [[f64; 6]; 6],
}

impl RelativePoseFactor {
    /// Robust cost [variances].
    pub(super) fn cost(&self, poses: &[Pose<f64>]) -> f64 {
        let scale = huber_scale();
        huber(self.length(poses) / scale).1 * scale * scale
    }

    /// Mahalanobis length of the residual.
    pub(crate) fn length(&self, poses: &[Pose<f64>]) -> f64 {
        let residual = self.residual(poses).to_array();
        dot(&residual, &multiply(&self.information, &residual)).max(0.0).sqrt()
    }

    /// `measured.local(first⁻¹ second)`.
    fn residual(&self, poses: &[Pose<f64>]) -> Tangent<f64> {
        self.first_from_second.local(poses[self.first].inverse() * poses[self.second])
    }

    /// Derivatives of the residual `e = (R_Mᵀ (t_E - t_M), log(R_Mᵀ R_E))` by both tangents, with
    /// `E = first⁻¹ second`: moving the first by `(ρ, φ)` moves `t_E` by `t_E × φ - ρ`, the second by
    /// `R_E ρ`; turning them turns `R_E` to `Exp(-φ₁) R_E Exp(φ₂)`.
    fn jacobians(&self, poses: &[Pose<f64>]) -> [[[f64; 6]; 6]; 2] {
        let relative = poses[self.first].inverse() * poses[self.second];
        let back = self.first_from_second.rotation.matrix().transpose();
        let turned = relative.rotation.matrix();
        let jacobian = right_jacobian_inverse(self.residual(poses).rotation);
        let spin = back * Mat3::skew(relative.translation);
        let mut out = [[[0.0; 6]; 6]; 2];
        let mut place = |side: usize, (row, column): (usize, usize), block: &Mat3<f64>| {
            for a in 0..3 {
                (0..3).for_each(|b| out[side][row + a][column + b] = block.rows[a][b]);
            }
        };
        place(0, (0, 0), &back.scaled(-1.0));
        place(0, (0, 3), &spin);
        place(0, (3, 3), &(jacobian * turned.transpose()).scaled(-1.0));
        place(1, (0, 0), &(back * turned));
        place(1, (3, 3), &jacobian);
        out
    }

    /// Half the derivative of the cost by both tangents where the residual is `B noise`, with
    /// `B Bᵀ` the covariance that the information claims: `w Jᵀ L noise` with `L Lᵀ = Λ`.
    pub(super) fn noise_gradients(&self, poses: &[Pose<f64>], noise: &[f64; 6]) -> [[f64; 6]; 2] {
        let weight = huber(self.length(poses) / huber_scale()).0;
        let root = cholesky(&self.information).unwrap_or_default();
        let turned: [f64; 6] = root.map(|row| weight * dot(&row, noise));
        self.jacobians(poses)
            .map(|j| std::array::from_fn(|c| (0..6).map(|r| j[r][c] * turned[r]).sum()))
    }

    pub(super) fn linearize(&self, poses: &[Pose<f64>]) -> LinearRelativePose {
        let weight = huber(self.length(poses) / huber_scale()).0;
        let residual = self.residual(poses).to_array();
        let jacobians = self.jacobians(poses);
        let weighted = jacobians.map(|j| {
            let columns: [[f64; 6]; 6] = std::array::from_fn(|c| {
                multiply(&self.information, &std::array::from_fn(|r| j[r][c])).map(|v| weight * v)
            });
            columns
        });
        let product = |left: usize, right: usize| -> [[f64; 6]; 6] {
            std::array::from_fn(|a| {
                std::array::from_fn(|b| {
                    (0..6).map(|r| weighted[left][a][r] * jacobians[right][r][b]).sum()
                })
            })
        };
        LinearRelativePose {
            hessians: [product(0, 0), product(1, 1)],
            gradients: [0, 1].map(|side| weighted[side].map(|column| dot(&column, &residual))),
            coupling: product(0, 1),
        }
    }
}

/// Factor from the Huber threshold of one residual to that of a six-dimensional one.
fn huber_scale() -> f64 {
    USUAL_LENGTH / crate::multiview::robust_loss::HUBER_THRESHOLD
}

fn multiply(m: &[[f64; 6]; 6], v: &[f64; 6]) -> [f64; 6] {
    m.map(|row| dot(&row, v))
}

fn dot(a: &[f64; 6], b: &[f64; 6]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::{assert_gradient, noise};
    use i2slam_geometry::{Rotation, Vec3};

    fn pose(seed: u64) -> Pose<f64> {
        let n = noise(seed, 6);
        Pose::new(Rotation::exp(Vec3::new(n[0], n[1], n[2])), Vec3::new(n[3], n[4], n[5]))
    }

    /// A factor whose measurement is off by `off`.
    fn factor(off: f64) -> RelativePoseFactor {
        let exact = pose(1).inverse() * pose(2);
        let n = noise(3, 42);
        let first_from_second =
            exact.retract(Tangent::from_array(std::array::from_fn(|i| off * n[i])));
        let root: [[f64; 6]; 6] =
            std::array::from_fn(|i| std::array::from_fn(|j| n[6 + 6 * i + j]));
        let information = std::array::from_fn(|i| {
            std::array::from_fn(|j| 30.0 * (0..6).map(|k| root[i][k] * root[j][k]).sum::<f64>())
        });
        RelativePoseFactor { first: 0, second: 1, first_from_second, information }
    }

    #[test]
    fn half_the_derivative_of_the_cost_is_the_gradient() {
        // Within the threshold of the robust loss, and beyond.
        for off in [0.05, 2.0] {
            let (factor, poses) = (factor(off), [pose(1), pose(2)]);
            let found = factor.linearize(&poses);
            let gradient: Vec<f64> = found.gradients.concat().iter().map(|g| 2.0 * g).collect();
            assert_gradient("relative pose", &[0.0; 12], &gradient, 1e-5, 1e-6, |x| {
                let part = |k: usize| Tangent::from_array(std::array::from_fn(|i| x[6 * k + i]));
                factor.cost(&[poses[0].retract(part(0)), poses[1].retract(part(1))])
            });
        }
    }
}
