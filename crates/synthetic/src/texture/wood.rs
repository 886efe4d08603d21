//! Wood: floors, furniture, doors.

use super::{Canvas, Texture};
use crate::rgb::{Rgb, mix, scale};
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
    let painted = Canvas::painted(1024, |u, v| {
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
    });
    painted.into_texture()
}

/// Furniture boards with grain along `u`.
pub(crate) fn timber(base: Rgb, seed: u32) -> Texture {
    Canvas::painted(512, |u, v| scale(base, grain(u, v, seed))).into_texture()
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
