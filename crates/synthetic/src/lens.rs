//! The lens: less light towards the corners.

use crate::error::SyntheticError;
use crate::spec::LensSpec;
use i2slam_geometry::{Camera, Image};
use std::borrow::Cow;

/// Places between middle and corner at which a specification is checked.
const CHECKS: usize = 64;

/// Share of light at a distance `r` from a centre over half the picture's diagonal,
/// `v(r) = 1 + a r² + b r⁴ + c r⁶`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Falloff {
    /// `a`, `b`, `c`.
    pub(crate) coefficients: [f64; 3],
}

impl Falloff {
    /// `v` at a squared distance.
    pub(crate) fn at(&self, square: f64) -> f64 {
        let [a, b, c] = self.coefficients;
        1.0 + square * (a + square * (b + square * c))
    }

    /// `v` at a pixel, counted row by row, of a picture with that size and centre.
    pub(crate) fn at_pixel(
        &self,
        (width, height): (usize, usize),
        (cx, cy): (f64, f64),
        pixel: usize,
    ) -> f32 {
        let (u, v) = Camera::<f64>::pixel_centre(pixel % width, pixel / width);
        let half_diagonal = 0.5 * (width as f64).hypot(height as f64);
        let radius = (u - cx).hypot(v - cy) / half_diagonal;
        self.at(radius * radius) as f32
    }
}

/// The factor of vignetting at a distance from the middle of the picture over half its diagonal,
/// `v(r) = 1 + a r² + b r⁴ + c r⁶`.
pub fn vignetting_at(spec: &LensSpec, r: f64) -> f64 {
    Falloff { coefficients: spec.vignetting }.at(r * r)
}

/// Radiance as it falls on the sensor.
pub(crate) fn behind_lens<'a>(radiance: &'a Image<f32>, spec: &LensSpec) -> Cow<'a, Image<f32>> {
    if *spec == LensSpec::default() {
        return Cow::Borrowed(radiance);
    }
    let mut out = radiance.clone();
    let lens = Falloff { coefficients: spec.vignetting };
    let size = (out.width, out.height);
    let centre = (0.5 * size.0 as f64, 0.5 * size.1 as f64);
    for i in 0..out.pixels() {
        let factor = lens.at_pixel(size, centre, i);
        (0..3).for_each(|channel| out.plane_mut(channel)[i] *= factor);
    }
    Cow::Owned(out)
}

impl LensSpec {
    /// An error for vignetting that leaves no light somewhere in the picture.
    pub(crate) fn check_light(&self) -> Result<(), SyntheticError> {
        let factor = |i: usize| vignetting_at(self, i as f64 / CHECKS as f64);
        let least = (0..=CHECKS).map(factor).fold(f64::INFINITY, f64::min);
        if least > 0.0 {
            return Ok(());
        }
        Err(SyntheticError::OutOfRange {
            key: "lens.vignetting".into(),
            value: format!("{:?}", self.vignetting),
            expected: format!(
                "1 + a r^2 + b r^4 + c r^6 above 0 up to r = 1, here down to {least:.3}"
            ),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_falls_off_by_the_polynomial_up_to_the_corner() {
        let spec = LensSpec { vignetting: [-0.3, -0.2, 0.1] };
        assert!((vignetting_at(&spec, 1.0) - 0.6).abs() < 1e-12);
        assert!((vignetting_at(&spec, 0.5) - (1.0 - 0.075 - 0.0125 + 0.0015625)).abs() < 1e-12);
        let white = Image { data: vec![2.0; 3 * 48], ..Image::new(8, 6, 3) };
        let seen = behind_lens(&white, &spec);
        // The middle of the corner pixel is at (3.5, 2.5) of (4, 3) from the middle.
        let corner = 2.0 * vignetting_at(&spec, 3.5_f64.hypot(2.5) / 5.0) as f32;
        for (column, row) in [(0, 0), (7, 0), (0, 5), (7, 5)] {
            for channel in 0..3 {
                assert!((seen.at(channel, column, row) - corner).abs() < 1e-6);
            }
        }
        assert!(seen.at(1, 4, 3) > 1.98 && seen.at(1, 4, 0) < seen.at(1, 4, 1));
        assert!(matches!(behind_lens(&white, &LensSpec::default()), Cow::Borrowed(_)));
    }

    #[test]
    fn a_lens_without_light_is_refused() {
        let refused = LensSpec { vignetting: [-3.0, 2.0, 0.0] }.check_light();
        assert!(refused.expect_err("dark at r = 0.87").to_string().contains("lens.vignetting"));
        LensSpec { vignetting: [-0.4, 0.0, 0.0] }.check_light().expect("light");
    }
}
