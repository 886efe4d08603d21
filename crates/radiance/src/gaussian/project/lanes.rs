//! Many numbers at once, written like one.

use crate::gaussian::simd;
use pulp::Simd;
use std::ops::{Add, Mul, Neg, Sub};

/// Numbers that one group holds at most: one of the widest vectors.
pub(crate) const WIDTH: usize = 16;

/// One number of each member of a group; members beyond the vector's width are not used.
pub(crate) type Column = [f32; WIDTH];

/// A vector of `f32` with the instruction set that computes on it.
#[derive(Clone, Copy)]
pub(crate) struct Lanes<S: Simd> {
    simd: S,
    v: S::f32s,
}

impl<S: Simd> Lanes<S> {
    #[inline(always)]
    pub(crate) fn splat(simd: S, value: f32) -> Self {
        Self { simd, v: simd.splat_f32s(value) }
    }

    #[inline(always)]
    pub(crate) fn load(simd: S, column: &Column) -> Self {
        Self { simd, v: S::as_simd_f32s(column).0[0] }
    }

    /// The vector with this number of a column.
    #[inline(always)]
    pub(crate) fn load_part(simd: S, column: &Column, part: usize) -> Self {
        Self { simd, v: S::as_simd_f32s(column).0[part] }
    }

    #[inline(always)]
    pub(crate) fn load_all<const N: usize>(simd: S, columns: &[Column; N]) -> [Self; N] {
        let mut all = [Self::splat(simd, 0.0); N];
        for k in 0..N {
            all[k] = Self::load(simd, &columns[k]);
        }
        all
    }

    #[inline(always)]
    pub(crate) fn store(self, column: &mut Column) {
        S::as_mut_simd_f32s(column).0[0] = self.v;
    }

    #[inline(always)]
    pub(crate) fn store_part(self, column: &mut Column, part: usize) {
        S::as_mut_simd_f32s(column).0[part] = self.v;
    }

    #[inline(always)]
    fn with(self, v: S::f32s) -> Self {
        Self { v, ..self }
    }

    /// The instruction set.
    #[inline(always)]
    pub(crate) fn simd(self) -> S {
        self.simd
    }

    /// A constant beside this.
    #[inline(always)]
    pub(crate) fn constant(self, value: f32) -> Self {
        Self::splat(self.simd, value)
    }

    #[inline(always)]
    pub(crate) fn times(self, factor: f32) -> Self {
        self * self.constant(factor)
    }

    /// The smallest of the numbers.
    #[inline(always)]
    pub(crate) fn least(self) -> f32 {
        self.simd.reduce_min_f32s(self.v)
    }

    /// The largest of the numbers.
    #[inline(always)]
    pub(crate) fn most(self) -> f32 {
        self.simd.reduce_max_f32s(self.v)
    }

    #[inline(always)]
    pub(crate) fn recip(self) -> Self {
        self.with(self.simd.div_f32s(self.simd.splat_f32s(1.0), self.v))
    }

    #[inline(always)]
    pub(crate) fn sqrt(self) -> Self {
        self.with(self.simd.sqrt_f32s(self.v))
    }

    #[inline(always)]
    pub(crate) fn min(self, limit: f32) -> Self {
        self.with(self.simd.min_f32s(self.v, self.simd.splat_f32s(limit)))
    }

    #[inline(always)]
    pub(crate) fn max(self, limit: f32) -> Self {
        self.with(self.simd.max_f32s(self.v, self.simd.splat_f32s(limit)))
    }

    /// The smaller number of each pair.
    #[inline(always)]
    pub(crate) fn smaller(self, other: Self) -> Self {
        self.with(self.simd.min_f32s(self.v, other.v))
    }

    /// The larger number of each pair.
    #[inline(always)]
    pub(crate) fn larger(self, other: Self) -> Self {
        self.with(self.simd.max_f32s(self.v, other.v))
    }

    #[inline(always)]
    pub(crate) fn abs(self) -> Self {
        self.with(self.simd.abs_f32s(self.v))
    }

    /// `eˣ` for `|x| < 87`, beyond that the value there.
    #[inline(always)]
    pub(crate) fn exp(self) -> Self {
        self.with(simd::exp(self.simd, self.min(87.0).v))
    }

    /// `log₂ x` of positive normal numbers.
    #[inline(always)]
    pub(crate) fn log2(self) -> Self {
        self.with(simd::log2(self.simd, self.v))
    }

    /// `self` where the mask is set, elsewhere zero.
    #[inline(always)]
    pub(crate) fn only(self, mask: S::m32s) -> Self {
        self.with(self.simd.select_f32s(mask, self.v, self.simd.splat_f32s(0.0)))
    }

    /// Where this is at least `low` and at most `high`.
    #[inline(always)]
    pub(crate) fn within(self, low: f32, high: f32) -> S::m32s {
        let above = self.simd.greater_than_or_equal_f32s(self.v, self.simd.splat_f32s(low));
        let below = self.simd.less_than_or_equal_f32s(self.v, self.simd.splat_f32s(high));
        self.simd.and_m32s(above, below)
    }

    /// `self` where `low < ratio < high`, elsewhere zero.
    #[inline(always)]
    pub(crate) fn where_between(self, ratio: Self, low: f32, high: f32) -> Self {
        let (low, high) = (self.simd.splat_f32s(low), self.simd.splat_f32s(high));
        let above = self.simd.greater_than_f32s(ratio.v, low);
        self.only(self.simd.and_m32s(above, self.simd.less_than_f32s(ratio.v, high)))
    }
}

impl<S: Simd> Add for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        self.with(self.simd.add_f32s(self.v, o.v))
    }
}

impl<S: Simd> Sub for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, o: Self) -> Self {
        self.with(self.simd.sub_f32s(self.v, o.v))
    }
}

impl<S: Simd> Mul for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, o: Self) -> Self {
        self.with(self.simd.mul_f32s(self.v, o.v))
    }
}

impl<S: Simd> Neg for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.with(self.simd.neg_f32s(self.v))
    }
}

/// `a · b`.
#[inline(always)]
pub(crate) fn dot<S: Simd>(a: [Lanes<S>; 3], b: [Lanes<S>; 3]) -> Lanes<S> {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// `a × b`.
#[inline(always)]
pub(crate) fn cross<S: Simd>(a: [Lanes<S>; 3], b: [Lanes<S>; 3]) -> [Lanes<S>; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// `x a + y b`.
#[inline(always)]
pub(crate) fn combine<S: Simd>(
    x: Lanes<S>,
    a: [Lanes<S>; 3],
    y: Lanes<S>,
    b: [Lanes<S>; 3],
) -> [Lanes<S>; 3] {
    [x * a[0] + y * b[0], x * a[1] + y * b[1], x * a[2] + y * b[2]]
}

/// `M v` for one matrix and many vectors.
#[inline(always)]
pub(crate) fn transform<S: Simd>(m: &[[f32; 3]; 3], v: [Lanes<S>; 3]) -> [Lanes<S>; 3] {
    [
        v[0].times(m[0][0]) + v[1].times(m[0][1]) + v[2].times(m[0][2]),
        v[0].times(m[1][0]) + v[1].times(m[1][1]) + v[2].times(m[1][2]),
        v[0].times(m[2][0]) + v[1].times(m[2][1]) + v[2].times(m[2][2]),
    ]
}
