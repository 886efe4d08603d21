//! A whole room from a specification.

use super::builder::{Builder, LocalFrame};
use super::library::MaterialLibrary;
use super::still_life::still_life;
use super::{Bvh, DeskPlace, Emitter, LightRole, Material, Scene, Vec3, furniture, objects};
use crate::rgb::{Rgb, scale, srgb};
use crate::rng::{between32, stream};
use crate::spec::Spec;
use crate::texture::Decoder;
use i2slam_compute::Random;
use std::f32::consts::{FRAC_PI_2, PI};

/// Purpose number of the random stream that furnishes.
const FURNITURE: u64 = 2;

/// Radiance of white daylight for lighting, before all light is scaled to a set level.
const DAYLIGHT: [f32; 3] = [0.86, 0.95, 1.1];
/// Place of the lamp over the desk: right, away from the viewer, up, from the desk's foot at the
/// wall [m].
const DESK_LAMP: [f32; 3] = [0.0, -0.55, 1.75];
/// Colour of lamps.
const LAMPLIGHT: [f32; 3] = [1.0, 0.76, 0.48];

/// The room of a specification: the same for the same `seed` and `[room]`, `[light]`.
pub(crate) fn furnished_room(spec: &Spec) -> Scene {
    let mut builder = Builder::new(stream(spec.seed, FURNITURE, 0));
    let mut library = MaterialLibrary::new(&mut builder, spec.seed, spec.room.text_panels.max(1));
    library.polish(&spec.gloss);
    let [width, depth, height] = spec.room.size.map(|v| v as f32);
    let walls = walls(width, depth, height, builder.random.below(4));
    shell(&mut builder, &library, [width, depth, height]);
    let b = &mut builder;
    window_wall(b, &library, &walls[0], spec);
    let desk = study_wall(b, &library, &walls[1], spec);
    sofa_wall(b, &library, &walls[2], spec);
    door_wall(b, &library, &walls[3]);
    middle(b, &library, spec);
    let sun = (spec.light.sun > 0.0 && spec.room.windows > 0).then(|| {
        let (elevation, azimuth) = (spec.light.sun_elevation, spec.light.sun_azimuth);
        let (up, side) = ((elevation as f32).to_radians(), (azimuth as f32).to_radians());
        walls[0].place.turn([side.sin() * up.cos(), side.cos() * up.cos(), up.sin()])
    });
    let bvh = Bvh::new(&builder.surfaces);
    Scene {
        surfaces: builder.surfaces,
        textures: builder.textures,
        decoder: Decoder::new(),
        emitters: builder.emitters,
        bvh,
        sun,
        desk,
    }
}

/// The four walls, clockwise seen from above, beginning with one of them.
fn walls(width: f32, depth: f32, height: f32, first: usize) -> [Wall; 4] {
    let (x, y) = (0.5 * width, 0.5 * depth);
    let all = [
        (LocalFrame::new(-x, y, 0.0), width),
        (LocalFrame::new(x, y, -FRAC_PI_2), depth),
        (LocalFrame::new(x, -y, PI), width),
        (LocalFrame::new(-x, -y, FRAC_PI_2), depth),
    ];
    std::array::from_fn(|i| {
        let (place, length) = all[(first + i) % 4];
        Wall { place, length, height }
    })
}

fn shell(b: &mut Builder, l: &MaterialLibrary, [width, depth, height]: [f32; 3]) {
    let (x, y) = (0.5 * width, 0.5 * depth);
    let right = Vec3::new(width, 0.0, 0.0);
    b.quad(Vec3::new(-x, y, 0.0), right, Vec3::new(0.0, -depth, 0.0), l.floor);
    b.quad(Vec3::new(-x, -y, height), right, Vec3::new(0.0, depth, 0.0), l.ceiling);
}

