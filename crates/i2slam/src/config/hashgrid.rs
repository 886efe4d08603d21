//! Settings of a radiance field in a hash grid.

use i2slam_radiance::hashgrid::FieldSettings;
use serde::{Deserialize, Serialize};

/// A radiance field in a hash grid, and how it is trained. Keyframes and the rates of frames are
/// those of `mapping`; its window is the number of keyframes that a step draws from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HashGridConfig {
    /// Half edge of the cube around the first camera that is mapped [m]; zero takes it from the
    /// first frame's depth, and a larger one, with a field begun anew, where a frame sees farther.
    pub bound: f32,
    /// The same as a multiple of a frame's largest distance, the farthest 1 % left out.
    pub margin: f32,
    /// Number of grids, from coarse to fine; at least, around known surfaces (`keyframed`).
    pub levels: usize,
    /// Binary logarithm of the largest number of nodes that a grid stores.
    pub log2_table: u32,
    /// Cells of the finest grid [m].
    pub finest_cell: f32,
    /// Share of an `N`-th of an exposure, around its middle, from which one of `N` rays of a pixel
    /// draws its moment: 1 for all of it, 0 for evenly spaced virtual cameras.
    pub moment_jitter: f32,
    /// Units of every hidden layer.
    pub hidden_width: usize,
    /// Cells along an edge of the cube that are sampled or skipped.
    pub occupancy_cells: u32,
    /// Half thickness of the shell that is sampled around a surface, as a share of its depth.
    pub shell: f32,
    /// Distance of samples as a share of their distance from the camera.
    pub step: f32,
    /// Least distance of samples [m].
    pub step_min: f32,
    /// Rays of a step, about; in a session on keyframes with poses, pixels of a step, each of which
    /// takes a ray for every virtual camera.
    pub rays: usize,
    /// Steps per mapping round.
    pub iterations: usize,
    /// Steps of the round that starts the map.
    pub first_iterations: usize,
    /// Steps after the last frame, over all keyframes; the rate falls tenfold during them.
    pub final_iterations: usize,
    /// Learning rate of the field.
    pub rate: f32,
    /// λ_img (a mean over pixels).
    pub image_weight: f32,
    /// λ_depth (a mean over pixels).
    pub depth_weight: f32,
}

impl HashGridConfig {
    /// The same with all cells and distances of samples `factor` times as fine.
    pub(crate) fn finer(&self, factor: f32) -> Self {
        Self {
            finest_cell: self.finest_cell / factor,
            occupancy_cells: (self.occupancy_cells as f32 * factor).round() as u32,
            step: self.step / factor,
            step_min: self.step_min / factor,
            ..self.clone()
        }
    }

    /// The same whose finest cells have an edge of at most `most`, with a grid more for each halving
    /// of it. Cells of half the edge need four times the entries on a surface, which they get once:
    /// beyond that the finest grids share entries, so that small cells of a large scene do not fill
    /// the memory.
    pub(crate) fn with_cells(&self, most: f32) -> Self {
        let halvings = (self.finest_cell / most).log2();
        if halvings.is_nan() || halvings <= 0.0 {
            return self.clone();
        }
        let halvings = halvings.min(FieldSettings::MAX_LEVELS as f32);
        let log2_table = self.log2_table + (2.0 * halvings.min(1.0)).round() as u32;
        Self {
            finest_cell: most,
            levels: (self.levels + halvings.round() as usize).min(FieldSettings::MAX_LEVELS),
            log2_table: log2_table.min(FieldSettings::MAX_LOG2_TABLE),
            ..self.clone()
        }
    }

    /// Cells along an edge of a cube of half edge `bound` \[m\], in the coarsest and the finest grid.
    pub(crate) fn cells(&self, bound: f64) -> [u32; 2] {
        let coarsest = FieldSettings::cube([0.0; 3], bound).base_resolution;
        let finest = 2.0 * bound / f64::from(self.finest_cell);
        [coarsest, finest.clamp(f64::from(coarsest), 1e6) as u32]
    }

    /// The same with as many grids as keep the cells of one to those of the next within a factor of
    /// `most`, in a cube of half edge `bound` \[m\]; none more for a factor of at most 1.
    pub(crate) fn with_growth(&self, bound: f64, most: f32) -> Self {
        if most.is_nan() || most <= 1.0 {
            return self.clone();
        }
        let [coarsest, finest] = self.cells(bound).map(f64::from);
        let steps = ((finest / coarsest).ln() / f64::from(most).ln()).ceil() as usize;
        let levels = steps.min(FieldSettings::MAX_LEVELS - 1) + 1;
        Self { levels: self.levels.max(levels), ..self.clone() }
    }
}

#[cfg(test)]
mod tests {
    use crate::config::Config;

    #[test]
    fn smaller_cells_get_more_grids_and_entries() {
        let coarse = Config::default().hashgrid;
        let shape = |most: f32| {
            let fine = coarse.with_cells(most);
            (fine.finest_cell, fine.levels - coarse.levels, fine.log2_table - coarse.log2_table)
        };
        let cell = coarse.finest_cell;
        assert_eq!(shape(cell / 1.4), (cell / 1.4, 0, 1));
        assert_eq!(shape(cell / 2.0), (cell / 2.0, 1, 2));
        assert_eq!(shape(cell / 8.0), (cell / 8.0, 3, 2));
        for enough in [cell, 2.0 * cell, f32::INFINITY, f32::NAN] {
            assert_eq!(coarse.with_cells(enough), coarse);
        }
        for tiny in [f32::MIN_POSITIVE, 1e-44, 0.0] {
            assert_eq!(coarse.with_cells(tiny).levels, 32);
        }
    }

    #[test]
    fn large_cubes_get_more_grids() {
        let config = Config::default().hashgrid;
        let levels = |bound: f64, most: f32| config.with_growth(bound, most).levels;
        // The coarsest grid has 16 cells along an edge, the finest 16 · 1.2ⁿ.
        let bound = |n: i32| 0.499 * f64::from(config.finest_cell) * 16.0 * 1.2_f64.powi(n);
        let enough = config.levels as i32 - 1;
        assert_eq!(levels(bound(2), 1.2), config.levels);
        assert_eq!(levels(bound(enough), 1.2), config.levels);
        assert_eq!(levels(bound(enough + 3), 1.2), config.levels + 3);
        for bound in [bound(50), bound(60), f64::INFINITY] {
            let [coarsest, finest] = config.cells(bound).map(f64::from);
            let ratio = (finest / coarsest).powf(1.0 / (levels(bound, 1.7) - 1) as f64);
            assert!(ratio <= 1.7 && ratio > 1.5, "{ratio}");
            assert_eq!(levels(bound, 1.01), 32);
        }
        for any in [0.0, 1.0, f32::NAN] {
            assert_eq!(levels(bound(50), any), config.levels);
        }
    }
}
