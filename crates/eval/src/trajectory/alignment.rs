//! Least-squares alignment of point sets.

use crate::EvalError;
use i2slam_geometry::{Mat3, Rotation, Similarity, Vec3};
use serde::Serialize;

/// Degrees of freedom of the alignment before errors are measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Alignment {
    /// Rotation and translation: for systems with metric scale (RGB-D).
    Se3,
    /// Rotation, translation and scale: for systems without metric scale (one colour camera).
    Sim3,
}

/// The similarity with the least `Σ ‖target_i - (s R source_i + t)‖²`.
///
/// Umeyama 1991, eq. 34-43: with the covariance `Σ_ts = 1/n Σ (target - μ_t)(source - μ_s)ᵀ
/// = U D Vᵀ`, `R = U S Vᵀ`, `s = tr(D S)/σ_s²`, `t = μ_t - s R μ_s`, where
/// `S = diag(1, 1, det U · det V)` keeps `R` a rotation when a reflection would fit better.
/// Collinear points leave the rotation about their line free (evo refuses them); the smallest
/// rotation that aligns the lines is used. Points that all coincide are refused.
pub fn align(
    source: &[Vec3<f64>],
    target: &[Vec3<f64>],
    alignment: Alignment,
) -> Result<Similarity<f64>, EvalError> {
    if source.len() != target.len() {
        let (first, second) = (vec![source.len()], vec![target.len()]);
        return Err(EvalError::ShapeMismatch { what: "point lists", first, second });
    }
    if source.len() < 2 {
        return Err(EvalError::TooFew { what: "points", found: source.len(), needed: 2 });
    }
    let (source_mean, source_variance) = moments(source, "points of the estimate")?;
    let (target_mean, target_variance) = moments(target, "points of the truth")?;
    let covariance = covariance(source, source_mean, target, target_mean);
    let (rotation, trace) = best_rotation(&covariance);
    if trace <= 1e-12 * (source_variance * target_variance).sqrt() {
        return Err(EvalError::Uncorrelated);
    }
    let scale = match alignment {
        Alignment::Se3 => 1.0,
        Alignment::Sim3 => trace / source_variance,
    };
    let translation = target_mean - rotation.rotate(source_mean) * scale;
    Ok(Similarity { scale, rotation, translation })
}

/// Mean, and mean squared distance from it.
fn moments(points: &[Vec3<f64>], what: &'static str) -> Result<(Vec3<f64>, f64), EvalError> {
    if points.iter().any(|p| !p.is_finite()) {
        return Err(EvalError::NotFinite { what });
    }
    let weight = (points.len() as f64).recip();
    let mean = points.iter().fold(Vec3::zero(), |sum, &p| sum + p * weight);
    let variance = points.iter().map(|&p| (p - mean).norm_squared() * weight).sum::<f64>();
    if variance.sqrt() <= 1e-12 * mean.norm().max(1.0) {
        return Err(EvalError::Coincident { what });
    }
    Ok((mean, variance))
}

/// `1/n Σ (target - μ_t)(source - μ_s)ᵀ`.
fn covariance(
    source: &[Vec3<f64>],
    source_mean: Vec3<f64>,
    target: &[Vec3<f64>],
    target_mean: Vec3<f64>,
) -> Mat3<f64> {
    let mut sum = Mat3::zero();
    for (&s, &t) in source.iter().zip(target) {
        let (s, t) = ((s - source_mean).to_array(), (t - target_mean).to_array());
        for r in 0..3 {
            for c in 0..3 {
                sum[(r, c)] += t[r] * s[c];
            }
        }
    }
    sum.scaled((source.len() as f64).recip())
}

/// The rotation `R` with the largest `tr(Rᵀ M)`, and that trace.
///
/// Completing both sets of singular vectors to right-handed frames by a cross product equals
/// `U S Vᵀ`, and needs no third singular value (coplanar points).
fn best_rotation(m: &Mat3<f64>) -> (Rotation<f64>, f64) {
    let s = svd(m);
    let [first, second] = [s.image[0].norm(), s.image[1].norm()];
    if first <= f64::MIN_POSITIVE {
        return (Rotation::identity(), 0.0);
    }
    let u0 = s.image[0] * first.recip();
    if second <= 1e-12 * first {
        return (shortest_rotation(s.right[0], u0), first);
    }
    let across = s.image[1] - u0 * u0.dot(s.image[1]);
    let u1 = across * across.norm().recip();
    let (u, v) = ([u0, u1, u0.cross(u1)], [s.right[0], s.right[1], s.right[0].cross(s.right[1])]);
    let columns = Mat3 { rows: u.map(Vec3::to_array) }.transpose();
    let rotation = columns * Mat3 { rows: v.map(Vec3::to_array) };
    let trace = (0..3).map(|k| u[k].dot(*m * v[k])).sum();
    (Rotation::from_matrix(&rotation), trace)
}

