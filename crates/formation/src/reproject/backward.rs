//! The fast lane, backward: the transpose of every tap, and the gradient of its position.

use super::band::{Band, LaneSums, Scene};
use super::ray_surface::amplification;
use super::sampling::{Corners, LANES, Lines, Taps, Texel, read_chunk, scatter};
use super::upsample::{TAPS, neighbours, pull_back_row};
use super::views::View;
use i2slam_compute::simd::Column;
use pulp::{Simd, WithSimd};

/// Pulls the band's rows of `d_blurred` back to the band's own cotangents: of the sharp render
/// (`d_sharp`, `sharp_rows`) and of every moving view (`sums`).
pub(super) struct PullBackBand<'a> {
    pub(super) scene: &'a Scene,
    /// The sharp render at twice its resolution.
    pub(super) fine: &'a [Texel],
    pub(super) band: &'a mut Band,
    /// As [`BlurBand`](super::forward::BlurBand) left them.
    pub(super) inverse_depths: &'a [Column],
    pub(super) d_blurred: [&'a [f32]; 3],
}

impl WithSimd for PullBackBand<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { scene, fine, band, inverse_depths, d_blurred } = self;
        let width = scene.picture_camera().width;
        let rows = d_blurred[0].len() / width;
        let count = scene.views.count();
        band.start_pull_back(count, scene.views.sums(0, rows).1, scene.camera.width);
        let mut chunks = inverse_depths.chunks_exact(count);
        for row in 0..rows {
            let y = band.first_row + row + scene.margin;
            for (x, depths) in (0..width).step_by(LANES).zip(&mut chunks) {
                let at = row * width + x..row * width + width.min(x + LANES);
                let d_planes = d_blurred.map(|plane| &plane[at.clone()]);
                if d_planes.iter().all(|plane| plane.iter().all(|d| *d == 0.0)) {
                    continue;
                }
                let d = read_chunk(&d_planes, 1.0);
                pull_back_chunk((scene, fine), band, (x + scene.margin, y), &d, depths);
            }
            band.end_row(scene.views.sums(row, rows).0);
        }
        pull_back_fine(scene, band);
    }
}

#[inline(always)]
fn pull_back_chunk(
    (scene, fine): (&Scene, &[Texel]),
    band: &mut Band,
    (x, y): (usize, usize),
    d: &[Texel; LANES],
    depths: &[Column],
) {
    let slopes = slopes(scene, x, y);
    let stride = 2 * scene.camera.width;
    let offset = band.fine_first as usize * stride;
    for (k, (view, w)) in scene.views.row(y).iter().zip(depths).enumerate() {
        let lines = Lines::new(&scene.camera, view, x, y);
        let taps = Taps::new(&scene.camera, &lines, w);
        let (mut d_x, mut d_y) = ([0.0; LANES], [0.0; LANES]);
        for i in 0..LANES {
            let index = taps.index[i] as usize;
            let Some(corners) = Corners::at(fine, index, stride) else { break };
            let d = d[i] * view.weight;
            let (by_x, by_y) = corners.slopes(taps.across[i], taps.down[i]);
            (d_x[i], d_y[i]) = d.dots(by_x, by_y);
            scatter(&mut band.d_fine, index - offset, stride, d, (taps.across[i], taps.down[i]));
        }
        for i in 0..LANES {
            d_x[i] *= taps.free_x[i];
            d_y[i] *= taps.free_y[i];
        }
        add_shares(scene, view, &lines, w, &slopes, [d_x, d_y], &mut band.lane_sums[k]);
    }
}

/// Slopes of the surface from column `x` on in row `y`; zero where the depth was searched.
#[inline(always)]
fn slopes(scene: &Scene, x: usize, y: usize) -> [Column; 2] {
    let mut slopes = [[0.0; LANES]; 2];
    for (i, facet) in scene.surface.facets(y)[x..].iter().enumerate().take(LANES) {
        let smooth = scene.surface.blocks.search_bounds(x + i, y).is_none();
        slopes[0][i] = if smooth { facet.slope_x } else { 0.0 };
        slopes[1][i] = if smooth { facet.slope_y } else { 0.0 };
    }
    slopes
}

/// Adds the chunk's shares of one view's six sums, from the cotangent of the positions [per px].
#[inline(always)]
fn add_shares(
    scene: &Scene,
    view: &View<f32>,
    lines: &Lines,
    w: &Column,
    [slope_x, slope_y]: &[Column; 2],
    [d_x, d_y]: [Column; 2],
    sums: &mut LaneSums,
) {
    let mut total = *sums;
    for i in 0..LANES {
        let along = (d_x[i] * lines.ex[i] + d_y[i] * lines.ey[i])
            * amplification(slope_x[i], slope_y[i], lines.ex[i], lines.ey[i]);
        let gx = (d_x[i] + slope_x[i] * along) * scene.camera.fx;
        let gy = (d_y[i] + slope_y[i] * along) * scene.camera.fy;
        let share = view.share((lines.a[i], lines.b[i]), w[i], gx, gy);
        for k in 0..6 {
            total[k][i] += share[k];
        }
    }
    *sums = total;
}

/// From `d_fine` to `d_sharp`.
#[inline(always)]
fn pull_back_fine(scene: &Scene, band: &mut Band) {
    let (width, height) = (scene.camera.width, scene.camera.height);
    let (first, last) = (band.fine_first as usize, band.fine_last as usize + 1);
    let rows = (neighbours(first / 2, height)[0], neighbours(last / 2, height)[TAPS - 1] + 1);
    band.sharp_rows = rows;
    let plane = (rows.1 - rows.0) * width;
    band.d_sharp.clear();
    band.d_sharp.resize(3 * plane, 0.0);
    for (y, d_row) in (first..).zip(band.d_fine.chunks_exact(2 * width)) {
        let (red, rest) = band.d_sharp.split_at_mut(plane);
        let (green, blue) = rest.split_at_mut(plane);
        let planes = [red, green, blue];
        pull_back_row(d_row, y, height, &mut band.planar_row, rows.0, planes);
    }
}
