//! Samples of the fine grid.

use i2slam_compute::simd::Float4;

/// Red, green, blue and a zero.
pub(super) type Texel = Float4;

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
        a.lerp(c, down).lerp(b.lerp(d, down), across)
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
