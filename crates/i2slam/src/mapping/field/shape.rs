//! Size of a radiance field: grids, cells and distances of samples.

use crate::config::Config;
use i2slam_radiance::hashgrid::FieldSettings;

/// Settings and [`FieldParameters`](crate::config::FieldParameters) that a field is made by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::mapping) struct FieldShape {
    pub(super) levels: usize,
    pub(super) log2_table: u32,
    pub(super) finest_cell: f32,
    pub(super) hidden_width: usize,
    pub(super) occupancy_cells: u32,
    pub(super) step: f32,
    pub(super) step_min: f32,
}

impl FieldShape {
    pub(in crate::mapping) fn new(config: &Config) -> Self {
        let (settings, parameters) = (&config.hashgrid, &config.parameters.field);
        Self {
            levels: parameters.levels,
            log2_table: settings.log2_table,
            finest_cell: settings.finest_cell,
            hidden_width: parameters.hidden_width,
            occupancy_cells: parameters.occupancy_cells,
            step: parameters.step,
            step_min: parameters.step_min,
        }
    }

    /// The largest that a field becomes in a cube of half edge `bound` \[m\]; `with_poses` for
    /// keyframes with poses, around whose surfaces cells are as fine as pictures. Pictures are taken
    /// to be twice as fine as the cells.
    fn largest(config: &Config, bound: f64, with_poses: bool) -> Self {
        let shape = Self::new(config);
        if !with_poses {
            return shape;
        }
        let keyframed = &config.parameters.keyframed;
        let finer = shape.finer(keyframed.surface_detail);
        let detailed = match keyframed.surface_cell > 0.0 {
            true => finer.with_cells(0.5 * finer.finest_cell),
            false => finer,
        };
        detailed.with_growth(bound, keyframed.surface_growth)
    }

    /// Settings of a field in the cube of half edge `bound` \[m\] around `centre`.
    pub(super) fn settings(&self, centre: [f64; 3], bound: f64) -> FieldSettings {
        let [base_resolution, finest_resolution] = self.cells(bound);
        FieldSettings {
            levels: self.levels,
            log2_table: self.log2_table,
            base_resolution,
            finest_resolution,
            hidden_width: self.hidden_width,
            ..FieldSettings::cube(centre, bound)
        }
    }

    /// Divides cells and distances of samples by `factor`.
    pub(in crate::mapping) fn finer(&self, factor: f32) -> Self {
        Self {
            finest_cell: self.finest_cell / factor,
            occupancy_cells: (self.occupancy_cells as f32 * factor).round() as u32,
            step: self.step / factor,
            step_min: self.step_min / factor,
            ..*self
        }
    }

    /// Bounds the edge of the finest cells by `most`, with one grid more for each halving. The
    /// table grows fourfold once; beyond that the finest grids share entries, to bound the memory.
    pub(in crate::mapping) fn with_cells(&self, most: f32) -> Self {
        let halvings = (self.finest_cell / most).log2();
        if halvings.is_nan() || halvings <= 0.0 {
            return *self;
        }
        let halvings = halvings.min(FieldSettings::MAX_LEVELS as f32);
        let log2_table = self.log2_table + (2.0 * halvings.min(1.0)).round() as u32;
        Self {
            finest_cell: most,
            levels: (self.levels + halvings.round() as usize).min(FieldSettings::MAX_LEVELS),
            log2_table: log2_table.min(FieldSettings::MAX_LOG2_TABLE),
            ..*self
        }
    }

    /// Cells along an edge of a cube of half edge `bound` \[m\], in the coarsest and the finest grid.
    pub(in crate::mapping) fn cells(&self, bound: f64) -> [u32; 2] {
        let coarsest = FieldSettings::cube([0.0; 3], bound).base_resolution;
        let finest = 2.0 * bound / f64::from(self.finest_cell);
        [coarsest, finest.clamp(f64::from(coarsest), 1e6) as u32]
    }

    /// Adds grids until the cells of one to those of the next are within a factor of `most`, in a
    /// cube of half edge `bound` \[m\]; adds none for a factor of at most 1.
    pub(in crate::mapping) fn with_growth(&self, bound: f64, most: f32) -> Self {
        if most.is_nan() || most <= 1.0 {
            return *self;
        }
        let [coarsest, finest] = self.cells(bound).map(f64::from);
        let steps = ((finest / coarsest).ln() / f64::from(most).ln()).ceil() as usize;
        let levels = steps.min(FieldSettings::MAX_LEVELS - 1) + 1;
        Self { levels: self.levels.max(levels), ..*self }
    }
}

/// Settings and occupancy cells of the largest field that settings lead to in a cube of half edge
/// `bound` \[m\], to estimate its memory; `with_poses` for keyframes with poses.
pub(crate) fn largest_field(config: &Config, bound: f64, with_poses: bool) -> (FieldSettings, u32) {
    let shape = FieldShape::largest(config, bound, with_poses);
    (shape.settings([0.0; 3], bound), shape.occupancy_cells)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_around_surfaces_is_larger() {
        let config = Config::preset("default-rgb").expect("known");
        let (plain, cells) = largest_field(&config, 4.0, false);
        let (fine, fine_cells) = largest_field(&config, 4.0, true);
        assert_eq!((plain.log2_table, cells), (config.hashgrid.log2_table, 96));
        assert_eq!((fine.log2_table, fine_cells), (plain.log2_table + 2, 192));
        assert!(fine.levels > plain.levels && fine.finest_resolution > plain.finest_resolution);
    }

    #[test]
    fn smaller_cells_get_more_grids_and_entries() {
        let coarse = FieldShape::new(&Config::default());
        let changes = |most: f32| {
            let fine = coarse.with_cells(most);
            (fine.finest_cell, fine.levels - coarse.levels, fine.log2_table - coarse.log2_table)
        };
        let cell = coarse.finest_cell;
        assert_eq!(changes(cell / 1.4), (cell / 1.4, 0, 1));
        assert_eq!(changes(cell / 2.0), (cell / 2.0, 1, 2));
        assert_eq!(changes(cell / 8.0), (cell / 8.0, 3, 2));
        for enough in [cell, 2.0 * cell, f32::INFINITY, f32::NAN] {
            assert_eq!(coarse.with_cells(enough), coarse);
        }
        for tiny in [f32::MIN_POSITIVE, 1e-44, 0.0] {
            assert_eq!(coarse.with_cells(tiny).levels, 32);
        }
    }

    #[test]
    fn large_cubes_get_more_grids() {
        let shape = FieldShape::new(&Config::default());
        let levels = |bound: f64, most: f32| shape.with_growth(bound, most).levels;
        // The coarsest grid has 16 cells along an edge, the finest 16 · 1.2ⁿ.
        let bound = |n: i32| 0.499 * f64::from(shape.finest_cell) * 16.0 * 1.2_f64.powi(n);
        let enough = shape.levels as i32 - 1;
        assert_eq!(levels(bound(2), 1.2), shape.levels);
        assert_eq!(levels(bound(enough), 1.2), shape.levels);
        assert_eq!(levels(bound(enough + 3), 1.2), shape.levels + 3);
        for bound in [bound(50), bound(60), f64::INFINITY] {
            let [coarsest, finest] = shape.cells(bound).map(f64::from);
            let ratio = (finest / coarsest).powf(1.0 / (levels(bound, 1.7) - 1) as f64);
            assert!(ratio <= 1.7 && ratio > 1.5, "{ratio}");
            assert_eq!(levels(bound, 1.01), 32);
        }
        for any in [0.0, 1.0, f32::NAN] {
            assert_eq!(levels(bound(50), any), shape.levels);
        }
    }
}
