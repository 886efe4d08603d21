//! From footprints to pixels, and back.

mod cpu_backward;
mod cpu_forward;
pub mod reference;
mod tile;

use super::bin::{Bins, TileGrid};
use super::project::{self, Chunk, Footprints, Frame, Splat};
use super::sort::Sorter;
use super::{GaussianMap, MapGradient, RasterSettings, Render, RenderCotangent, View};
use crate::RadianceMap;
pub(crate) use cpu_backward::Slot;
use i2slam_geometry::Tangent;
use pulp::Arch;
use tile::TilePixels;

/// The fast lane: all threads of the current `rayon` pool and the widest vectors found at run
/// time, in `f32`.
///
/// Buffers are kept from call to call. Pictures and gradients are bitwise the same for any number
/// of threads on one machine; the width of its vectors changes the order of some sums.
pub struct Rasterizer {
    settings: RasterSettings,
    arch: Arch,
    grid: TileGrid,
    splats: Vec<Splat>,
    chunks: Vec<Chunk>,
    sorted: Vec<u64>,
    sorter: Sorter,
    bins: Bins,
    tiles: Vec<TilePixels>,
    slots: Vec<Slot>,
    pose_sums: Vec<[f64; 6]>,
}

impl Rasterizer {
    /// A rasteriser that has rendered nothing yet.
    pub fn new(settings: RasterSettings) -> Self {
        Self {
            settings: settings.bounded(),
            arch: Arch::new(),
            grid: TileGrid::default(),
            splats: Vec::new(),
            chunks: Vec::new(),
            sorted: Vec::new(),
            sorter: Sorter::default(),
            bins: Bins::default(),
            tiles: Vec::new(),
            slots: Vec::new(),
            pose_sums: Vec::new(),
        }
    }

    /// The same on a chosen instruction set.
    #[cfg(test)]
    pub(crate) fn on(arch: Arch, settings: RasterSettings) -> Self {
        Self { arch, ..Self::new(settings) }
    }

    /// The settings.
    pub fn settings(&self) -> &RasterSettings {
        &self.settings
    }

    /// Pairs of a Gaussian and a 16x16 tile that its box touched in the last render: the measure
    /// of work.
    pub fn intersections(&self) -> usize {
        self.bins.len()
    }

    /// Write what `view` shows into `out`, whose allocation is reused.
    pub fn render(&mut self, map: &GaussianMap, view: &View<f32>, out: &mut Render) {
        self.grid = TileGrid::of(&view.camera);
        let (splats, chunks) = (&mut self.splats, &mut self.chunks);
        project::project(self.arch, map, view, &self.settings, splats, chunks);
        self.sorted.clear();
        self.chunks.iter().for_each(|chunk| self.sorted.extend_from_slice(&chunk.visible));
        self.sorter.sort(&mut self.sorted);
        self.bins.fill(&self.grid, &self.splats, &self.chunks, &self.sorted);
        self.tiles.resize_with(self.grid.len(), TilePixels::default);
        let (arch, settings) = (self.arch, &self.settings);
        cpu_forward::render(arch, settings, &self.grid, &self.splats, &self.bins, &mut self.tiles);
        tile::copy_out(&self.grid, &self.tiles, out);
    }

    /// Pull `∂L/∂render` back through the last [`render`](Self::render), which must have been of
    /// this `map` and `view`. Adds `∂L/∂map` to `map_gradient` when given and returns `∂L/∂ξ` for
    /// the pose `world_from_camera.retract(ξ)`, summed in `f64` in a fixed order.
    ///
    /// # Panics
    /// If `map`, `view` or `map_gradient` has not the size of the last render, or an image of
    /// the cotangent has data of another size.
    pub fn pull_back(
        &mut self,
        map: &GaussianMap,
        view: &View<f32>,
        cotangent: &RenderCotangent,
        map_gradient: Option<&mut MapGradient>,
    ) -> Tangent<f64> {
        let of_last_render =
            map.len() == self.splats.len() && TileGrid::of(&view.camera) == self.grid;
        assert!(of_last_render, "pull_back needs the map and the view of the last render");
        let planes = cotangent.planes(self.grid.width, self.grid.height);
        self.slots.resize(self.bins.len(), Slot::default());
        let picture = cpu_backward::Picture {
            arch: self.arch,
            settings: &self.settings,
            grid: &self.grid,
            splats: &self.splats,
            bins: &self.bins,
            tiles: &self.tiles,
            cotangent: planes,
            with_map: map_gradient.is_some(),
        };
        cpu_backward::pull_back(&picture, &mut self.slots);
        let footprints = Footprints {
            arch: self.arch,
            map,
            frame: Frame::new(map, view, &self.settings),
            splats: &self.splats,
            chunks: &self.chunks,
            bins: &self.bins,
            slots: &self.slots,
        };
        self.pose_sums.resize(self.chunks.len(), [0.0; 6]);
        footprints.pull_back(map_gradient, &mut self.pose_sums);
        let mut sum = [0.0; 6];
        self.pose_sums.iter().for_each(|part| (0..6).for_each(|k| sum[k] += part[k]));
        Tangent::from_array(sum)
    }
}

impl Default for Rasterizer {
    fn default() -> Self {
        Self::new(RasterSettings::default())
    }
}

/// A map together with its rasteriser.
pub struct GaussianRadiance {
    /// The Gaussians.
    pub map: GaussianMap,
    /// What draws them.
    pub rasterizer: Rasterizer,
}

impl RadianceMap for GaussianRadiance {
    type Gradient = MapGradient;

    fn render(&mut self, view: &View<f32>, out: &mut Render) {
        self.rasterizer.render(&self.map, view, out);
    }

    fn pull_back(
        &mut self,
        view: &View<f32>,
        cotangent: &RenderCotangent,
        gradient: Option<&mut MapGradient>,
    ) -> Tangent<f64> {
        self.rasterizer.pull_back(&self.map, view, cotangent, gradient)
    }
}
