//! Drawing on a square: coordinates in `[0, 1]`, `v` down.

use super::Texture;
use crate::rgb::{Rgb, mix};
use i2slam_compute::Random;
use rayon::prelude::*;

/// A square image being painted.
pub(crate) struct Canvas {
    size: usize,
    pixels: Vec<Rgb>,
}

impl Canvas {
    /// A canvas of `size` texels a side (a power of two) in one colour.
    pub(crate) fn new(size: usize, colour: Rgb) -> Self {
        Self { size, pixels: vec![colour; size * size] }
    }

    /// A canvas painted by a function of `(u, v)` at texel centres.
    pub(crate) fn painted(size: usize, colour: impl Fn(f32, f32) -> Rgb + Sync) -> Self {
        let centre = |i: usize| (i as f32 + 0.5) / size as f32;
        let rows = (0..size).into_par_iter().map(|row| {
            (0..size).map(|column| colour(centre(column), centre(row))).collect::<Vec<Rgb>>()
        });
        let rows: Vec<Vec<Rgb>> = rows.collect();
        Self { size, pixels: rows.concat() }
    }

    /// The finished picture.
    pub(crate) fn into_texture(self) -> Texture {
        Texture::new(self.size, self.pixels)
    }

    /// Blend over the texels whose centres lie in a rectangle; the function gets `(u, v)` and the
    /// present colour, and returns colour and opacity.
    pub(crate) fn blend(
        &mut self,
        low: [f32; 2],
        high: [f32; 2],
        brush: impl Fn(f32, f32, Rgb) -> (Rgb, f32),
    ) {
        let side = self.size as f32;
        let first = |x: f32| (x * side - 0.5).ceil().clamp(0.0, side) as usize;
        for row in first(low[1])..first(high[1]) {
            for column in first(low[0])..first(high[0]) {
                let (u, v) = ((column as f32 + 0.5) / side, (row as f32 + 0.5) / side);
                let pixel = &mut self.pixels[row * self.size + column];
                let (colour, opacity) = brush(u, v, *pixel);
                *pixel = mix(*pixel, colour, opacity);
            }
        }
    }

    /// A filled rectangle.
    pub(crate) fn rectangle(&mut self, low: [f32; 2], high: [f32; 2], colour: Rgb) {
        self.blend(low, high, |_, _, _| (colour, 1.0));
    }

    /// An outlined rectangle of a line of width `line`.
    pub(crate) fn outline(&mut self, low: [f32; 2], high: [f32; 2], line: f32, colour: Rgb) {
        self.blend(low, high, |u, v, _| {
            let inner = (u - low[0]).min(high[0] - u).min(v - low[1]).min(high[1] - v);
            (colour, if inner < line { 1.0 } else { 0.0 })
        });
    }

    /// A filled circle.
    pub(crate) fn disc(&mut self, centre: [f32; 2], radius: f32, colour: Rgb) {
        let (low, high) = (centre.map(|c| c - radius), centre.map(|c| c + radius));
        self.blend(low, high, |u, v, _| {
            let distance = (u - centre[0]).hypot(v - centre[1]);
            (colour, if distance < radius { 1.0 } else { 0.0 })
        });
    }

    /// Capital letters, digits and spaces; `height` of a letter, `stretch` is width over height
    /// of a cell as it shall look, corrected by the caller for surfaces that are not square.
    /// Returns where the line ends.
    pub(crate) fn text(
        &mut self,
        start: [f32; 2],
        height: f32,
        stretch: f32,
        words: &str,
        ink: Rgb,
    ) -> f32 {
        let dot = [height / 7.0 * stretch, height / 7.0];
        let mut x = start[0];
        for letter in words.chars() {
            for (row, bits) in glyph(letter).into_iter().enumerate() {
                for column in (0..5).filter(|c| bits >> (4 - c) & 1 == 1) {
                    let low = [x + column as f32 * dot[0], start[1] + row as f32 * dot[1]];
                    self.rectangle(low, [low[0] + dot[0], low[1] + dot[1]], ink);
                }
            }
            x += 6.0 * dot[0];
        }
        x
    }

    /// A column of lines of pseudo-words, between `low` and `high`.
    pub(crate) fn paragraph(
        &mut self,
        (low, high): ([f32; 2], [f32; 2]),
        height: f32,
        stretch: f32,
        ink: Rgb,
        random: &mut Random,
    ) {
        let mut y = low[1];
        while y + height <= high[1] {
            let mut x = low[0];
            let end = if random.below(5) == 0 { 0.6 } else { 1.0 };
            let limit = low[0] + (high[0] - low[0]) * end;
            loop {
                let word = invented_word(random);
                let width = word.len() as f32 * 6.0 / 7.0 * height * stretch;
                if x + width > limit {
                    break;
                }
                x = self.text([x, y], height, stretch, &word, ink) + height * stretch * 0.5;
            }
            y += 1.6 * height;
        }
    }
}

