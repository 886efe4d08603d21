//! Whole-picture translation between two pictures: the starting point of every point search.

use i2slam_geometry::Image;

/// Largest translation tried, as a ratio of each side.
const MAX_TRANSLATION_RATIO: f32 = 0.3;

/// The best whole-pixel translation within [`MAX_TRANSLATION_RATIO`] between two pictures of one
/// size, second less first [px], and the correlation of their overlap there.
pub(crate) fn estimate_global_translation(
    first: &Image<f32>,
    second: &Image<f32>,
) -> ([f32; 2], f32) {
    let reach = |side: usize| (side as f32 * MAX_TRANSLATION_RATIO) as isize;
    let (across, down) = (reach(first.width), reach(first.height));
    let mut best = ([0.0, 0.0], overlap_correlation(first, second, (0, 0), 0.0));
    for dy in -down..=down {
        for dx in -across..=across {
            let correlation = overlap_correlation(first, second, (dx, dy), 0.0);
            if correlation > best.1 {
                best = ([dx as f32, dy as f32], correlation);
            }
        }
    }
    best
}

/// Normalised correlation of the overlap of two pictures of one size, `first(x)` with `second(x +
/// (dx, dy))`; 0 where `n⁴ σ₁² σ₂²`, with `n` the number of pixels, is at most `min_spread`.
pub(crate) fn overlap_correlation(
    first: &Image<f32>,
    second: &Image<f32>,
    (dx, dy): (isize, isize),
    min_spread: f32,
) -> f32 {
    let (w, h) = (first.width as isize, first.height as isize);
    let (c0, c1) = ((-dx).max(0), (w - dx).min(w));
    let (mut n, mut a, mut b, mut aa, mut bb, mut ab) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    for row in (-dy).max(0)..(h - dy).min(h) {
        let from = (row * w + c0) as usize..(row * w + c1) as usize;
        let to = ((row + dy) * w + c0 + dx) as usize..((row + dy) * w + c1 + dx) as usize;
        for (x, y) in first.data[from].iter().zip(&second.data[to]) {
            (n, a, b) = (n + 1.0, a + x, b + y);
            (aa, bb, ab) = (aa + x * x, bb + y * y, ab + x * y);
        }
    }
    let spread = (n * aa - a * a).max(0.0) * (n * bb - b * b).max(0.0);
    if spread > min_spread { (n * ab - a * b) / spread.sqrt() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn blobs(dx: f32, dy: f32) -> Image<f32> {
        Image::from_fn(40, 30, 1, |_, column, row| {
            let (x, y) = (column as f32 - dx, row as f32 - dy);
            (0.31 * x + 0.2 * y).sin() + (0.17 * y * y * 0.1 - 0.21 * x).cos()
        })
    }

    #[test]
    fn a_move_is_found_whatever_the_exposure() {
        let mut second = blobs(5.0, -3.0);
        second.data.iter_mut().for_each(|v| *v = 0.3 * *v + 1.0);
        let (translation, correlation) = estimate_global_translation(&blobs(0.0, 0.0), &second);
        assert_eq!(translation, [5.0, -3.0]);
        assert!(correlation > 0.99);
    }
}
