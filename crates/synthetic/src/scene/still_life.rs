//! A still life of fine structure: a ball of wicker and a fern on a table.

use super::builder::{Builder, LocalFrame};
use super::library::MaterialLibrary;
use super::objects;
use super::{Material, Shape, Vec3, orthonormal_basis};
use crate::rgb::srgb;
use crate::rng::between32;
use std::f32::consts::{PI, TAU};

/// Height of the table [m].
const TABLE: f32 = 0.75;
/// The point that photographs are taken around, above the middle of the table [m].
pub(crate) const MIDDLE: [f64; 3] = [0.0, 0.0, TABLE as f64 + 0.15];

/// Radius of the ball and of its withies [m].
const BALL: f32 = 0.15;
const WITHY: f32 = 0.0032;
/// Hoops of the ball, strands of a hoop, rods of a strand.
const HOOPS: usize = 21;
const STRANDS: usize = 2;
const HOOP_RODS: usize = 40;

/// Fronds of the fern, rods of a frond.
const FRONDS: usize = 17;
const FROND_RODS: usize = 14;

/// A round table with cloth and papers, the ball and the fern.
pub(super) fn still_life(b: &mut Builder, l: &MaterialLibrary, place: &LocalFrame) {
    b.frustum(place, [0.0, 0.03], [0.25, 0.2], l.woods[0]);
    b.tube(place, [0.03, TABLE - 0.03], [0.04, 0.04], l.woods[0]);
    b.frustum(place, [TABLE - 0.03, TABLE], [0.48, 0.48], l.woods[1]);
    let top = place.at([0.0, 0.0, TABLE], 0.0);
    let cloth = [[-0.3, 0.3, 0.002], [0.6, 0.0, 0.0], [0.0, -0.6, 0.0]];
    b.panel(&top.at([0.0; 3], 0.4), cloth, l.cloths[0]);
    for (x, y, turn) in [(-0.02, -0.3, 0.3), (0.28, -0.2, 1.9), (-0.25, 0.26, 4.0)] {
        objects::sheet(b, l, &top.at([x, y, 0.002], turn));
    }
    objects::mug(b, l, &top.at([0.02, 0.3, 0.0], 1.0));
    objects::pile(b, l, &top.at([-0.33, -0.05, 0.002], 1.2));
    let ball = top.point([-0.1, 0.0, BALL + 0.01]);
    wicker_ball(b, l.woods[2], ball);
    fern(b, l, &top.at([0.2, 0.06, 0.002], 0.0));
}

/// A chain of rods through points.
fn chain(b: &mut Builder, points: &[Vec3], radius: f32, material: Material) {
    for pair in points.windows(2) {
        b.add(Shape::rod(pair[0], pair[1], radius), material, None);
    }
}

/// Hoops on a sphere that pass over and under each other.
fn wicker_ball(b: &mut Builder, withies: Material, centre: Vec3) {
    for hoop in 0..HOOPS {
        // Normals on a half of Fibonacci's sphere, moved a little.
        let up = 1.0 - (hoop as f32 + 0.5) / HOOPS as f32;
        let (sine, cosine) = (hoop as f32 * 2.399_963).sin_cos();
        let flat = (1.0 - up * up).sqrt();
        let mut draw = |size: f32| between32(&mut b.random, -size, size);
        let normal =
            Vec3::new(flat * cosine + draw(0.15), flat * sine + draw(0.15), up + draw(0.15));
        let normal = normal * normal.norm().recip();
        let (x, y) = orthonormal_basis(normal);
        let (off, phase) = (draw(0.35) * BALL, draw(PI));
        let waves = 5.0 + (hoop % 3) as f32;
        let tone = 1.0 + draw(0.25);
        let material = withies.tinted([tone, tone, 0.95 * tone]);
        for strand in 0..STRANDS {
            let along = off + (strand as f32 - 0.5) * 2.6 * WITHY;
            let points = (0..=HOOP_RODS).map(|i| {
                let angle = TAU * i as f32 / HOOP_RODS as f32;
                let out = BALL + 1.2 * WITHY * (waves * angle + phase).sin();
                let reach = (out * out - along * along).max(0.0).sqrt();
                let (sine, cosine) = angle.sin_cos();
                centre + normal * along + x * (reach * cosine) + y * (reach * sine)
            });
            let points: Vec<Vec3> = points.collect();
            chain(b, &points, WITHY, material);
        }
    }
}

/// A fern in a pot: arching fronds with two rows of narrow leaflets.
fn fern(b: &mut Builder, l: &MaterialLibrary, place: &LocalFrame) {
    b.frustum(place, [0.0, 0.11], [0.05, 0.068], l.glazes[0]);
    let stem = l.paint.tinted(srgb(0x5a6a2c));
    for frond in 0..FRONDS {
        let turn = frond as f32 * 2.4 + between32(&mut b.random, -0.25, 0.25);
        let length = between32(&mut b.random, 0.16, 0.27);
        let rise = between32(&mut b.random, 0.6, 1.3);
        let (sine, cosine) = turn.sin_cos();
        let out = place.turn([cosine, sine, 0.0]);
        let points = (0..=FROND_RODS).map(|i| {
            let u = i as f32 / FROND_RODS as f32;
            let height = length * (rise * u - 0.75 * u * u);
            place.point([0.0, 0.0, 0.105]) + out * (0.02 + 0.8 * length * u) + up(height)
        });
        let points: Vec<Vec3> = points.collect();
        chain(b, &points, 0.0014, stem);
        let green = between32(&mut b.random, 0.7, 1.3);
        let leaf = l.glazes[2].tinted([0.35 * green, 0.62 * green, 0.25 * green]);
        for (i, pair) in points.windows(2).enumerate().skip(2) {
            let u = i as f32 / FROND_RODS as f32;
            leaflets(b, pair, 0.05 * (1.15 - u), leaf);
        }
    }
}

fn up(height: f32) -> Vec3 {
    Vec3::new(0.0, 0.0, height)
}

/// A leaflet to each side of a piece of stem; `length` [m].
fn leaflets(b: &mut Builder, stem: &[Vec3], length: f32, leaf: Material) {
    let along = (stem[1] - stem[0]) * (stem[1] - stem[0]).norm().recip();
    let side = along.cross(up(1.0));
    let side = side * side.norm().max(1e-3).recip();
    for sign in [-1.0, 1.0] {
        let droop = between32(&mut b.random, -0.5, 0.1);
        let ahead = between32(&mut b.random, 0.25, 0.6);
        let reach = side * sign + along * ahead + up(droop);
        let reach = reach * (length / reach.norm());
        let across = reach.cross(side.cross(along)) * (0.22 / length);
        let across = across * (0.2 * length / across.norm().max(1e-6));
        blade(b, stem[0], reach, across, leaf);
    }
}

/// An ellipse from its foot along `reach`, with two sides.
fn blade(b: &mut Builder, foot: Vec3, reach: Vec3, across: Vec3, material: Material) {
    let corner = foot - across * 0.5;
    for (right, down) in [(across, reach), (reach, across)] {
        // The normals of the two sides are opposite, a hair apart.
        let normal = down.cross(right);
        let lift = normal * (2e-4 / normal.norm());
        b.add(Shape::quad(corner + lift, right, down, true), material, None);
    }
}
