//! Numbers, as many at a time as one instruction holds.
//!
//! Everything is `#[inline(always)]`: only inside of a dispatched call is it compiled with the
//! instruction set that was found at run time. Kernels use plain loops for the same reason.

use pulp::Simd;
use std::ops::{Add, AddAssign, BitAnd, Div, Mul, Sub};

/// Samples of one block; a multiple of the widest instruction.
pub(super) const BLOCK: usize = 128;

/// One number for each sample of a block.
#[derive(Clone, Copy)]
#[repr(align(64))]
pub(super) struct Row(pub(super) [f32; BLOCK]);

impl Row {
    pub(super) const ZERO: Self = Self([0.0; BLOCK]);
}

/// How many groups of `S`'s width a block has.
#[inline(always)]
pub(super) fn groups<S: Simd>() -> usize {
    BLOCK / S::F32_LANES
}

/// One number for each lane.
#[derive(Clone, Copy)]
pub(super) struct Wide<S: Simd> {
    simd: S,
    lanes: S::f32s,
}

/// Yes or no for each lane.
#[derive(Clone, Copy)]
pub(super) struct Mask<S: Simd> {
    simd: S,
    lanes: S::m32s,
}

impl<S: Simd> Wide<S> {
    #[inline(always)]
    pub(super) fn splat(simd: S, value: f32) -> Self {
        Self { simd, lanes: simd.splat_f32s(value) }
    }

    #[inline(always)]
    pub(super) fn zero(simd: S) -> Self {
        Self::splat(simd, 0.0)
    }

    /// The numbers of group `group`.
    #[inline(always)]
    pub(super) fn load(simd: S, row: &Row, group: usize) -> Self {
        Self { simd, lanes: S::as_simd_f32s(&row.0).0[group] }
    }

    /// The numbers of group `group` of another row.
    #[inline(always)]
    pub(super) fn beside(self, row: &Row, group: usize) -> Self {
        Self::load(self.simd, row, group)
    }

    #[inline(always)]
    pub(super) fn store(self, row: &mut Row, group: usize) {
        S::as_mut_simd_f32s(&mut row.0).0[group] = self.lanes;
    }

    /// `self · a + b`.
    #[inline(always)]
    pub(super) fn mul_add(self, a: Self, b: Self) -> Self {
        Self { lanes: self.simd.mul_add_e_f32s(self.lanes, a.lanes, b.lanes), ..self }
    }

    #[inline(always)]
    pub(super) fn sqrt(self) -> Self {
        Self { lanes: self.simd.sqrt_f32s(self.lanes), ..self }
    }

    #[inline(always)]
    pub(super) fn abs(self) -> Self {
        Self { lanes: self.simd.abs_f32s(self.lanes), ..self }
    }

    #[inline(always)]
    pub(super) fn max(self, other: Self) -> Self {
        Self { lanes: self.simd.max_f32s(self.lanes, other.lanes), ..self }
    }

    #[inline(always)]
    pub(super) fn reciprocal(self) -> Self {
        Self::splat(self.simd, 1.0) / self
    }

    #[inline(always)]
    pub(super) fn less(self, other: Self) -> Mask<S> {
        Mask { simd: self.simd, lanes: self.simd.less_than_f32s(self.lanes, other.lanes) }
    }

    #[inline(always)]
    pub(super) fn at_most(self, other: Self) -> Mask<S> {
        Mask { simd: self.simd, lanes: self.simd.less_than_or_equal_f32s(self.lanes, other.lanes) }
    }

    #[inline(always)]
    pub(super) fn sum(self) -> f32 {
        self.simd.reduce_sum_f32s(self.lanes)
    }

