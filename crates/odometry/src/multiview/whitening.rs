//! Deviations of image positions: residuals in multiples of them, in every direction.

/// Least variance along an axis [px²].
const MIN_VARIANCE: f64 = 1e-6;

/// Lower triangular `W` with `Wᵀ W = Σ⁻¹`, for the covariance `Σ` of an image position [px²]: `W r` has unit
/// covariance where the residual `r` has `Σ`. Observations hold it in single precision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Whitening {
    /// `xx`, `yx`, `yy`.
    factor: [f32; 3],
}

impl Whitening {
    /// A standard deviation [px] in all directions.
    pub(crate) fn isotropic(sigma: f64) -> Self {
        let inverse = sigma.recip() as f32;
        Self { factor: [inverse, 0.0, inverse] }
    }

    /// Of a covariance, `xx`, `xy`, `yy` [px²].
    pub(crate) fn of_covariance([xx, xy, yy]: [f64; 3]) -> Self {
        let x = xx.max(MIN_VARIANCE).sqrt();
        // Rounding may leave less than nothing of a long ellipse.
        let y = (yy - (xy / x) * (xy / x)).max(MIN_VARIANCE).sqrt();
        Self { factor: [x.recip(), -xy / (x * x * y), y.recip()].map(|v| v as f32) }
    }

    /// The covariance `Σ`: `xx`, `xy`, `yy` [px²].
    pub(crate) fn covariance(&self) -> [f64; 3] {
        let [x, yx, y] = self.factor.map(f64::from);
        let (a, c) = (x.recip(), y.recip());
        let b = -yx * a * c;
        [a * a, a * b, b * b + c * c]
    }

    /// The deviation of an error `by` times as large.
    pub(crate) fn scaled(&self, by: f64) -> Self {
        Self { factor: self.factor.map(|v| v / by as f32) }
    }

    /// The deviation of an error after a linear map.
    pub(crate) fn mapped(&self, by: [[f32; 2]; 2]) -> Self {
        Self::of_covariance(mapped_covariance(self.covariance(), by))
    }

    /// The deviation of a sum of two independent errors.
    pub(crate) fn plus(&self, other: &Self) -> Self {
        let (a, b) = (self.covariance(), other.covariance());
        Self::of_covariance(std::array::from_fn(|i| a[i] + b[i]))
    }

    /// Standard deviation [px] in the root mean square over all directions.
    pub(crate) fn sigma(&self) -> f64 {
        let [xx, _, yy] = self.covariance();
        (0.5 * (xx + yy)).sqrt()
    }

    /// A residual in standard deviations.
    #[inline(always)]
    pub(crate) fn apply(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [xx, yx, yy] = self.factor.map(f64::from);
        [xx * x, yx * x + yy * y]
    }

    /// Derivatives of a residual, those of `x` and of `y`, in standard deviations.
    #[inline(always)]
    pub(crate) fn apply_to_rows<const N: usize>(&self, x: &mut [f64; N], y: &mut [f64; N]) {
        for (x, y) in x.iter_mut().zip(y) {
            [*x, *y] = self.apply([*x, *y]);
        }
    }
}

/// `A Σ Aᵀ` of a covariance `Σ`: `xx`, `xy`, `yy`.
#[inline(always)]
pub(crate) fn mapped_covariance([xx, xy, yy]: [f64; 3], by: [[f32; 2]; 2]) -> [f64; 3] {
    let product =
        |a: [f64; 2], b: [f64; 2]| a[0] * (xx * b[0] + xy * b[1]) + a[1] * (xy * b[0] + yy * b[1]);
    let [x, y] = by.map(|row| row.map(f64::from));
    [product(x, x), product(x, y), product(y, y)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn squared_lengths_are_those_of_the_inverse_covariance() {
        let [xx, xy, yy] = [0.3, -0.11, 0.09];
        let determinant = xx * yy - xy * xy;
        let whitening = Whitening::of_covariance([xx, xy, yy]);
        for [x, y] in [[1.0, 0.0], [0.0, 1.0], [0.7, -0.4]] {
            let expected = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / determinant;
            let [a, b] = whitening.apply([x, y]);
            assert!((a * a + b * b - expected).abs() < 1e-5 * expected, "{x} {y}");
        }
        let again = whitening.covariance();
        [xx, xy, yy].iter().zip(again).for_each(|(a, b)| assert!((a - b).abs() < 1e-6));
        assert!((whitening.sigma() - (0.5 * (xx + yy)).sqrt()).abs() < 1e-6);
        let turned = whitening.mapped([[0.0, -1.0], [1.0, 0.0]]).covariance();
        [yy, -xy, xx].iter().zip(turned).for_each(|(a, b)| assert!((a - b).abs() < 1e-6));
        let long = Whitening::of_covariance([1e6, 1e6, 1e6 - 1.0]);
        assert!(long.apply([1.0, 1.0]).iter().all(|v| v.is_finite()));
        let sum = whitening.plus(&Whitening::isotropic(0.2)).covariance();
        let expected = [xx + 0.04, xy, yy + 0.04];
        expected.iter().zip(sum).for_each(|(a, b)| assert!((a - b).abs() < 1e-6));
        assert_eq!(Whitening::isotropic(0.5).apply([1.0, -2.0]), [2.0, -4.0]);
    }
}
