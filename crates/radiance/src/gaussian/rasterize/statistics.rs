//! Statistics of the last picture: time by stage, and amount of work.

use super::Rasterizer;
use std::time::Instant;

/// Wall time \[s\] of the stages of the last forward and backward pass.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StageSeconds {
    /// From Gaussians to footprints.
    pub project: f64,
    /// Sorting the footprints by depth.
    pub sort: f64,
    /// Listing the footprints of each tile.
    pub bin: f64,
    /// Compositing the tiles.
    pub blend: f64,
    /// Tiles to planes.
    pub copy_out: f64,
    /// From pixels to sums per footprint and tile.
    pub blend_back: f64,
    /// From those sums to parameters and pose.
    pub project_back: f64,
}

/// Amount of work of the last picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Work {
    /// Gaussians of the map.
    pub gaussians: usize,
    /// Gaussians that touch a tile.
    pub visible: usize,
    /// Pairs of a Gaussian and a tile that its box touches.
    pub pairs: usize,
    /// Pairs looked at before all pixels of their tile had ended.
    pub visited: usize,
    /// Rows of 16 pixels that these pairs blended.
    pub rows: usize,
    /// Tiles.
    pub tiles: usize,
}

impl Rasterizer {
    /// Time by stage of the last forward and backward pass with a camera at rest.
    pub fn stage_seconds(&self) -> StageSeconds {
        self.seconds
    }

    /// The work of the last picture, counted from the lists that it left.
    pub fn work(&self) -> Work {
        let visited = |tile: usize| self.bins.list(tile).take(self.tiles[tile].visited);
        let rows = |[first, end]: [usize; 2]| end.saturating_sub(first);
        let tiles = 0..self.grid.len();
        Work {
            gaussians: self.splats.len(),
            visible: self.sorted.len(),
            pairs: self.bins.len(),
            visited: tiles.clone().map(|tile| visited(tile).count()).sum(),
            rows: tiles.flat_map(visited).map(|entry| rows(entry.rows())).sum(),
            tiles: self.grid.len(),
        }
    }
}

/// Runs `work` and writes its duration to `seconds`.
pub(super) fn timed<R>(seconds: &mut f64, work: impl FnOnce() -> R) -> R {
    let clock = Instant::now();
    let result = work();
    *seconds = clock.elapsed().as_secs_f64();
    result
}
