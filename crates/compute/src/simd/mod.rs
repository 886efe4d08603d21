//! Vectors of `f32` for kernels, with any instruction set that `pulp` finds at run time.
//!
//! Everything is `#[inline(always)]`: only inside of a dispatched call is it compiled with the
//! instruction set of that call. For the same reason kernels use plain loops: a closure that
//! `map` or `for_each` calls may stay a function of its own, without the instruction set.

mod float4;
mod functions;
mod lanes;

pub use float4::Float4;
pub use functions::{clamp_or_zero, exp, exp2, floor_and_fraction, ln, log2, nearest};
pub use lanes::{Lanes, Mask, combine, cross, dot, transform};

/// `f32` of the widest vector: no instruction set has more.
pub const MAX_LANES: usize = 16;

/// One number of each member of a group; members beyond the vector's width are not used.
pub type Column = [f32; MAX_LANES];

/// The instruction sets that kernels are tested on: the best, none, and AVX2.
pub fn instruction_sets() -> Vec<pulp::Arch> {
    let mut all = vec![pulp::Arch::new(), pulp::Arch::Scalar];
    #[cfg(target_arch = "x86_64")]
    all.extend(pulp::x86::V3::try_new().map(pulp::Arch::V3));
    all
}
