//! The fast lane, forward: one band of rows at a time, sixteen pixels of a row at a time.

use super::TILE;
use super::band::{Band, Scene};
use super::ray_surface::{DepthEdges, interpolate_in_time, intersect_lanes};
use super::sampling::{Corners, LANES, Lines, Taps, Texel, read_chunk};
use i2slam_compute::simd::Column;
use pulp::{Simd, WithSimd};

/// Blurs the rows of one band.
pub(super) struct BlurBand<'a> {
    pub(super) scene: &'a Scene,
    /// The sharp render at twice its resolution.
    pub(super) fine: &'a [Texel],
    pub(super) band: &'a mut Band,
    /// (row, chunk, moving view), written for the backward pass [1/m].
    pub(super) inverse_depths: &'a mut [Column],
    /// Of the band's tiles, row by row.
    pub(super) uncovered: &'a mut [f32],
    /// The rows of the sharp render that the band blurs.
    pub(super) sharp: [&'a [f32]; 3],
    /// The band's rows of the blurred picture.
    pub(super) blurred: [&'a mut [f32]; 3],
}

impl WithSimd for BlurBand<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { scene, fine, band, inverse_depths, uncovered, sharp, mut blurred } = self;
        let (width, margin) = (scene.picture_camera().width, scene.margin);
        let still = scene.views.still_weight;
        (band.fine_first, band.fine_last) = (u32::MAX, 0);
        uncovered.fill(0.0);
        let mut chunks = inverse_depths.chunks_exact_mut(scene.views.count());
        for row in 0..blurred[0].len() / width {
            let y = band.first_row + row + margin;
            let tiles = &mut uncovered[row / TILE * width.div_ceil(TILE)..];
            let columns = (0..width).step_by(LANES).zip(tiles);
            for ((x, uncovered), depths) in columns.zip(&mut chunks) {
                let lanes = LANES.min(width - x);
                let at = row * width + x..row * width + x + lanes;
                let from = row * scene.camera.width + margin + x;
                let mut sum = read_chunk(&sharp.map(|plane| &plane[from..from + lanes]), still);
                *uncovered += find_inverse_depths(scene, x + margin, y, lanes, depths);
                let rows = blur_chunk((scene, fine), (x + margin, y), depths, &mut sum);
                band.fine_first = band.fine_first.min(rows.0);
                band.fine_last = band.fine_last.max(rows.1);
                let [red, green, blue] = &mut blurred;
                let planes = red[at.clone()].iter_mut().zip(&mut green[at.clone()]);
                for (((red, green), blue), texel) in planes.zip(&mut blue[at]).zip(&sum) {
                    [*red, *green, *blue] = texel.xyz();
                }
            }
        }
    }
}

/// Adds what the moving views see to `sum`; returns the first and last fine row touched.
#[inline(always)]
fn blur_chunk(
    (scene, fine): (&Scene, &[Texel]),
    (x, y): (usize, usize),
    depths: &[Column],
    sum: &mut [Texel; LANES],
) -> (u32, u32) {
    let stride = 2 * scene.camera.width;
    let (mut first, mut last) = (u32::MAX, 0);
    for (view, w) in scene.views.row(y).iter().zip(depths) {
        let taps = Taps::new(&scene.camera, &Lines::new(&scene.camera, view, x, y), w);
        for i in 0..LANES {
            let index = taps.index[i] as usize;
            let Some(corners) = Corners::at(fine, index, stride) else { break };
            sum[i] += corners.interpolate(taps.across[i], taps.down[i]) * view.weight;
        }
        let rows = taps.rows();
        (first, last) = (first.min(rows.0), last.max(rows.1));
    }
    (first, last)
}

/// Lands the first and the last view and lays a parabola in time through both and the middle.
#[inline(always)]
fn interpolate_inverse_depths(
    scene: &Scene,
    (x, y): (usize, usize),
    own: &Column,
    depths: &mut [Column],
) {
    let moving = scene.views.row(y);
    let (Some(first), Some(last)) = (moving.first(), moving.last()) else { return };
    let first = intersect_lanes(scene, &Lines::new(&scene.camera, first, x, y), own);
    let last = intersect_lanes(scene, &Lines::new(&scene.camera, last, x, y), own);
    for (view, depths) in moving.iter().zip(depths.iter_mut()) {
        for i in 0..LANES {
            depths[i] = interpolate_in_time(first[i], own[i], last[i], view.moment);
        }
    }
}

/// The inverse depths that every moving view sees from column `x` of the render on in its row
/// `y`; returns the share of a tile's exposure that the render hides from the chunk's first `lanes`.
#[inline(always)]
fn find_inverse_depths(
    scene: &Scene,
    x: usize,
    y: usize,
    lanes: usize,
    depths: &mut [Column],
) -> f32 {
    let moving = scene.views.row(y);
    let row = scene.surface.row(y);
    let own: Column = match row.get(x..).and_then(|rest| rest.first_chunk()) {
        Some(lanes) => *lanes,
        None => std::array::from_fn(|i| row[(x + i).min(row.len() - 1)]),
    };
    if scene.views.rolling {
        for (view, depths) in moving.iter().zip(depths.iter_mut()) {
            let lines = Lines::new(&scene.camera, view, x, y);
            *depths = intersect_lanes(scene, &lines, &intersect_lanes(scene, &lines, &own));
        }
    } else {
        interpolate_inverse_depths(scene, (x, y), &own, depths);
    }
    let steps = DepthEdges::around(scene, x, y);
    let mut uncovered = 0.0;
    if steps.any {
        for (view, depths) in moving.iter().zip(depths.iter_mut()) {
            let Some(shown) = steps.shown(view.steep) else { continue };
            let lines = Lines::new(&scene.camera, view, x, y);
            let hidden = shown.search(scene, &lines, &own, depths);
            let count = hidden[..lanes].iter().filter(|hidden| **hidden).count();
            uncovered += view.weight * count as f32;
        }
    }
    uncovered / (TILE * TILE) as f32
}