fn window_wall(b: &mut Builder, l: &MaterialLibrary, wall: &Wall, spec: &Spec) {
    let count = spec.room.windows.min((wall.length / 1.5) as usize);
    let step = wall.length / count.max(1) as f32;
    let (z0, z1) = (0.88, (wall.height - 0.35).min(2.25));
    let width = (step - 0.75).min(1.35);
    let hole = |i: usize| -> Opening {
        let x = (i as f32 + 0.5) * step;
        [x - 0.5 * width, x + 0.5 * width, z0, z1]
    };
    let holes: Vec<Opening> = (0..count).map(hole).collect();
    wall.build(b, l.plaster, l.woods[2], &holes);
    for &hole in &holes {
        wall.window(b, l, hole, scale(DAYLIGHT, spec.light.daylight as f32));
        let at = 0.5 * (hole[0] + hole[1]);
        furniture::radiator(b, l, &wall.place.at([at, 0.0, 0.0], 0.0));
        let sill = wall.place.at([hole[0] + 0.25, 0.08, z0], 0.0);
        objects::plant(b, l, &sill, 0.34);
    }
    objects::plant(b, l, &wall.place.at([0.35, -0.38, 0.0], 0.0), 1.15);
    let corner = wall.place.at([wall.length - 0.36, -0.05, 0.0], 0.0);
    furniture::cartons(b, l, &corner);
}

/// Middles of things of given widths, spread over a wall with random gaps.
fn spread(random: &mut Random, length: f32, widths: &[f32]) -> Vec<f32> {
    let free = (length - widths.iter().sum::<f32>()).max(0.0);
    let gaps: Vec<f32> = (0..=widths.len()).map(|_| between32(random, 0.6, 1.4)).collect();
    let total: f32 = gaps.iter().sum();
    let mut x = 0.0;
    let place = |(width, gap): (&f32, &f32)| {
        let middle = x + gap / total * free + 0.5 * width;
        x = middle + 0.5 * width;
        middle
    };
    widths.iter().zip(&gaps).map(place).collect()
}

fn study_wall(b: &mut Builder, l: &MaterialLibrary, wall: &Wall, spec: &Spec) -> DeskPlace {
    wall.build(b, l.accent, l.woods[2], &[]);
    let at = spread(&mut b.random, wall.length, &[1.0, 1.4, 0.6]);
    let clutter = spec.room.clutter as f32;
    furniture::bookshelf(b, l, &wall.place.at([at[0], 0.0, 0.0], 0.0), clutter);
    let glow = spec.light.lamps as f32;
    let desk = wall.place.at([at[1], 0.0, 0.0], 0.0);
    furniture::desk(b, l, &desk, 0.4 * glow.max(0.3));
    if spec.light.desk_lamp > 0.0 {
        let (bulb, radiance) = (desk.point(DESK_LAMP), 80.0 * spec.light.desk_lamp as f32);
        b.bulb(bulb, 0.05, l.paint, [1.0; 3], radiance);
    }
    sheets(b, l, wall, (at[1] - 0.45, 1.62), 0);
    let shelf = wall.place.at([at[2], 0.0, 0.0], 0.0);
    for (i, z) in [1.05_f32, 1.40, 1.75].into_iter().enumerate() {
        b.block(&shelf, [-0.3, -0.22, z - 0.025], [0.3, 0.0, z], l.woods[1]);
        let board = shelf.at([0.0, 0.0, z], 0.0);
        let full = -0.28 + 0.5 * clutter * between32(&mut b.random, 0.5, 1.0);
        objects::books(b, l, &board, ([-0.28, full], 0.22, 0.27));
        if i != 1 {
            objects::mug(b, l, &board.at([0.23, -0.1, 0.0], 0.0));
        }
    }
    let [x, y] = [desk.origin.x, desk.origin.y].map(f64::from);
    DeskPlace { x, y, yaw: f64::from(desk.yaw) }
}

/// Every other text panel, side by side from `x` on.
fn sheets(b: &mut Builder, l: &MaterialLibrary, wall: &Wall, (x, z): (f32, f32), first: usize) {
    let mut x = x;
    for (i, sheet) in l.sheets.iter().skip(first).step_by(2).take(3).enumerate() {
        let size = [[0.50, 0.70], [0.42, 0.58], [0.36, 0.50]][i];
        wall.picture(b, [x + 0.5 * size[0], z + 0.04 * i as f32], size, *sheet, None);
        x += size[0] + 0.06;
    }
}

