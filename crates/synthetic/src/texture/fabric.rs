//! Cloth: upholstery, rugs, curtains.

use super::{Canvas, Texture};
use crate::rgb::{Rgb, mix, scale};
use crate::rng::{fractal, lattice};

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
    let painted = Canvas::painted(512, |u, v| {
        let patch = 0.85 + 0.3 * fractal(u, v, [4, 4], 4, seed);
        let pale = 0.35 * lattice((u * 64.0) as i32, (v * 64.0) as i32, seed + 4);
        scale(mix(base, [0.5; 3], pale * 0.5), weave(u, v, 64.0, seed) * patch)
    });
    painted.into_texture()
}

/// A checked cloth: cushions, blankets.
pub(crate) fn woven(base: Rgb, accent: Rgb, seed: u32) -> Texture {
    let painted = Canvas::painted(512, |u, v| {
        let band = |x: f32| ((x * 5.0).fract() < 0.4) as u8 + ((x * 5.0).fract() > 0.85) as u8;
        let share = 0.45 * f32::from(band(u) + band(v));
        scale(mix(base, accent, share.min(1.0)), weave(u, v, 96.0, seed))
    });
    painted.into_texture()
}

/// A rug: border bands and a field of diamonds.
pub(crate) fn rug(colours: [Rgb; 3], seed: u32) -> Texture {
    let painted = Canvas::painted(1024, |u, v| {
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
            e if e < 0.07 => {
                if teeth {
                    colours[0]
                } else {
                    colours[1]
                }
            }
            e if e < 0.09 => colours[2],
            e if e < 0.12 => colours[0],
            _ => field,
        };
        let worn = 0.75 + 0.4 * fractal(u, v, [6, 6], 5, seed);
        scale(colour, weave(u, v, 170.0, seed) * worn)
    });
    painted.into_texture()
}

/// Pleats of a curtain, along `v`.
pub(crate) fn curtain(base: Rgb, seed: u32) -> Texture {
    let painted = Canvas::painted(512, |u, v| {
        let bend = 0.25 * fractal(u, v, [4, 2], 2, seed);
        let fold = (std::f32::consts::TAU * (u * 6.0 + bend)).sin();
        scale(base, (0.72 + 0.28 * fold) * (0.9 + 0.1 * weave(u, v, 128.0, seed)))
    });
    painted.into_texture()
}
