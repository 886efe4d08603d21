//! Furniture against a wall: x from the middle, y from -depth to 0 at the wall.

use super::builder::{Builder, LocalFrame};
use super::library::{MaterialLibrary, small_colour};
use super::objects;
use super::{Gloss, LightRole, Material};
use crate::rgb::{scale, srgb};
use crate::rng::between32;

/// A bookshelf of 1.0 x 0.3 x 1.95 m.
pub(super) fn bookshelf(b: &mut Builder, l: &MaterialLibrary, place: &LocalFrame, clutter: f32) {
    let (half, depth, tall, board) = (0.5, 0.3, 1.95, 0.025);
    let wood = l.woods[1];
    b.block(place, [-half, -depth, 0.0], [-half + board, 0.0, tall], wood);
    b.block(place, [half - board, -depth, 0.0], [half, 0.0, tall], wood);
    b.block(place, [-half, -0.012, 0.0], [half, 0.0, tall], wood);
    let levels = 5;
    for level in 0..=levels {
        let z = 0.06 + (tall - 0.06 - board) * level as f32 / levels as f32;
        b.block(place, [-half, -depth, z], [half, 0.0, z + board], wood);
        if level == levels {
            break;
        }
        let room = (tall - 0.06) / levels as f32 - 2.0 * board;
        let shelf = place.at([0.0, 0.0, z + board], 0.0);
        let full = -half + 0.04 + 0.9 * clutter * between32(&mut b.random, 0.45, 1.0);
        objects::books(b, l, &shelf, ([-half + 0.03, full], depth, room));
        let rest = shelf.at([0.5 * (full + half), -0.15, 0.0], 0.0);
        if half - full > 0.28 {
            match b.random.below(3) {
                0 => objects::vase(b, l, &rest),
                1 => objects::globe(b, l, &rest),
                _ => objects::pile(b, l, &rest),
            }
        }
    }
}

/// A sideboard of 1.3 x 0.42 x 0.78 m with drawers.
pub(super) fn sideboard(b: &mut Builder, l: &MaterialLibrary, place: &LocalFrame) {
    let (half, depth, tall) = (0.65, 0.42, 0.78);
    let (wood, front) = (l.woods[0], l.woods[1]);
    b.block(place, [-half, -depth, 0.08], [half, -0.01, tall], wood);
    for x in [-half + 0.03, half - 0.07] {
        b.block(place, [x, -depth + 0.02, 0.0], [x + 0.04, -depth + 0.06, 0.08], wood);
    }
    let knob = l.paint.tinted(srgb(0xb9a25a));
    for column in 0..3 {
        for row in 0..3 {
            let x0 = -half + 0.02 + column as f32 * 0.422;
            let z0 = 0.10 + row as f32 * 0.224;
            let low = [x0, -depth - 0.015, z0];
            b.block(place, low, [x0 + 0.412, -depth, z0 + 0.214], front);
            b.ball(place.point([x0 + 0.206, -depth - 0.03, z0 + 0.107]), 0.017, knob);
        }
    }
    let top = place.at([0.0, -0.21, tall], 0.0);
    objects::vase(b, l, &top.at([-0.45, 0.0, 0.0], 0.0));
    objects::pile(b, l, &top.at([-0.12, -0.03, 0.0], 0.3));
    objects::globe(b, l, &top.at([0.2, 0.03, 0.0], 0.0));
    objects::plant(b, l, &top.at([0.48, 0.02, 0.0], 0.0), 0.45);
}

