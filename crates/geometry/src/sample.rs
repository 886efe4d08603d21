//! Values between pixel centres.

use crate::{Image, Real};

/// The four pixels around an image position and their bilinear weights.
#[derive(Clone, Copy, Debug)]
pub struct Tap<T> {
    index: usize,
    width: usize,
    du: T,
    dv: T,
}

impl<T: Real> Tap<T> {
    /// The tap at `(u, v)` of an image of `width x height`, or `None` outside its pixel centres.
    pub fn new(width: usize, height: usize, u: T, v: T) -> Option<Self> {
        let half = T::of(0.5);
        let (x, y) = (u - half, v - half);
        let most = |size: usize| T::of(size.saturating_sub(1) as f64);
        let inside = x >= T::zero() && y >= T::zero() && x < most(width) && y < most(height);
        if !inside {
            return None;
        }
        let (column, row) = (x.to_usize()?, y.to_usize()?);
        let (du, dv) = (x - T::of(column as f64), y - T::of(row as f64));
        Some(Self { index: row * width + column, width, du, dv })
    }

    /// Value of a plane and its derivatives by `u` and `v`.
    pub fn sample(self, plane: &[T]) -> (T, T, T) {
        self.interpolate(self.values(plane))
    }

    /// Value and slopes by `u` and `v` from given values of the four pixels.
    pub fn interpolate(self, [a, b, c, d]: [T; 4]) -> (T, T, T) {
        let (top, bottom) = (a + (b - a) * self.du, c + (d - c) * self.du);
        let by_u = (b - a) + ((d - c) - (b - a)) * self.dv;
        (top + (bottom - top) * self.dv, by_u, bottom - top)
    }

    /// The four pixels: upper left, upper right, lower left, lower right.
    pub fn values(self, plane: &[T]) -> [T; 4] {
        let (i, w) = (self.index, self.width);
        [plane[i], plane[i + 1], plane[i + w], plane[i + w + 1]]
    }
}

impl<T: Real> Image<T> {
    /// The bilinear tap at `(u, v)`, or `None` outside the pixel centres.
    pub fn tap(&self, u: T, v: T) -> Option<Tap<T>> {
        Tap::new(self.width, self.height, u, v)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tap_reproduces_a_plane_and_its_slope() {
        let image =
            Image::from_fn(6, 5, 1, |_, column, row| 2.0 * column as f64 - 3.0 * row as f64);
        let (value, by_u, by_v) = image.tap(3.2, 2.9).expect("inside").sample(&image.data);
        assert!((value - (2.0 * 2.7 - 3.0 * 2.4)).abs() < 1e-12);
        assert!((by_u - 2.0).abs() < 1e-12 && (by_v + 3.0).abs() < 1e-12);
    }

    #[test]
    fn there_is_no_tap_outside_the_pixel_centres() {
        let image = Image::<f32>::new(6, 5, 1);
        assert!(image.tap(0.4, 2.0).is_none() && image.tap(5.6, 2.0).is_none());
        assert!(image.tap(f32::NAN, 2.0).is_none());
    }
}
