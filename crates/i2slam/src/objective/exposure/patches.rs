//! Tiles whose blur one render cannot tell, because it hides what the motion uncovers: they are
//! drawn from the map at every moment.

use i2slam_formation::reproject;
use i2slam_geometry::Image;
use i2slam_radiance::RenderCotangent;
use i2slam_radiance::gaussian::TILE;
use std::ops::Range;

const _: () = assert!(TILE == reproject::TILE, "both divide the picture alike");

/// Uncovered share of a tile times its contrast from which a tile is drawn from the map.
///
/// On a map of a desk a blur of 4 to 10 px then wants 2 to 6 % of the tiles, and half of the energy
/// of the error is gone.
const WORTH: f32 = 0.033;

/// The tiles of one exposure that are drawn from the map, and their share of its cotangent.
pub(super) struct Patches {
    width: usize,
    height: usize,
    /// Tile by tile, row by row.
    wanted: Vec<bool>,
    /// Cotangent of the patches.
    pub(super) cotangent: RenderCotangent<f32>,
    /// Cotangent of what is not patched.
    pub(super) rest: Image<f32>,
}

impl Patches {
    pub(super) fn none() -> Self {
        let none = Image::default;
        let cotangent = RenderCotangent { radiance: none(), depth: none(), opacity: none() };
        Self { width: 0, height: 0, wanted: Vec::new(), cotangent, rest: none() }
    }

    /// The tiles that are drawn, if there are any.
    pub(super) fn wanted(&self) -> Option<&[bool]> {
        self.wanted.contains(&true).then_some(&self.wanted)
    }

    /// Chooses among the tiles of `blurred`, of which the re-projection left `uncovered` shares to
    /// guesses (none where it is empty). Guesses are wrong by about the contrast around, which is
    /// the standard deviation of a tile over its mean: exposure is no part of it.
    pub(super) fn choose(&mut self, uncovered: &[f32], blurred: &Image<f32>) {
        (self.width, self.height) = (blurred.width, blurred.height);
        self.wanted.clear();
        let columns = self.width.div_ceil(TILE).max(1);
        self.wanted.extend(uncovered.iter().enumerate().map(|(number, &share)| {
            share > 0.0 && share * contrast(blurred, number % columns, number / columns) > WORTH
        }));
    }

    /// Copies the patches of `drawn` into `blurred`.
    pub(super) fn paste(&self, drawn: &Image<f32>, blurred: &mut Image<f32>) {
        for part in self.parts() {
            blurred.data[part.clone()].copy_from_slice(&drawn.data[part]);
        }
    }

    /// Divides the cotangent of a patched picture.
    pub(super) fn divide(&mut self, d_blurred: &Image<f32>) {
        self.rest.clone_from(d_blurred);
        let mut patches = std::mem::take(&mut self.cotangent.radiance);
        patches.reset(d_blurred.width, d_blurred.height, d_blurred.channels);
        for part in self.parts() {
            patches.data[part.clone()].copy_from_slice(&d_blurred.data[part.clone()]);
            self.rest.data[part].fill(0.0);
        }
        self.cotangent.radiance = patches;
    }

    /// Every row of every patch, in each of three planes.
    fn parts(&self) -> Vec<Range<usize>> {
        let (width, height) = (self.width, self.height);
        let columns = width.div_ceil(TILE).max(1);
        let mut parts = Vec::new();
        for number in (0..self.wanted.len()).filter(|&number| self.wanted[number]) {
            let across = span(number % columns, width);
            for y in span(number / columns, height) {
                for start in (0..3).map(|plane| (plane * height + y) * width) {
                    parts.push(start + across.start..start + across.end);
                }
            }
        }
        parts
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
    fn what_is_uncovered_and_varies_is_wanted() {
        let mut patches = Patches::none();
        assert!(patches.wanted().is_none());
        patches.choose(&[0.0, 0.4, 0.001, 0.0, 0.0, 0.4], &picture());
        assert_eq!(patches.wanted(), Some(&[false, true, false, false, false, true][..]));
        let mut brighter = picture();
        brighter.data.iter_mut().for_each(|v| *v *= 50.0);
        let wanted = patches.wanted.clone();
        patches.choose(&[0.0, 0.4, 0.001, 0.0, 0.0, 0.4], &brighter);
        assert_eq!(patches.wanted, wanted);
        let flat = Image { data: vec![0.7; 2400], ..picture() };
        patches.choose(&[0.9; 6], &flat);
        assert!(patches.wanted().is_none());
        patches.choose(&[0.9; 6], &Image::new(40, 20, 3));
        assert!(patches.wanted().is_none());
        patches.choose(&[], &picture());
        assert!(patches.wanted().is_none());
    }

    /// Every number goes one way, and patches are where their tiles are.
    #[test]
    fn cotangents_are_divided_as_pictures_are_pasted() {
        let mut patches = Patches::none();
        patches.choose(&[0.0, 0.4, 0.0, 0.0, 0.0, 0.4], &picture());
        let d = Image { data: (1..2401).map(|i| i as f32).collect(), ..picture() };
        patches.divide(&d);
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
