//! A picture inside a render that is larger by a margin.

use i2slam_geometry::{Image, Real};

/// Copies the middle of `outer` to `inner`, which has the right size already.
pub(super) fn crop<T: Real>(outer: &Image<T>, margin: usize, inner: &mut Image<T>) {
    let (width, height) = (inner.width, inner.height);
    for (i, row) in inner.data.chunks_exact_mut(width.max(1)).enumerate() {
        let (plane, y) = (i / height, i % height + margin);
        let from = (plane * outer.height + y) * outer.width + margin;
        row.copy_from_slice(&outer.data[from..from + width]);
    }
}

/// Writes `scale · inner` to the middle of `outer`, which has the right size already, and zero
/// around it.
pub(super) fn embed<T: Real>(inner: &Image<T>, margin: usize, scale: T, outer: &mut Image<T>) {
    let (width, height) = (outer.width.max(1), outer.height);
    for (i, to) in outer.data.chunks_exact_mut(width).enumerate() {
        embed_row(inner, margin, scale, (i / height, i % height), to);
    }
}

/// One row of [`embed`], by its plane and its place in the larger image.
#[inline(always)]
pub(super) fn embed_row<T: Real>(
    inner: &Image<T>,
    margin: usize,
    scale: T,
    (plane, row): (usize, usize),
    to: &mut [T],
) {
    to.fill(T::zero());
    let Some(row) = row.checked_sub(margin).filter(|&row| row < inner.height) else { return };
    let from = (plane * inner.height + row) * inner.width;
    let from = &inner.data[from..from + inner.width];
    to[margin..].iter_mut().zip(from).for_each(|(to, &from)| *to = scale * from);
}
