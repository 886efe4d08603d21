//! Pictures on surfaces: painted once, read at the resolution of a pixel's footprint.

mod canvas;
mod materials;
mod paper;

use crate::rgb::{Rgb, decode, encode, plus, scale};
pub(crate) use canvas::Canvas;
pub(crate) use materials::{
    brick, ceramic, curtain, door, outside, plain, planks, plaster, rug, timber, upholstery,
    wallpaper, woven,
};
pub(crate) use paper::{
    abstract_painting, calendar, carton, landscape_painting, screen, spine, text_sheet,
};

/// A square picture, periodic, with all reductions by two. Values are kept as sRGB codes.
pub(crate) struct Texture {
    /// Side of level 0 [texel], a power of two.
    pub(crate) size: usize,
    /// The mean colour.
    pub(crate) mean: Rgb,
    levels: Vec<Vec<[u8; 4]>>,
}

impl Texture {
    /// From linear values, row by row.
    pub(crate) fn new(size: usize, pixels: Vec<Rgb>) -> Self {
        debug_assert!(size.is_power_of_two() && pixels.len() == size * size);
        let mut levels = vec![pixels.iter().map(|&p| pack(p)).collect()];
        let (mut side, mut pixels) = (size, pixels);
        while side > 1 {
            pixels = halved(&pixels, side);
            side /= 2;
            levels.push(pixels.iter().map(|&p| pack(p)).collect());
        }
        Self { size, mean: pixels[0], levels }
    }

    /// A texture of `size` texels a side, painted by a function of `(u, v)` at texel centres.
    pub(crate) fn painted(size: usize, colour: impl Fn(f32, f32) -> Rgb + Sync) -> Self {
        Canvas::painted(size, colour).into_texture()
    }

    /// The colour at `(u, v)`, `v` down, period 1, of the given level (0 is the finest).
    #[inline]
    pub(crate) fn sample(&self, decoder: &Decoder, u: f32, v: f32, level: i32) -> Rgb {
        let level = (level.max(0) as usize).min(self.levels.len() - 1);
        let (side, pixels) = (self.size >> level, &self.levels[level]);
        let (x, y) = (u * side as f32 - 0.5, v * side as f32 - 0.5);
        let (x0, y0) = (floor(x), floor(y));
        let (du, dv) = (x - x0 as f32, y - y0 as f32);
        let mask = side as i32 - 1;
        let (i0, j0) = (x0 & mask, y0 & mask);
        let (i1, j1) = ((i0 + 1) & mask, (j0 + 1) & mask);
        let at = |i: i32, j: i32| pixels[(j as usize) * side + i as usize];
        let (a, b, c, d) = (at(i0, j0), at(i1, j0), at(i0, j1), at(i1, j1));
        let weights = [(1.0 - du) * (1.0 - dv), du * (1.0 - dv), (1.0 - du) * dv, du * dv];
        std::array::from_fn(|k| {
            weights[0] * decoder.0[a[k] as usize]
                + weights[1] * decoder.0[b[k] as usize]
                + weights[2] * decoder.0[c[k] as usize]
                + weights[3] * decoder.0[d[k] as usize]
        })
    }
}

/// The integer below, without a call on machines that have no instruction for it.
#[inline]
fn floor(x: f32) -> i32 {
    let cut = x as i32;
    cut - i32::from(x < cut as f32)
}

/// The linear value of every sRGB code.
pub(crate) struct Decoder([f32; 256]);

impl Decoder {
    pub(crate) fn new() -> Self {
        Self(std::array::from_fn(|code| decode(code as f32 / 255.0)))
    }
}

fn pack(colour: Rgb) -> [u8; 4] {
    let code = |v: f32| (encode(v.clamp(0.0, 1.0)) * 255.0).round() as u8;
    [code(colour[0]), code(colour[1]), code(colour[2]), 255]
}

fn halved(pixels: &[Rgb], side: usize) -> Vec<Rgb> {
    let half = side / 2;
    (0..half * half)
        .map(|i| {
            let at =
                |dx: usize, dy: usize| pixels[(2 * (i / half) + dy) * side + 2 * (i % half) + dx];
            scale(plus(plus(at(0, 0), at(1, 0)), plus(at(0, 1), at(1, 1))), 0.25)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_level_keeps_the_mean() {
        let mut canvas = Canvas::new(64, [0.2, 0.4, 0.6]);
        canvas.rectangle([0.0, 0.0], [0.5, 0.25], [0.8, 0.8, 0.1]);
        let texture = canvas.into_texture();
        let decoder = Decoder::new();
        for level in 0..7 {
            let side = 64 >> level;
            let mut sum = [0.0; 3];
            for j in 0..side {
                for i in 0..side {
                    let centre = |k: i32| (k as f32 + 0.5) / side as f32;
                    sum = plus(sum, texture.sample(&decoder, centre(i), centre(j), level));
                }
            }
            for k in 0..3 {
                let mean = sum[k] / (side * side) as f32;
                assert!((mean - texture.mean[k]).abs() < 0.004, "{level} {mean}");
            }
        }
    }

    #[test]
    fn samples_repeat_and_lie_at_texel_centres() {
        let mut canvas = Canvas::new(8, [0.0; 3]);
        canvas.rectangle([0.25, 0.5], [0.375, 0.625], [1.0; 3]);
        let texture = canvas.into_texture();
        let decoder = Decoder::new();
        let at = |u: f32, v: f32| texture.sample(&decoder, u, v, 0)[0];
        assert!((at(2.5 / 8.0, 4.5 / 8.0) - 1.0).abs() < 1e-6);
        assert!((at(2.5 / 8.0 - 1.0, 4.5 / 8.0 + 2.0) - 1.0).abs() < 1e-5);
        assert!((at(3.0 / 8.0, 4.5 / 8.0) - 0.5).abs() < 1e-5);
        assert!(at(4.5 / 8.0, 4.5 / 8.0) < 1e-6);
    }
}
