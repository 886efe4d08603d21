//! Lens distortion after Brown and Conrady, in OpenCV's parametrisation.

/// Radial (rational) and tangential distortion coefficients.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Distortion {
    /// `k1 k2 k3`, numerator of the radial factor.
    pub(crate) radial: [f64; 3],
    /// `k4 k5 k6`, its denominator.
    pub(crate) radial_denominator: [f64; 3],
    /// `p1 p2`.
    pub(crate) tangential: [f64; 2],
}

impl Distortion {
    /// From OpenCV's order `k1 k2 p1 p2 [k3 [k4 k5 k6]]`: 0, 4, 5 or 8 finite numbers.
    pub(crate) fn from_opencv(c: &[f64]) -> Option<Self> {
        if ![0, 4, 5, 8].contains(&c.len()) || c.iter().any(|v| !v.is_finite()) {
            return None;
        }
        let at = |i: usize| c.get(i).copied().unwrap_or(0.0);
        Some(Self {
            radial: [at(0), at(1), at(4)],
            radial_denominator: [at(5), at(6), at(7)],
            tangential: [at(2), at(3)],
        })
    }

    /// Whether all coefficients are zero.
    pub(crate) fn is_zero(&self) -> bool {
        *self == Self::default()
    }

    /// Distorted image coordinates of the ray `(x, y, 1)`:
    ///
    /// `x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶) + 2 p1 x y + p2 (r² + 2
    /// x²)`, `y'` alike with `p1` and `p2` exchanged (OpenCV, *Camera Calibration and 3D
    /// Reconstruction*).
    pub(crate) fn distort(&self, x: f64, y: f64) -> (f64, f64) {
        let r2 = x * x + y * y;
        let series = |k: [f64; 3]| 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[2]));
        let factor = series(self.radial) / series(self.radial_denominator);
        let [p1, p2] = self.tangential;
        (
            x * factor + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * factor + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Positions by `cv2.projectPoints` for the coefficients of freiburg1.
    #[test]
    fn agrees_with_opencv() {
        let lens = Distortion::from_opencv(&[0.2624, -0.9531, -0.0054, 0.0026, 1.1633]);
        let lens = lens.expect("five coefficients");
        for ((x, y), expected) in EXPECTED {
            let (u, v) = lens.distort(x, y);
            assert!((u - expected.0).abs() < 1e-12 && (v - expected.1).abs() < 1e-12, "{u} {v}");
        }
    }

    #[test]
    fn only_opencv_coefficient_counts_are_accepted() {
        assert!(Distortion::from_opencv(&[]).is_some_and(|d| d.is_zero()));
        assert!(Distortion::from_opencv(&[0.1, 0.0]).is_none());
        assert!(Distortion::from_opencv(&[0.1, 0.0, f64::NAN, 0.0]).is_none());
    }

    const EXPECTED: [((f64, f64), (f64, f64)); 3] = [
        ((0.0, 0.0), (0.0, 0.0)),
        ((0.3, -0.2), (0.30762211402999995, -0.20555807602000004)),
        ((-0.5, 0.4), (-0.50924584465, 0.40603547572000004)),
    ];
}
