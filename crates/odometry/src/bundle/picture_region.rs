//! Regions of the picture whose points err together.

use super::Bundle;

/// Regions across and down.
const GRID: [usize; 2] = [4, 3];
/// Number of regions.
pub(super) const REGIONS: usize = GRID[0] * GRID[1];

impl Bundle {
    /// Region of the picture in which a landmark was first observed.
    pub(super) fn picture_region(&self, landmark: usize) -> usize {
        let at = self.observations[landmark].first().map_or([0.0; 2], |observation| observation.at);
        let size = [self.camera.width, self.camera.height];
        let [column, row] = std::array::from_fn(|i| {
            let share = (at[i] / size[i] as f64).clamp(0.0, 1.0);
            ((share * GRID[i] as f64) as usize).min(GRID[i] - 1)
        });
        row * GRID[0] + column
    }
}
