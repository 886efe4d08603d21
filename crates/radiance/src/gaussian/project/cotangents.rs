//! Steps of the way back from a footprint to the parameters, for a group of Gaussians.

use super::stages::{Axes, Frame, Stages};
use i2slam_compute::simd::Lanes;
use pulp::Simd;

/// `∂L/∂Σ₂` as a symmetric matrix `[xx, xy, yy]`, from the second moments `M = Σ e d dᵀ`: with
/// `K = Σ₂⁻¹`, `∂L/∂K = -½ M` and `∂L/∂Σ₂ = ½ K M K`.
#[inline(always)]
pub(crate) fn covariance_cotangent<S: Simd>(
    [a, b, c]: [Lanes<S>; 3],
    m: [Lanes<S>; 3],
) -> [Lanes<S>; 3] {
    let (p, q) = (a * m[0] + b * m[1], a * m[1] + b * m[2]);
    let (r, s) = (b * m[0] + c * m[1], b * m[1] + c * m[2]);
    [(p * a + q * b).scale(0.5), (p * b + q * c).scale(0.5), (r * b + s * c).scale(0.5)]
}

/// `∂L/∂p` through the centre, the Jacobian and the depth.
#[inline(always)]
pub(crate) fn mean_cotangent<S: Simd>(
    frame: &Frame,
    stages: &Stages<S>,
    d_centre: [Lanes<S>; 2],
    d_jacobian: [[Lanes<S>; 2]; 2],
    d_depth: Lanes<S>,
) -> [Lanes<S>; 3] {
    let (j, inverse_depth) = (&stages.jacobian, stages.inverse_depth);
    let focal = [j.x[0], j.y[0]];
    let (mut lateral, mut d_z) = ([d_depth; 2], d_depth);
    for axis in 0..2 {
        let ([first, last], [low, high]) = (d_jacobian[axis], frame.range(axis));
        let ratio = stages.ratio[axis];
        // J's rows are f/z and -f/z clamp(x/z); the clamp passes nothing on outside.
        let slope = ratio.strictly_within(low, high).keep(last * focal[axis] * inverse_depth);
        lateral[axis] = d_centre[axis] * focal[axis] - slope;
        d_z = d_z - lateral[axis] * ratio;
        d_z = d_z + (last * stages.clamped[axis] - first) * focal[axis] * inverse_depth;
    }
    [lateral[0], lateral[1], d_z]
}

/// `∂L/∂q` of the stored quaternion from the columns of `∂L/∂R`.
#[inline(always)]
pub(crate) fn quaternion_cotangent<S: Simd>(
    axes: &Axes<S>,
    d: &[[Lanes<S>; 3]; 3],
) -> [Lanes<S>; 4] {
    let [w, x, y, z] = axes.unit;
    // Entry (row, column) of ∂L/∂R is d[column][row].
    let turn = [d[1][2] - d[2][1], d[2][0] - d[0][2], d[0][1] - d[1][0]];
    let (xy, xz, yz) = (d[1][0] + d[0][1], d[2][0] + d[0][2], d[2][1] + d[1][2]);
    let unit = [
        x * turn[0] + y * turn[1] + z * turn[2],
        y * xy + z * xz + w * turn[0] - (x * (d[1][1] + d[2][2])).scale(2.0),
        x * xy + z * yz + w * turn[1] - (y * (d[0][0] + d[2][2])).scale(2.0),
        x * xz + y * yz + w * turn[2] - (z * (d[0][0] + d[1][1])).scale(2.0),
    ];
    let along = unit[0] * w + unit[1] * x + unit[2] * y + unit[3] * z;
    let factor = axes.inverse_norm.scale(2.0);
    [
        (unit[0] - w * along) * factor,
        (unit[1] - x * along) * factor,
        (unit[2] - y * along) * factor,
        (unit[3] - z * along) * factor,
    ]
}
