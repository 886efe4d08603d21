//! Materials: wood, plaster, brick, ceramics, cloth, and the view through a window.

use super::{Canvas, Texture};
use crate::rgb::{Rgb, mix, scale, srgb};
use crate::rng::{fractal, lattice, value_noise};

/// Brightness of grain along `u`, near 1.
fn grain(u: f32, v: f32, seed: u32) -> f32 {
    let bend = 0.05 * fractal(u, v, [3, 4], 2, seed + 7);
    let fibres = fractal(u, v + bend, [3, 48], 3, seed);
    let rings = ((v + bend) * 9.0 + 1.3 * value_noise(u * 2.0, v * 5.0, [2, 5], seed + 3)) % 1.0;
    0.78 + 0.32 * fibres + 0.10 * (rings - 0.5)
}

/// Floor boards, eight to a side and running along `u`.
pub(crate) fn planks(base: Rgb, seed: u32) -> Texture {
    const ROWS: f32 = 8.0;
    Texture::painted(1024, |u, v| {
        let row = (v * ROWS).floor();
        let shift = lattice(row as i32, 1, seed);
        let along = (u + shift).rem_euclid(1.0) * 2.0;
        let board = along.floor();
        let tone = lattice(row as i32 * 2 + board as i32, 2, seed);
        let across = (v * ROWS).fract();
        let edge =
            (across.min(1.0 - across) / ROWS).min(along.fract().min(1.0 - along.fract()) / 2.0);
        let gap = (edge * 500.0).clamp(0.0, 1.0);
        let colour = mix(scale(base, 0.66 + 0.6 * tone), [base[1]; 3], 0.25 * (1.0 - tone));
        let knots = fractal(u, v, [6, 12], 3, seed + 20);
        let wear = if knots > 0.72 { 0.75 } else { 1.0 };
        scale(colour, grain(u + tone, v + 0.3 * tone, seed) * (0.30 + 0.70 * gap) * wear)
    })
}

/// Furniture boards with grain along `u`.
pub(crate) fn timber(base: Rgb, seed: u32) -> Texture {
    Texture::painted(512, |u, v| scale(base, grain(u, v, seed)))
}

/// A door with four sunk panels and a frame.
pub(crate) fn door(base: Rgb, seed: u32) -> Texture {
    let mut canvas = Canvas::painted(512, |u, v| scale(base, 0.85 + 0.15 * grain(v, u, seed)));
    for (low, high) in [
        ([0.12, 0.06], [0.46, 0.42]),
        ([0.54, 0.06], [0.88, 0.42]),
        ([0.12, 0.52], [0.46, 0.93]),
        ([0.54, 0.52], [0.88, 0.93]),
    ] {
        canvas.blend(low, high, |u, v, colour| {
            let (left, right) = ((u - low[0]) * 2.0, (high[0] - u) * 2.0);
            let (top, bottom) = (v - low[1], high[1] - v);
            let edge = left.min(right).min(top).min(bottom);
            let dark = if edge == top || edge == left { 0.55 } else { 1.12 };
            (scale(colour, if edge < 0.025 { dark } else { 0.95 }), 1.0)
        });
    }
    canvas.into_texture()
}

/// Painted plaster: faint stains, roller marks, fine grain.
pub(crate) fn plaster(base: Rgb, seed: u32) -> Texture {
    Texture::painted(1024, |u, v| {
        let stains = fractal(u, v, [3, 3], 4, seed) - 0.5;
        let fine = fractal(u, v, [96, 96], 3, seed + 30) - 0.5;
        let marks = fractal(u, v, [40, 6], 2, seed + 60) - 0.5;
        let speck = if fractal(u, v, [150, 150], 1, seed + 80) > 0.965 { -0.16 } else { 0.0 };
        scale(base, 1.0 + 0.22 * stains + 0.20 * fine + 0.08 * marks + speck)
    })
}

/// Bricks in running bond, ten courses to a side.
pub(crate) fn brick(base: Rgb, mortar: Rgb, seed: u32) -> Texture {
    Texture::painted(1024, |u, v| {
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
    })
}

/// Stripes with a leaf-like motif.
pub(crate) fn wallpaper(base: Rgb, accent: Rgb, seed: u32) -> Texture {
    Texture::painted(512, |u, v| {
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
    })
}

/// Glaze with clouds of a second colour and fine specks.
pub(crate) fn ceramic(base: Rgb, cloud: Rgb, seed: u32) -> Texture {
    Texture::painted(512, |u, v| {
        let clouds = ((fractal(u, v, [5, 5], 4, seed) - 0.42) * 5.0).clamp(0.0, 1.0);
        let speck = if fractal(u, v, [70, 70], 2, seed + 5) > 0.72 { 0.55 } else { 1.0 };
        scale(mix(base, cloud, clouds), speck)
    })
}

