//! Small things that stand on others.

use super::builder::{Builder, LocalFrame};
use super::library::{MaterialLibrary, small_colour};
use super::{LightRole, Material, Vec3};
use crate::rgb::{scale, srgb};
use crate::rng::between32;

/// Books side by side from `x0` to at most `x1`, backs to the front; `depth` of the board, `room`
/// above it [m].
pub(super) fn books(
    builder: &mut Builder,
    library: &MaterialLibrary,
    board: &LocalFrame,
    ([x0, x1], depth, room): ([f32; 2], f32, f32),
) {
    let mut x = x0;
    loop {
        let thick = between32(&mut builder.random, 0.018, 0.05);
        if x + thick > x1 {
            return;
        }
        let tall = between32(&mut builder.random, 0.62, 0.92) * room;
        let inset = between32(&mut builder.random, 0.01, 0.05);
        let colour = scale(small_colour(&mut builder.random), 1.4);
        let cover = library.paint.tinted(colour);
        let back = library.spines[builder.random.below(library.spines.len())].tinted(colour);
        let (low, high) = ([x, -depth + inset, 0.0], [x + thick - 0.001, -0.02, tall]);
        builder.block_with_front(board, low, high, cover, back);
        x += thick;
    }
}

/// A pile of lying books.
pub(super) fn pile(builder: &mut Builder, library: &MaterialLibrary, place: &LocalFrame) {
    let mut z = 0.0;
    for _ in 0..2 + builder.random.below(3) {
        let here = place.at([0.0, 0.0, z], between32(&mut builder.random, -0.35, 0.35));
        let thick = between32(&mut builder.random, 0.018, 0.04);
        let cover = library.paint.tinted(small_colour(&mut builder.random));
        builder.block(&here, [-0.11, -0.08, 0.0], [0.11, 0.08, thick], cover);
        z += thick;
    }
}

/// A sheet of paper with text.
pub(super) fn sheet(builder: &mut Builder, library: &MaterialLibrary, place: &LocalFrame) {
    let paper = library.papers[builder.random.below(library.papers.len())];
    let edges = [[-0.105, 0.149, 0.0015], [0.21, 0.0, 0.0], [0.0, -0.297, 0.0]];
    builder.panel(place, edges, paper);
}

/// A mug with a handle.
pub(super) fn mug(builder: &mut Builder, library: &MaterialLibrary, place: &LocalFrame) {
    let glaze = library.paint.tinted(scale(small_colour(&mut builder.random), 1.2));
    builder.frustum(place, [0.0, 0.09], [0.038, 0.042], glaze);
    builder.block(place, [0.04, -0.006, 0.02], [0.065, 0.006, 0.075], glaze);
}

/// A vase of turned parts.
pub(super) fn vase(builder: &mut Builder, library: &MaterialLibrary, place: &LocalFrame) {
    let glaze = library.glazes[builder.random.below(3)];
    let r = between32(&mut builder.random, 0.06, 0.09);
    builder.frustum(place, [0.0, 0.10], [0.7 * r, r], glaze);
    builder.frustum(place, [0.10, 0.20], [r, 0.45 * r], glaze);
    builder.frustum(place, [0.20, 0.25], [0.45 * r, 0.65 * r], glaze);
}

/// A bowl of fruit.
pub(super) fn fruit(builder: &mut Builder, library: &MaterialLibrary, place: &LocalFrame) {
    builder.frustum(place, [0.0, 0.06], [0.07, 0.15], library.glazes[0]);
    for i in 0..6 {
        let angle = i as f32 * 1.05 + between32(&mut builder.random, -0.2, 0.2);
        let (s, c) = angle.sin_cos();
        let colour = [0xc0392b, 0xd98e1f, 0x7c9a2e, 0xe0b32c][builder.random.below(4)];
        let material = library.glazes[1].tinted([0.0; 3]);
        let peel = Material { texture: library.paint.texture, ..material }.tinted(srgb(colour));
        let r = between32(&mut builder.random, 0.034, 0.042);
        let reach = if i == 5 { 0.0 } else { 0.075 };
        let height = if i == 5 { 0.11 } else { 0.08 };
        builder.ball(place.point([reach * c, reach * s, height]), r, peel);
    }
}

/// A patterned ball.
pub(super) fn globe(builder: &mut Builder, library: &MaterialLibrary, place: &LocalFrame) {
    let r = between32(&mut builder.random, 0.07, 0.13);
    builder.frustum(place, [0.0, 0.02], [0.05, 0.04], library.woods[0]);
    let glaze = library.glazes[builder.random.below(3)];
    builder.ball(place.point([0.0, 0.0, r + 0.015]), r, glaze);
}

/// A plant in a pot: stems and round leaves as tilted discs.
pub(super) fn plant(
    builder: &mut Builder,
    library: &MaterialLibrary,
    place: &LocalFrame,
    tall: f32,
) {
    let pot = 0.16 * tall.max(0.6);
    builder.frustum(place, [0.0, 0.26 * tall], [0.75 * pot, pot], library.glazes[1]);
    let leaf = library.glazes[2].tinted([0.45, 0.75, 0.35]);
    let stem = library.paint.tinted(srgb(0x4c5a2a));
    builder.tube(place, [0.26 * tall, 0.8 * tall], [0.015, 0.01], stem);
    for i in 0..22 {
        let angle = i as f32 * 2.4 + between32(&mut builder.random, -0.3, 0.3);
        let z = tall * between32(&mut builder.random, 0.42, 1.0);
        let reach = tall * between32(&mut builder.random, 0.08, 0.26);
        let tilt = between32(&mut builder.random, -0.5, 0.9);
        let (s, c) = angle.sin_cos();
        let size = tall * between32(&mut builder.random, 0.08, 0.14);
        let middle = place.point([reach * c, reach * s, z]);
        let along = Vec3::new(c * tilt.cos(), s * tilt.cos(), tilt.sin()) * (1.9 * size);
        let across = Vec3::new(-s, c, 0.0) * size;
        let corner = middle - (along + across) * 0.5;
        for (a, b) in [(across, along), (along, across)] {
            // Two sides: the normals of (a, b) and (b, a) are opposite, a hair apart.
            let lift = b.cross(a) * (0.001 / (size * size * 1.9));
            builder.add(super::Shape::quad(corner + lift, a, b, true), leaf, None);
        }
    }
}

/// A lamp on a foot with a glowing shade; `tall` [m].
pub(super) fn lamp(
    builder: &mut Builder,
    library: &MaterialLibrary,
    place: &LocalFrame,
    tall: f32,
    light: [f32; 3],
) {
    let (size, metal) = (0.22 * tall.powf(0.4), library.paint.tinted(srgb(0x39352f)));
    builder.frustum(place, [0.0, 0.02], [0.6 * size, 0.55 * size], metal);
    builder.frustum(place, [0.02, tall - size], [0.012, 0.012], metal);
    let shade = library.paint.tinted(srgb(0xf2dfb8)).emitting(LightRole::Glow, 0.8 * light[0]);
    builder.tube(place, [tall - size, tall], [0.72 * size, 0.5 * size], shade);
    let bulb = place.point([0.0, 0.0, tall - 0.45 * size]);
    let area = 0.045 * 0.045 * std::f32::consts::PI;
    builder.bulb(
        bulb,
        0.045,
        library.paint,
        scale(light, light[0].recip()),
        light[0] * 0.06 / area,
    );
}
