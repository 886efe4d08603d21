//! Screen filters of viewers.
//!
//! Viewers add a variance to every Gaussian that they draw, so that none falls between two pixels. Maps are
//! made with 0.3 px², as Kerbl et al. 2023 draw them, and so does gsplat. PlayCanvas and SuperSplat add
//! 0.075 px² and let a Gaussian end at 2√2 standard deviations, as (e^(−4A) − e⁻⁴)/(1 − e⁻⁴) with A from 0 to
//! 1, which has 0.925 of its area: Gaussians as small as a pixel leave gaps. Exported Gaussians have what is
//! missing, in pixels of the nearest frame in whose field of view they lie (hidden or not):
//!
//! ```text
//! σ² + (0.3 / 0.925 - 0.075) (z / f)²    along each axis,
//! ```
//!
//! so that the smallest ones cover the same area there, in a picture of the map's size and near its axis, as in
//! renders of the map (others up to 7 % less). With 0.3 px², and in larger pictures, they are softer than
//! these; from nearer, fewer gaps open. Colours are those that blend to renders without the difference.

use super::splat::Splat;
use i2slam::geometry::{Camera, Pose, Vec3};
use i2slam::radiance::gaussian::RasterSettings;
use rayon::prelude::*;

/// Variance that PlayCanvas 2.23 adds \[px²\].
const PLAYCANVAS_VARIANCE: f64 = 0.075;
/// Share of a Gaussian's area that PlayCanvas draws.
const PLAYCANVAS_AREA: f64 = 0.925;

/// Widens Gaussians for PlayCanvas' filter; those that no picture of `camera` at `poses` shows stay.
pub(super) fn widen(splats: &mut [Splat], camera: &Camera<f64>, poses: &[Pose<f64>]) {
    let inverse: Vec<Pose<f64>> = poses.iter().map(|pose| pose.inverse()).collect();
    splats.par_iter_mut().for_each(|splat| {
        let mean = Vec3::from_array(splat.mean).cast();
        let depths = inverse.iter().filter_map(|camera_from_world| {
            let point = *camera_from_world * mean;
            let (u, v) = (point.z > 0.0).then(|| camera.project(point))?;
            camera.contains(u, v, 0.0).then_some(point.z)
        });
        let Some(nearest) = depths.min_by(f64::total_cmp) else { return };
        let added = missing_variance() * (nearest / camera.fx).powi(2);
        splat.log_scale = splat.log_scale.map(|scale| {
            let variance = (2.0 * f64::from(scale)).exp() + added;
            (0.5 * variance.ln()) as f32
        });
    });
}

/// Variance that Gaussians as small as a point lack in PlayCanvas \[px²\].
fn missing_variance() -> f64 {
    f64::from(RasterSettings::default().screen_variance) / PLAYCANVAS_AREA - PLAYCANVAS_VARIANCE
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam::geometry::Rotation;

    const CAMERA: Camera<f64> =
        Camera { width: 40, height: 30, fx: 50.0, fy: 50.0, cx: 20.0, cy: 15.0 };

    fn splat(z: f32) -> Splat {
        Splat {
            mean: [0.1, 0.0, z],
            colour: [0.5; 3],
            view: None,
            opacity_logit: 1.0,
            log_scale: [-9.0, -4.0, -3.0],
            rotation: [1.0, 0.0, 0.0, 0.0],
        }
    }

    /// Variance in the nearest picture of a Gaussian seen along its thin axis, and as it was \[px²\].
    fn variances(before: &Splat, after: &Splat, z: f64) -> Vec<[f64; 2]> {
        let of = |scale: f32| (f64::from(scale).exp() * CAMERA.fx / z).powi(2);
        before.log_scale.iter().zip(after.log_scale).map(|(a, b)| [of(*a), of(b)]).collect()
    }

    #[test]
    fn in_the_nearest_picture_the_smallest_cover_the_same_area() {
        let poses =
            [0.0, 1.5, -2.0].map(|z| Pose::new(Rotation::identity(), Vec3::new(0.0, 0.0, z)));
        let mut splats = [splat(4.0)];
        widen(&mut splats, &CAMERA, &poses);
        let shares: Vec<f64> = variances(&splat(4.0), &splats[0], 2.5)
            .iter()
            .map(|[before, after]| PLAYCANVAS_AREA * (after + 0.075) / (before + 0.3))
            .collect();
        assert!((shares[0] - 1.0).abs() < 1e-3, "{shares:?}");
        assert!(shares.is_sorted_by(|a, b| a > b), "{shares:?}");
        assert!(shares[2] > PLAYCANVAS_AREA, "{shares:?}");
    }

    #[test]
    fn playcanvas_draws_that_share_of_the_area() {
        let step = 1e-4;
        let end = (-4.0f64).exp();
        let drawn = |i: usize| ((-4.0 * step * (i as f64 + 0.5)).exp() - end) / (1.0 - end);
        let area = (0..10_000).map(|i| drawn(i) * step).sum::<f64>();
        assert!((area / 0.25 - PLAYCANVAS_AREA).abs() < 1e-3, "{area}");
    }

    #[test]
    fn what_no_picture_shows_stays() {
        let mut splats = [splat(-1.0), Splat { mean: [9.0, 0.0, 1.0], ..splat(1.0) }];
        widen(&mut splats, &CAMERA, &[Pose::identity()]);
        assert!(splats.iter().all(|s| s.log_scale == splat(1.0).log_scale));
    }
}
