//! Printed and painted things: sheets, calendars, cartons, book spines, screens, paintings.

use super::canvas::invented_word;
use super::{Canvas, Texture};
use crate::rgb::{Rgb, mix, scale, srgb};
use crate::rng::{between32, fractal, stream};
use i2slam_compute::Random;

/// Purpose number of the random streams of printed matter.
const PRINT: u64 = 101;

fn colour(random: &mut Random) -> Rgb {
    const INKS: [u32; 8] =
        [0xc0392b, 0x1f618d, 0x117a65, 0xd68910, 0x6c3483, 0x2c3e50, 0xa04000, 0x148f77];
    srgb(INKS[random.below(INKS.len())])
}

/// A poster or notice with a headline, columns of text and a table; `shape` is width over height.
pub(crate) fn text_sheet(shape: f32, seed: u64) -> Texture {
    let mut random = stream(seed, PRINT, 1);
    let (ink, accent) = (srgb(0x1c1c22), colour(&mut random));
    let mut canvas = Canvas::painted(1024, |u, v| {
        scale([0.82, 0.81, 0.76], 0.94 + 0.08 * fractal(u, v, [8, 8], 4, seed as u32))
    });
    let narrow = 1.0 / shape;
    canvas.rectangle([0.0, 0.0], [1.0, 0.15], accent);
    let title = format!("{} {}", invented_word(&mut random), invented_word(&mut random));
    let height = (0.9 / (title.len() as f32 * 6.0 / 7.0 * narrow)).min(0.10);
    canvas.text([0.05, 0.03], height, narrow, &title, [0.85; 3]);
    let columns = 1 + random.below(2);
    for c in 0..columns {
        let low = 0.05 + 0.9 * c as f32 / columns as f32;
        let high = 0.05 + 0.9 * (c + 1) as f32 / columns as f32 - 0.04;
        canvas.text([low, 0.19], 0.035, narrow, &invented_word(&mut random), accent);
        let size = between32(&mut random, 0.016, 0.026);
        canvas.paragraph(([low, 0.25], [high, 0.60]), size, narrow, ink, &mut random);
    }
    bars(&mut canvas, [0.05, 0.64], [0.52, 0.95], &mut random);
    canvas.paragraph(([0.57, 0.66], [0.95, 0.95]), 0.02, narrow, ink, &mut random);
    canvas.into_texture()
}

/// A bar chart with axes.
fn bars(canvas: &mut Canvas, low: [f32; 2], high: [f32; 2], random: &mut Random) {
    let ink = srgb(0x22252a);
    canvas.rectangle(low, [low[0] + 0.006, high[1]], ink);
    canvas.rectangle([low[0], high[1] - 0.006], high, ink);
    let count = 6 + random.below(5);
    let step = (high[0] - low[0] - 0.02) / count as f32;
    for i in 0..count {
        let x = low[0] + 0.015 + i as f32 * step;
        let top = high[1] - (high[1] - low[1]) * between32(random, 0.15, 0.95);
        let ink = colour(random);
        canvas.rectangle([x, top], [x + 0.7 * step, high[1] - 0.006], ink);
    }
}

/// A month: a picture above a grid of days.
pub(crate) fn calendar(seed: u64) -> Texture {
    let mut random = stream(seed, PRINT, 2);
    let picture = landscape(seed as u32 + 3);
    let mut canvas = Canvas::new(512, [0.8; 3]);
    canvas.blend([0.05, 0.04], [0.95, 0.42], |u, v, _| (picture(u, (v - 0.04) / 0.38), 1.0));
    let (ink, red) = (srgb(0x202028), srgb(0xb03a2e));
    canvas.text([0.08, 0.46], 0.06, 1.0, &invented_word(&mut random), red);
    for day in 0..31 {
        let (column, row) = ((day + 2) % 7, (day + 2) / 7);
        let low = [0.06 + 0.127 * column as f32, 0.56 + 0.084 * row as f32];
        canvas.outline(low, [low[0] + 0.125, low[1] + 0.082], 0.004, scale(ink, 3.0));
        let ink = if column == 6 { red } else { ink };
        canvas.text([low[0] + 0.02, low[1] + 0.018], 0.042, 0.9, &(day + 1).to_string(), ink);
    }
    canvas.into_texture()
}

/// Side of a cardboard box with tape, label and arrows.
pub(crate) fn carton(seed: u64) -> Texture {
    let mut random = stream(seed, PRINT, 3);
    let base = srgb(0xb08a5b);
    let mut canvas = Canvas::painted(512, |u, v| {
        scale(base, 0.85 + 0.2 * fractal(u, v, [6, 90], 3, seed as u32))
    });
    canvas.rectangle([0.0, 0.46], [1.0, 0.54], srgb(0xcbb489));
    canvas.rectangle([0.58, 0.10], [0.92, 0.40], [0.8; 3]);
    let ink = srgb(0x24201c);
    canvas.paragraph(([0.61, 0.13], [0.90, 0.30]), 0.028, 1.0, ink, &mut random);
    for bar in 0..22 {
        let x = 0.61 + 0.0125 * bar as f32;
        canvas.rectangle([x, 0.32], [x + between32(&mut random, 0.003, 0.010), 0.385], ink);
    }
    canvas.text([0.08, 0.62], 0.14, 0.9, &invented_word(&mut random), ink);
    canvas.text([0.08, 0.82], 0.07, 0.9, &invented_word(&mut random), ink);
    canvas.outline([0.08, 0.10], [0.36, 0.40], 0.012, ink);
    canvas.text([0.13, 0.17], 0.16, 1.0, "UP", ink);
    canvas.into_texture()
}

