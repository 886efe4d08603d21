//! Alignment of a path to an earlier estimate of it.

use i2slam_geometry::{Pose, Rotation, Similarity, Vec3};

/// A pose as it is now, and as it was.
pub(crate) type PosePair = (Pose<f64>, Pose<f64>);

/// The similarity that takes poses as they are now nearest to where they were: the mean rotation
/// between their axes, and scale and translation of least squares between their centres,
///
/// ```text
/// s = Σ (R aᵢ) · bᵢ / Σ |aᵢ|²,   t = mean b - s R mean a
/// ```
///
/// `a` now and `b` before, in the sums from their means: `a`, which more frames have corrected, has the
/// smaller errors, and those of `b` bias nothing. `None` where the centres fix no scale.
pub fn align_path(pairs: &[(Pose<f64>, Pose<f64>)]) -> Option<Similarity<f64>> {
    let mean = |of: &dyn Fn(&PosePair) -> Vec3<f64>| {
        pairs.iter().map(of).fold(Vec3::zero(), |sum, v| sum + v) * (pairs.len() as f64).recip()
    };
    let (first, first_was) = pairs.first()?;
    // Logarithms around the first rotation are small.
    let start = first_was.rotation * first.rotation.inverse();
    let turn =
        |(now, was): &PosePair| (start.inverse() * was.rotation * now.rotation.inverse()).log();
    let rotation = (start * Rotation::exp(mean(&turn))).normalized();
    let (mean_now, mean_was) = (mean(&|pair| pair.0.translation), mean(&|pair| pair.1.translation));
    let (mut product, mut square) = (0.0, 0.0);
    for (now, was) in pairs {
        let a = now.translation - mean_now;
        product += rotation.rotate(a).dot(was.translation - mean_was);
        square += a.dot(a);
    }
    let scale = Some(product / square).filter(|scale| scale.is_finite() && *scale > 0.0)?;
    let translation = mean_was - rotation.rotate(mean_now) * scale;
    Some(Similarity { scale, rotation, translation })
}

/// Relative change of a path: what is left of it after [`align_path`], over its extent, and the
/// logarithm of the scale. `None` where no scale is fixed.
pub(crate) fn path_change(pairs: &[PosePair]) -> Option<f64> {
    let by = align_path(pairs)?;
    let count = (pairs.len() as f64).recip();
    let mean = pairs.iter().fold(Vec3::zero(), |sum, pair| sum + pair.1.translation) * count;
    let square = |v: Vec3<f64>| v.dot(v);
    let extent: f64 = pairs.iter().map(|(_, was)| square(was.translation - mean)).sum();
    let left = |(now, was): &PosePair| square(by.apply(now.translation) - was.translation);
    let left: f64 = pairs.iter().map(left).sum();
    Some((left / extent).sqrt().hypot(by.scale.ln())).filter(|change| change.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path() -> Vec<Pose<f64>> {
        let pose = |i: usize| {
            let t = i as f64;
            let turn = Rotation::exp(Vec3::new(0.1 * t, 0.3 - 0.05 * t, 0.02 * t));
            Pose::new(turn, Vec3::new(t, (0.7 * t).sin(), 0.1 * t * t))
        };
        (0..8).map(pose).collect()
    }

    #[test]
    fn a_path_moved_by_a_similarity_is_moved_back() {
        let rotation = Rotation::exp(Vec3::new(0.4, -2.0, 0.3));
        let by: Similarity<f64> =
            Similarity { scale: 0.03, rotation, translation: Vec3::new(5.0, -1.0, 2.0) };
        let pairs: Vec<PosePair> =
            path().into_iter().map(|was| (by.apply_to_pose(was), was)).collect();
        let back = align_path(&pairs).expect("a path with an extent").compose(&by);
        assert!(back.coordinates().iter().all(|v| v.abs() < 1e-9), "{back:?}");
        let change = path_change(&pairs).expect("a path with an extent");
        assert!((change - 0.03_f64.ln().abs()).abs() < 1e-9, "{change}");
    }

    #[test]
    fn the_change_of_a_path_is_relative_to_its_extent() {
        let change = |scale: f64, off: f64| {
            let moved = |(i, was): (usize, Pose<f64>)| {
                let was = Pose { translation: was.translation * scale, ..was };
                let side = if i % 2 == 0 { off } else { -off };
                let up = Vec3::new(0.0, 0.0, side * scale);
                (Pose { translation: was.translation + up, ..was }, was)
            };
            let pairs: Vec<PosePair> = path().into_iter().enumerate().map(moved).collect();
            path_change(&pairs).expect("a path with an extent")
        };
        assert!(change(1.0, 0.0) < 1e-12);
        assert!((change(1.0, 0.1) - change(50.0, 0.1)).abs() < 1e-12);
        assert!((change(1.0, 0.2) / change(1.0, 0.1) - 2.0).abs() < 0.1);
    }

    #[test]
    fn a_camera_that_stood_still_fixes_no_scale() {
        let still = [(Pose::identity(), Pose::identity()); 4];
        assert!(align_path(&still).is_none() && path_change(&still).is_none());
    }
}