    /// Natural logarithm of positive normal numbers. Absolute error below 2e-7 plus 1e-7 of the
    /// value.
    ///
    /// With the mantissa `m` in `[1/√2, √2)` and `s = (m-1)/(m+1)`, `ln m = 2 atanh s` as a
    /// series.
    #[inline(always)]
    pub(super) fn ln(self) -> Self {
        const HALF_ROOT: u32 = 0x3f35_04f3;
        let simd = self.simd;
        let bits = simd.transmute_u32s_f32s(self.lanes);
        let bits = simd.add_u32s(bits, simd.splat_u32s(0x3f80_0000 - HALF_ROOT));
        // Read as a float, the exponent behind that of 2²³ is 2²³ plus itself.
        let exponent = simd.wrapping_dyn_shr_u32s(bits, simd.splat_u32s(23));
        let exponent = simd.or_u32s(exponent, simd.splat_u32s(0x4b00_0000));
        let exponent = Self { lanes: simd.transmute_f32s_u32s(exponent), simd };
        let mantissa = simd.and_u32s(bits, simd.splat_u32s(0x007f_ffff));
        let mantissa = simd.add_u32s(mantissa, simd.splat_u32s(HALF_ROOT));
        let m = Self { lanes: simd.transmute_f32s_u32s(mantissa), simd };
        let number = |value| Self::splat(simd, value);
        let s = (m - number(1.0)) / (m + number(1.0));
        let square = s * s;
        let series = square.mul_add(number(2.0 / 9.0), number(2.0 / 7.0));
        let series = series.mul_add(square, number(2.0 / 5.0));
        let series = series.mul_add(square, number(2.0 / 3.0));
        let series = series.mul_add(square, number(2.0));
        let exponent = exponent - number(8_388_608.0 + 127.0);
        exponent.mul_add(number(std::f32::consts::LN_2), s * series)
    }
}

impl<S: Simd> Mask<S> {
    /// `yes` where true, `no` elsewhere.
    #[inline(always)]
    pub(super) fn select(self, yes: Wide<S>, no: Wide<S>) -> Wide<S> {
        Wide { lanes: self.simd.select_f32s(self.lanes, yes.lanes, no.lanes), simd: self.simd }
    }

    /// `value` where true, 0 elsewhere, whatever `value` is there.
    #[inline(always)]
    pub(super) fn keep(self, value: Wide<S>) -> Wide<S> {
        self.select(value, Wide::zero(self.simd))
    }

    /// 1 where true, 0 elsewhere.
    #[inline(always)]
    pub(super) fn ones(self) -> Wide<S> {
        self.keep(Wide::splat(self.simd, 1.0))
    }

    /// Where `row` of a block is not 0.
    #[inline(always)]
    pub(super) fn load(simd: S, row: &Row, group: usize) -> Self {
        Wide::zero(simd).less(Wide::load(simd, row, group))
    }
}

impl<S: Simd> BitAnd for Mask<S> {
    type Output = Self;
    #[inline(always)]
    fn bitand(self, other: Self) -> Self {
        Self { lanes: self.simd.and_m32s(self.lanes, other.lanes), ..self }
    }
}

/// Gives `Wide` an operator.
macro_rules! operator {
    ($operator:ident, $name:ident, $instruction:ident) => {
        impl<S: Simd> $operator for Wide<S> {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                Self { lanes: self.simd.$instruction(self.lanes, other.lanes), ..self }
            }
        }
    };
}

operator!(Add, add, add_f32s);
operator!(Sub, sub, sub_f32s);
operator!(Mul, mul, mul_f32s);
operator!(Div, div, div_f32s);

impl<S: Simd> AddAssign for Wide<S> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pulp::{Arch, WithSimd};

    struct Logarithms<'a>(&'a mut Row);

    impl WithSimd for Logarithms<'_> {
        type Output = ();
        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) {
            for group in 0..groups::<S>() {
                Wide::load(simd, self.0, group).ln().store(self.0, group);
            }
        }
    }

    #[test]
    fn the_logarithm_keeps_its_promise() {
        for k in 0..2000 {
            let x = Row(std::array::from_fn(|i| 1.0 + ((k * BLOCK + i) as f32 * 3e-5).powi(5)));
            let mut y = x;
            Arch::new().dispatch(Logarithms(&mut y));
            for (x, y) in x.0.iter().zip(&y.0) {
                let truth = f64::from(*x).ln();
                let error = (f64::from(*y) - truth).abs();
                assert!(error < 2e-7 + 1e-7 * truth, "{x} {y} {truth}");
            }
        }
    }
}
