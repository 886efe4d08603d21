//! The projection of all Gaussians on all threads.

use super::reference::{Footprint, FootprintCotangent, Projector};
use crate::gaussian::bin::{Bins, TILE, TileGrid};
use crate::gaussian::gradient::GradientRows;
use crate::gaussian::rasterize::Slot;
use crate::gaussian::{Gaussian, GaussianMap, MapGradient, RasterSettings, View, sort};
use i2slam_geometry::Tangent;
use rayon::prelude::*;

/// Gaussians that are projected, and whose gradients are summed, together. Fixed, so that sums
/// do not depend on the number of threads.
pub(crate) const CHUNK: usize = 256;

/// A footprint, ready for rasterising: one cache line.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(64))]
pub(crate) struct Splat {
    /// Centre [px].
    pub(crate) centre: [f32; 2],
    /// `[a, b, c]` of `log₂ α = log2_opacity + a dx² + b dx dy + c dy²`, all of `[px⁻²]`.
    pub(crate) exponent: [f32; 3],
    /// `log₂` of the opacity.
    pub(crate) log2_opacity: f32,
    /// Linear radiance.
    pub(crate) radiance: [f32; 3],
    /// Depth of the mean [m].
    pub(crate) depth: f32,
    /// Half the width and height of the extent [px].
    pub(crate) extent: [f32; 2],
    /// Half the height of the extent at the column of the centre [px].
    pub(crate) height_at_centre: f32,
    /// Tiles that the extent's box touches: first column, first row, end column, end row.
    pub(crate) tiles: [u16; 4],
    /// Position of the first of this splat's tiles among those of its chunk.
    pub(crate) first_tile: u32,
}

impl Splat {
    /// Number of tiles that the extent's box touches.
    pub(crate) fn tile_count(&self) -> u32 {
        let [x0, y0, x1, y1] = self.tiles.map(u32::from);
        (x1 - x0) * (y1 - y0)
    }
}

/// What a chunk of Gaussians adds to the picture.
#[derive(Default)]
pub(crate) struct Chunk {
    /// Sort items of the Gaussians that touch a tile.
    pub(crate) visible: Vec<u64>,
    /// Number of tiles they touch.
    pub(crate) tile_count: u32,
}

/// Project the map. Splats are written at the index of their Gaussian, those of Gaussians that
/// touch no tile have none in `tiles`.
pub(crate) fn project(
    map: &GaussianMap,
    view: &View<f32>,
    settings: &RasterSettings,
    splats: &mut Vec<Splat>,
    chunks: &mut Vec<Chunk>,
) {
    let grid = TileGrid::of(&view.camera);
    let projector = Projector::new(map, view, settings);
    splats.resize(map.len(), Splat::default());
    chunks.resize_with(map.len().div_ceil(CHUNK), Chunk::default);
    let work = splats.par_chunks_mut(CHUNK).zip(chunks.par_iter_mut()).enumerate();
    work.for_each(|(number, (splats, chunk))| {
        chunk.visible.clear();
        chunk.tile_count = 0;
        for (i, splat) in splats.iter_mut().enumerate() {
            let index = number * CHUNK + i;
            let footprint = map.get(index).and_then(|g| projector.project(index, &g));
            *splat = footprint.map(|f| splat_of(&f, settings, &grid)).unwrap_or_default();
            splat.first_tile = chunk.tile_count;
            if splat.tile_count() > 0 {
                chunk.tile_count += splat.tile_count();
                chunk.visible.push(sort::item(splat.depth, index as u32));
            }
        }
    });
}

fn splat_of(f: &Footprint<f32>, settings: &RasterSettings, grid: &TileGrid) -> Splat {
    use std::f32::consts::{LN_2, LOG2_E};
    let [a, b, c] = f.conic;
    let log2_opacity = f.opacity.log2();
    // dᵀ Σ₂⁻¹ d <= reach² and the covariance's diagonal bound the extent.
    let reach2 = 2.0 * LN_2 * (log2_opacity - settings.alpha_min.log2());
    let determinant = a * c - b * b;
    let half = |variance: f32| (reach2 * variance).sqrt() * 1.001 + 0.01;
    let extent = [half(c / determinant), half(a / determinant)];
    let height_at_centre = half(c.recip());
    Splat {
        centre: f.centre,
        exponent: [-0.5 * LOG2_E * a, -LOG2_E * b, -0.5 * LOG2_E * c],
        log2_opacity,
        radiance: f.radiance,
        depth: f.depth,
        extent,
        height_at_centre,
        tiles: tiles(f.centre, extent, grid),
        first_tile: 0,
    }
}

