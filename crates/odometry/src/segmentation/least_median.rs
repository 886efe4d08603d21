//! Least median of squares (Rousseeuw 1984): the motion of most of the picture, however large the
//! noise.
//!
//! A criterion with a fixed width prefers a compromise between two motions where that fits all
//! points within the width. The median does not: it is least for a motion that fits half of them
//! exactly. Points weigh by the area that they stand for, because texture is not spread evenly.

use crate::segmentation::picture_share::{CELLS, cell_of};
use i2slam_compute::Random;
use i2slam_geometry::Camera;

/// Points of one picture with weights that give each cell with points the same sum.
pub(crate) struct AreaWeights {
    /// Points of every cell that has some.
    cells: Vec<Vec<usize>>,
    /// Weight of every point.
    weights: Vec<f64>,
}

impl AreaWeights {
    /// For points at positions [px].
    pub(crate) fn new(camera: &Camera<f64>, positions: &[[f64; 2]]) -> Self {
        let mut cells = vec![Vec::new(); CELLS[0] * CELLS[1]];
        for (point, at) in positions.iter().enumerate() {
            cells[cell_of(camera, *at)].push(point);
        }
        cells.retain(|cell: &Vec<usize>| !cell.is_empty());
        let mut weights = vec![0.0; positions.len()];
        for cell in &cells {
            cell.iter().for_each(|point| weights[*point] = 1.0 / cell.len() as f64);
        }
        Self { cells, weights }
    }

    /// Number of cells with points.
    pub(crate) fn area(&self) -> usize {
        self.cells.len()
    }

    /// `size` points of as many cells; `None` where fewer have points.
    fn sample(&self, random: &mut Random, size: usize) -> Option<Vec<usize>> {
        if self.cells.len() < size {
            return None;
        }
        let chosen = random.distinct_below(self.cells.len(), size);
        let point = |cell: &usize| self.cells[*cell][random.below(self.cells[*cell].len())];
        Some(chosen.iter().map(point).collect())
    }

    /// Weighted median of the points' errors.
    pub(crate) fn median(&self, errors: &[f64]) -> f64 {
        let mut order: Vec<usize> = (0..errors.len()).collect();
        order.sort_by(|a, b| errors[*a].total_cmp(&errors[*b]));
        let mut left = 0.5 * self.cells.len() as f64;
        for point in order {
            left -= self.weights[point];
            if left <= 0.0 {
                return errors[point];
            }
        }
        f64::INFINITY
    }

    /// Of the motions that `fit` finds for samples of `size` points, the one of least median error.
    pub(crate) fn least_median<M>(
        &self,
        (hypotheses, size): (usize, usize),
        fit: impl Fn(&[usize], &mut Random) -> Option<M>,
        errors: impl Fn(&M) -> Vec<f64>,
    ) -> Option<(M, f64)> {
        let mut random = Random::new(self.weights.len() as u64);
        let mut best: Option<(M, f64)> = None;
        for _ in 0..hypotheses {
            let sample = self.sample(&mut random, size)?;
            let Some(motion) = fit(&sample, &mut random) else { continue };
            let median = self.median(&errors(&motion));
            if best.as_ref().is_none_or(|(_, least)| median < *least) {
                best = Some((motion, median));
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::camera;

    #[test]
    fn cells_weigh_alike_whatever_their_points() {
        // Nine points in one corner, one each in two others.
        let mut positions = vec![[10.0, 10.0]; 9];
        positions.extend([[300.0, 10.0], [300.0, 230.0]]);
        let weights = AreaWeights::new(&camera(), &positions);
        let errors: Vec<f64> = (0..11).map(|i| if i < 9 { 50.0 } else { 1.0 }).collect();
        assert_eq!(weights.median(&errors), 1.0);
        assert!(weights.sample(&mut Random::new(1), 4).is_none());
        let sample = weights.sample(&mut Random::new(1), 3).expect("three cells");
        assert_eq!(sample.iter().filter(|point| **point < 9).count(), 1);
    }
}
