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
            paths: Vec::new(),
            row_times: RowTimes::default(),
            states: Vec::new(),
            motion_slots: Vec::new(),
            seconds: StageSeconds::default(),
        }
    }

    /// A rasteriser on a chosen instruction set.
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

    /// Writes what `view` shows into `out`, whose allocation is reused.
    pub fn render(&mut self, map: &GaussianMap, view: &View<f32>, out: &mut Render) {
        self.list(map, view, None, None, None);
        let Self { arch, settings, grid, splats, bins, tiles, seconds, .. } = self;
        timed(&mut seconds.blend, || {
            cpu_forward::render(*arch, settings, grid, splats, bins, tiles);
        });
        timed(&mut seconds.copy_out, || tile::copy_out(grid, tiles, None, out));
    }

    /// Projects the map, or what `candidates` show, and lists the splats of each tile, or of the
    /// marked ones, in order of depth.
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

    /// Pulls `∂L/∂render` back through the last [`render`](Self::render), which must have been of
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
        assert!(
            self.is_of_last_render(map, view) && self.paths.is_empty(),
            "{}",
            NOT_OF_LAST_RENDER
        );
        let planes = cotangent.planes(self.grid.width, self.grid.height);
        self.slots.resize(self.bins.len(), TileSums::default());
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
        let mut seconds = self.seconds;
        timed(&mut seconds.blend_back, || cpu_backward::pull_back(&picture, &mut self.slots));
        let sums = timed(&mut seconds.project_back, || {
            self.pull_back_slots(map, view, None, map_gradient)
        });
        self.seconds = seconds;
        Tangent::from_array(sums.middle)
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

    fn is_of_last_render(&self, map: &GaussianMap, view: &View<f32>) -> bool {
        map.len() == self.splats.len() && TileGrid::of(&view.camera) == self.grid
    }
}

const NOT_OF_LAST_RENDER: &str = "pull_back needs the map and the view of the last render";

/// Rendering with a moving camera.
impl Rasterizer {
    /// Writes the average over `motion` of a camera at `view` at mid-exposure into `out`, whose
    /// allocation is reused: radiance, depth and opacity, weighted by moment.
    ///
    /// Gaussians are projected, sorted and listed once; only the blend repeats. Exact are the
    /// projections of the means at shutter open, at mid-exposure and at shutter close; in between
    /// and beyond, where rows of a rolling shutter are exposed earlier or later, a mean follows the
    /// parabola through these three (`project/path.rs`). The covariance of a footprint, its
    /// depth and the order of depths are those at mid-exposure. Gaussians that are nearer than
    /// [`RasterSettings::near`] at any of the three are left out.
    ///
    /// With zero velocity it shows what [`render`](Self::render) shows: exactly for one moment,
    /// up to rounding for several.
    ///
    /// `mask` marks tiles of [`TILE`](super::TILE) pixels, row by row, partial ones at the
    /// right and lower edge included; only marked tiles are drawn, the others are black. `None`
    /// draws all.
    ///
    /// With `visible_in`, only Gaussians that its last picture shows are projected; that must be of
    /// this map and cover the marked tiles.
    ///
    /// # Panics
    /// If `mask` has another size than the picture has tiles, or the picture of `visible_in` is of
    /// a map of another size.
    pub fn render_moving(
        &mut self,
        map: &GaussianMap,
        view: &View<f32>,
        motion: &ShutterMotion,
        mask: Option<&[bool]>,
        visible_in: Option<&Self>,
        out: &mut Render,
    ) {
        let tiles = TileGrid::of(&view.camera).len();
        assert!(mask.is_none_or(|mask| mask.len() == tiles), "one number per tile");
        assert!(visible_in.is_none_or(|r| r.splats.len() == map.len()), "{}", NOT_OF_LAST_RENDER);
        self.row_times = RowTimes::new(motion, view.camera.height);
        let frame = MotionFrame::new(view, motion, &self.settings);
        self.list(map, view, Some(&frame), mask, visible_in.map(|r| r.chunks.as_slice()));
        let count = moving::moment_rows(&self.grid, &self.row_times);
        self.states.resize(count, MomentRow::default());
        let scene = moving::Scene {
            arch: self.arch,
            settings: &self.settings,
            grid: &self.grid,
            row_times: &self.row_times,
            splats: &self.splats,
            paths: &self.paths,
            bins: &self.bins,
        };
        moving::render(&scene, mask, &mut self.tiles, &mut self.states);
        tile::copy_out(&self.grid, &self.tiles, mask, out);
    }