/// The tiles that hold a pixel centre within the box `centre ± extent`.
fn tiles(centre: [f32; 2], extent: [f32; 2], grid: &TileGrid) -> [u16; 4] {
    let span = |axis: usize, pixels: usize| {
        let limit = |v: f32| v.clamp(0.0, pixels as f32) as usize;
        let first = limit((centre[axis] - extent[axis] - 0.5).ceil());
        let end = limit((centre[axis] + extent[axis] - 0.5).floor() + 1.0);
        if first < end { [first / TILE, end.div_ceil(TILE)] } else { [0, 0] }
    };
    let ([x0, x1], [y0, y1]) = (span(0, grid.width), span(1, grid.height));
    [x0, y0, x1, y1].map(|v| v as u16)
}

/// The splats of the last render with the sums over their pixels.
pub(crate) struct Footprints<'a> {
    pub(crate) splats: &'a [Splat],
    pub(crate) bins: &'a Bins,
    pub(crate) slots: &'a [Slot],
}

impl Footprints<'_> {
    /// Pull the sums back to the map and, one sum per chunk, to the pose.
    ///
    /// # Panics
    /// If `map_gradient` is not of the map's size.
    pub(crate) fn pull_back(
        &self,
        map: &GaussianMap,
        view: &View<f32>,
        settings: &RasterSettings,
        map_gradient: Option<&mut MapGradient>,
        pose_sums: &mut [[f64; 6]],
    ) {
        let projector = Projector::new(map, view, settings);
        let rows = map_gradient.map(|gradient| {
            assert_eq!(gradient.len(), map.len(), "gradient and map differ in size");
            gradient.rows()
        });
        self.split_chunks(map, &projector, 0, rows, pose_sums);
    }

    /// Chunks from `first` on, whose rows and sums these are, halved until one is left.
    fn split_chunks(
        &self,
        map: &GaussianMap,
        projector: &Projector<f32>,
        first: usize,
        rows: Option<GradientRows<'_, f32>>,
        pose_sums: &mut [[f64; 6]],
    ) {
        match pose_sums {
            [] => {}
            [sum] => *sum = self.pull_back_chunk(map, projector, first, rows),
            _ => {
                let middle = pose_sums.len() / 2;
                let (left_sums, right_sums) = pose_sums.split_at_mut(middle);
                let (left, right) = rows.map(|rows| rows.split_at(middle * CHUNK)).unzip();
                rayon::join(
                    || self.split_chunks(map, projector, first, left, left_sums),
                    || self.split_chunks(map, projector, first + middle, right, right_sums),
                );
            }
        }
    }

    fn pull_back_chunk(
        &self,
        map: &GaussianMap,
        projector: &Projector<f32>,
        chunk: usize,
        mut rows: Option<GradientRows<'_, f32>>,
    ) -> [f64; 6] {
        let mut pose = [0.0; 6];
        let start = chunk * CHUNK;
        for index in start..(start + CHUNK).min(map.len()) {
            let splat = &self.splats[index];
            if splat.tile_count() == 0 {
                continue;
            }
            let mut sum = Slot::default();
            self.bins.places_of(index, splat).for_each(|place| sum.add(&self.slots[place]));
            let Some(gaussian) = map.get(index) else { continue };
            let Some((g, tangent)) = pull_back_one(projector, index, &gaussian, &sum) else {
                continue;
            };
            tangent.to_array().iter().zip(&mut pose).for_each(|(t, p)| *p += f64::from(*t));
            if let Some(rows) = &mut rows {
                rows.add(index - start, &g, sum.weight > 0.0);
            }
        }
        pose
    }
}

fn pull_back_one(
    projector: &Projector<f32>,
    index: usize,
    gaussian: &Gaussian<f32>,
    sum: &Slot,
) -> Option<(Gaussian<f32>, Tangent<f32>)> {
    let footprint = projector.project(index, gaussian)?;
    let [a, b, c] = footprint.conic;
    let [x, y] = sum.first;
    let [xx, xy, yy] = sum.second;
    let cotangent = FootprintCotangent {
        centre: [a * x + b * y, b * x + c * y],
        conic: [-0.5 * xx, -xy, -0.5 * yy],
        opacity: sum.zeroth / footprint.opacity,
        radiance: sum.radiance,
        depth: sum.depth,
    };
    projector.pull_back(gaussian, &footprint, &cotangent)
}
