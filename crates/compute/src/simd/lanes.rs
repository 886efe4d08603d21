//! One number for each lane of a vector, with arithmetic and comparisons.

use super::{Column, functions};
use pulp::Simd;
use std::ops::{Add, AddAssign, BitAnd, Div, Mul, Neg, Sub};

/// A vector of `f32` with the instruction set that computes on it.
#[derive(Clone, Copy)]
pub struct Lanes<S: Simd> {
    simd: S,
    v: S::f32s,
}

/// A truth value for each lane.
#[derive(Clone, Copy)]
pub struct Mask<S: Simd> {
    simd: S,
    v: S::m32s,
}

impl<S: Simd> Lanes<S> {
    /// `value` in every lane.
    #[inline(always)]
    pub fn splat(simd: S, value: f32) -> Self {
        Self { simd, v: simd.splat_f32s(value) }
    }

    /// Zero in every lane.
    #[inline(always)]
    pub fn zero(simd: S) -> Self {
        Self::splat(simd, 0.0)
    }

    /// The first numbers of a column.
    #[inline(always)]
    pub fn load(simd: S, column: &Column) -> Self {
        Self::load_group(simd, column, 0)
    }

    /// The first numbers of several columns.
    #[inline(always)]
    pub fn load_all<const N: usize>(simd: S, columns: &[Column; N]) -> [Self; N] {
        let mut all = [Self::zero(simd); N];
        for k in 0..N {
            all[k] = Self::load(simd, &columns[k]);
        }
        all
    }

    /// The numbers of group `group`, each as wide as a vector. Panics beyond the last whole one.
    #[inline(always)]
    pub fn load_group(simd: S, values: &[f32], group: usize) -> Self {
        Self { simd, v: S::as_simd_f32s(values).0[group] }
    }

    /// Writes the first numbers of a column.
    #[inline(always)]
    pub fn store(self, column: &mut Column) {
        self.store_group(column, 0);
    }

    /// Writes the numbers of group `group`. Panics beyond the last whole one.
    #[inline(always)]
    pub fn store_group(self, values: &mut [f32], group: usize) {
        S::as_mut_simd_f32s(values).0[group] = self.v;
    }

    #[inline(always)]
    fn with(self, v: S::f32s) -> Self {
        Self { v, ..self }
    }

    #[inline(always)]
    fn mask(self, v: S::m32s) -> Mask<S> {
        Mask { simd: self.simd, v }
    }

    /// The instruction set.
    #[inline(always)]
    pub fn simd(self) -> S {
        self.simd
    }

    /// `value` in every lane of a vector of this instruction set.
    #[inline(always)]
    pub fn constant(self, value: f32) -> Self {
        Self::splat(self.simd, value)
    }

    /// `self · factor`.
    #[inline(always)]
    pub fn scale(self, factor: f32) -> Self {
        self * self.constant(factor)
    }

    /// `self · a + b`, fused where the instruction set can.
    #[inline(always)]
    pub fn mul_add(self, a: Self, b: Self) -> Self {
        self.with(self.simd.mul_add_e_f32s(self.v, a.v, b.v))
    }

    /// The smallest of the lanes.
    #[inline(always)]
    pub fn reduce_min(self) -> f32 {
        self.simd.reduce_min_f32s(self.v)
    }

    /// The largest of the lanes.
    #[inline(always)]
    pub fn reduce_max(self) -> f32 {
        self.simd.reduce_max_f32s(self.v)
    }

    /// The sum of the lanes.
    #[inline(always)]
    pub fn reduce_sum(self) -> f32 {
        self.simd.reduce_sum_f32s(self.v)
    }

    /// `1 / self`.
    #[inline(always)]
    pub fn recip(self) -> Self {
        self.constant(1.0) / self
    }

    /// `√self`.
    #[inline(always)]
    pub fn sqrt(self) -> Self {
        self.with(self.simd.sqrt_f32s(self.v))
    }

    /// `|self|`.
    #[inline(always)]
    pub fn abs(self) -> Self {
        self.with(self.simd.abs_f32s(self.v))
    }

    /// The smaller number of each lane.
    #[inline(always)]
    pub fn min(self, other: Self) -> Self {
        self.with(self.simd.min_f32s(self.v, other.v))
    }

    /// The larger number of each lane.
    #[inline(always)]
    pub fn max(self, other: Self) -> Self {
        self.with(self.simd.max_f32s(self.v, other.v))
    }

    /// At most `high` in every lane.
    #[inline(always)]
    pub fn clamp_max(self, high: f32) -> Self {
        self.min(self.constant(high))
    }