/// Two to four syllables, sometimes a number.
pub(crate) fn invented_word(random: &mut Random) -> String {
    if random.below(9) == 0 {
        return (10 + random.below(1990)).to_string();
    }
    const CONSONANTS: &[u8] = b"BCDFGHJKLMNPRSTVWXZ";
    const VOWELS: &[u8] = b"AEIOUY";
    let mut word = String::new();
    for _ in 0..1 + random.below(3) {
        word.push(CONSONANTS[random.below(CONSONANTS.len())] as char);
        word.push(VOWELS[random.below(VOWELS.len())] as char);
    }
    if random.below(2) == 0 {
        word.push(CONSONANTS[random.below(CONSONANTS.len())] as char);
    }
    word
}

const LETTERS: [[u8; 7]; 26] = [
    [0x0e, 0x11, 0x11, 0x1f, 0x11, 0x11, 0x11],
    [0x1e, 0x11, 0x11, 0x1e, 0x11, 0x11, 0x1e],
    [0x0e, 0x11, 0x10, 0x10, 0x10, 0x11, 0x0e],
    [0x1e, 0x11, 0x11, 0x11, 0x11, 0x11, 0x1e],
    [0x1f, 0x10, 0x10, 0x1e, 0x10, 0x10, 0x1f],
    [0x1f, 0x10, 0x10, 0x1e, 0x10, 0x10, 0x10],
    [0x0e, 0x11, 0x10, 0x17, 0x11, 0x11, 0x0f],
    [0x11, 0x11, 0x11, 0x1f, 0x11, 0x11, 0x11],
    [0x0e, 0x04, 0x04, 0x04, 0x04, 0x04, 0x0e],
    [0x07, 0x02, 0x02, 0x02, 0x02, 0x12, 0x0c],
    [0x11, 0x12, 0x14, 0x18, 0x14, 0x12, 0x11],
    [0x10, 0x10, 0x10, 0x10, 0x10, 0x10, 0x1f],
    [0x11, 0x1b, 0x15, 0x15, 0x11, 0x11, 0x11],
    [0x11, 0x19, 0x15, 0x13, 0x11, 0x11, 0x11],
    [0x0e, 0x11, 0x11, 0x11, 0x11, 0x11, 0x0e],
    [0x1e, 0x11, 0x11, 0x1e, 0x10, 0x10, 0x10],
    [0x0e, 0x11, 0x11, 0x11, 0x15, 0x12, 0x0d],
    [0x1e, 0x11, 0x11, 0x1e, 0x14, 0x12, 0x11],
    [0x0f, 0x10, 0x10, 0x0e, 0x01, 0x01, 0x1e],
    [0x1f, 0x04, 0x04, 0x04, 0x04, 0x04, 0x04],
    [0x11, 0x11, 0x11, 0x11, 0x11, 0x11, 0x0e],
    [0x11, 0x11, 0x11, 0x11, 0x11, 0x0a, 0x04],
    [0x11, 0x11, 0x11, 0x15, 0x15, 0x1b, 0x11],
    [0x11, 0x11, 0x0a, 0x04, 0x0a, 0x11, 0x11],
    [0x11, 0x11, 0x0a, 0x04, 0x04, 0x04, 0x04],
    [0x1f, 0x01, 0x02, 0x04, 0x08, 0x10, 0x1f],
];

const DIGITS: [[u8; 7]; 10] = [
    [0x0e, 0x11, 0x13, 0x15, 0x19, 0x11, 0x0e],
    [0x04, 0x0c, 0x04, 0x04, 0x04, 0x04, 0x0e],
    [0x0e, 0x11, 0x01, 0x06, 0x08, 0x10, 0x1f],
    [0x1f, 0x01, 0x02, 0x06, 0x01, 0x11, 0x0e],
    [0x02, 0x06, 0x0a, 0x12, 0x1f, 0x02, 0x02],
    [0x1f, 0x10, 0x1e, 0x01, 0x01, 0x11, 0x0e],
    [0x06, 0x08, 0x10, 0x1e, 0x11, 0x11, 0x0e],
    [0x1f, 0x01, 0x02, 0x04, 0x08, 0x08, 0x08],
    [0x0e, 0x11, 0x11, 0x0e, 0x11, 0x11, 0x0e],
    [0x0e, 0x11, 0x11, 0x0f, 0x01, 0x02, 0x0c],
];

/// The rows of a capital letter or digit, five bits each, the leftmost highest; others are blank.
pub(super) fn glyph(letter: char) -> [u8; 7] {
    match letter {
        'A'..='Z' => LETTERS[letter as usize - 'A' as usize],
        '0'..='9' => DIGITS[letter as usize - '0' as usize],
        _ => [0; 7],
    }
}
