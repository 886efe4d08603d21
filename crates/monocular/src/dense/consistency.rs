//! Estimates of several keyframes compared with each other: what agrees is kept and averaged.

use super::estimate::Estimate;
use i2slam_geometry::{Camera, Image, Pose};

/// Difference of inverse depths that agree, in standard deviations of both, ...
const DEVIATIONS: f32 = 3.0;
/// ... or as a share of them, whichever is more.
const SHARE: f32 = 0.03;
/// Of two other keyframes that see a pixel one must agree, of more than that two.
const AGREEING: usize = 2;

/// What of an estimate others agree with; `others` are estimates with `other_from_keyframe`. The
/// inverse depths that agree are averaged by their variances.
pub(super) fn agreed(
    camera: &Camera<f64>,
    own: &Estimate,
    others: &[(&Estimate, Pose<f64>)],
) -> Estimate {
    let (width, height) = (own.inverse_depth.width, own.inverse_depth.height);
    let mut out = Estimate {
        inverse_depth: Image::new(width, height, 1),
        variance: Image::new(width, height, 1),
    };
    for pixel in 0..width * height {
        let (rho, variance) = (own.inverse_depth.data[pixel], own.variance.data[pixel]);
        if rho <= 0.0 {
            continue;
        }
        let (u, v) = Camera::pixel_centre(pixel % width, pixel / width);
        let point = camera.unproject(u, v, 1.0 / f64::from(rho));
        let (mut seen, mut agree) = (0, 0);
        let (mut sum, mut weight) = (rho / variance, 1.0 / variance);
        for (other, other_from_own) in others {
            let there = *other_from_own * point;
            let (x, y) = camera.project(there);
            if there.z <= 0.0 || !camera.contains(x, y, 0.0) {
                continue;
            }
            let at = y as usize * width + x as usize;
            let (found, its) = (other.inverse_depth.data[at], other.variance.data[at]);
            if found <= 0.0 {
                continue;
            }
            seen += 1;
            let due = (1.0 / there.z) as f32;
            let most = (DEVIATIONS * (variance + its).sqrt()).min(0.1 * due).max(SHARE * due);
            if (found - due).abs() > most {
                continue;
            }
            agree += 1;
            // The same error of the depth along nearly the same ray.
            let ratio = rho / due;
            let its = its * ratio * ratio;
            sum += (rho + (found - due) * ratio) / its;
            weight += 1.0 / its;
        }
        if agree >= AGREEING.min(seen) && agree > 0 {
            out.inverse_depth.data[pixel] = sum / weight;
            // Neighbours share pictures: their errors are not independent.
            out.variance.data[pixel] = (1 + agree) as f32 / weight;
        }
    }
    out
}
