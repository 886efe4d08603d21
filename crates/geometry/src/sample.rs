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

/// The sixteen pixels around a place, with the weights of cubic convolution (Keys 1981, a = −½). Unlike
/// a bilinear tap it keeps the contrast of what lies between pixel centres.
#[derive(Clone, Copy, Debug)]
pub struct CubicTap<T> {
    index: usize,
    width: usize,
    columns: [T; 4],
    rows: [T; 4],
}

impl<T: Real> CubicTap<T> {
    /// The tap at `(u, v)` of an image of `width x height`, or `None` where one of the pixels is outside.
    pub fn new(width: usize, height: usize, u: T, v: T) -> Option<Self> {
        let inner = Tap::new(width, height, u, v)?;
        let (column, row) = (inner.index % width, inner.index / width);
        let is_inside = column >= 1 && row >= 1 && column + 2 < width && row + 2 < height;
        is_inside.then(|| Self {
            index: inner.index - width - 1,
            width,
            columns: cubic_weights(inner.du),
            rows: cubic_weights(inner.dv),
        })
    }

    /// Value of a plane; beyond those of the pixels by a few percent of their differences at most.
    pub fn sample(self, plane: &[T]) -> T {
        let dot = |first: usize| {
            let pixels = plane[first..first + 4].iter().zip(self.columns);
            pixels.fold(T::zero(), |sum, (&pixel, weight)| sum + weight * pixel)
        };
        let rows = self.rows.into_iter().enumerate();
        rows.fold(T::zero(), |sum, (row, weight)| sum + weight * dot(self.index + row * self.width))
    }
}

/// Weights of the pixels at -1, 0, 1 and 2 for a place `t` of [0, 1).
fn cubic_weights<T: Real>(t: T) -> [T; 4] {
    let (half, t2, t3) = (T::of(0.5), t * t, t * t * t);
    [
        half * (-t + T::of(2.0) * t2 - t3),
        T::one() + half * (T::of(3.0) * t3 - T::of(5.0) * t2),
        half * (t + T::of(4.0) * t2 - T::of(3.0) * t3),
        half * (t3 - t2),
    ]
}

impl<T: Real> Image<T> {
    /// The cubic tap at `(u, v)`, or `None` within a pixel and a half of the border.
    pub fn cubic_tap(&self, u: T, v: T) -> Option<CubicTap<T>> {
        CubicTap::new(self.width, self.height, u, v)
    }

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
    fn a_cubic_tap_reproduces_a_quadratic_and_the_pixels() {
        let value = |x: f64, y: f64| 0.3 * x * x - 0.2 * x * y + y - 1.0;
        let image = Image::from_fn(9, 8, 1, |_, column, row| value(column as f64, row as f64));
        for (u, v) in [(3.2, 2.9), (4.5, 3.5), (2.0, 5.99)] {
            let sampled = image.cubic_tap(u, v).expect("inside").sample(&image.data);
            assert!((sampled - value(u - 0.5, v - 0.5)).abs() < 1e-12, "{u} {v} {sampled}");
        }
        assert!(image.cubic_tap(1.4, 4.0).is_none() && image.cubic_tap(4.0, 6.6).is_none());
        assert!(image.cubic_tap(1.6, 4.0).is_some() && image.cubic_tap(4.0, 6.4).is_some());
    }

    #[test]
    fn there_is_no_tap_outside_the_pixel_centres() {
        let image = Image::<f32>::new(6, 5, 1);
        assert!(image.tap(0.4, 2.0).is_none() && image.tap(5.6, 2.0).is_none());
        assert!(image.tap(f32::NAN, 2.0).is_none());
    }
}
