//! Walls and hard things: plaster, brick, wallpaper, glaze.

use super::{Canvas, Texture};
use crate::rgb::{Rgb, mix, scale};
use crate::rng::{fractal, lattice};

/// Painted plaster: faint stains, roller marks, fine grain.
pub(crate) fn plaster(base: Rgb, seed: u32) -> Texture {
    let painted = Canvas::painted(1024, |u, v| {
        let stains = fractal(u, v, [3, 3], 4, seed) - 0.5;
        let fine = fractal(u, v, [96, 96], 3, seed + 30) - 0.5;
        let marks = fractal(u, v, [40, 6], 2, seed + 60) - 0.5;
        let speck = if fractal(u, v, [150, 150], 1, seed + 80) > 0.965 { -0.16 } else { 0.0 };
        scale(base, 1.0 + 0.22 * stains + 0.20 * fine + 0.08 * marks + speck)
    });
    painted.into_texture()
}

/// Bricks in running bond, ten courses to a side.
pub(crate) fn brick(base: Rgb, mortar: Rgb, seed: u32) -> Texture {
    let painted = Canvas::painted(1024, |u, v| {
        let course = (v * 10.0).floor();
        let along = u * 4.0 + 0.5 * (course as i32 % 2) as f32;
        let (column, x, y) =
            ((along.floor() as i32).rem_euclid(4), along.fract(), (v * 10.0).fract());
        let rough = 0.05 * (fractal(u, v, [60, 60], 2, seed + 9) - 0.5);
        let edge = (x.min(1.0 - x) * 2.5).min(y.min(1.0 - y)) + rough;
        let tone = lattice(column, course as i32, seed);
        let fired = mix(
            scale(base, 0.65 + 0.6 * tone),
            [base[0] * 0.8; 3],
            0.3 * lattice(column, course as i32, seed + 1),
        );
        let pores = 0.75 + 0.5 * fractal(u, v, [50, 50], 3, seed + 2);
        mix(
            scale(mortar, 0.8 + 0.4 * fractal(u, v, [80, 80], 2, seed + 4)),
            scale(fired, pores),
            ((edge - 0.06) * 25.0).clamp(0.0, 1.0),
        )
    });
    painted.into_texture()
}

/// Stripes with a leaf-like motif.
pub(crate) fn wallpaper(base: Rgb, accent: Rgb, seed: u32) -> Texture {
    let painted = Canvas::painted(512, |u, v| {
        let stripe = (u * 6.0).fract();
        let ground = mix(base, accent, if stripe < 0.5 { 0.18 } else { 0.0 });
        let (x, y) = (
            (u * 6.0).fract() - 0.25,
            (v * 4.0 + 0.5 * ((u * 6.0).floor() as i32 % 2) as f32).fract() - 0.5,
        );
        let leaf = (x.abs() - 0.16 * (1.0 - 4.0 * y * y) * (0.6 + 0.4 * (y * 40.0).cos())) < 0.0;
        let vein = (x + 0.5 * y * y - 0.05).abs() < 0.012;
        let ink = if leaf && !vein { 0.75 } else { 0.0 };
        let paper = 0.94 + 0.12 * fractal(u, v, [64, 64], 2, seed);
        scale(mix(ground, accent, ink), paper)
    });
    painted.into_texture()
}

/// Glaze with clouds of a second colour and fine specks.
pub(crate) fn ceramic(base: Rgb, cloud: Rgb, seed: u32) -> Texture {
    let painted = Canvas::painted(512, |u, v| {
        let clouds = ((fractal(u, v, [5, 5], 4, seed) - 0.42) * 5.0).clamp(0.0, 1.0);
        let speck = if fractal(u, v, [70, 70], 2, seed + 5) > 0.72 { 0.55 } else { 1.0 };
        scale(mix(base, cloud, clouds), speck)
    });
    painted.into_texture()
}

/// One colour with faint unevenness: paint, plastic, metal.
pub(crate) fn plain(seed: u32) -> Texture {
    let painted = Canvas::painted(256, |u, v| [0.86 + 0.14 * fractal(u, v, [8, 8], 4, seed); 3]);
    painted.into_texture()
}
