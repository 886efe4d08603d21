//! The view through a window.

use super::{Canvas, Texture};
use crate::rgb::{mix, scale, srgb};
use crate::rng::{fractal, lattice};

/// Sky with clouds over houses and trees.
pub(crate) fn outside(seed: u32) -> Texture {
    let painted = Canvas::painted(1024, |u, v| {
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
    });
    painted.into_texture()
}
