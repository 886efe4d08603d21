//! Uncertainty at depth edges: a window across two surfaces may have matched either, so that near
//! surfaces come out too large by up to half a window.

use super::DenseDepth;

/// Relative difference of depths at an edge.
const EDGE_CONTRAST: f32 = 0.1;
/// Standard deviation at an edge over its step: the other surface is three deviations away.
const STEP_DEVIATION_RATIO: f32 = 1.0 / 3.0;

/// Adds the uncertainty by edges within `reach` pixels, along rows and columns each, to the
/// variance of every pixel.
pub(super) fn inflate_variance_at_edges(found: &mut DenseDepth, reach: usize) {
    let (width, height) = (found.depth.width, found.depth.height);
    let depth = &found.depth.data;
    let most = square_filter(depth, (width, height), reach, f32::max);
    let least = square_filter(depth, (width, height), reach, |a, b| match (a > 0.0, b > 0.0) {
        (true, true) => a.min(b),
        _ => a.max(b),
    });
    for (pixel, variance) in found.variance.data.iter_mut().enumerate() {
        let here = depth[pixel];
        let step = (most[pixel] - here).max(here - least[pixel]);
        if here > 0.0 && step > EDGE_CONTRAST * least[pixel] {
            *variance += (STEP_DEVIATION_RATIO * step).powi(2);
        }
    }
}

/// Reduces squares of `2 reach + 1` pixels a side by `pick`.
fn square_filter(
    values: &[f32],
    (width, height): (usize, usize),
    reach: usize,
    pick: impl Fn(f32, f32) -> f32,
) -> Vec<f32> {
    let line = |values: &[f32], pixel: usize, (at, length): (usize, usize), stride: usize| {
        let first = pixel - at.min(reach) * stride;
        let count = at.min(reach) + 1 + reach.min(length - 1 - at);
        (0..count).map(|i| values[first + i * stride]).fold(values[pixel], &pick)
    };
    let rows: Vec<f32> =
        (0..values.len()).map(|p| line(values, p, (p % width, width), 1)).collect();
    (0..rows.len()).map(|p| line(&rows, p, (p / width, height), width)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_geometry::Image;

    /// A near half beside a far one, with an unknown column and a slope of one in a hundred
    /// downward.
    fn halves() -> DenseDepth {
        let mut depth = Image::new(20, 12, 1);
        for (i, d) in depth.data.iter_mut().enumerate() {
            let far = if i % 20 < 10 { 1.0 } else { 2.5 };
            *d = if i % 20 == 3 { 0.0 } else { far + 0.01 * (i / 20) as f32 };
        }
        let variance = Image { data: vec![1e-4; 240], ..depth.clone() };
        DenseDepth { depth, variance }
    }

    #[test]
    fn both_sides_of_an_edge_are_doubtful_up_to_the_other_surface() {
        let mut found = halves();
        inflate_variance_at_edges(&mut found, 3);
        for (pixel, variance) in found.variance.data.iter().enumerate() {
            let beside = (7..13).contains(&(pixel % 20));
            let reach = 3.0 * variance.sqrt();
            assert_eq!(beside, *variance > 1e-4, "{pixel}");
            assert!(!beside || (1.5..1.55).contains(&reach), "{pixel}: {reach}");
        }
    }

    #[test]
    fn unknown_depth_and_slopes_are_no_edges() {
        let mut found = halves();
        found.depth.data.iter_mut().filter(|d| **d > 2.0).for_each(|d| *d = 0.0);
        inflate_variance_at_edges(&mut found, 3);
        assert!(found.variance.data.iter().all(|v| *v == 1e-4));
    }
}