/// One colour with faint unevenness: paint, plastic, metal.
pub(crate) fn plain(seed: u32) -> Texture {
    Texture::painted(256, |u, v| [0.86 + 0.14 * fractal(u, v, [8, 8], 4, seed); 3])
}

/// A plain weave of `threads` threads a side, brightness near 1.
fn weave(u: f32, v: f32, threads: f32, seed: u32) -> f32 {
    let (x, y) = (u * threads, v * threads);
    let over = (x.floor() as i32 + y.floor() as i32) % 2 == 0;
    let across = if over { x.fract() } else { y.fract() };
    let thread = lattice(x.floor() as i32, y.floor() as i32, seed);
    0.62 + 0.42 * (std::f32::consts::PI * across).sin() + 0.28 * (thread - 0.5)
}

/// Sofa cloth with coarse threads of two colours.
pub(crate) fn upholstery(base: Rgb, seed: u32) -> Texture {
    Texture::painted(512, |u, v| {
        let patch = 0.85 + 0.3 * fractal(u, v, [4, 4], 4, seed);
        let pale = 0.35 * lattice((u * 64.0) as i32, (v * 64.0) as i32, seed + 4);
        scale(mix(base, [0.5; 3], pale * 0.5), weave(u, v, 64.0, seed) * patch)
    })
}

/// A checked cloth: cushions, blankets.
pub(crate) fn woven(base: Rgb, accent: Rgb, seed: u32) -> Texture {
    Texture::painted(512, |u, v| {
        let band = |x: f32| ((x * 5.0).fract() < 0.4) as u8 + ((x * 5.0).fract() > 0.85) as u8;
        let share = 0.45 * f32::from(band(u) + band(v));
        scale(mix(base, accent, share.min(1.0)), weave(u, v, 96.0, seed))
    })
}

/// A rug: border bands and a field of diamonds.
pub(crate) fn rug(colours: [Rgb; 3], seed: u32) -> Texture {
    Texture::painted(1024, |u, v| {
        let edge = u.min(1.0 - u).min(v.min(1.0 - v));
        let (x, y) = ((u * 9.0).fract() - 0.5, (v * 9.0).fract() - 0.5);
        let diamond = x.abs() + y.abs();
        let field = match diamond {
            d if d < 0.14 => colours[2],
            d if d < 0.24 => colours[1],
            d if d < 0.40 => colours[0],
            d if d < 0.45 => colours[2],
            _ => scale(colours[1], 0.8),
        };
        let teeth = ((u + v) * 40.0).fract() < 0.5;
        let colour = match edge {
            e if e < 0.03 => colours[2],
            e if e < 0.07 => colours[usize::from(!teeth)],
            e if e < 0.09 => colours[2],
            e if e < 0.12 => colours[0],
            _ => field,
        };
        let worn = 0.75 + 0.4 * fractal(u, v, [6, 6], 5, seed);
        scale(colour, weave(u, v, 170.0, seed) * worn)
    })
}

/// Pleats of a curtain, along `v`.
pub(crate) fn curtain(base: Rgb, seed: u32) -> Texture {
    Texture::painted(512, |u, v| {
        let bend = 0.25 * fractal(u, v, [4, 2], 2, seed);
        let fold = (std::f32::consts::TAU * (u * 6.0 + bend)).sin();
        scale(base, (0.72 + 0.28 * fold) * (0.9 + 0.1 * weave(u, v, 128.0, seed)))
    })
}

/// Sky with clouds over houses and trees.
pub(crate) fn outside(seed: u32) -> Texture {
    Texture::painted(1024, |u, v| {
        let clouds = ((fractal(u, v, [3, 6], 5, seed) - 0.45) * 4.0).clamp(0.0, 1.0);
        let sky = mix(mix(srgb(0x7fb2ea), srgb(0xd3e6f7), v * 1.3), [0.95; 3], clouds * 0.8);
        let house = (u * 6.0).floor() as i32;
        let roof =
            0.52 + 0.16 * lattice(house, 0, seed) - 0.05 * (0.5 - ((u * 6.0).fract() - 0.5).abs());
        let trees = 0.66 + 0.12 * fractal(u, 0.3, [5, 1], 4, seed + 9);
        if v > trees {
            let leaves = fractal(u, v, [30, 30], 3, seed + 4);
            return scale(mix(srgb(0x2d4a1f), srgb(0x86a04d), leaves), 0.6);
        }
        if v > roof {
            let (x, y) = ((u * 36.0).fract(), (v * 30.0).fract());
            let pane = x > 0.3 && x < 0.75 && y > 0.25 && y < 0.8 && v > roof + 0.05;
            let wall = mix(srgb(0xb9a58c), srgb(0x9c6b58), lattice(house, 3, seed));
            return scale(wall, if pane { 0.12 } else { 0.45 });
        }
        sky
    })
}
