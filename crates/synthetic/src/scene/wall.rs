//! Walls with windows, and what hangs on them.

use super::builder::{Builder, Place};
use super::library::Library;
use super::{Emitter, Role, Skin};
use crate::rgb::{Rgb, scale, srgb};

/// Depth of the wall behind a window [m].
const REVEAL: f32 = 0.24;

/// A wall: its place is the lower left corner as seen from the room.
#[derive(Clone, Copy)]
pub(super) struct Wall {
    pub(super) place: Place,
    pub(super) length: f32,
    pub(super) height: f32,
}

/// A rectangle on a wall: left, right, lower and upper edge [m].
pub(super) type Opening = [f32; 4];

impl Wall {
    fn rectangle(&self, builder: &mut Builder, [x0, x1, z0, z1]: Opening, skin: Skin) {
        if x1 - x0 < 1e-4 || z1 - z0 < 1e-4 {
            return;
        }
        let p = &self.place;
        let shape = super::Shape::quad(
            p.point([x0, 0.0, z1]),
            p.turn([x1 - x0, 0.0, 0.0]),
            p.turn([0.0, 0.0, z0 - z1]),
            false,
        );
        builder.add(shape, skin, Some([x0, self.height - z1]));
    }

    /// The wall around openings of one height, from left to right, and its skirting board.
    pub(super) fn build(&self, builder: &mut Builder, skin: Skin, board: Skin, holes: &[Opening]) {
        let (mut left, length) = (0.0, self.length);
        for hole in holes {
            self.rectangle(builder, [left, hole[0], 0.0, self.height], skin);
            self.rectangle(builder, [hole[0], hole[1], 0.0, hole[2]], skin);
            self.rectangle(builder, [hole[0], hole[1], hole[3], self.height], skin);
            left = hole[1];
        }
        self.rectangle(builder, [left, length, 0.0, self.height], skin);
        builder.block(&self.place, [0.0, -0.018, 0.0], [length, 0.0, 0.09], board);
        let top = [0.0, -0.05, self.height - 0.06];
        builder.block(&self.place, top, [length, 0.0, self.height], board);
    }

    /// A window in an opening: reveal, pane, frame, sill and curtains. `light` is the radiance
    /// of the sky for lighting.
    pub(super) fn window(
        &self,
        builder: &mut Builder,
        library: &Library,
        hole: Opening,
        light: Rgb,
    ) {
        let ([x0, x1, z0, z1], p, r) = (hole, &self.place, REVEAL);
        let (w, h) = (x1 - x0, z1 - z0);
        let mut face = |corner, right, down, skin| {
            builder.quad(p.point(corner), p.turn(right), p.turn(down), skin);
        };
        let white = library.paint.tinted(srgb(0xe8e6df));
        face([x0, 0.0, z1], [0.0, r, 0.0], [0.0, 0.0, -h], library.plaster);
        face([x1, r, z1], [0.0, -r, 0.0], [0.0, 0.0, -h], library.plaster);
        face([x0, r, z0], [w, 0.0, 0.0], [0.0, -r, 0.0], white);
        face([x0, 0.0, z1], [w, 0.0, 0.0], [0.0, r, 0.0], library.plaster);
        face([x0, r, z1], [w, 0.0, 0.0], [0.0, 0.0, -h], library.outside.bright(Role::Pane, 1.0));
        builder.emitters.push(Emitter::Rectangle {
            origin: p.point([x0, r - 0.002, z1]),
            edges: [p.turn([w, 0.0, 0.0]), p.turn([0.0, 0.0, -h])],
            normal: p.turn([0.0, -1.0, 0.0]),
            radiance: light,
        });
        let bar = 0.05;
        let (xm, zm) = (x0 + 0.5 * w, z0 + 0.62 * h);
        let bars = [
            [x0, x0 + bar, z0, z1],
            [x1 - bar, x1, z0, z1],
            [xm - 0.5 * bar, xm + 0.5 * bar, z0, z1],
            [x0, x1, z0, z0 + bar],
            [x0, x1, z1 - bar, z1],
            [x0, x1, zm - 0.02, zm + 0.02],
        ];
        for [a, b, c, d] in bars {
            builder.block(p, [a, r - 0.07, c], [b, r - 0.015, d], white);
        }
        let wood = library.woods[2];
        builder.block(p, [x0 - 0.06, -0.12, z0 - 0.04], [x1 + 0.06, 0.02, z0], wood);
        self.curtains(builder, library, hole);
    }

    fn curtains(&self, builder: &mut Builder, library: &Library, [x0, x1, z0, z1]: Opening) {
        let top = (z1 + 0.12).min(self.height - 0.08);
        for side in [x0 - 0.22, x1 - 0.08] {
            let (low, high) = ([side, -0.09, z0 - 0.25], [side + 0.30, -0.05, top]);
            builder.block(&self.place, low, high, library.curtain);
        }
        let rod = library.paint.tinted(scale(srgb(0x4a4238), 0.8));
        let (low, high) = ([x0 - 0.3, -0.075, top], [x1 + 0.3, -0.055, top + 0.02]);
        builder.block(&self.place, low, high, rod);
    }

    /// A picture with its frame, middle at (`x`, `z`).
    pub(super) fn picture(
        &self,
        builder: &mut Builder,
        [x, z]: [f32; 2],
        [width, height]: [f32; 2],
        picture: Skin,
        frame: Option<Skin>,
    ) {
        let (x0, x1) = (x - 0.5 * width, x + 0.5 * width);
        let (z0, z1) = (z - 0.5 * height, z + 0.5 * height);
        let p = &self.place;
        let Some(frame) = frame else {
            builder.dressed(p, [x0, -0.006, z0], [x1, -0.001, z1], picture, picture);
            return;
        };
        builder.dressed(p, [x0, -0.016, z0], [x1, -0.001, z1], frame, picture);
        let b = 0.03;
        for [a, b, c, d] in [
            [x0 - b, x0, z0 - b, z1 + b],
            [x1, x1 + b, z0 - b, z1 + b],
            [x0, x1, z0 - b, z0],
            [x0, x1, z1, z1 + b],
        ] {
            builder.block(p, [a, -0.032, c], [b, -0.001, d], frame);
        }
    }
}
