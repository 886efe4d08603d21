//! The fast lane, backward: the transpose of every tap, and what the positions want.

use super::band::Band;
use super::forward::{Scene, corners};
use super::landing::amplification;
use super::texel::{Texel, add_scaled, dot, minus, mix, scaled};
use super::upsample::{neighbours, pull_back_row};
use super::views::View;
use pulp::{Simd, WithSimd};

/// Lanes of the sums over a row.
const LANES: usize = 16;

/// Pulls the band's rows of `d_blurred` back to the band's own cotangents: of the sharp render
/// (`d_sharp`, `sharp_rows`) and of every moving view (`sums`).
pub(super) struct PullBackBand<'a> {
    pub(super) scene: &'a Scene<'a>,
    pub(super) band: &'a mut Band,
    /// As [`BlurBand`](super::forward::BlurBand) left them.
    pub(super) inverse_depths: &'a [f32],
    pub(super) d_blurred: [&'a [f32]; 3],
    pub(super) kernel: &'a [f32; 4],
}

impl WithSimd for PullBackBand<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { scene, band, inverse_depths, d_blurred, kernel } = self;
        let width = scene.camera.width;
        let moving = &scene.views.moving;
        band.sums.clear();
        band.sums.resize(moving.len(), [0.0; 6]);
        let fine_rows = (band.fine_last + 2).saturating_sub(band.fine_first) as usize;
        band.d_fine.clear();
        band.d_fine.resize(fine_rows * 2 * width, [0.0; 4]);
        for (i, row) in inverse_depths.chunks_exact(moving.len() * width).enumerate() {
            let y = band.first_row + i;
            let at = i * width..(i + 1) * width;
            interleave(d_blurred.map(|plane| &plane[at.clone()]), &mut band.texels);
            slopes(scene, y, &mut band.ends);
            for (k, (view, row)) in moving.iter().zip(row.chunks_exact(width)).enumerate() {
                band.taps.fill(scene.camera, view, y as f32 + 0.5, row);
                scatter(scene.fine, 2 * width, view.weight, band);
                let sum = sum_row(scene, view, band, row);
                band.sums[k].iter_mut().zip(sum).for_each(|(total, s)| *total += s);
            }
        }
        pull_back_fine(scene, band, kernel);
    }
}

#[inline(always)]
fn interleave([red, green, blue]: [&[f32]; 3], texels: &mut [Texel]) {
    let n = texels.len();
    let (red, green, blue) = (&red[..n], &green[..n], &blue[..n]);
    for (i, texel) in texels.iter_mut().enumerate() {
        *texel = [red[i], green[i], blue[i], 0.0];
    }
}

/// Slopes of the surface along row `y`; zero where the landing was searched.
#[inline(always)]
fn slopes(scene: &Scene<'_>, y: usize, slopes: &mut [Vec<f32>; 2]) {
    let [slope_x, slope_y] = slopes;
    for (x, facet) in scene.surface.facets(y).iter().enumerate() {
        let smooth = scene.surface.blocks.searched(x, y).is_none();
        slope_x[x] = if smooth { facet.slope_x } else { 0.0 };
        slope_y[x] = if smooth { facet.slope_y } else { 0.0 };
    }
}

/// Adds one row of one view to `d_fine` and writes `d_position`.
#[inline(always)]
fn scatter(fine: &[Texel], stride: usize, weight: f32, band: &mut Band) {
    let n = band.texels.len();
    let offset = band.fine_first as usize * stride;
    let taps = &band.taps;
    let (index, across, down) = (&taps.index[..n], &taps.across[..n], &taps.down[..n]);
    let [d_x, d_y] = &mut band.d_position;
    let (d_x, d_y) = (&mut d_x[..n], &mut d_y[..n]);
    for i in 0..n {
        let k = index[i] as usize;
        let Some((top, bottom)) = corners(fine, stride, k) else { continue };
        let d = scaled(band.texels[i], weight);
        let by_x = mix(minus(top[1], top[0]), minus(bottom[1], bottom[0]), down[i]);
        let by_y = mix(minus(bottom[0], top[0]), minus(bottom[1], top[1]), across[i]);
        d_x[i] = dot(d, by_x);
        d_y[i] = dot(d, by_y);
        let lower = scaled(d, down[i]);
        let upper = minus(d, lower);
        let Some(rows) = band.d_fine.get_mut(k - offset..k - offset + stride + 2) else { continue };
        let (right, lower_right) = (scaled(upper, across[i]), scaled(lower, across[i]));
        rows[0] = add_scaled(rows[0], minus(upper, right), 1.0);
        rows[1] = add_scaled(rows[1], right, 1.0);
        rows[stride] = add_scaled(rows[stride], minus(lower, lower_right), 1.0);
        rows[stride + 1] = add_scaled(rows[stride + 1], lower_right, 1.0);
    }
}

