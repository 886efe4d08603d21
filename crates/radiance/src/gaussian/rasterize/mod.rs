//! From footprints to pixels, and back.

mod cpu_backward;
mod cpu_forward;
mod moving;
pub mod reference;
mod statistics;
mod tile;

use super::bin::{Bins, TileGrid};
use super::project::{
    self, Chunk, Footprints, Frame, MotionFrame, Path, PoseSums, Projection, Splat,
};
use super::sort::Sorter;
use super::{
    GaussianMap, MapGradient, MotionGradient, RasterSettings, Render, RenderCotangent,
    ShutterMotion, View,
};
use crate::RadianceMap;
pub(crate) use cpu_backward::TileSums;
use i2slam_geometry::Tangent;
pub(crate) use moving::MotionTileSums;
use moving::{MomentRow, RowTimes};
use pulp::Arch;
use statistics::timed;
pub use statistics::{StageSeconds, Work};
use tile::TilePixels;

/// The fast lane: all threads of the current `rayon` pool and the widest vectors found at run
/// time, in `f32`.
///
/// Buffers are kept from call to call. Pictures and gradients are bitwise the same for any number
/// of threads on one machine; the width of its vectors changes the order of some sums.
#[derive(Default)]
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
    slots: Vec<TileSums>,
    pose_sums: Vec<PoseSums>,
    paths: Vec<Path<f32>>,
    row_times: RowTimes,
    states: Vec<MomentRow>,
    motion_slots: Vec<MotionTileSums>,
    seconds: StageSeconds,
}

impl Rasterizer {
    /// A rasteriser that has rendered nothing yet.
    pub fn new(settings: RasterSettings) -> Self {
        Self { settings: settings.bounded(), ..Self::default() }
    }

    /// A rasteriser on a chosen instruction set.
    #[cfg(test)]
    pub(crate) fn on(arch: Arch, settings: RasterSettings) -> Self {
        Self { arch, ..Self::new(settings) }
    }

    /// Projects the candidates and lists the splats of each marked tile in order of depth.
    fn list(
        &mut self,
        map: &GaussianMap,
        view: &View<f32>,
        motion: Option<&MotionFrame>,
        mask: Option<&[bool]>,
        candidates: Option<&[Chunk]>,
    ) {
        self.grid = TileGrid::of(&view.camera);
        let projection = Projection {
            splats: &mut self.splats,
            chunks: &mut self.chunks,
            paths: &mut self.paths,
            mask,
            candidates,
        };
        let (arch, settings, seconds) = (self.arch, &self.settings, &mut self.seconds);
        timed(&mut seconds.project, || {
            project::project(arch, map, view, motion, settings, projection);
        });
        timed(&mut seconds.sort, || {
            self.sorted.clear();
            self.chunks.iter().for_each(|chunk| self.sorted.extend_from_slice(&chunk.visible));
            self.sorter.sort(&mut self.sorted);
        });
        timed(&mut seconds.bin, || {
            self.bins.fill(motion.is_some(), &self.grid, &self.splats, &self.chunks, &self.sorted);
        });
        self.tiles.resize_with(self.grid.len(), TilePixels::default);
    }

    /// From the sums over pixels to the map and the poses.
    fn pull_back_slots(
        &mut self,
        map: &GaussianMap,
        view: &View<f32>,
        motion: Option<&MotionFrame>,
        map_gradient: Option<&mut MapGradient>,
    ) -> PoseSums {
        let footprints = Footprints {
            arch: self.arch,
            map,
            frame: Frame::new(map, view, &self.settings),
            splats: &self.splats,
            chunks: &self.chunks,
            bins: &self.bins,
            slots: &self.slots,
            moving: motion.map(|motion| (motion, self.motion_slots.as_slice())),
        };
        self.pose_sums.resize(self.chunks.len(), PoseSums::default());
        footprints.pull_back(map_gradient, &mut self.pose_sums);
        let mut sum = PoseSums::default();
        self.pose_sums.iter().for_each(|part| sum.add(part));
        sum
    }

    fn scene(&self) -> moving::Scene<'_> {
        moving::Scene {
            arch: self.arch,
            settings: &self.settings,
            grid: &self.grid,
            row_times: &self.row_times,
            splats: &self.splats,
            paths: &self.paths,
            bins: &self.bins,
        }
    }

    fn is_of_last_render(&self, map: &GaussianMap, view: &View<f32>) -> bool {
        map.len() == self.splats.len() && TileGrid::of(&view.camera) == self.grid
    }
}

const NOT_OF_LAST_RENDER: &str = "pull_back needs the map and the view of the last render";

impl RadianceMap for GaussianMap {
    type Settings = RasterSettings;
    type Renderer = Rasterizer;
    type Gradient = MapGradient;

    const RENDERS_MOTION: bool = true;

    fn renderer(settings: &RasterSettings) -> Rasterizer {
        Rasterizer::new(*settings)
    }

