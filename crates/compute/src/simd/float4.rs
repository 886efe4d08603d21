//! Four numbers in one register, for pixels that are read one by one.

use std::ops::{AddAssign, Mul};

/// Four `f32`; one register of every x86-64.
#[derive(Clone, Copy, Debug)]
pub struct Float4(Register);

#[cfg(target_arch = "x86_64")]
type Register = std::arch::x86_64::__m128;

#[cfg(not(target_arch = "x86_64"))]
type Register = [f32; 4];

#[cfg(target_arch = "x86_64")]
#[expect(unsafe_code, reason = "left to themselves, compilers gather each channel across pixels")]
mod register {
    use super::Float4;
    use std::arch::x86_64::{
        _mm_add_ps, _mm_cvtss_f32, _mm_movehl_ps, _mm_mul_ps, _mm_set1_ps, _mm_setr_ps,
        _mm_shuffle_ps, _mm_sub_ps, _mm_unpackhi_ps, _mm_unpacklo_ps,
    };
    use std::ops::{Add, Mul, Sub};

    // SAFETY of all of these: SSE is part of every x86-64, and none touches memory.
    impl Float4 {
        /// `[x, y, z, 0]`.
        #[inline(always)]
        pub fn xyz0(x: f32, y: f32, z: f32) -> Self {
            Self(unsafe { _mm_setr_ps(x, y, z, 0.0) })
        }

        /// Four times the same number.
        #[inline(always)]
        pub fn splat(value: f32) -> Self {
            Self(unsafe { _mm_set1_ps(value) })
        }

        /// The first three numbers.
        #[inline(always)]
        pub fn xyz(self) -> [f32; 3] {
            unsafe {
                let y = _mm_shuffle_ps::<1>(self.0, self.0);
                let z = _mm_movehl_ps(self.0, self.0);
                [_mm_cvtss_f32(self.0), _mm_cvtss_f32(y), _mm_cvtss_f32(z)]
            }
        }

        /// The sum of the four numbers of each of two: `(x + z) + (y + w)`.
        #[inline(always)]
        pub fn sums(self, other: Self) -> (f32, f32) {
            unsafe {
                let low = _mm_unpacklo_ps(self.0, other.0);
                let halves = _mm_add_ps(low, _mm_unpackhi_ps(self.0, other.0));
                let both = _mm_add_ps(halves, _mm_movehl_ps(halves, halves));
                (_mm_cvtss_f32(both), _mm_cvtss_f32(_mm_shuffle_ps::<1>(both, both)))
            }
        }
    }

    /// Gives `Float4` a binary operator.
    macro_rules! operator {
        ($operator:ident, $name:ident, $instruction:ident) => {
            impl $operator for Float4 {
                type Output = Self;
                #[inline(always)]
                fn $name(self, other: Self) -> Self {
                    Self(unsafe { $instruction(self.0, other.0) })
                }
            }
        };
    }

    operator!(Add, add, _mm_add_ps);
    operator!(Sub, sub, _mm_sub_ps);
    operator!(Mul, mul, _mm_mul_ps);
}

#[cfg(not(target_arch = "x86_64"))]
mod register {
    use super::Float4;
    use std::ops::{Add, Mul, Sub};

    impl Float4 {
        /// `[x, y, z, 0]`.
        #[inline(always)]
        pub fn xyz0(x: f32, y: f32, z: f32) -> Self {
            Self([x, y, z, 0.0])
        }

        /// Four times the same number.
        #[inline(always)]
        pub fn splat(value: f32) -> Self {
            Self([value; 4])
        }

        /// The first three numbers.
        #[inline(always)]
        pub fn xyz(self) -> [f32; 3] {
            [self.0[0], self.0[1], self.0[2]]
        }

        /// The sum of the four numbers of each of two: `(x + z) + (y + w)`.
        #[inline(always)]
        pub fn sums(self, other: Self) -> (f32, f32) {
            let sum = |v: [f32; 4]| (v[0] + v[2]) + (v[1] + v[3]);
            (sum(self.0), sum(other.0))
        }
    }

    /// Gives `Float4` a binary operator.
    macro_rules! operator {
        ($operator:ident, $name:ident, $symbol:tt) => {
            impl $operator for Float4 {
                type Output = Self;
                #[inline(always)]
                fn $name(self, other: Self) -> Self {
                    Self(std::array::from_fn(|i| self.0[i] $symbol other.0[i]))
                }
            }
        };
    }

    operator!(Add, add, +);
    operator!(Sub, sub, -);
    operator!(Mul, mul, *);
}

impl Float4 {
    /// Four zeros.
    #[inline(always)]
    pub fn zero() -> Self {
        Self::splat(0.0)
    }

    /// `(self · a, self · b)`.
    #[inline(always)]
    pub fn dots(self, a: Self, b: Self) -> (f32, f32) {
        (self * a).sums(self * b)
    }

    /// `self + (other - self) t`.
    #[inline(always)]
    pub fn lerp(self, other: Self, t: f32) -> Self {
        self + (other - self) * t
    }
}

impl Default for Float4 {
    fn default() -> Self {
        Self::zero()
    }
}

impl AddAssign for Float4 {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Mul<f32> for Float4 {
    type Output = Self;
    #[inline(always)]
    fn mul(self, s: f32) -> Self {
        self * Self::splat(s)
    }
}