fn sofa_wall(b: &mut Builder, l: &MaterialLibrary, wall: &Wall, spec: &Spec) {
    wall.build(b, l.plaster, l.woods[2], &[]);
    let at = spread(&mut b.random, wall.length, &[0.5, 1.9, 0.5]);
    furniture::sofa(b, l, &wall.place.at([at[1], 0.0, 0.0], 0.0));
    let light = scale(LAMPLIGHT, spec.light.lamps as f32 * 6.0);
    let corner = wall.place.at([at[0], -0.32, 0.0], 0.0);
    objects::lamp(b, l, &corner, 1.55, light.map(|v| v.max(1e-3)));
    let side = wall.place.at([at[2], -0.28, 0.0], 0.0);
    b.frustum(&side, [0.0, 0.5], [0.05, 0.05], l.woods[0]);
    b.frustum(&side, [0.5, 0.53], [0.24, 0.24], l.woods[1]);
    objects::globe(b, l, &side.at([0.05, 0.03, 0.53], 0.0));
    objects::mug(b, l, &side.at([-0.1, -0.08, 0.53], 1.0));
    if let Some(mirror) = l.mirror {
        wall.picture(b, [at[1], 1.45], [1.7, 0.85], mirror, Some(l.woods[0]));
        return;
    }
    let sizes = [[0.62, 0.46], [0.44, 0.56], [0.50, 0.40], [0.36, 0.36]];
    let mut x = at[1] - 1.05;
    for (i, size) in sizes.into_iter().enumerate() {
        let frame = Some(l.woods[i % 3]);
        let z = 1.52 + between32(&mut b.random, -0.06, 0.08);
        wall.picture(b, [x + 0.5 * size[0], z], size, l.paintings[i], frame);
        x += size[0] + 0.14;
    }
}

fn door_wall(b: &mut Builder, l: &MaterialLibrary, wall: &Wall) {
    wall.build(b, l.plaster.tinted([0.95, 0.97, 1.0]), l.woods[2], &[]);
    let at = spread(&mut b.random, wall.length, &[1.05, 1.35, 0.5]);
    furniture::door(b, l, &wall.place.at([at[0], 0.0, 0.0], 0.0));
    furniture::sideboard(b, l, &wall.place.at([at[1], 0.0, 0.0], 0.0));
    sheets(b, l, wall, (at[1] - 0.72, 1.62), 1);
    wall.picture(b, [at[2] + 0.2, 1.55], [0.34, 0.46], l.calendar, None);
    furniture::cartons(b, l, &wall.place.at([at[2] + 0.12, 0.0, 0.0], 0.0));
}

fn middle(b: &mut Builder, l: &MaterialLibrary, spec: &Spec) {
    if spec.stills.around_object {
        let place = LocalFrame::new(0.0, 0.0, 0.0);
        still_life(b, l, &place);
        hanging_lamp(b, l, spec, place);
        return;
    }
    let [x, y] = [(); 2].map(|()| between32(&mut b.random, -0.1, 0.1));
    let place = LocalFrame::new(x, y, 0.0);
    let turned = place.at([0.0; 3], between32(&mut b.random, -0.25, 0.25));
    let polished = spec.gloss.polish > 0.0;
    if !polished {
        b.panel(&turned, [[-1.15, 0.85, 0.006], [2.3, 0.0, 0.0], [0.0, -1.7, 0.0]], l.rug);
    }
    furniture::table(b, l, &turned);
    hanging_lamp(b, l, spec, turned);
}