/// What the sums over a row read, by column.
struct Row<'a> {
    a: &'a [f32],
    b: &'a [f32],
    d: [&'a [f32]; 2],
    free: [&'a [f32]; 2],
    slope: [&'a [f32]; 2],
    inverse_depth: &'a [f32],
}

impl Row<'_> {
    #[inline(always)]
    fn share(&self, scene: &Scene<'_>, view: &View<f32>, i: usize) -> [f32; 6] {
        let direction = (self.a[i], self.b[i]);
        let line = view.line(scene.camera, direction);
        let [slope_x, slope_y] = [self.slope[0][i], self.slope[1][i]];
        let (gx, gy) = (self.d[0][i] * self.free[0][i], self.d[1][i] * self.free[1][i]);
        let along =
            (gx * line.ex + gy * line.ey) * amplification(slope_x, slope_y, line.ex, line.ey);
        let gx = (gx + slope_x * along) * scene.camera.fx;
        let gy = (gy + slope_y * along) * scene.camera.fy;
        view.share(direction, self.inverse_depth[i], gx, gy)
    }
}

/// The six sums of one row of one view.
#[inline(always)]
fn sum_row(scene: &Scene<'_>, view: &View<f32>, band: &Band, inverse_depths: &[f32]) -> [f64; 6] {
    let n = inverse_depths.len();
    let row = Row {
        a: &band.taps.a[..n],
        b: &band.taps.b[..n],
        d: [&band.d_position[0][..n], &band.d_position[1][..n]],
        free: [&band.taps.free_x[..n], &band.taps.free_y[..n]],
        slope: [&band.ends[0][..n], &band.ends[1][..n]],
        inverse_depth: inverse_depths,
    };
    let mut lanes = [[0.0_f32; LANES]; 6];
    let full = n - n % LANES;
    for start in (0..full).step_by(LANES) {
        for lane in 0..LANES {
            let share = row.share(scene, view, start + lane);
            for k in 0..6 {
                lanes[k][lane] += share[k];
            }
        }
    }
    for i in full..n {
        let share = row.share(scene, view, i);
        for k in 0..6 {
            lanes[k][i - full] += share[k];
        }
    }
    lanes.map(|lanes| lanes.iter().map(|&v| f64::from(v)).sum())
}

/// From `d_fine` to `d_sharp`.
#[inline(always)]
fn pull_back_fine(scene: &Scene<'_>, band: &mut Band, kernel: &[f32; 4]) {
    let (width, height) = (scene.camera.width, scene.camera.height);
    let (first, last) = (band.fine_first as usize, band.fine_last as usize + 1);
    let rows = (neighbours(first / 2, height)[0], neighbours(last / 2, height)[3] + 1);
    band.sharp_rows = rows;
    let plane = (rows.1 - rows.0) * width;
    band.d_sharp.clear();
    band.d_sharp.resize(3 * plane, 0.0);
    for (y, d_row) in (first..).zip(band.d_fine.chunks_exact(2 * width)) {
        let (red, rest) = band.d_sharp.split_at_mut(plane);
        let (green, blue) = rest.split_at_mut(plane);
        let planes = [red, green, blue];
        pull_back_row(d_row, y, height, kernel, &mut band.planar_row, rows.0, planes);
    }
}
