//! The fast lane, forward: one band of rows at a time.

use super::band::Band;
use super::landing::{between, land, search};
use super::surface::Surface;
use super::taps::RowTaps;
use super::texel::{Texel, add_scaled, mix};
use super::views::{View, Views};
use i2slam_geometry::Camera;
use pulp::{Simd, WithSimd};

/// What a band reads.
#[derive(Clone, Copy)]
pub(super) struct Scene<'a> {
    pub(super) camera: &'a Camera<f32>,
    pub(super) views: &'a Views<f32>,
    pub(super) surface: &'a Surface<f32>,
    pub(super) fine: &'a [Texel],
}

/// Blurs the rows of one band.
pub(super) struct BlurBand<'a> {
    pub(super) scene: &'a Scene<'a>,
    pub(super) band: &'a mut Band,
    /// (row, moving view, column), written for the way back [1/m].
    pub(super) inverse_depths: &'a mut [f32],
    /// The band's rows of the sharp render.
    pub(super) sharp: [&'a [f32]; 3],
    /// The band's rows of the blurred picture.
    pub(super) blurred: [&'a mut [f32]; 3],
}

impl WithSimd for BlurBand<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { scene, band, inverse_depths, sharp, blurred: [red, green, blue] } = self;
        let width = scene.camera.width;
        let rows = inverse_depths.chunks_exact_mut(scene.views.moving.len() * width);
        (band.fine_first, band.fine_last) = (u32::MAX, 0);
        for (i, row) in rows.enumerate() {
            let at = i * width..(i + 1) * width;
            start(scene.views.still_weight, sharp.map(|p| &p[at.clone()]), &mut band.texels);
            blur_row(scene, band, band.first_row + i, row);
            let (red, green, blue) = (&mut red[at.clone()], &mut green[at.clone()], &mut blue[at]);
            for (i, texel) in band.texels.iter().enumerate().take(width) {
                (red[i], green[i], blue[i]) = (texel[0], texel[1], texel[2]);
            }
        }
    }
}

#[inline(always)]
fn blur_row(scene: &Scene<'_>, band: &mut Band, y: usize, row: &mut [f32]) {
    let width = scene.camera.width;
    see_row(scene, y, row, &mut band.ends);
    for (view, row) in scene.views.moving.iter().zip(row.chunks_exact(width)) {
        let (first, last) = band.taps.fill(scene.camera, view, y as f32 + 0.5, row);
        band.fine_first = band.fine_first.min(first);
        band.fine_last = band.fine_last.max(last);
        gather(scene.fine, 2 * width, &band.taps, view.weight, &mut band.texels);
    }
}

#[inline(always)]
fn start(weight: f32, [red, green, blue]: [&[f32]; 3], texels: &mut [Texel]) {
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
    fine: &[Texel],
    stride: usize,
    index: usize,
) -> Option<([Texel; 2], [Texel; 2])> {
    let rows = fine.get(index..index + stride + 2)?;
    Some(([rows[0], rows[1]], [rows[stride], rows[stride + 1]]))
}

#[inline(always)]
fn gather(fine: &[Texel], stride: usize, taps: &RowTaps, weight: f32, texels: &mut [Texel]) {
    let n = texels.len();
    let (index, across, down) = (&taps.index[..n], &taps.across[..n], &taps.down[..n]);
    for (i, texel) in texels.iter_mut().enumerate() {
        let Some((top, bottom)) = corners(fine, stride, index[i] as usize) else { continue };
        let left = mix(top[0], bottom[0], down[i]);
        let right = mix(top[1], bottom[1], down[i]);
        *texel = add_scaled(*texel, mix(left, right, across[i]), weight);
    }
}
