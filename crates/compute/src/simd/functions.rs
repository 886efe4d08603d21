//! Exponentials, logarithms and roundings that vectorise.

use pulp::Simd;

/// Added to a small float it leaves its nearest integer in the low bits (`1.5 · 2²³`).
const ROUND: f32 = 12_582_912.0;

/// Lower bound of [`exp2`]'s argument: below every opacity cut-off, and normal after products, as
/// one subnormal number in a vector takes a hundred cycles.
const MIN_EXPONENT: f32 = -64.0;

/// `2ˣ` for `x < 128`; below -64 it stays at `2⁻⁶⁴`. Relative error below 4e-7.
///
/// Range reduction to `[-½, ½]` and a polynomial of degree 5 fitted to least worst relative
/// error (7.5e-8 before rounding).
#[inline(always)]
pub fn exp2<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    let x = simd.max_f32s(x, simd.splat_f32s(MIN_EXPONENT));
    let round = simd.splat_f32s(ROUND);
    let shifted = simd.add_f32s(x, round);
    let f = simd.sub_f32s(x, simd.sub_f32s(shifted, round));
    const TERMS: [f32; 6] =
        [1.0, 0.693_146_94, 0.240_221_2, 0.055_507_133, 0.009_675_541, 0.001_327_647_2];
    let p = polynomial(simd, f, &TERMS);
    scale_by_power(simd, p, shifted)
}

/// `eˣ` for `x < 88`; below -87 it stays near `1e-38`. Relative error below 4e-7.
#[inline(always)]
pub fn exp<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    let x = simd.max_f32s(x, simd.splat_f32s(-87.0));
    let round = simd.splat_f32s(ROUND);
    let shifted = simd.mul_add_e_f32s(x, simd.splat_f32s(std::f32::consts::LOG2_E), round);
    let n = simd.sub_f32s(shifted, round);
    // x - n ln 2 in two steps; the first constant has few bits, so that its product is exact.
    let f = simd.mul_add_e_f32s(n, simd.splat_f32s(-0.693_359_4), x);
    let f = simd.mul_add_e_f32s(n, simd.splat_f32s(2.121_944_4e-4), f);
    const TERMS: [f32; 7] = [1.0, 1.0, 0.5, 1.0 / 6.0, 1.0 / 24.0, 1.0 / 120.0, 1.0 / 720.0];
    let p = polynomial(simd, f, &TERMS);
    scale_by_power(simd, p, shifted)
}

/// `Σ terms[k] xᵏ` by Horner's rule.
#[inline(always)]
fn polynomial<S: Simd, const N: usize>(simd: S, x: S::f32s, terms: &[f32; N]) -> S::f32s {
    let mut sum = simd.splat_f32s(terms[N - 1]);
    for k in (0..N - 1).rev() {
        sum = simd.mul_add_e_f32s(sum, x, simd.splat_f32s(terms[k]));
    }
    sum
}

/// `p · 2ⁿ` for the integer `n` in the low bits of `shifted`, by adding to the exponent.
#[inline(always)]
fn scale_by_power<S: Simd>(simd: S, p: S::f32s, shifted: S::f32s) -> S::f32s {
    let n = simd.transmute_u32s_f32s(shifted);
    let n = simd.wrapping_dyn_shl_u32s(n, simd.splat_u32s(23));
    simd.transmute_f32s_u32s(simd.add_u32s(simd.transmute_u32s_f32s(p), n))
}

/// `log₂ x` for positive normal `x`. Absolute error below 2e-7 plus 1e-7 of the value.
#[inline(always)]
pub fn log2<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    const TWICE: f32 = 2.0 * std::f32::consts::LOG2_E;
    const SERIES: [f32; 5] = [TWICE, TWICE / 3.0, TWICE / 5.0, TWICE / 7.0, TWICE / 9.0];
    let (exponent, s) = exponent_and_ratio(simd, x);
    let p = polynomial(simd, simd.mul_f32s(s, s), &SERIES);
    simd.mul_add_e_f32s(p, s, exponent)
}

/// `ln x` for positive normal `x`. Absolute error below 2e-7 plus 1e-7 of the value.
#[inline(always)]
pub fn ln<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    const SERIES: [f32; 5] = [2.0, 2.0 / 3.0, 2.0 / 5.0, 2.0 / 7.0, 2.0 / 9.0];
    let (exponent, s) = exponent_and_ratio(simd, x);
    let p = polynomial(simd, simd.mul_f32s(s, s), &SERIES);
    simd.mul_add_e_f32s(exponent, simd.splat_f32s(std::f32::consts::LN_2), simd.mul_f32s(s, p))
}

