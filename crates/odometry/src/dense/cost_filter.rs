//! Means of matching costs within edges of the picture: the guided filter (He, Sun, Tang 2013), by
//! which Hosni et al. 2013 filter cost volumes.
//!
//! In every square the costs `p` are fitted by a linear function of the brightness `I`, `a I + b` with
//! `a = cov(I, p) / (var(I) + ε)` and `b = p̄ - a Ī`; a pixel has the mean of the functions of all squares around
//! it. Squares with contrast above `√ε` keep the sides of an edge apart, others are averaged. Small
//! matching windows leave noise in the costs, large ones fatten near surfaces; a filter after small
//! windows averages the noise and keeps the edges.

use super::plane_sweep::write_window_means;
use i2slam_geometry::Image;

/// Half the side of a square [px].
const HALF_SQUARE: usize = 2;
/// Variance of brightness, encoded in [0, 1], above which a square keeps its edges.
const EDGE_VARIANCE: f32 = 1e-3;

/// The guided filter with the statistics of its picture.
pub(super) struct CostFilter<'a> {
    guide: &'a Image<f32>,
    means: Vec<f32>,
    /// `1 / (var(I) + ε)`.
    precisions: Vec<f32>,
}

/// Buffers of a filter.
#[derive(Default)]
struct Scratch {
    /// Sums along rows.
    rows: Vec<f32>,
    products: Vec<f32>,
    mean_products: Vec<f32>,
    mean_costs: Vec<f32>,
}

impl<'a> CostFilter<'a> {
    pub(super) fn new(guide: &'a Image<f32>) -> Self {
        let size = (guide.width, guide.height);
        let (mut rows, mut means, mut squares) = (Vec::new(), Vec::new(), Vec::new());
        write_window_means(&guide.data, size, HALF_SQUARE, &mut rows, &mut means);
        let products: Vec<f32> = guide.data.iter().map(|v| v * v).collect();
        write_window_means(&products, size, HALF_SQUARE, &mut rows, &mut squares);
        let precision = |(square, mean): (&f32, &f32)| {
            ((square - mean * mean).max(0.0) + EDGE_VARIANCE).recip()
        };
        let precisions = squares.iter().zip(&means).map(precision).collect();
        Self { guide, means, precisions }
    }

    /// Filters costs in [0, 1], one for each pixel.
    #[inline(always)]
    pub(super) fn apply(&self, costs: &mut [f32]) {
        let (size, count) = ((self.guide.width, self.guide.height), costs.len());
        let guide = &self.guide.data[..count];
        let Scratch { mut rows, mut products, mut mean_products, mut mean_costs } =
            Scratch::default();
        products.extend(guide.iter().zip(&*costs).map(|(i, p)| i * p));
        write_window_means(&products, size, HALF_SQUARE, &mut rows, &mut mean_products);
        write_window_means(costs, size, HALF_SQUARE, &mut rows, &mut mean_costs);
        // Slopes and offsets of the lines take the places of the products and the costs.
        for i in 0..count {
            let covariance = mean_products[i] - self.means[i] * mean_costs[i];
            products[i] = covariance * self.precisions[i];
            costs[i] = mean_costs[i] - products[i] * self.means[i];
        }
        write_window_means(&products, size, HALF_SQUARE, &mut rows, &mut mean_products);
        write_window_means(costs, size, HALF_SQUARE, &mut rows, &mut mean_costs);
        for i in 0..count {
            costs[i] = (mean_products[i] * guide[i] + mean_costs[i]).clamp(0.0, 1.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::noise;
    use std::ops::Range;

    const SIZE: (usize, usize) = (24, 18);

    fn picture(of: impl Fn(usize, usize) -> f32) -> Image<f32> {
        Image::from_fn(SIZE.0, SIZE.1, 1, |_, x, y| of(x, y))
    }

    /// The definition, square by square.
    fn plain(guide: &Image<f32>, costs: &Image<f32>) -> Vec<f64> {
        let (width, height) = SIZE;
        let around = |pixel: usize| {
            let half = HALF_SQUARE as isize;
            let (x, y) = ((pixel % width) as isize, (pixel / width) as isize);
            (-half..=half).flat_map(move |dy| (-half..=half).map(move |dx| (dx, dy))).map(
                move |(dx, dy)| {
                    let column = (x + dx).clamp(0, width as isize - 1) as usize;
                    let row = (y + dy).clamp(0, height as isize - 1) as usize;
                    row * width + column
                },
            )
        };
        let mean = |pixel: usize, of: &dyn Fn(usize) -> f64| {
            around(pixel).map(of).sum::<f64>() / ((2 * HALF_SQUARE + 1).pow(2)) as f64
        };
        let (i, p) = (|at: usize| f64::from(guide.data[at]), |at: usize| f64::from(costs.data[at]));
        let line = |pixel: usize| {
            let [mi, mp] = [mean(pixel, &i), mean(pixel, &p)];
            let covariance = mean(pixel, &|at| i(at) * p(at)) - mi * mp;
            let variance = mean(pixel, &|at| i(at) * i(at)) - mi * mi;
            let slope = covariance / (variance + f64::from(EDGE_VARIANCE));
            (slope, mp - slope * mi)
        };
        let lines: Vec<(f64, f64)> = (0..width * height).map(line).collect();
        let filtered = |pixel: usize| {
            mean(pixel, &|at| lines[at].0) * i(pixel) + mean(pixel, &|at| lines[at].1)
        };
        (0..width * height).map(|pixel| filtered(pixel).clamp(0.0, 1.0)).collect()
    }

    #[test]
    fn filtered_costs_are_those_of_the_definition() {
        let random = |seed| noise(seed, SIZE.0 * SIZE.1);
        let [guide, costs] = [1, 2].map(|seed| {
            let values = random(seed);
            picture(|x, y| 0.5 + 0.4 * values[y * SIZE.0 + x].clamp(-1.0, 1.0) as f32)
        });
        let mut found = costs.data.clone();
        CostFilter::new(&guide).apply(&mut found);
        for (pixel, (found, due)) in found.iter().zip(plain(&guide, &costs)).enumerate() {
            assert!((f64::from(*found) - due).abs() < 1e-5, "{pixel}: {found} {due}");
        }
    }

    /// Noise becomes less, beside an edge as elsewhere.
    #[test]
    fn noise_is_averaged_and_edges_stay() {
        let guide = picture(|x, _| if x < 12 { 0.2 } else { 0.8 });
        let noise = noise(3, SIZE.0 * SIZE.1);
        let due = |x: usize| if x < 12 { 0.3 } else { 0.7 };
        let costs = picture(|x, y| due(x) + 0.1 * noise[y * SIZE.0 + x].clamp(-1.0, 1.0) as f32);
        let mut found = costs.data.clone();
        CostFilter::new(&guide).apply(&mut found);
        let deviation = |costs: &[f32], columns: Range<usize>| {
            let all = costs.iter().enumerate().filter(|(p, _)| columns.contains(&(p % SIZE.0)));
            let squares: Vec<f32> = all.map(|(p, cost)| (cost - due(p % SIZE.0)).powi(2)).collect();
            (squares.iter().sum::<f32>() / squares.len() as f32).sqrt()
        };
        for columns in [0..SIZE.0, 11..13] {
            let [before, after] =
                [&costs.data, &found].map(|costs| deviation(costs, columns.clone()));
            assert!(after < 0.4 * before, "{columns:?}: {before} {after}");
        }
    }
}