/// A lamp that hangs from the ceiling above a place.
fn hanging_lamp(b: &mut Builder, l: &MaterialLibrary, spec: &Spec, place: LocalFrame) {
    let top = spec.room.size[2] as f32;
    let hung = LocalFrame { origin: place.point([0.0, 0.0, top - 0.62]), yaw: 0.0 };
    let black = l.paint.tinted([0.05; 3]);
    b.frustum(&hung, [0.16, 0.62], [0.008, 0.008], black);
    b.tube(&hung, [-0.02, 0.17], [0.24, 0.05], l.paint.tinted([0.6, 0.25, 0.15]));
    let lamp = 5.0 * spec.light.lamps.max(1e-3) as f32;
    let bulb = hung.point([0.0, 0.0, 0.02]);
    b.bulb(bulb, 0.07, l.paint, LAMPLIGHT, lamp);
}

/// Depth of the wall behind a window [m].
const REVEAL_DEPTH: f32 = 0.24;

/// A wall: its place is the lower left corner as seen from the room.
#[derive(Clone, Copy)]
pub(super) struct Wall {
    pub(super) place: LocalFrame,
    pub(super) length: f32,
    pub(super) height: f32,
}

/// A rectangle on a wall: left, right, lower and upper edge [m].
pub(super) type Opening = [f32; 4];

impl Wall {
    fn rectangle(&self, builder: &mut Builder, [x0, x1, z0, z1]: Opening, material: Material) {
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
        builder.add(shape, material, Some([x0, self.height - z1]));
    }

    /// The wall around openings of one height, from left to right, and its skirting board.
    pub(super) fn build(
        &self,
        builder: &mut Builder,
        material: Material,
        board: Material,
        holes: &[Opening],
    ) {
        let (mut left, length) = (0.0, self.length);
        for hole in holes {
            self.rectangle(builder, [left, hole[0], 0.0, self.height], material);
            self.rectangle(builder, [hole[0], hole[1], 0.0, hole[2]], material);
            self.rectangle(builder, [hole[0], hole[1], hole[3], self.height], material);
            left = hole[1];
        }
        self.rectangle(builder, [left, length, 0.0, self.height], material);
        builder.block(&self.place, [0.0, -0.018, 0.0], [length, 0.0, 0.09], board);
        let top = [0.0, -0.05, self.height - 0.06];
        builder.block(&self.place, top, [length, 0.0, self.height], board);
    }

    /// A window in an opening: reveal, pane, frame, sill and curtains. `light` is the radiance
    /// of the sky for lighting.
    pub(super) fn window(
        &self,
        builder: &mut Builder,
        library: &MaterialLibrary,
        hole: Opening,
        light: Rgb,
    ) {
        let ([x0, x1, z0, z1], p, r) = (hole, &self.place, REVEAL_DEPTH);
        let (w, h) = (x1 - x0, z1 - z0);
        let mut face = |corner, right, down, material| {
            builder.panel(p, [corner, right, down], material);
        };
        let white = library.paint.tinted(srgb(0xe8e6df));
        face([x0, 0.0, z1], [0.0, r, 0.0], [0.0, 0.0, -h], library.plaster);
        face([x1, r, z1], [0.0, -r, 0.0], [0.0, 0.0, -h], library.plaster);
        face([x0, r, z0], [w, 0.0, 0.0], [0.0, -r, 0.0], white);
        face([x0, 0.0, z1], [w, 0.0, 0.0], [0.0, r, 0.0], library.plaster);
        face(
            [x0, r, z1],
            [w, 0.0, 0.0],
            [0.0, 0.0, -h],
            library.outside.emitting(LightRole::Pane, 1.0),
        );
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

    fn curtains(
        &self,
        builder: &mut Builder,
        library: &MaterialLibrary,
        [x0, x1, z0, z1]: Opening,
    ) {
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
        picture: Material,
        frame: Option<Material>,
    ) {
        let (x0, x1) = (x - 0.5 * width, x + 0.5 * width);
        let (z0, z1) = (z - 0.5 * height, z + 0.5 * height);
        let p = &self.place;
        let Some(frame) = frame else {
            builder.block_with_front(p, [x0, -0.006, z0], [x1, -0.001, z1], picture, picture);
            return;
        };
        builder.block_with_front(p, [x0, -0.016, z0], [x1, -0.001, z1], frame, picture);
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
