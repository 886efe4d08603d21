//! Values of a block of samples.

use pulp::Simd;
use std::ops::{Deref, DerefMut};

/// Samples of one block; a multiple of the widest instruction.
pub(super) const BLOCK: usize = 128;

/// One number for each sample of a block.
#[derive(Clone, Copy)]
#[repr(align(64))]
pub(super) struct Row(pub(super) [f32; BLOCK]);

impl Row {
    pub(super) const ZERO: Self = Self([0.0; BLOCK]);
}

impl Deref for Row {
    type Target = [f32];

    #[inline(always)]
    fn deref(&self) -> &[f32] {
        &self.0
    }
}

impl DerefMut for Row {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut [f32] {
        &mut self.0
    }
}

/// Number of vectors of `S` in a block.
#[inline(always)]
pub(super) fn groups<S: Simd>() -> usize {
    BLOCK / S::F32_LANES
}
