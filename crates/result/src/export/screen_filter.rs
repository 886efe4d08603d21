//! Screen filters of viewers.
//!
//! Viewers add a variance to every Gaussian that they draw, so that none falls between two pixels. Maps are
//! made with 0.3 px², as Kerbl et al. 2023 draw them; PlayCanvas and SuperSplat add 0.075 px², so that
//! Gaussians as small as a pixel leave gaps. A file for these has the difference in the Gaussians, in pixels of
//! the nearest frame in whose field of view they lie (hidden or not):
//!
//! ```text
//! σ² + (0.3 - 0.075) (z / f)²    along each axis,
//! ```
//!
//! which is drawn as other viewers draw the map there, in a picture of the map's size and near its axis. In a
//! larger picture it is softer than these.

use super::splat::Splat;
use i2slam::geometry::{Camera, Pose, Vec3};
use rayon::prelude::*;

/// Variance that maps are made with, and that of PlayCanvas 2.23 \[px²\].
const OWN_VARIANCE: f64 = 0.3;
const PLAYCANVAS_VARIANCE: f64 = 0.075;

/// Widens Gaussians for PlayCanvas; those that no picture of `camera` at `poses` shows stay.
pub(super) fn widen_for_playcanvas(
    splats: &mut [Splat],
    camera: &Camera<f64>,
    poses: &[Pose<f64>],
) {
    let inverse: Vec<Pose<f64>> = poses.iter().map(|pose| pose.inverse()).collect();
    splats.par_iter_mut().for_each(|splat| {
        let mean = Vec3::from_array(splat.mean).cast();
        let depths = inverse.iter().filter_map(|camera_from_world| {
            let point = *camera_from_world * mean;
            let (u, v) = (point.z > 0.0).then(|| camera.project(point))?;
            camera.contains(u, v, 0.0).then_some(point.z)
        });
        let Some(nearest) = depths.min_by(f64::total_cmp) else { return };
        let added = (OWN_VARIANCE - PLAYCANVAS_VARIANCE) * (nearest / camera.fx).powi(2);
        splat.log_scale = splat.log_scale.map(|scale| {
            let variance = (2.0 * f64::from(scale)).exp() + added;
            (0.5 * variance.ln()) as f32
        });
    });
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
    fn the_nearest_picture_shows_them_as_the_map_does() {
        let poses =
            [0.0, 1.5, -2.0].map(|z| Pose::new(Rotation::identity(), Vec3::new(0.0, 0.0, z)));
        let mut splats = [splat(4.0)];
        widen_for_playcanvas(&mut splats, &CAMERA, &poses);
        for [before, after] in variances(&splat(4.0), &splats[0], 2.5) {
            let drawn = (before + OWN_VARIANCE, after + PLAYCANVAS_VARIANCE);
            assert!((drawn.0 / drawn.1 - 1.0).abs() < 1e-5, "{drawn:?}");
        }
    }

    #[test]
    fn what_no_picture_shows_stays() {
        let mut splats = [splat(-1.0), Splat { mean: [9.0, 0.0, 1.0], ..splat(1.0) }];
        widen_for_playcanvas(&mut splats, &CAMERA, &[Pose::identity()]);
        assert!(splats.iter().all(|s| s.log_scale == splat(1.0).log_scale));
    }
}
