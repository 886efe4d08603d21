//! Settings of the field, of sampling along rays and of the occupancy grid.

/// Shape of a field. Fixed for its life; the defaults are those of torch-ngp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FieldSettings {
    /// Centre of the cube that holds the field, in the world \[m\].
    pub centre: [f64; 3],
    /// Half of the cube's edge \[m\], positive. There is nothing outside of the cube.
    pub bound: f64,
    /// Number of grids, from coarse to fine, at least 1.
    pub levels: usize,
    /// Numbers per node of a grid: 1, 2, 4 or 8.
    pub features: usize,
    /// Binary logarithm of the most nodes that a grid stores, from 4 to 24; finer ones are hashed.
    pub log2_table: u32,
    /// Cells along an edge of the coarsest grid, at least 2.
    pub base_resolution: u32,
    /// Cells along an edge of the finest grid, not less than the coarsest and at most 2²⁰.
    pub finest_resolution: u32,
    /// Units of every hidden layer.
    pub hidden_width: usize,
    /// Hidden layers of the density network.
    pub density_layers: usize,
    /// Hidden layers of the colour network.
    pub colour_layers: usize,
    /// Numbers that the density network hands to the colour network.
    pub geometry_features: usize,
}

impl FieldSettings {
    /// Most grids of a field.
    pub const MAX_LEVELS: usize = 32;
    /// Binary logarithm of the most nodes that a grid stores.
    pub const MAX_LOG2_TABLE: u32 = 24;

    /// The settings of torch-ngp for a cube of half edge `bound` \[m\] around `centre`; the
    /// finest grid has `2048 · bound` cells along an edge.
    pub fn cube(centre: [f64; 3], bound: f64) -> Self {
        Self {
            centre,
            bound,
            levels: 16,
            features: 2,
            log2_table: 19,
            base_resolution: 16,
            finest_resolution: (2048.0 * bound).round().clamp(16.0, MAX_CELLS) as u32,
            hidden_width: 64,
            density_layers: 1,
            colour_layers: 2,
            geometry_features: 15,
        }
    }

    /// Checks all ranges; the error names the first entry out of range.
    pub fn check(&self) -> Result<(), SettingsError> {
        let within = |name: &'static str, value: usize, from: usize, to: usize| {
            if (from..=to).contains(&value) { Ok(()) } else { Err(SettingsError { name }) }
        };
        if !(self.bound.is_finite() && self.bound > 0.0) {
            return Err(SettingsError { name: "bound" });
        }
        if !self.centre.iter().all(|c| c.is_finite()) {
            return Err(SettingsError { name: "centre" });
        }
        within("levels", self.levels, 1, Self::MAX_LEVELS)?;
        if ![1, 2, 4, 8].contains(&self.features) {
            return Err(SettingsError { name: "features" });
        }
        within("log2_table", self.log2_table as usize, 4, Self::MAX_LOG2_TABLE as usize)?;
        within("base_resolution", self.base_resolution as usize, 2, 1 << 20)?;
        let base = self.base_resolution as usize;
        within("finest_resolution", self.finest_resolution as usize, base, 1 << 20)?;
        within("hidden_width", self.hidden_width, 1, 1024)?;
        within("density_layers", self.density_layers, 0, 8)?;
        within("colour_layers", self.colour_layers, 0, 8)?;
        within("geometry_features", self.geometry_features, 0, 256)
    }
}

/// Positions along an edge must keep a fraction in `f32`.
const MAX_CELLS: f64 = (1 << 20) as f64;

/// An entry of [`FieldSettings`] or of a file of them is out of its range.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("hash grid: `{name}` is out of its range")]
pub struct SettingsError {
    /// Name of the entry.
    pub name: &'static str,
}

/// Sampling along rays. Not differentiated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarchSettings {
    /// Depth before which there are no samples \[units of the ray's direction\].
    pub near: f32,
    /// Shortest step \[m\], positive.
    pub step_min: f32,
    /// Longest step \[m\].
    pub step_max: f32,
    /// Step as a part of the distance from the origin, between the two lengths above.
    pub cone: f32,
    /// Most samples of a ray, counting skipped ones.
    pub steps_max: u32,
    /// A ray ends after the sample that takes its transmittance under this.
    pub transmittance_min: f32,
}

impl MarchSettings {
    /// The settings of torch-ngp for a cube of half edge `bound` \[m\]: at most 1024 steps.
    pub fn cube(bound: f64) -> Self {
        let diagonal = 2.0 * 3.0_f64.sqrt() * bound;
        Self {
            near: 0.05,
            step_min: (diagonal / 1024.0) as f32,
            step_max: (diagonal / 128.0) as f32,
            cone: 1.0 / 128.0,
            steps_max: 1024,
            transmittance_min: 1e-4,
        }
    }
}

/// Settings of the occupancy grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OccupancySettings {
    /// Cells along an edge of the cube, from 1 to 512.
    pub resolution: u32,
    /// Factor of a cell's remembered density at each update, in `[0, 1]`.
    pub decay: f32,
    /// Density \[1/m\] from which on a cell is occupied, unless half of the mean of all cells with
    /// any is lower. (torch-ngp takes the mean, which empties half of an untrained field.)
    pub density: f32,
    /// Number of updates at every cell before updates of a part of them.
    pub full_updates: u32,
}

impl Default for OccupancySettings {
    fn default() -> Self {
        Self { resolution: 128, decay: 0.95, density: 10.0, full_updates: 16 }
    }
}
