//! Vignetting: a lens passes less light to the border of a picture than to its centre.
//!
//! ```text
//! v(r) = 1 + a r² + b r⁴ + c r⁶,   held to [0.2, 1.2]
//! ```
//!
//! with `r` the distance from the principal point over half the picture's diagonal (Goldman 2010,
//! *Vignette and Exposure Calibration and Compensation*). It multiplies linear values before the
//! response, for all channels alike. [`estimate`] finds it from pictures of the same surfaces.

mod estimate;
#[cfg(test)]
mod tests;

pub use estimate::{RadiancePair, VignettingEstimate, estimate};

use crate::form::assert_same_shape;
use crate::tone::ResponseCurve;
use i2slam_geometry::{Camera, Image, Real};
use rayon::prelude::*;

/// Bounds of the share of light, so that no polynomial goes beyond what lenses do.
const BOUNDS: [f64; 2] = [0.2, 1.2];

/// Share of the light that reaches a place of the picture, over that at the principal point.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Vignetting<T> {
    /// `a`, `b`, `c`; all zero for a lens without vignetting.
    pub coefficients: [T; 3],
}

impl<T: Real> Vignetting<T> {
    /// `v` at a squared distance `r²` from the principal point, in squared half diagonals.
    #[inline]
    pub fn at(&self, squared_radius: T) -> T {
        self.polynomial(squared_radius).max(T::of(BOUNDS[0])).min(T::of(BOUNDS[1]))
    }

    /// `v` at half a diagonal: in the corners, where the principal point is the centre.
    pub fn corner(&self) -> T {
        self.at(T::one())
    }

    /// True if `v` is 1 everywhere.
    pub fn is_none(&self) -> bool {
        self.coefficients.iter().all(|c| *c == T::zero())
    }

    /// `v` at every pixel of a camera, row by row.
    pub fn at_pixels(&self, camera: &Camera<T>) -> Vec<T> {
        squared_radii(camera).map(|r2| self.at(r2)).collect()
    }

    /// Derivative by `a`, `b` and `c` from `d_hdr`, that by the radiance `hdr` of all pixels of a
    /// camera as [`Formation::pull_back`](crate::Formation::pull_back) writes it: both enter the
    /// picture as their product. Zero where `v` is held.
    ///
    /// # Panics
    /// When the images are of different shape, or not of the camera's size.
    pub fn pull_back(&self, camera: &Camera<T>, hdr: &Image<T>, d_hdr: &Image<T>) -> [T; 3] {
        assert_same_shape(hdr, d_hdr);
        assert_eq!([hdr.width, hdr.height], [camera.width, camera.height], "image and camera");
        let mut sums = [0.0; 3];
        for (pixel, r2) in squared_radii(camera).enumerate() {
            let v = self.polynomial(r2);
            if !(BOUNDS[0]..=BOUNDS[1]).contains(&v.to_f64()) {
                continue;
            }
            let each = (0..hdr.channels).map(|c| d_hdr.plane(c)[pixel] * hdr.plane(c)[pixel]);
            let d_v = each.map(Real::to_f64).sum::<f64>() / v.to_f64();
            let r2 = r2.to_f64();
            [r2, r2 * r2, r2 * r2 * r2].iter().zip(&mut sums).for_each(|(p, sum)| *sum += d_v * p);
        }
        sums.map(T::of)
    }

    fn polynomial(&self, r2: T) -> T {
        let [a, b, c] = self.coefficients;
        T::one() + r2 * (a + r2 * (b + r2 * c))
    }
}

/// `r²` of the place (u, v) \[px\]: 1 at half the picture's diagonal from the principal point.
pub fn squared_radius<T: Real>(camera: &Camera<T>, u: T, v: T) -> T {
    let (x, y) = (u - camera.cx, v - camera.cy);
    let (width, height) = (camera.width as f64, camera.height as f64);
    (x * x + y * y) * T::of(4.0 / (width * width + height * height).max(1.0))
}

fn squared_radii<T: Real>(camera: &Camera<T>) -> impl Iterator<Item = T> {
    let camera = *camera;
    (0..camera.pixels()).map(move |pixel| {
        let (u, v) = Camera::pixel_centre(pixel % camera.width, pixel / camera.width);
        squared_radius(&camera, u, v)
    })
}

/// The picture as a lens without vignetting had shown it, `CRF(CRF⁻¹(picture) / v)`, from the values
/// `vignetting` of `v` at its pixels. White pixels stay white or become whiter.
///
/// # Panics
/// When there are not as many values as pixels.
pub fn without_vignetting<T: Real>(
    picture: &Image<T>,
    curve: &ResponseCurve<T>,
    vignetting: &[T],
) -> Image<T> {
    assert_eq!(picture.pixels(), vignetting.len(), "vignetting of another picture");
    let mut out = picture.clone();
    for channel in 0..picture.channels {
        let plane = out.plane_mut(channel).par_iter_mut().zip(vignetting);
        plane.for_each(|(value, &v)| {
            *value = curve.evaluate(channel, curve.inverse(channel, *value) / v);
        });
    }
    out
}
