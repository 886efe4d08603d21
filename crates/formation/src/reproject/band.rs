//! The fixed partition of an image into bands of rows, and what each band keeps.

use super::taps::RowTaps;
use super::texel::Texel;

/// Rows of the picture per band.
pub(super) const BAND: usize = 32;

/// Scratch of one band; it keeps its allocation from call to call.
#[derive(Clone, Debug, Default)]
pub(super) struct Band {
    /// First row of the picture.
    pub(super) first_row: usize,
    /// Fine rows that its taps' upper samples lie in, first and last.
    pub(super) fine_first: u32,
    pub(super) fine_last: u32,
    pub(super) taps: RowTaps,
    /// One row: colours forward, their cotangents backward.
    pub(super) texels: Vec<Texel>,
    /// One row: inverse depths at both ends of the exposure; slopes backward.
    pub(super) ends: [Vec<f32>; 2],
    /// One row: cotangent of the position [per px].
    pub(super) d_position: [Vec<f32>; 2],
    /// Three rows, one per plane.
    pub(super) planar_row: Vec<f32>,
    /// Cotangent of the fine rows, and of the image rows that they come from.
    pub(super) d_fine: Vec<Texel>,
    pub(super) d_sharp: Vec<f32>,
    /// The rows of the image in `d_sharp`, first and one past the last.
    pub(super) sharp_rows: (usize, usize),
    /// Six sums for each moving view.
    pub(super) sums: Vec<[f64; 6]>,
}

/// Lays `bands` over an image.
pub(super) fn lay(bands: &mut Vec<Band>, width: usize, height: usize) {
    bands.resize_with(height.div_ceil(BAND), Band::default);
    for (i, band) in bands.iter_mut().enumerate() {
        band.first_row = i * BAND;
        band.taps.resize(width);
        band.texels.resize(width, [0.0; 4]);
        for row in band.ends.iter_mut().chain(&mut band.d_position) {
            row.resize(width, 0.0);
        }
        band.planar_row.resize(3 * width, 0.0);
    }
}
