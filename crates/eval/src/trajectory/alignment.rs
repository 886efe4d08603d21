//! The transform that lays one set of points best on another.

use super::singular::singular;
use crate::EvalError;
use i2slam_geometry::{Mat3, Rotation, Similarity, Vec3};
use serde::Serialize;

/// Transform that is fitted before errors are measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Alignment {
    /// Rotation and translation: for systems that know metres (RGB-D).
    Se3,
    /// Rotation, translation and scale: for systems that do not (one colour camera).
    Sim3,
}

/// The similarity with the least `Σ ‖target_i - (s R source_i + t)‖²`.
///
/// Umeyama 1991, eq. 34-43: with the covariance `Σ_ts = 1/n Σ (target - μ_t)(source - μ_s)ᵀ
/// = U D Vᵀ`, `R = U S Vᵀ`, `s = tr(D S)/σ_s²`, `t = μ_t - s R μ_s`, where
/// `S = diag(1, 1, det U · det V)` keeps `R` a rotation when a reflection would fit better.
/// Points on one line leave the turn about that line free (evo refuses them); the smallest
/// rotation that lays line on line is taken. Points that all coincide are refused.
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
/// Completing both sets of singular vectors to right-handed frames by a cross product is the
/// same as `U S Vᵀ`, and needs no third singular value (points in one plane).
fn best_rotation(m: &Mat3<f64>) -> (Rotation<f64>, f64) {
    let s = singular(m);
    let [first, second] = [s.image[0].norm(), s.image[1].norm()];
    if first <= f64::MIN_POSITIVE {
        return (Rotation::identity(), 0.0);
    }
    let u0 = s.image[0] * first.recip();
    if second <= 1e-12 * first {
        return (shortest_turn(s.right[0], u0), first);
    }
    let across = s.image[1] - u0 * u0.dot(s.image[1]);
    let u1 = across * across.norm().recip();
    let (u, v) = ([u0, u1, u0.cross(u1)], [s.right[0], s.right[1], s.right[0].cross(s.right[1])]);
    let columns = Mat3 { rows: u.map(Vec3::to_array) }.transpose();
    let rotation = columns * Mat3 { rows: v.map(Vec3::to_array) };
    let trace = (0..3).map(|k| u[k].dot(*m * v[k])).sum();
    (Rotation::from_matrix(&rotation), trace)
}

/// The smallest rotation that takes the line of unit vector `from` to that of `to`, with sign.
fn shortest_turn(from: Vec3<f64>, to: Vec3<f64>) -> Rotation<f64> {
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

#[cfg(test)]
#[path = "alignment_tests.rs"]
mod tests;
