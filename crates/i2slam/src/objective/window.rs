//! The 11x11 Gaussian window of SSIM as a separable filter with zeros outside the image.

use i2slam_geometry::Real;

/// Taps of the window, and its reach to either side.
const TAPS: usize = 11;
const REACH: usize = TAPS / 2;

/// The window's weights along one axis.
#[derive(Clone, Copy)]
pub(super) struct Window<T>([T; TAPS]);

impl<T: Real> Window<T> {
    /// Normalised weights, σ = 1.5 (Wang et al. 2004).
    pub(super) fn new() -> Self {
        let raw: [f64; TAPS] = std::array::from_fn(|i| {
            let d = i as f64 - REACH as f64;
            (-d * d / (2.0 * 1.5 * 1.5)).exp()
        });
        let sum: f64 = raw.iter().sum();
        Self(raw.map(|w| T::of(w / sum)))
    }

    /// One row filtered along itself.
    #[inline(always)]
    pub(super) fn along(&self, row: &[T], out: &mut [T]) {
        out.fill(T::zero());
        let width = row.len();
        for (k, &w) in self.0.iter().enumerate() {
            let (skip, from) = (REACH.saturating_sub(k), k.saturating_sub(REACH));
            let count = width.saturating_sub(skip + from);
            let (out, row) = (out.iter_mut().skip(skip), row.iter().skip(from));
            for (out, &v) in out.zip(row).take(count) {
                *out += w * v;
            }
        }
    }

    /// Row `y` of a plane filtered down its columns.
    #[inline(always)]
    pub(super) fn down(&self, plane: &[T], y: usize, out: &mut [T]) {
        out.fill(T::zero());
        let width = out.len();
        for (k, &w) in self.0.iter().enumerate() {
            let Some(source) = (y + k).checked_sub(REACH) else { continue };
            let Some(row) = plane.get(source * width..(source + 1) * width) else { break };
            for (out, &v) in out.iter_mut().zip(row) {
                *out += w * v;
            }
        }
    }
}

/// `plane` (`width x height`) filtered by the window. The filter is its own adjoint.
pub(super) fn filter<T: Real>(plane: &[T], width: usize) -> Vec<T> {
    let window = Window::new();
    let (mut rows, mut out) = (vec![T::zero(); plane.len()], vec![T::zero(); plane.len()]);
    for (input, row) in plane.chunks_exact(width).zip(rows.chunks_exact_mut(width)) {
        window.along(input, row);
    }
    for (y, out) in out.chunks_exact_mut(width).enumerate() {
        window.down(&rows, y, out);
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
        for width in [24, 3] {
            let (a, b) = (i2slam_check::noise(1, width * 17), i2slam_check::noise(2, width * 17));
            let dot = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
            assert!((dot(&filter(&a, width), &b) - dot(&a, &filter(&b, width))).abs() < 1e-12);
        }
    }
}
