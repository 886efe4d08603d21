//! The fast lane, backward: the transpose of every tap, and what the positions want.

use super::band::Band;
use super::forward::{Scene, corners};
use super::landing::amplification;
use super::upsample::{Texel, neighbours, pull_back_row};
use super::views::View;

/// Lanes of the sums over a row.
const LANES: usize = 16;

/// Pulls the band's rows of `d_blurred` (three planes) back to the band's own cotangents: of the
/// sharp render (`d_sharp`, `sharp_rows`) and of every moving view (`sums`).
#[inline(always)]
pub(super) fn pull_back_band(
    scene: &Scene<'_>,
    band: &mut Band,
    inverse_depths: &[f32],
    d_blurred: [&[f32]; 3],
    kernel: &[f32; 4],
) {
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

#[inline(always)]
fn interleave([red, green, blue]: [&[f32]; 3], texels: &mut [Texel<f32>]) {
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
fn scatter(fine: &[Texel<f32>], stride: usize, weight: f32, band: &mut Band) {
    let n = band.texels.len();
    let offset = band.fine_first as usize * stride;
    let taps = &band.taps;
    let (index, across, down) = (&taps.index[..n], &taps.across[..n], &taps.down[..n]);
    let [d_x, d_y] = &mut band.d_position;
    let (d_x, d_y) = (&mut d_x[..n], &mut d_y[..n]);
    for i in 0..n {
        let k = index[i] as usize;
        let Some((top, bottom)) = corners(fine, stride, k) else { continue };
        let (mut by_x, mut by_y) = ([0.0; 4], [0.0; 4]);
        let d = band.texels[i].map(|d| weight * d);
        for c in 0..4 {
            let (right, left) = (top[1][c] - top[0][c], bottom[1][c] - bottom[0][c]);
            by_x[c] = d[c] * (right + down[i] * (left - right));
            let (near, far) = (bottom[0][c] - top[0][c], bottom[1][c] - top[1][c]);
            by_y[c] = d[c] * (near + across[i] * (far - near));
        }
        d_x[i] = (by_x[0] + by_x[1]) + by_x[2];
        d_y[i] = (by_y[0] + by_y[1]) + by_y[2];
        let local = k - offset;
        let lower = across[i] * down[i];
        add(&mut band.d_fine, local, &d, [1.0 - across[i] - down[i] + lower, across[i] - lower]);
        add(&mut band.d_fine, local + stride, &d, [down[i] - lower, lower]);
    }
}

#[inline(always)]
fn add(d_fine: &mut [Texel<f32>], index: usize, d: &Texel<f32>, weights: [f32; 2]) {
    let Some(pair) = d_fine.get_mut(index..).and_then(|rest| rest.first_chunk_mut::<2>()) else {
        return;
    };
    for c in 0..4 {
        pair[0][c] += weights[0] * d[c];
        pair[1][c] += weights[1] * d[c];
    }
}

/// The six sums of one row of one view.
#[inline(always)]
fn sum_row(scene: &Scene<'_>, view: &View<f32>, band: &Band, inverse_depths: &[f32]) -> [f64; 6] {
    let n = inverse_depths.len();
    let taps = &band.taps;
    let (a, b) = (&taps.a[..n], &taps.b[..n]);
    let (free_x, free_y) = (&taps.free_x[..n], &taps.free_y[..n]);
    let (d_x, d_y) = (&band.d_position[0][..n], &band.d_position[1][..n]);
    let (slope_x, slope_y) = (&band.ends[0][..n], &band.ends[1][..n]);
    let share = |i: usize| {
        let line = view.line(scene.camera, (a[i], b[i]));
        let (gx, gy) = (d_x[i] * free_x[i], d_y[i] * free_y[i]);
        let along =
            (gx * line.ex + gy * line.ey) * amplification(slope_x[i], slope_y[i], line.ex, line.ey);
        let (gx, gy) = (gx + slope_x[i] * along, gy + slope_y[i] * along);
        let (gx, gy) = (gx * scene.camera.fx, gy * scene.camera.fy);
        view.share((a[i], b[i]), inverse_depths[i], gx, gy)
    };
    let mut lanes = [[0.0_f32; LANES]; 6];
    let full = n - n % LANES;
    for start in (0..full).step_by(LANES) {
        for lane in 0..LANES {
            let share = share(start + lane);
            for k in 0..6 {
                lanes[k][lane] += share[k];
            }
        }
    }
    for i in full..n {
        let share = share(i);
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
