//! The two leaky branches outside [0, 1] (eq. 11): pixels that clip still say which way to go.
//!
//! ```text
//! CRF_leaky(x) = α x                   x < 0
//!              = CRF(x)           0 <= x <= 1
//!              = -α/√x + α + 1         x > 1,      α = 0.01
//! ```
//!
//! Values meet at 0 and at 1. Above 1 the slope starts at α/2 and dies away as `x^(-3/2)`.

use i2slam_geometry::Real;

const ALPHA: f64 = 0.01;

/// `α x`, for `x < 0`.
#[inline(always)]
pub(crate) fn below_value<T: Real>(x: T) -> T {
    T::of(ALPHA) * x
}

/// Slope below 0.
#[inline(always)]
pub(crate) fn below_slope<T: Real>() -> T {
    T::of(ALPHA)
}

/// `1 + α (1 - 1/√x)`, for `x > 1`.
#[inline(always)]
pub(crate) fn above_value<T: Real>(x: T) -> T {
    T::one() + T::of(ALPHA) * (T::one() - x.sqrt().recip())
}

/// `α/2 · x^(-3/2)`, for `x > 1`.
#[inline(always)]
pub(crate) fn above_slope<T: Real>(x: T) -> T {
    T::of(0.5 * ALPHA) / (x * x.sqrt())
}
