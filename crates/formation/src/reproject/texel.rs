//! One sample of the fine grid, R, G, B and a zero: four numbers that are treated as one.

pub(super) use four::Texel;
use std::ops::{Add, AddAssign, Mul, Sub};

/// One register of every x86-64.
#[cfg(target_arch = "x86_64")]
#[expect(unsafe_code, reason = "left to themselves, compilers gather each channel across pixels")]
mod four {
    use std::arch::x86_64::{
        __m128, _mm_add_ps, _mm_cvtss_f32, _mm_movehl_ps, _mm_mul_ps, _mm_set1_ps, _mm_setr_ps,
        _mm_setzero_ps, _mm_shuffle_ps, _mm_sub_ps, _mm_unpackhi_ps, _mm_unpacklo_ps,
    };

    #[derive(Clone, Copy, Debug)]
    pub(in crate::reproject) struct Texel(__m128);

    // SAFETY of all of these: SSE is part of every x86-64, and none touches memory.
    impl Texel {
        #[inline(always)]
        pub(in crate::reproject) fn zero() -> Self {
            Self(unsafe { _mm_setzero_ps() })
        }

        #[inline(always)]
        pub(in crate::reproject) fn new(red: f32, green: f32, blue: f32) -> Self {
            Self(unsafe { _mm_setr_ps(red, green, blue, 0.0) })
        }

        #[inline(always)]
        pub(super) fn splat(value: f32) -> Self {
            Self(unsafe { _mm_set1_ps(value) })
        }

        #[inline(always)]
        pub(in crate::reproject) fn channels(self) -> [f32; 3] {
            unsafe {
                let green = _mm_shuffle_ps::<1>(self.0, self.0);
                let blue = _mm_movehl_ps(self.0, self.0);
                [_mm_cvtss_f32(self.0), _mm_cvtss_f32(green), _mm_cvtss_f32(blue)]
            }
        }

        /// The sum of the four numbers of each of two.
        #[inline(always)]
        pub(super) fn sums(self, other: Self) -> (f32, f32) {
            unsafe {
                let low = _mm_unpacklo_ps(self.0, other.0);
                let halves = _mm_add_ps(low, _mm_unpackhi_ps(self.0, other.0));
                let both = _mm_add_ps(halves, _mm_movehl_ps(halves, halves));
                (_mm_cvtss_f32(both), _mm_cvtss_f32(_mm_shuffle_ps::<1>(both, both)))
            }
        }

        #[inline(always)]
        pub(super) fn plus(self, other: Self) -> Self {
            Self(unsafe { _mm_add_ps(self.0, other.0) })
        }

        #[inline(always)]
        pub(super) fn minus(self, other: Self) -> Self {
            Self(unsafe { _mm_sub_ps(self.0, other.0) })
        }

        #[inline(always)]
        pub(super) fn times(self, other: Self) -> Self {
            Self(unsafe { _mm_mul_ps(self.0, other.0) })
        }
    }
}

#[cfg(not(target_arch = "x86_64"))]
mod four {
    #[derive(Clone, Copy, Debug)]
    pub(in crate::reproject) struct Texel([f32; 4]);

    impl Texel {
        pub(in crate::reproject) fn zero() -> Self {
            Self([0.0; 4])
        }

        #[inline(always)]
        pub(in crate::reproject) fn new(red: f32, green: f32, blue: f32) -> Self {
            Self([red, green, blue, 0.0])
        }

        #[inline(always)]
        pub(super) fn splat(value: f32) -> Self {
            Self([value; 4])
        }

        #[inline(always)]
        pub(in crate::reproject) fn channels(self) -> [f32; 3] {
            [self.0[0], self.0[1], self.0[2]]
        }

        #[inline(always)]
        pub(super) fn sums(self, other: Self) -> (f32, f32) {
            let sum = |v: [f32; 4]| (v[0] + v[2]) + (v[1] + v[3]);
            (sum(self.0), sum(other.0))
        }

        #[inline(always)]
        pub(super) fn plus(self, other: Self) -> Self {
            let (a, b) = (self.0, other.0);
            Self([a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3]])
        }

        #[inline(always)]
        pub(super) fn minus(self, other: Self) -> Self {
            let (a, b) = (self.0, other.0);
            Self([a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3]])
        }

        #[inline(always)]
        pub(super) fn times(self, other: Self) -> Self {
            let (a, b) = (self.0, other.0);
            Self([a[0] * b[0], a[1] * b[1], a[2] * b[2], a[3] * b[3]])
        }
    }
}

impl Default for Texel {
    fn default() -> Self {
        Self::zero()
    }
}

impl Add for Texel {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.plus(other)
    }
}

impl AddAssign for Texel {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Sub for Texel {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.minus(other)
    }
}

impl Mul<f32> for Texel {
    type Output = Self;
    #[inline(always)]
    fn mul(self, s: f32) -> Self {
        self.times(Self::splat(s))
    }
}

impl Texel {
    /// `(self · a, self · b)`.
    #[inline(always)]
    pub(super) fn dots(self, a: Self, b: Self) -> (f32, f32) {
        self.times(a).sums(self.times(b))
    }

    /// `a + (b - a) t`.
    #[inline(always)]
    fn mix(self, other: Self, t: f32) -> Self {
        self + (other - self) * t
    }
}

/// The four samples around a position: upper left, upper right, lower left, lower right.
#[derive(Clone, Copy)]
pub(super) struct Corners([Texel; 4]);

impl Corners {
    #[inline(always)]
    pub(super) fn at(fine: &[Texel], index: usize, stride: usize) -> Option<Self> {
        let rows = fine.get(index..index + stride + 2)?;
        Some(Self([rows[0], rows[1], rows[stride], rows[stride + 1]]))
    }

    /// The bilinear value at fractions `across` and `down`.
    #[inline(always)]
    pub(super) fn interpolate(&self, across: f32, down: f32) -> Texel {
        let [a, b, c, d] = self.0;
        a.mix(c, down).mix(b.mix(d, down), across)
    }

    /// Its derivatives by `across` and by `down`.
    #[inline(always)]
    pub(super) fn slopes(&self, across: f32, down: f32) -> (Texel, Texel) {
        let [a, b, c, d] = self.0;
        let (right, lower) = (b - a, c - a);
        let twist = d - c - right;
        (right + twist * down, lower + twist * across)
    }
}

/// The transpose of [`Corners::interpolate`]: adds `d` to the four samples around a position.
#[inline(always)]
pub(super) fn scatter(
    d_fine: &mut [Texel],
    index: usize,
    stride: usize,
    d: Texel,
    (across, down): (f32, f32),
) {
    let Some(rows) = d_fine.get_mut(index..index + stride + 2) else { return };
    let right = d * across;
    let left = d - right;
    let (lower_left, lower_right) = (left * down, right * down);
    rows[0] += left - lower_left;
    rows[1] += right - lower_right;
    rows[stride] += lower_left;
    rows[stride + 1] += lower_right;
}