/// A sofa of 1.9 x 0.85 x 0.82 m with cushions.
pub(super) fn sofa(b: &mut Builder, l: &MaterialLibrary, place: &LocalFrame) {
    let (half, depth) = (0.95, 0.85);
    let cloth = l.sofa;
    b.block(place, [-half, -depth, 0.07], [half, -0.02, 0.30], cloth);
    b.block(place, [-half, -0.24, 0.30], [half, -0.03, 0.82], cloth);
    for x in [-half, half - 0.17] {
        b.block(place, [x, -depth, 0.30], [x + 0.17, -0.24, 0.60], cloth);
        b.block(place, [x + 0.03, -depth + 0.03, 0.0], [x + 0.09, -depth + 0.09, 0.07], l.woods[0]);
    }
    for i in 0..2 {
        let x = -half + 0.18 + 0.775 * i as f32;
        let seat = cloth.tinted([1.1; 3]);
        b.block(place, [x, -depth - 0.01, 0.30], [x + 0.76, -0.25, 0.45], seat);
    }
    for (i, x) in [-0.55_f32, 0.05, 0.52].into_iter().enumerate() {
        let turn = between32(&mut b.random, -0.3, 0.3);
        let cushion = place.at([x, -0.33, 0.45], turn);
        b.block(&cushion, [-0.21, -0.07, 0.0], [0.21, 0.05, 0.38], l.cloths[i % 2]);
    }
}

/// A desk of 1.4 x 0.65 x 0.74 m with a display, a keyboard and a chair.
pub(super) fn desk(b: &mut Builder, l: &MaterialLibrary, place: &LocalFrame, light: f32) {
    let (half, depth, tall) = (0.7, 0.65, 0.74);
    let wood = l.woods[2];
    b.block(place, [-half, -depth, tall - 0.03], [half, 0.0, tall], wood);
    for x in [-half + 0.02, half - 0.07] {
        for y in [-depth + 0.02, -0.07] {
            b.block(place, [x, y, 0.0], [x + 0.05, y + 0.05, tall - 0.03], l.woods[0]);
        }
    }
    let top = place.at([0.0, -0.32, tall], 0.0);
    let black = l.paint.tinted(srgb(0x1d1e21));
    let shown = l.screen.emitting(LightRole::Glow, light);
    b.block(&top, [-0.12, 0.05, 0.0], [0.12, 0.22, 0.015], black);
    b.block(&top, [-0.03, 0.14, 0.015], [0.03, 0.17, 0.15], black);
    b.block(&top, [-0.30, 0.10, 0.12], [0.30, 0.135, 0.48], black);
    b.panel(&top, [[-0.285, 0.0985, 0.465], [0.57, 0.0, 0.0], [0.0, 0.0, -0.33]], shown);
    keyboard(b, l, &top.at([0.0, -0.12, 0.0], 0.05));
    objects::mug(b, l, &top.at([0.42, -0.1, 0.0], 0.9));
    objects::pile(b, l, &top.at([-0.5, 0.05, 0.0], 0.2));
    for (x, turn) in [(-0.45, 0.3), (0.5, -0.25)] {
        objects::sheet(b, l, &top.at([x, -0.15, 0.0], turn));
    }
    chair(b, l, &place.at([0.1, -0.95, 0.0], 0.25), l.woods[0]);
}

fn keyboard(b: &mut Builder, l: &MaterialLibrary, place: &LocalFrame) {
    b.block(place, [-0.22, -0.07, 0.0], [0.22, 0.07, 0.018], l.paint.tinted(srgb(0x2b2c30)));
    let key = l.paint.tinted(srgb(0xc9c9c4));
    for row in 0..4 {
        for column in 0..12 {
            let (x, y) = (-0.21 + 0.0352 * column as f32, -0.062 + 0.032 * row as f32);
            b.panel(place, [[x, y + 0.026, 0.022], [0.029, 0.0, 0.0], [0.0, -0.026, 0.0]], key);
        }
    }
}

/// A chair, its back towards local -y, its middle at the origin.
pub(super) fn chair(b: &mut Builder, l: &MaterialLibrary, place: &LocalFrame, wood: Material) {
    let half = 0.21;
    for (x, y) in
        [(-half, -half), (half - 0.04, -half), (-half, half - 0.04), (half - 0.04, half - 0.04)]
    {
        let tall = if y < 0.0 { 0.92 } else { 0.43 };
        b.block(place, [x, y, 0.0], [x + 0.04, y + 0.04, tall], wood);
    }
    b.block(place, [-half, -half, 0.43], [half, half, 0.46], wood);
    b.block(
        place,
        [-half + 0.02, -half + 0.05, 0.46],
        [half - 0.02, half - 0.01, 0.49],
        l.cloths[1],
    );
    for z in [0.60, 0.72, 0.84] {
        b.block(place, [-half, -half + 0.01, z], [half, -half + 0.03, z + 0.06], wood);
    }
}