/// The smallest rotation that takes unit vector `from` to `to`.
fn shortest_rotation(from: Vec3<f64>, to: Vec3<f64>) -> Rotation<f64> {
    let axis = from.cross(to);
    let half_turn = || {
        let smallest = if from.x.abs() < 0.6 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
        let across = from.cross(Vec3::from_array(smallest));
        Rotation { w: 0.0, v: across * across.norm().recip() }
    };
    let cosine = from.dot(to);
    Rotation::from_wxyz(1.0 + cosine, axis.x, axis.y, axis.z)
        .filter(|_| cosine > -1.0 + 1e-12)
        .unwrap_or_else(half_turn)
}

/// Singular value decomposition of a matrix `m` with singular values in descending order:
/// `m · right[k] = image[k]`, the images orthogonal, their lengths the singular values.
struct Svd {
    /// Orthonormal right singular vectors.
    right: [Vec3<f64>; 3],
    /// Their images under the matrix: left singular vectors times singular values.
    image: [Vec3<f64>; 3],
}

/// One-sided Jacobi (Hestenes 1958; Golub & Van Loan, Matrix Computations, 8.6.3): rotate pairs
/// of columns of `B = M V` until all are orthogonal. Small singular values keep their relative
/// accuracy, which forming `MᵀM` would lose.
fn svd(m: &Mat3<f64>) -> Svd {
    let mut image = m.transpose().rows.map(Vec3::from_array);
    let mut right = Mat3::<f64>::identity().rows.map(Vec3::from_array);
    for _ in 0..40 {
        let mut orthogonal = true;
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            let (a, b) = (image[p].norm_squared(), image[q].norm_squared());
            let overlap = image[p].dot(image[q]);
            if overlap.abs() <= f64::EPSILON * (a * b).sqrt() {
                continue;
            }
            orthogonal = false;
            let zeta = (b - a) / (2.0 * overlap);
            let tangent = zeta.signum() / (zeta.abs() + (1.0 + zeta * zeta).sqrt());
            rotate_columns(&mut image, p, q, tangent);
            rotate_columns(&mut right, p, q, tangent);
        }
        if orthogonal {
            break;
        }
    }
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| image[b].norm().total_cmp(&image[a].norm()));
    Svd { right: order.map(|k| right[k]), image: order.map(|k| image[k]) }
}