    /// Pulls `∂L/∂render` back through the last [`render_moving`](Self::render_moving), which must
    /// have been of this `map`, `view` and `motion`. Adds `∂L/∂map` to `map_gradient` when given;
    /// the approximations named there are differentiated exactly.
    ///
    /// # Panics
    /// If `map`, `view`, `motion` or `map_gradient` has not the size of the last render, or an
    /// image of the cotangent has data of another size.
    pub fn pull_back_moving(
        &mut self,
        map: &GaussianMap,
        view: &View<f32>,
        motion: &ShutterMotion,
        cotangent: &RenderCotangent,
        map_gradient: Option<&mut MapGradient>,
    ) -> MotionGradient {
        let same_motion = self.row_times == RowTimes::new(motion, view.camera.height)
            && self.paths.len() == self.splats.len();
        assert!(self.is_of_last_render(map, view) && same_motion, "{}", NOT_OF_LAST_RENDER);
        self.slots.resize(self.bins.len(), TileSums::default());
        self.motion_slots.resize(self.bins.len(), MotionTileSums::default());
        let scene = moving::Scene {
            arch: self.arch,
            settings: &self.settings,
            grid: &self.grid,
            row_times: &self.row_times,
            splats: &self.splats,
            paths: &self.paths,
            bins: &self.bins,
        };
        let picture = moving::Picture {
            scene,
            tiles: &self.tiles,
            states: &self.states,
            cotangent: cotangent.planes(self.grid.width, self.grid.height),
            with_map: map_gradient.is_some(),
        };
        moving::pull_back(&picture, &mut self.slots, &mut self.motion_slots);
        let frame = MotionFrame::new(view, motion, &self.settings);
        let sums = self.pull_back_slots(map, view, Some(&frame), map_gradient);
        let ends = sums.ends.map(Tangent::from_array);
        MotionGradient::new(&motion.cast(), Tangent::from_array(sums.middle), ends, sums.readout)
    }
}

impl Default for Rasterizer {
    fn default() -> Self {
        Self::new(RasterSettings::default())
    }
}

impl RadianceMap for GaussianMap {
    type Settings = RasterSettings;
    type Renderer = Rasterizer;
    type Gradient = MapGradient;

    const RENDERS_MOTION: bool = true;

    fn renderer(settings: &RasterSettings) -> Rasterizer {
        Rasterizer::new(*settings)
    }

    fn render(&self, rasterizer: &mut Rasterizer, view: &View<f32>, out: &mut Render) {
        rasterizer.render(self, view, out);
    }

    fn pull_back(
        &self,
        rasterizer: &mut Rasterizer,
        view: &View<f32>,
        cotangent: &RenderCotangent,
        gradient: Option<&mut MapGradient>,
    ) -> Tangent<f64> {
        rasterizer.pull_back(self, view, cotangent, gradient)
    }

    fn render_moving(
        &self,
        rasterizer: &mut Rasterizer,
        view: &View<f32>,
        motion: &ShutterMotion,
        tiles: &[bool],
        still: &Rasterizer,
        out: &mut Render,
    ) {
        rasterizer.render_moving(self, view, motion, Some(tiles), Some(still), out);
    }

    fn pull_back_moving(
        &self,
        rasterizer: &mut Rasterizer,
        view: &View<f32>,
        motion: &ShutterMotion,
        cotangent: &RenderCotangent,
        gradient: Option<&mut MapGradient>,
    ) -> MotionGradient {
        rasterizer.pull_back_moving(self, view, motion, cotangent, gradient)
    }
}
