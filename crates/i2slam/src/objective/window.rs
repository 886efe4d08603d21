//! The 11x11 Gaussian window of SSIM as a separable filter with zeros outside the image.

use i2slam_geometry::Real;

/// Taps of the window, and its reach to either side.
const TAPS: usize = 11;
const REACH: usize = TAPS / 2;

/// Normalised weights, σ = 1.5 (Wang et al. 2004).
fn weights<T: Real>() -> [T; TAPS] {
    let raw: [f64; TAPS] = std::array::from_fn(|i| {
        let d = i as f64 - REACH as f64;
        (-d * d / (2.0 * 1.5 * 1.5)).exp()
    });
    let sum: f64 = raw.iter().sum();
    raw.map(|w| T::of(w / sum))
}

/// `plane` (`width x height`) filtered by the window. The filter is its own adjoint.
pub(super) fn filter<T: Real>(plane: &[T], width: usize) -> Vec<T> {
    pulp::Arch::new().dispatch(|| filter_here(plane, width))
}

#[inline(always)]
fn filter_here<T: Real>(plane: &[T], width: usize) -> Vec<T> {
    let taps = weights::<T>();
    let height = plane.len() / width;
    let mut padded = vec![T::zero(); width + 2 * REACH];
    let mut rows = vec![T::zero(); plane.len()];
    for (input, output) in plane.chunks_exact(width).zip(rows.chunks_exact_mut(width)) {
        padded[REACH..REACH + width].copy_from_slice(input);
        for (k, &w) in taps.iter().enumerate() {
            for (out, &v) in output.iter_mut().zip(&padded[k..k + width]) {
                *out += w * v;
            }
        }
    }
    let mut out = vec![T::zero(); plane.len()];
    for (y, output) in out.chunks_exact_mut(width).enumerate() {
        for (k, &w) in taps.iter().enumerate() {
            let Some(source) = (y + k).checked_sub(REACH).filter(|&s| s < height) else { continue };
            for (out, &v) in output.iter_mut().zip(&rows[source * width..(source + 1) * width]) {
                *out += w * v;
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_constant_stays_inside_the_border() {
        let out = filter(&[2.0_f32; 30 * 20], 30);
        assert!((out[10 * 30 + 15] - 2.0).abs() < 1e-5);
        assert!(out[0] < 1.0);
    }

    #[test]
    fn the_filter_is_its_own_adjoint() {
        let (a, b) = (i2slam_check::noise(1, 24 * 17), i2slam_check::noise(2, 24 * 17));
        let dot = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
        assert!((dot(&filter(&a, 24), &b) - dot(&a, &filter(&b, 24))).abs() < 1e-12);
    }
}