/// Rotates columns `p` and `q` by the angle with the given tangent.
fn rotate_columns(columns: &mut [Vec3<f64>; 3], p: usize, q: usize, tangent: f64) {
    let cosine = (1.0 + tangent * tangent).sqrt().recip();
    let sine = cosine * tangent;
    let (a, b) = (columns[p], columns[q]);
    columns[p] = a * cosine - b * sine;
    columns[q] = a * sine + b * cosine;
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cloud(seed: u64, extent: [f64; 3]) -> Vec<Vec3<f64>> {
        let n = i2slam_check::noise(seed, 60);
        n.chunks(3)
            .map(|c| Vec3::new(c[0] * extent[0], c[1] * extent[1], c[2] * extent[2]))
            .collect()
    }

    fn example(scale: f64) -> Similarity<f64> {
        Similarity {
            scale,
            rotation: Rotation::exp(Vec3::new(1.4, -2.0, 0.9)),
            translation: Vec3::new(30.0, -2.0, 0.5),
        }
    }

    fn cost(fit: &Similarity<f64>, source: &[Vec3<f64>], target: &[Vec3<f64>]) -> f64 {
        source.iter().zip(target).map(|(&s, &t)| (fit.apply(s) - t).norm_squared()).sum()
    }

    #[test]
    fn recovers_an_exact_similarity() {
        for (extent, kind) in [([1.0, 1.0, 1.0], "volume"), ([2.0, 1.0, 0.0], "plane")] {
            let source = cloud(1, extent);
            for (alignment, scale) in [(Alignment::Se3, 1.0), (Alignment::Sim3, 0.37)] {
                let truth = example(scale);
                let target: Vec<_> = source.iter().map(|&p| truth.apply(p)).collect();
                let fit = align(&source, &target, alignment).unwrap();
                assert!((fit.scale - scale).abs() < 1e-13, "{kind} {fit:?}");
                assert!((fit.rotation.inverse() * truth.rotation).log().norm() < 1e-13, "{kind}");
                assert!(cost(&fit, &source, &target) < 1e-24, "{kind}");
            }
        }
    }

    #[test]
    fn a_mirrored_cloud_gets_a_rotation_and_the_best_one() {
        let source = cloud(3, [1.0, 0.8, 0.5]);
        let target: Vec<_> = source.iter().map(|p| Vec3::new(-p.x, p.y, p.z)).collect();
        let fit = align(&source, &target, Alignment::Sim3).unwrap();
        assert!((fit.rotation.matrix().determinant() - 1.0).abs() < 1e-12);
        let best = cost(&fit, &source, &target);
        assert!(best > 0.1, "no rotation undoes a mirror");
        assert_optimal(&fit, &source, &target);
    }

    #[test]
    fn noisy_fit_is_a_minimum() {
        let source = cloud(4, [1.0; 3]);
        let noise = cloud(5, [0.1; 3]);
        let target: Vec<_> =
            source.iter().zip(&noise).map(|(&p, &n)| example(1.7).apply(p) + n).collect();
        assert_optimal(&align(&source, &target, Alignment::Sim3).unwrap(), &source, &target);
    }

    /// No small step lowers the cost, nor does any of a thousand rotations.
    fn assert_optimal(fit: &Similarity<f64>, source: &[Vec3<f64>], target: &[Vec3<f64>]) {
        let best = cost(fit, source, target);
        for direction in 0..7 {
            for step in [-1e-3, 1e-3] {
                let mut d = [0.0; 7];
                d[direction] = step;
                let moved = Similarity {
                    scale: fit.scale * (1.0 + d[6]),
                    rotation: Rotation::exp(Vec3::new(d[0], d[1], d[2])) * fit.rotation,
                    translation: fit.translation + Vec3::new(d[3], d[4], d[5]),
                };
                assert!(cost(&moved, source, target) > best, "direction {direction} step {step}");
            }
        }
        let centre = |points: &[Vec3<f64>]| {
            points.iter().fold(Vec3::zero(), |s, &p| s + p * (points.len() as f64).recip())
        };
        for turn in i2slam_check::noise(6, 3000).chunks(3) {
            let rotation = Rotation::exp(Vec3::new(turn[0], turn[1], turn[2]) * 3.2);
            let translation = centre(target) - rotation.rotate(centre(source)) * fit.scale;
            let other = Similarity { scale: fit.scale, rotation, translation };
            assert!(cost(&other, source, target) >= best);
        }
    }

    #[test]
    fn a_line_is_laid_on_its_line() {
        let source = cloud(7, [1.0, 0.0, 0.0]);
        for turn in [[0.2, 0.4, -0.9], [0.0, 0.0, std::f64::consts::PI], [0.0; 3]] {
            let rotation = Rotation::exp(Vec3::from_array(turn));
            let target: Vec<_> = source.iter().map(|&p| rotation.rotate(p)).collect();
            let fit = align(&source, &target, Alignment::Se3).unwrap();
            assert!(cost(&fit, &source, &target) < 1e-20, "{turn:?}");
        }
    }

    #[test]
    fn degenerate_input_is_an_error() {
        let (spread, still) = (cloud(8, [1.0; 3]), vec![Vec3::new(3.0, 4.0, 5.0); 20]);
        let coincident = |r| matches!(r, Err(EvalError::Coincident { .. }));
        assert!(coincident(align(&still, &spread, Alignment::Se3)));
        assert!(coincident(align(&spread, &still, Alignment::Sim3)));
        let poisoned = vec![Vec3::new(f64::NAN, 0.0, 0.0); 20];
        let bad = align(&spread, &poisoned, Alignment::Se3);
        assert!(matches!(bad, Err(EvalError::NotFinite { .. })));
        let uneven = align(&spread, &still[1..], Alignment::Se3);
        assert!(matches!(uneven, Err(EvalError::ShapeMismatch { .. })));
        assert!(matches!(align(&[], &[], Alignment::Se3), Err(EvalError::TooFew { .. })));
    }

    #[test]
    fn uncorrelated_points_are_an_error() {
        let x = |s: f64| Vec3::new(s, 0.0, 0.0);
        let (source, target) =
            ([x(1.0), x(1.0), x(-1.0), x(-1.0)], [x(1.0), x(-1.0), x(1.0), x(-1.0)]);
        assert_eq!(align(&source, &target, Alignment::Se3), Err(EvalError::Uncorrelated));
    }

    fn matrices() -> Vec<Mat3<f64>> {
        let of =
            |v: &[f64]| Mat3 { rows: [[v[0], v[1], v[2]], [v[3], v[4], v[5]], [v[6], v[7], v[8]]] };
        let mut all: Vec<_> = (0..20).map(|seed| of(&i2slam_check::noise(seed, 9))).collect();
        all.push(Mat3::identity());
        all.push(Mat3::zero());
        all.push(of(&[1.0, 2.0, 3.0, 2.0, 4.0, 6.0, -1.0, -2.0, -3.0]));
        all.push(of(&[1.0, 1.0, 1.0, 1.0, 1.0 + 1e-14, 1.0, 1.0, 1.0, 1.0 - 1e-14]));
        all
    }

    #[test]
    fn vectors_are_orthogonal_and_reproduce_the_matrix() {
        for m in matrices() {
            let s = svd(&m);
            for i in 0..3 {
                assert!((m * s.right[i] - s.image[i]).norm() < 1e-14 * 10.0);
                assert!((s.right[i].norm() - 1.0).abs() < 1e-14);
                for j in 0..i {
                    assert!(s.right[i].dot(s.right[j]).abs() < 1e-14);
                    let scale = s.image[0].norm_squared().max(1.0);
                    assert!(s.image[i].dot(s.image[j]).abs() < 1e-14 * scale);
                    assert!(s.image[j].norm() >= s.image[i].norm());
                }
            }
        }
    }
}