/// A table of 1.3 x 0.8 x 0.75 m in the middle of the room, laid, with chairs around it.
pub(super) fn table(b: &mut Builder, l: &MaterialLibrary, place: &LocalFrame) {
    let (hx, hy, tall) = (0.65, 0.40, 0.75);
    let wood = l.woods[1];
    b.block(place, [-hx, -hy, tall - 0.035], [hx, hy, tall], wood);
    b.block(
        place,
        [-hx + 0.06, -hy + 0.06, tall - 0.11],
        [hx - 0.06, hy - 0.06, tall - 0.035],
        wood,
    );
    for (x, y) in [
        (-hx + 0.04, -hy + 0.04),
        (hx - 0.1, -hy + 0.04),
        (-hx + 0.04, hy - 0.1),
        (hx - 0.1, hy - 0.1),
    ] {
        b.block(place, [x, y, 0.0], [x + 0.06, y + 0.06, tall - 0.035], wood);
    }
    for (x, y, turn) in [(-0.3, -0.55, 0.1), (0.35, 0.58, 3.3), (0.95, 0.0, 1.5)] {
        let turn = turn + between32(&mut b.random, -0.15, 0.15);
        chair(b, l, &place.at([x, y, 0.0], turn), l.woods[0]);
    }
    let top = place.at([0.0, 0.0, tall], 0.0);
    if wood.gloss == Gloss::MATT {
        b.panel(&top, [[-0.55, 0.16, 0.003], [1.1, 0.0, 0.0], [0.0, -0.32, 0.0]], l.cloths[0]);
    }
    objects::fruit(b, l, &top.at([0.05, 0.0, 0.003], 0.0));
    objects::mug(b, l, &top.at([-0.35, 0.22, 0.0], 2.0));
    objects::mug(b, l, &top.at([0.42, -0.2, 0.0], 0.4));
    objects::pile(b, l, &top.at([-0.40, -0.18, 0.0], 0.5));
    objects::sheet(b, l, &top.at([0.25, 0.23, 0.0], 2.8));
    objects::vase(b, l, &top.at([0.40, 0.05, 0.003], 0.0));
}

/// Cardboard boxes on each other.
pub(super) fn cartons(b: &mut Builder, l: &MaterialLibrary, place: &LocalFrame) {
    let mut z = 0.0;
    for i in 0..2 + b.random.below(2) {
        let here = place.at([0.0, -0.25, z], between32(&mut b.random, -0.25, 0.25));
        let half = between32(&mut b.random, 0.17, 0.23);
        let tall = between32(&mut b.random, 0.24, 0.34);
        b.block(&here, [-half, -half * 0.8, 0.0], [half, half * 0.8, tall], l.cartons[i % 2]);
        z += tall;
    }
}

/// A radiator of 1.0 x 0.1 x 0.55 m.
pub(super) fn radiator(b: &mut Builder, l: &MaterialLibrary, place: &LocalFrame) {
    let white = l.paint.tinted(srgb(0xdfded8));
    b.block(place, [-0.5, -0.09, 0.12], [0.5, -0.05, 0.62], white);
    for i in 0..14 {
        let x = -0.48 + 0.07 * i as f32;
        b.block(place, [x, -0.11, 0.14], [x + 0.045, -0.09, 0.60], white);
    }
}

/// A door of 0.9 x 2.05 m with its frame and knob.
pub(super) fn door(b: &mut Builder, l: &MaterialLibrary, place: &LocalFrame) {
    let frame = l.woods[2];
    b.block_with_front(place, [-0.43, -0.03, 0.0], [0.43, 0.0, 2.03], frame, l.door);
    for (x0, x1, z0, z1) in
        [(-0.51, -0.43, 0.0, 2.11), (0.43, 0.51, 0.0, 2.11), (-0.43, 0.43, 2.03, 2.11)]
    {
        b.block(place, [x0, -0.05, z0], [x1, 0.0, z1], frame);
    }
    let knob = l.paint.tinted(scale(small_colour(&mut b.random), 0.8));
    b.ball(place.point([0.36, -0.07, 1.02]), 0.03, knob);
}
