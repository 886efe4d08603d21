//! Tiles whose blur cannot be re-projected from one render, because the motion uncovers what that
//! hides: they are rendered from the map with its motion.

use i2slam_formation::reproject;
use i2slam_geometry::Image;
use i2slam_radiance::RenderCotangent;
use i2slam_radiance::gaussian::TILE;
use std::ops::Range;

const _: () = assert!(TILE == reproject::TILE, "both divide the picture alike");

/// Uncovered share of a tile times its contrast from which the tile is rendered. On a map of a
/// desk, at a blur of 4 to 10 px, this selects 2 to 6 % of the tiles and removes half of the
/// squared error.
const MIN_UNCOVERED_CONTRAST: f32 = 0.033;

/// The rendered tiles of one exposure, and their share of its cotangent.
#[derive(Default)]
pub(super) struct Patches {
    width: usize,
    height: usize,
    /// Whether each tile is rendered, row by row.
    mask: Vec<bool>,
    /// Cotangent of the rendered tiles.
    pub(super) cotangent: RenderCotangent<f32>,
    /// Cotangent of the other tiles.
    pub(super) rest: Image<f32>,
}

impl Patches {
    /// The rendered tiles, if there are any.
    pub(super) fn tile_mask(&self) -> Option<&[bool]> {
        self.mask.contains(&true).then_some(&self.mask)
    }

    /// Selects among the tiles of `blurred`, of each of which the re-projection filled the share
    /// `uncovered` from the surroundings (nothing where that is empty). The filling is wrong by
    /// about the contrast of the tile, its standard deviation over its mean.
    pub(super) fn select(&mut self, uncovered: &[f32], blurred: &Image<f32>) {
        (self.width, self.height) = (blurred.width, blurred.height);
        self.mask.clear();
        let columns = self.width.div_ceil(TILE).max(1);
        self.mask.extend(uncovered.iter().enumerate().map(|(number, &share)| {
            share > 0.0
                && share * contrast(blurred, number % columns, number / columns)
                    > MIN_UNCOVERED_CONTRAST
        }));
    }

    /// Copies the selected tiles of `rendered` into `blurred`.
    pub(super) fn paste(&self, rendered: &Image<f32>, blurred: &mut Image<f32>) {
        for range in self.row_ranges() {
            blurred.data[range.clone()].copy_from_slice(&rendered.data[range]);
        }
    }

    /// Splits the cotangent of a patched picture into [`cotangent`](Self::cotangent) and
    /// [`rest`](Self::rest).
    pub(super) fn split(&mut self, d_blurred: &Image<f32>) {
        self.rest.clone_from(d_blurred);
        let mut patches = std::mem::take(&mut self.cotangent.radiance);
        patches.reset(d_blurred.width, d_blurred.height, d_blurred.channels);
        for range in self.row_ranges() {
            patches.data[range.clone()].copy_from_slice(&d_blurred.data[range.clone()]);
            self.rest.data[range].fill(0.0);
        }
        self.cotangent.radiance = patches;
    }

    /// Index ranges of all rows of the selected tiles, in each of three planes.
    fn row_ranges(&self) -> Vec<Range<usize>> {
        let (width, height) = (self.width, self.height);
        let columns = width.div_ceil(TILE).max(1);
        let mut ranges = Vec::new();
        for number in (0..self.mask.len()).filter(|&number| self.mask[number]) {
            let across = span(number % columns, width);
            for y in span(number / columns, height) {
                for start in (0..3).map(|plane| (plane * height + y) * width) {
                    ranges.push(start + across.start..start + across.end);
                }
            }
        }
        ranges
    }
}

/// The pixels of a row or column of tiles, along one axis.
fn span(tile: usize, size: usize) -> Range<usize> {
    tile * TILE..((tile + 1) * TILE).min(size)
}

/// Standard deviation over mean of the brightness of a tile's pixels; 0 where it is black.
fn contrast(picture: &Image<f32>, column: usize, row: usize) -> f32 {
    let planes = [0, 1, 2].map(|c| picture.plane(c));
    let (mut count, mut sum, mut squares) = (0.0, 0.0, 0.0);
    for y in span(row, picture.height) {
        for x in span(column, picture.width) {
            let value: f32 = planes.iter().map(|plane| plane[y * picture.width + x]).sum();
            (count, sum, squares) = (count + 1.0, sum + value, squares + value * value);
        }
    }
    let mean = sum / count;
    if mean > 0.0 { (squares / count - mean * mean).max(0.0).sqrt() / mean } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two tiles in a row and a rest of a third, two rows; bright in the first column of each tile.
    fn picture() -> Image<f32> {
        let mut picture = Image::new(40, 20, 3);
        for (i, value) in picture.data.iter_mut().enumerate() {
            *value = if i % 40 % TILE == 0 { 3.0 } else { 0.1 + 1e-4 * i as f32 };
        }
        picture
    }

    #[test]
    fn uncovered_tiles_with_contrast_are_selected() {
        let mut patches = Patches::default();
        assert!(patches.tile_mask().is_none());
        patches.select(&[0.0, 0.4, 0.001, 0.0, 0.0, 0.4], &picture());
        assert_eq!(patches.tile_mask(), Some(&[false, true, false, false, false, true][..]));
        let mut brighter = picture();
        brighter.data.iter_mut().for_each(|v| *v *= 50.0);
        let mask = patches.mask.clone();
        patches.select(&[0.0, 0.4, 0.001, 0.0, 0.0, 0.4], &brighter);
        assert_eq!(patches.mask, mask);
        let flat = Image { data: vec![0.7; 2400], ..picture() };
        patches.select(&[0.9; 6], &flat);
        assert!(patches.tile_mask().is_none());
        patches.select(&[0.9; 6], &Image::new(40, 20, 3));
        assert!(patches.tile_mask().is_none());
        patches.select(&[], &picture());
        assert!(patches.tile_mask().is_none());
    }

    /// Every value goes to exactly one of the two ranges.
    #[test]
    fn cotangents_are_split_as_pictures_are_pasted() {
        let mut patches = Patches::default();
        patches.select(&[0.0, 0.4, 0.0, 0.0, 0.0, 0.4], &picture());
        let d = Image { data: (1..2401).map(|i| i as f32).collect(), ..picture() };
        patches.split(&d);
        let mut pasted = Image::new(40, 20, 3);
        patches.paste(&d, &mut pasted);
        assert_eq!(pasted.data, patches.cotangent.radiance.data);
        for i in 0..2400 {
            let (x, y) = (i % 40, i / 40 % 20);
            let patched = (16..32).contains(&x) && y < 16 || x >= 32 && y >= 16;
            let (here, there) = (pasted.data[i], patches.rest.data[i]);
            assert_eq!((here, there), if patched { (d.data[i], 0.0) } else { (0.0, d.data[i]) });
        }
    }
}