/// Spine of a book in pale colours, to be tinted: bands and a title that runs down.
pub(crate) fn spine(seed: u64) -> Texture {
    let mut random = stream(seed, PRINT, 4);
    let mut flat = Canvas::new(256, [0.62; 3]);
    let dark = between32(&mut random, 0.02, 0.2);
    for _ in 0..2 + random.below(3) {
        let x = between32(&mut random, 0.02, 0.95);
        let width = between32(&mut random, 0.01, 0.05);
        flat.rectangle([x, 0.0], [x + width, 1.0], [dark; 3]);
    }
    let title = format!("{} {}", invented_word(&mut random), invented_word(&mut random));
    let ink = if random.below(2) == 0 { [0.95; 3] } else { [0.03; 3] };
    let letters = title.len() as f32;
    flat.text([0.12, 0.25], 0.5, 0.72 / (letters * 6.0 / 7.0 * 0.5), &title, ink);
    let flat = flat.into_texture();
    let decoder = super::Decoder::new();
    Texture::painted(256, |u, v| flat.sample(&decoder, v, 1.0 - u, 0))
}

/// A display with windows of text; shown as light.
pub(crate) fn screen(seed: u64) -> Texture {
    let mut random = stream(seed, PRINT, 5);
    let mut canvas = Canvas::painted(512, |u, v| mix(srgb(0x1b2a4a), srgb(0x3d5a80), u * v));
    for (low, high) in [([0.04, 0.06], [0.60, 0.80]), ([0.45, 0.30], [0.96, 0.94])] {
        canvas.rectangle(low, high, srgb(0xeef1f4));
        canvas.rectangle(low, [high[0], low[1] + 0.05], srgb(0x4a6fa5));
        let inner = ([low[0] + 0.02, low[1] + 0.08], [high[0] - 0.02, high[1] - 0.02]);
        canvas.paragraph(inner, 0.028, 0.6, srgb(0x262b33), &mut random);
    }
    canvas.into_texture()
}

/// Hills, a lake and a sun.
fn landscape(seed: u32) -> impl Fn(f32, f32) -> Rgb {
    move |u, v| {
        let ridge = |base: f32, height: f32, s: u32| base - height * fractal(u, 0.5, [3, 1], 4, s);
        let sun = (u - 0.7).hypot(v - 0.25) < 0.07;
        let strokes = 0.85 + 0.3 * fractal(u, v, [20, 50], 3, seed + 40);
        let colour = if v > 0.78 {
            mix(srgb(0x24506b), srgb(0xe7b77a), fractal(u, v, [4, 60], 2, seed))
        } else if v > ridge(0.80, 0.25, seed + 1) {
            srgb(0x2f4a2c)
        } else if v > ridge(0.70, 0.40, seed + 2) {
            srgb(0x5c6f88)
        } else if sun {
            srgb(0xfff0c0)
        } else {
            mix(srgb(0xd98a5b), srgb(0xf4d9a6), v)
        };
        scale(colour, strokes)
    }
}

/// A framed landscape.
pub(crate) fn landscape_painting(seed: u32) -> Texture {
    let picture = landscape(seed);
    let mut canvas = Canvas::new(512, [0.75, 0.73, 0.68]);
    canvas.blend([0.07, 0.07], [0.93, 0.93], |u, v, _| (picture(u, v), 1.0));
    canvas.into_texture()
}

/// A framed composition of discs, bands and strokes.
pub(crate) fn abstract_painting(seed: u64) -> Texture {
    let mut random = stream(seed, PRINT, 6);
    let ground = mix(colour(&mut random), [0.75, 0.7, 0.6], 0.75);
    let mut canvas = Canvas::painted(512, |u, v| {
        scale(ground, 0.8 + 0.35 * fractal(u, v, [12, 30], 4, seed as u32))
    });
    for _ in 0..14 {
        let at = [between32(&mut random, 0.0, 0.95), between32(&mut random, 0.0, 0.95)];
        let (ink, size) = (colour(&mut random), between32(&mut random, 0.03, 0.16));
        match random.below(3) {
            0 => canvas.disc(at, size, ink),
            1 => canvas.rectangle(at, [at[0] + size, at[1] + 2.0 * size], ink),
            _ => canvas.outline(at, [at[0] + 2.0 * size, at[1] + size], 0.012, ink),
        }
    }
    canvas.outline([0.0, 0.0], [1.0, 1.0], 0.05, srgb(0xe6e1d6));
    canvas.into_texture()
}