    /// At least `low` in every lane.
    #[inline(always)]
    pub fn clamp_min(self, low: f32) -> Self {
        self.max(self.constant(low))
    }

    /// `eˣ` for `|x| < 87`, beyond that the value there.
    #[inline(always)]
    pub fn exp(self) -> Self {
        self.with(functions::exp(self.simd, self.clamp_max(87.0).v))
    }

    /// `log₂ x` of positive normal numbers.
    #[inline(always)]
    pub fn log2(self) -> Self {
        self.with(functions::log2(self.simd, self.v))
    }

    /// `ln x` of positive normal numbers.
    #[inline(always)]
    pub fn ln(self) -> Self {
        self.with(functions::ln(self.simd, self.v))
    }

    /// `self < other`.
    #[inline(always)]
    pub fn lt(self, other: Self) -> Mask<S> {
        self.mask(self.simd.less_than_f32s(self.v, other.v))
    }

    /// `self <= other`.
    #[inline(always)]
    pub fn le(self, other: Self) -> Mask<S> {
        self.mask(self.simd.less_than_or_equal_f32s(self.v, other.v))
    }

    /// `low <= self <= high`.
    #[inline(always)]
    pub fn within(self, low: f32, high: f32) -> Mask<S> {
        self.constant(low).le(self) & self.le(self.constant(high))
    }

    /// `low < self < high`.
    #[inline(always)]
    pub fn strictly_within(self, low: f32, high: f32) -> Mask<S> {
        self.constant(low).lt(self) & self.lt(self.constant(high))
    }
}

impl<S: Simd> Mask<S> {
    /// True where group `group` of `values` is above 0.
    #[inline(always)]
    pub fn load_group(simd: S, values: &[f32], group: usize) -> Self {
        Lanes::zero(simd).lt(Lanes::load_group(simd, values, group))
    }

    /// `yes` where true, `no` elsewhere.
    #[inline(always)]
    pub fn select(self, yes: Lanes<S>, no: Lanes<S>) -> Lanes<S> {
        Lanes { v: self.simd.select_f32s(self.v, yes.v, no.v), simd: self.simd }
    }

    /// `value` where true, 0 elsewhere, even where `value` is NaN.
    #[inline(always)]
    pub fn keep(self, value: Lanes<S>) -> Lanes<S> {
        self.select(value, Lanes::zero(self.simd))
    }

    /// 1 where true, 0 elsewhere.
    #[inline(always)]
    pub fn ones(self) -> Lanes<S> {
        self.keep(Lanes::splat(self.simd, 1.0))
    }
}

impl<S: Simd> BitAnd for Mask<S> {
    type Output = Self;
    #[inline(always)]
    fn bitand(self, other: Self) -> Self {
        Self { v: self.simd.and_m32s(self.v, other.v), ..self }
    }
}

/// Gives `Lanes` a binary operator.
macro_rules! operator {
    ($operator:ident, $name:ident, $instruction:ident) => {
        impl<S: Simd> $operator for Lanes<S> {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                self.with(self.simd.$instruction(self.v, other.v))
            }
        }
    };
}

operator!(Add, add, add_f32s);
operator!(Sub, sub, sub_f32s);
operator!(Mul, mul, mul_f32s);
operator!(Div, div, div_f32s);

impl<S: Simd> AddAssign for Lanes<S> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
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
pub fn dot<S: Simd>(a: [Lanes<S>; 3], b: [Lanes<S>; 3]) -> Lanes<S> {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// `a × b`.
#[inline(always)]
pub fn cross<S: Simd>(a: [Lanes<S>; 3], b: [Lanes<S>; 3]) -> [Lanes<S>; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// `x a + y b`.
#[inline(always)]
pub fn combine<S: Simd>(
    x: Lanes<S>,
    a: [Lanes<S>; 3],
    y: Lanes<S>,
    b: [Lanes<S>; 3],
) -> [Lanes<S>; 3] {
    [x * a[0] + y * b[0], x * a[1] + y * b[1], x * a[2] + y * b[2]]
}

/// `M v` for one matrix and many vectors.
#[inline(always)]
pub fn transform<S: Simd>(m: &[[f32; 3]; 3], v: [Lanes<S>; 3]) -> [Lanes<S>; 3] {
    [
        v[0].scale(m[0][0]) + v[1].scale(m[0][1]) + v[2].scale(m[0][2]),
        v[0].scale(m[1][0]) + v[1].scale(m[1][1]) + v[2].scale(m[1][2]),
        v[0].scale(m[2][0]) + v[1].scale(m[2][1]) + v[2].scale(m[2][2]),
    ]
}
