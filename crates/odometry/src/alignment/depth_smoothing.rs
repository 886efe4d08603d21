//! Smoothing of noisy depth, as much as its slopes need.
//!
//! An alignment takes the slope of a surface from neighbouring pixels. Under noise `σ` of single
//! pixels that slope errs by `√2 σ f/z`, for a Kinect as much as walls are inclined: the slopes
//! claim what is not there, and the cost has its minima where pixels fall between pixels, where
//! interpolation averages most. The mean of `(2r+1)²` pixels leaves `√2 σ f/z / (2r+1)^(3/2)`.

use super::residual::{depth_noise, depth_spread};
use i2slam_geometry::{Camera, Image};

/// Largest slope that noise may leave.
const MAX_SLOPE_NOISE: f32 = 0.1;
/// Largest radius [px].
const MAX_RADIUS: usize = 4;
/// Distance of the mean of two opposite neighbours from the pixel between them, up to which all
/// three are of one surface [standard deviations].
const MAX_DEVIATIONS: f32 = 3.0;

/// Depth smoothed over the radius that the noise asks for at each pixel, none for exact depth.
///
/// Averages inverse depth, which is linear over the image of a plane, over pairs of opposite
/// neighbours: any plane stays as it is, and of a pair across an edge the mean lies far off.
pub(super) fn smoothed_depth(camera: &Camera<f64>, depth: &Image<f32>) -> Image<f32> {
    let noise = depth_noise(depth);
    let radius = |z: f32| radius(noise * depth_spread(z), z, camera.fx as f32);
    let (width, height) = (depth.width, depth.height);
    let inverse: Vec<f32> =
        depth.data.iter().map(|&d| if d > 0.0 { 1.0 / d } else { 0.0 }).collect();
    Image::from_fn(width, height, 1, |_, column, row| {
        let (z, at) = (depth.at(0, column, row), row * width + column);
        let radius = if z > 0.0 { radius(z) } else { 0 };
        if radius == 0 {
            return z;
        }
        // The mean of two less a third has the variance 3/2 σ².
        let most = MAX_DEVIATIONS * 1.5_f32.sqrt() * noise * depth_spread(z) / (z * z);
        let (mut sum, mut count) = (inverse[at], 1.0);
        let across = radius.min(column).min(width - 1 - column);
        for down in 0..=radius.min(row).min(height - 1 - row) {
            // Half of the window: the other half are the opposite neighbours.
            let first = if down == 0 { 1 } else { -(across as isize) };
            for right in first..=across as isize {
                let offset = down as isize * width as isize + right;
                let pair = [at.wrapping_add_signed(offset), at.wrapping_add_signed(-offset)];
                let [a, b] = pair.map(|i| inverse[i]);
                let is_one_surface =
                    a > 0.0 && b > 0.0 && (0.5 * (a + b) - inverse[at]).abs() < most;
                if is_one_surface {
                    sum += a + b;
                    count += 2.0;
                }
            }
        }
        count / sum
    })
}

/// Radius [px] that leaves no more than [`MAX_SLOPE_NOISE`] of the noise `sigma` at depth `z` [m].
fn radius(sigma: f32, z: f32, focal: f32) -> usize {
    let slope = 2.0_f32.sqrt() * sigma * focal / z;
    let side = (slope / MAX_SLOPE_NOISE).powf(2.0 / 3.0);
    let radius = (0.5 * (side - 1.0)).ceil();
    // Also for noise that is not a number.
    if radius > 0.0 { (radius as usize).min(MAX_RADIUS) } else { 0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_compute::Random;

    const CAMERA: Camera<f64> =
        Camera { width: 80, height: 60, fx: 100.0, fy: 100.0, cx: 40.0, cy: 30.0 };

    fn wall(noise: f64) -> Image<f32> {
        let mut random = Random::new(5);
        Image::from_fn(80, 60, 1, |_, column, row| {
            let step = if column < 40 { 0.25 } else { 0.0 };
            let z = 1.0 / (0.5 + step + 0.002 * row as f64);
            let uniform = 12.0_f64.sqrt() * (random.uniform() - 0.5);
            (z + noise * uniform * z * z.max(1.0)) as f32
        })
    }

    #[test]
    fn noise_becomes_less_and_edges_stay() {
        let (exact, noisy) = (wall(0.0), wall(0.004));
        assert_eq!(smoothed_depth(&CAMERA, &exact).data, exact.data);
        let smooth = smoothed_depth(&CAMERA, &noisy);
        let rms = |image: &Image<f32>, columns: std::ops::Range<usize>| {
            let errors = (2..58).flat_map(|row| columns.clone().map(move |column| (column, row)));
            let squares =
                errors.map(|(c, r)| f64::from(image.at(0, c, r) - exact.at(0, c, r)).powi(2));
            (squares.sum::<f64>() / (56 * columns.len()) as f64).sqrt()
        };
        assert!(rms(&smooth, 45..75) < 0.5 * rms(&noisy, 45..75));
        assert!(rms(&smooth, 38..42) < rms(&noisy, 38..42));
    }
}
