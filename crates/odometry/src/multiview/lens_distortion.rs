//! Radial lens distortion.
//!
//! Positions are corrected by `u = c + (s - c) (1 + a r² + b r⁴)`, with `s` the measured position,
//! `c` the principal point and `r` the distance of `s` from it over half the picture's diagonal.
//! The model is linear in `(a, b)`, which bundle adjustment estimates.

use i2slam_compute::NormalEquations;
use i2slam_geometry::Camera;

/// Derivatives of a corrected image position by the camera parameters beside the focal length [px]:
/// two distortion coefficients, or the readout and an unused second.
pub(crate) type CameraJacobian = [[f64; 2]; 2];

/// Radii at which the model of Brown is fitted.
const FIT_RADII: usize = 40;

/// Half the diagonal of the picture [px].
fn half_diagonal(camera: &Camera<f64>) -> f64 {
    0.5 * (camera.width as f64).hypot(camera.height as f64)
}

/// Derivatives of the corrected position by both coefficients: `(s - c) r²` and `(s - c) r⁴` [px].
pub(crate) fn distortion_jacobian(camera: &Camera<f64>, seen: [f64; 2]) -> CameraJacobian {
    let off = [seen[0] - camera.cx, seen[1] - camera.cy];
    let square = (off[0] * off[0] + off[1] * off[1]) / half_diagonal(camera).powi(2);
    [off.map(|v| v * square), off.map(|v| v * square * square)]
}

/// Removes distortion from a measured position.
pub(crate) fn undistort(camera: &Camera<f64>, lens: [f64; 2], seen: [f64; 2]) -> [f64; 2] {
    let radial = distortion_jacobian(camera, seen);
    std::array::from_fn(|i| seen[i] + lens[0] * radial[0][i] + lens[1] * radial[1][i])
}

/// Fits the coefficients `(k1, k2)` of the model of Brown (1971), as in OpenCV, which maps
/// undistorted to distorted positions: `s = c + (u - c) (1 + k1 r² + k2 r⁴)` with `r` in focal
/// lengths.
pub(crate) fn brown_coefficients(camera: &Camera<f64>, lens: [f64; 2]) -> [f64; 2] {
    let mut sum = NormalEquations::<2>::default();
    for i in 1..=FIT_RADII {
        let r = i as f64 / FIT_RADII as f64;
        let ratio = 1.0 + lens[0] * r * r + lens[1] * r.powi(4);
        let far = (r * half_diagonal(camera) * ratio / camera.fx).powi(2);
        // Weighted by the radius, so that errors count in pixels.
        sum.add(&[far, far * far], 1.0 - ratio.recip(), r * r);
    }
    sum.step(0.0).unwrap_or([0.0; 2])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_usual_coefficients_bring_positions_back() {
        let camera = Camera { width: 320, height: 240, fx: 250.0, fy: 250.0, cx: 161.0, cy: 119.0 };
        let lens = [0.08, 0.03];
        let [k1, k2] = brown_coefficients(&camera, lens);
        for seen in [[10.0, 20.0], [300.0, 230.0], [170.0, 60.0]] {
            let [u, v] = undistort(&camera, lens, seen);
            let ray = camera.unproject(u, v, 1.0);
            let square = ray.x * ray.x + ray.y * ray.y;
            let factor = 1.0 + k1 * square + k2 * square * square;
            let back = [camera.cx + factor * (u - camera.cx), camera.cy + factor * (v - camera.cy)];
            assert!((back[0] - seen[0]).hypot(back[1] - seen[1]) < 0.1, "{seen:?} {back:?}");
        }
        assert!(k1 < -0.1);
    }
}