/// The exponent of `x = 2ⁿ m` with `m` in `[1/√2, √2)`, and `s = (m-1)/(m+1)`:
/// `ln m = 2 atanh s = 2 s (1 + s²/3 + s⁴/5 + …)`.
#[inline(always)]
fn exponent_and_ratio<S: Simd>(simd: S, x: S::f32s) -> (S::f32s, S::f32s) {
    const HALF_ROOT: u32 = 0x3f35_04f3;
    let bits = simd.transmute_u32s_f32s(x);
    let bits = simd.add_u32s(bits, simd.splat_u32s(0x3f80_0000 - HALF_ROOT));
    // Read as a float, the exponent behind that of 2²³ is 2²³ plus itself.
    let exponent = simd.wrapping_dyn_shr_u32s(bits, simd.splat_u32s(23));
    let exponent = simd.or_u32s(exponent, simd.splat_u32s(0x4b00_0000));
    let exponent = simd.transmute_f32s_u32s(exponent);
    let exponent = simd.sub_f32s(exponent, simd.splat_f32s(8_388_608.0 + 127.0));
    let mantissa = simd.and_u32s(bits, simd.splat_u32s(0x007f_ffff));
    let mantissa = simd.add_u32s(mantissa, simd.splat_u32s(HALF_ROOT));
    let (m, one) = (simd.transmute_f32s_u32s(mantissa), simd.splat_f32s(1.0));
    (exponent, simd.div_f32s(simd.sub_f32s(m, one), simd.add_f32s(m, one)))
}

/// `position` within `0..=high`; NaN gives 0.
#[inline(always)]
pub fn clamp_or_zero(position: f32, high: f32) -> f32 {
    let above = if position > 0.0 { position } else { 0.0 };
    if above < high { above } else { high }
}

/// A position of at least 0 and less than 2²² as a whole number and a fraction in 0..=1; an odd
/// whole number comes with a fraction of 1.
///
/// Adding 1.5 · 2²³ leaves no bits for a fraction, so that the sum's last bits are the number:
/// two operations for a whole vector, where a checked conversion goes one by one.
#[inline(always)]
pub fn floor_and_fraction(position: f32) -> (u32, f32) {
    let rounded = (position - 0.5) + ROUND;
    (rounded.to_bits() - ROUND.to_bits(), position - (rounded - ROUND))
}

/// The nearest integer of a number between 0 and 2²².
#[inline(always)]
pub fn nearest(x: f32) -> usize {
    ((x + 8_388_608.0).to_bits() & 0x007f_ffff) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use pulp::{Arch, WithSimd};

    #[derive(Clone, Copy)]
    enum Function {
        Exp2,
        Exp,
        Log2,
        Ln,
    }

    struct Evaluate<'a>(Function, &'a mut [f32]);

    impl WithSimd for Evaluate<'_> {
        type Output = ();
        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) {
            for v in S::as_mut_simd_f32s(self.1).0 {
                *v = match self.0 {
                    Function::Exp2 => exp2(simd, *v),
                    Function::Exp => exp(simd, *v),
                    Function::Log2 => log2(simd, *v),
                    Function::Ln => ln(simd, *v),
                };
            }
        }
    }

    /// Worst error over a fine grid, scaled by `size` of the true value.
    fn worst(which: Function, range: [f32; 2], truth: fn(f64) -> f64, size: fn(f64) -> f64) -> f64 {
        let count = 1 << 18;
        let step = (range[1] - range[0]) / count as f32;
        let x: Vec<f32> = (0..count).map(|i| range[0] + step * i as f32).collect();
        let mut y = x.clone();
        Arch::new().dispatch(Evaluate(which, &mut y));
        x.iter().zip(&y).fold(0.0_f64, |worst, (x, y)| {
            let expected = truth(f64::from(*x));
            worst.max((f64::from(*y) - expected).abs() / size(expected))
        })
    }

    #[test]
    fn exponentials_and_logarithm_keep_their_promises() {
        let relative = |v: f64| v;
        assert!(worst(Function::Exp2, [-63.9, 127.0], f64::exp2, relative) < 4e-7);
        assert!(worst(Function::Exp, [-86.9, 87.9], f64::exp, relative) < 4e-7);
        for range in [[2e-38, 1e-30], [1e-6, 1e-2], [0.5, 2.0], [1.0, 1e10]] {
            let error = worst(Function::Log2, range, f64::log2, |v| 2.0 + v.abs());
            assert!(error < 1e-7, "{range:?} {error}");
            let error = worst(Function::Ln, range, f64::ln, |v| 2.0 + v.abs());
            assert!(error < 1e-7, "{range:?} {error}");
        }
    }

    #[test]
    fn exponentials_stay_finite_far_below() {
        let mut v = [-1e30_f32; 16];
        Arch::new().dispatch(Evaluate(Function::Exp2, &mut v));
        assert!(v.iter().all(|v| (0.0..6e-20).contains(v) && (v * 1e-12).is_normal()));
        let mut v = [f32::NEG_INFINITY; 16];
        Arch::new().dispatch(Evaluate(Function::Exp, &mut v));
        assert!(v.iter().all(|v| (0.0..2e-38).contains(v)));
    }

    #[test]
    fn a_position_is_its_whole_part_and_fraction() {
        for (position, expected) in [
            (0.0, (0, 0.0)),
            (0.25, (0, 0.25)),
            (1.0, (0, 1.0)),
            (2.0, (2, 0.0)),
            (638.75, (638, 0.75)),
            (65_534.0, (65_534, 0.0)),
        ] {
            assert_eq!(floor_and_fraction(position), expected);
        }
    }

    #[test]
    fn every_number_is_clamped() {
        for (position, expected) in
            [(f32::NAN, 0.0), (f32::INFINITY, 9.0), (-f32::INFINITY, 0.0), (3.5, 3.5), (-0.0, 0.0)]
        {
            assert_eq!(clamp_or_zero(position, 9.0), expected);
        }
    }
}
