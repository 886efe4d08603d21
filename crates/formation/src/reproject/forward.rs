//! The fast lane, forward: one band of rows at a time.

use super::band::Band;
use super::landing::{between, land, search};
use super::surface::Surface;
use super::taps::RowTaps;
use super::upsample::Texel;
use super::views::{View, Views};
use i2slam_geometry::Camera;

/// What a band reads.
#[derive(Clone, Copy)]
pub(super) struct Scene<'a> {
    pub(super) camera: &'a Camera<f32>,
    pub(super) views: &'a Views<f32>,
    pub(super) surface: &'a Surface<f32>,
    pub(super) fine: &'a [Texel<f32>],
}

/// Blurs the rows of one band. `inverse_depths` (row, moving view, column) is written for the
/// way back; `planes` hold the band's rows of the sharp render and of the blurred picture.
#[inline(always)]
pub(super) fn blur_band(
    scene: &Scene<'_>,
    band: &mut Band,
    inverse_depths: &mut [f32],
    sharp: [&[f32]; 3],
    blurred: [&mut [f32]; 3],
) {
    let width = scene.camera.width;
    let [red, green, blue] = blurred;
    (band.fine_first, band.fine_last) = (u32::MAX, 0);
    for (i, row) in inverse_depths.chunks_exact_mut(scene.views.moving.len() * width).enumerate() {
        let y = band.first_row + i;
        let at = i * width..(i + 1) * width;
        start(scene.views.still_weight, sharp.map(|plane| &plane[at.clone()]), &mut band.texels);
        see_row(scene, y, row, &mut band.ends);
        for (view, row) in scene.views.moving.iter().zip(row.chunks_exact(width)) {
            let (first, last) = band.taps.fill(scene.camera, view, y as f32 + 0.5, row);
            band.fine_first = band.fine_first.min(first);
            band.fine_last = band.fine_last.max(last);
            gather(scene.fine, 2 * width, &band.taps, view.weight, &mut band.texels);
        }
        let (red, green, blue) = (&mut red[at.clone()], &mut green[at.clone()], &mut blue[at]);
        for (i, texel) in band.texels.iter().enumerate().take(width) {
            (red[i], green[i], blue[i]) = (texel[0], texel[1], texel[2]);
        }
    }
}

#[inline(always)]
fn start(weight: f32, [red, green, blue]: [&[f32]; 3], texels: &mut [Texel<f32>]) {
    let n = texels.len();
    let (red, green, blue) = (&red[..n], &green[..n], &blue[..n]);
    for (i, texel) in texels.iter_mut().enumerate() {
        *texel = [weight * red[i], weight * green[i], weight * blue[i], 0.0];
    }
}

/// The inverse depth that every moving view sees at every pixel of row `y`.
#[inline(always)]
fn see_row(scene: &Scene<'_>, y: usize, row: &mut [f32], ends: &mut [Vec<f32>; 2]) {
    let moving = &scene.views.moving;
    let (Some(first), Some(last)) = (moving.first(), moving.last()) else { return };
    let width = scene.camera.width;
    let own = scene.surface.row(y);
    for (view, end) in [first, last].into_iter().zip(ends.iter_mut()) {
        for (x, end) in end.iter_mut().enumerate().take(width) {
            let line = line(scene, view, x, y);
            *end = land(scene.surface, &line, own[x]);
        }
    }
    let (at_first, at_last) = (&ends[0][..width], &ends[1][..width]);
    for (view, row) in moving.iter().zip(row.chunks_exact_mut(width)) {
        for x in 0..width {
            row[x] = between(at_first[x], own[x], at_last[x], view.moment);
        }
        for x in 0..width {
            if let Some(bounds) = scene.surface.blocks.searched(x, y) {
                let line = line(scene, view, x, y);
                row[x] = search(scene.surface, &line, bounds, own[x]);
            }
        }
    }
}

#[inline(always)]
fn line(scene: &Scene<'_>, view: &View<f32>, x: usize, y: usize) -> super::views::Line<f32> {
    view.line(scene.camera, view.direction(x as f32 + 0.5, y as f32 + 0.5))
}

/// The four texels of a tap as two rows of two.
#[inline(always)]
pub(super) fn corners(
    fine: &[Texel<f32>],
    stride: usize,
    index: usize,
) -> Option<(&[Texel<f32>; 2], &[Texel<f32>; 2])> {
    let top = fine.get(index..)?.first_chunk()?;
    let bottom = fine.get(index + stride..)?.first_chunk()?;
    Some((top, bottom))
}

#[inline(always)]
fn gather(
    fine: &[Texel<f32>],
    stride: usize,
    taps: &RowTaps,
    weight: f32,
    texels: &mut [Texel<f32>],
) {
    let n = texels.len();
    let (index, across, down) = (&taps.index[..n], &taps.across[..n], &taps.down[..n]);
    for (i, texel) in texels.iter_mut().enumerate() {
        let Some((top, bottom)) = corners(fine, stride, index[i] as usize) else { continue };
        let right = weight * across[i];
        let left = weight - right;
        for c in 0..4 {
            let a = top[0][c] + down[i] * (bottom[0][c] - top[0][c]);
            let b = top[1][c] + down[i] * (bottom[1][c] - top[1][c]);
            texel[c] += left * a + right * b;
        }
    }
}