    fn render(&self, rasterizer: &mut Rasterizer, view: &View<f32>, out: &mut Render) {
        rasterizer.list(self, view, None, None, None);
        let Rasterizer { arch, settings, grid, splats, bins, tiles, seconds, .. } = rasterizer;
        timed(&mut seconds.blend, || {
            cpu_forward::render(*arch, settings, grid, splats, bins, tiles);
        });
        timed(&mut seconds.copy_out, || tile::copy_out(grid, tiles, None, out));
    }

    /// Sums are in `f64`, in a fixed order. Panics if a size is not that of the last render.
    fn pull_back(
        &self,
        rasterizer: &mut Rasterizer,
        view: &View<f32>,
        cotangent: &RenderCotangent,
        gradient: Option<&mut MapGradient>,
    ) -> Tangent<f64> {
        let still = rasterizer.paths.is_empty();
        assert!(rasterizer.is_of_last_render(self, view) && still, "{NOT_OF_LAST_RENDER}");
        let Rasterizer { arch, settings, grid, splats, bins, tiles, slots, .. } = rasterizer;
        let picture = cpu_backward::Picture {
            arch: *arch,
            settings,
            grid,
            splats,
            bins,
            tiles,
            cotangent: cotangent.planes(grid.width, grid.height),
            with_map: gradient.is_some() || !self.view_colours.is_empty(),
        };
        let mut seconds = rasterizer.seconds;
        slots.resize(bins.len(), TileSums::default());
        timed(&mut seconds.blend_back, || cpu_backward::pull_back(&picture, slots));
        let sums = timed(&mut seconds.project_back, || {
            rasterizer.pull_back_slots(self, view, None, gradient)
        });
        rasterizer.seconds = seconds;
        Tangent::from_array(sums.middle)
    }

    /// Gaussians are projected, sorted and listed once; only the blend repeats. Means are projected
    /// exactly at shutter open, mid-exposure and shutter close, and follow the parabola through
    /// these three (`project/path.rs`); covariance, depth and order are those at mid-exposure.
    /// Gaussians nearer than [`RasterSettings::near`] at any of the three are left out. At rest it
    /// shows what [`render`](Self::render) shows, up to rounding for several moments.
    fn render_moving(
        &self,
        rasterizer: &mut Rasterizer,
        view: &View<f32>,
        motion: &ShutterMotion,
        mask: Option<&[bool]>,
        still: Option<&Rasterizer>,
        out: &mut Render,
    ) {
        let tiles = TileGrid::of(&view.camera).len();
        assert!(mask.is_none_or(|mask| mask.len() == tiles), "one number per tile");
        assert!(still.is_none_or(|r| r.splats.len() == self.len()), "{NOT_OF_LAST_RENDER}");
        rasterizer.row_times = RowTimes::new(motion, view.camera.height);
        let frame = MotionFrame::new(view, motion, &rasterizer.settings);
        rasterizer.list(self, view, Some(&frame), mask, still.map(|r| r.chunks.as_slice()));
        let mut tiles = std::mem::take(&mut rasterizer.tiles);
        let mut states = std::mem::take(&mut rasterizer.states);
        let count = moving::moment_rows(&rasterizer.grid, &rasterizer.row_times);
        states.resize(count, MomentRow::default());
        moving::render(&rasterizer.scene(), mask, &mut tiles, &mut states);
        tile::copy_out(&rasterizer.grid, &tiles, mask, out);
        (rasterizer.tiles, rasterizer.states) = (tiles, states);
    }

    /// Differentiates [`render_moving`](Self::render_moving) exactly. Panics as
    /// [`pull_back`](Self::pull_back), and if the `motion` is another.
    fn pull_back_moving(
        &self,
        rasterizer: &mut Rasterizer,
        view: &View<f32>,
        motion: &ShutterMotion,
        cotangent: &RenderCotangent,
        gradient: Option<&mut MapGradient>,
    ) -> MotionGradient {
        let same_motion = rasterizer.row_times == RowTimes::new(motion, view.camera.height)
            && rasterizer.paths.len() == rasterizer.splats.len();
        let same = rasterizer.is_of_last_render(self, view) && same_motion;
        assert!(same, "{NOT_OF_LAST_RENDER}");
        let mut slots = std::mem::take(&mut rasterizer.slots);
        let mut motion_slots = std::mem::take(&mut rasterizer.motion_slots);
        slots.resize(rasterizer.bins.len(), TileSums::default());
        motion_slots.resize(rasterizer.bins.len(), MotionTileSums::default());
        let picture = moving::Picture {
            scene: rasterizer.scene(),
            tiles: &rasterizer.tiles,
            states: &rasterizer.states,
            cotangent: cotangent.planes(rasterizer.grid.width, rasterizer.grid.height),
            with_map: gradient.is_some() || !self.view_colours.is_empty(),
        };
        moving::pull_back(&picture, &mut slots, &mut motion_slots);
        (rasterizer.slots, rasterizer.motion_slots) = (slots, motion_slots);
        let frame = MotionFrame::new(view, motion, &rasterizer.settings);
        let sums = rasterizer.pull_back_slots(self, view, Some(&frame), gradient);
        let ends = sums.ends.map(Tangent::from_array);
        MotionGradient::new(&motion.cast(), Tangent::from_array(sums.middle), ends, sums.readout)
    }
}
