//! The materials of one room, chosen by its seed.

use super::builder::Builder;
use super::{Gloss, Material};
use crate::rgb::{Rgb, scale, srgb};
use crate::rng::stream;
use crate::spec::GlossSpec;
use crate::texture;
use crate::texture::Texture;
use i2slam_compute::Random;

/// Purpose number of the random stream that chooses materials.
const MATERIALS: u64 = 1;

/// Materials of all objects in a room.
pub(super) struct MaterialLibrary {
    pub(super) floor: Material,
    pub(super) plaster: Material,
    /// Bricks or wallpaper, for one wall.
    pub(super) accent: Material,
    pub(super) ceiling: Material,
    /// Dark, middle and pale wood.
    pub(super) woods: [Material; 3],
    pub(super) paint: Material,
    pub(super) sofa: Material,
    pub(super) cloths: [Material; 2],
    pub(super) curtain: Material,
    pub(super) rug: Material,
    pub(super) glazes: [Material; 3],
    pub(super) door: Material,
    pub(super) sheets: Vec<Material>,
    pub(super) papers: Vec<Material>,
    pub(super) paintings: Vec<Material>,
    pub(super) calendar: Material,
    pub(super) cartons: [Material; 2],
    pub(super) spines: Vec<Material>,
    pub(super) screen: Material,
    pub(super) outside: Material,
    /// A mirror, where one hangs.
    pub(super) mirror: Option<Material>,
}

fn one_of(random: &mut Random, codes: &[u32]) -> Rgb {
    srgb(codes[random.below(codes.len())])
}

impl MaterialLibrary {
    /// Paints all textures. `sheets` is the number of different text panels.
    pub(super) fn new(builder: &mut Builder, seed: u64, sheets: usize) -> Self {
        let mut random = stream(seed, MATERIALS, 0);
        let mut count = 0;
        let mut next = || {
            count += 1;
            stream(seed, MATERIALS, count).bits()
        };
        let paint_seed = next() as u32;
        let mut keep = |texture: Texture| builder.texture(texture);
        let tiled = |texture: usize, tile: f32| Material::tiled(texture, tile, [1.0; 3]);
        let wall = one_of(&mut random, &[0xd9cfbd, 0xc4cfcb, 0xd8c3b0, 0xbfc6d2, 0xcdd0b8]);
        let bold = one_of(&mut random, &[0x8c3b2f, 0x2e5e6e, 0x54703b, 0x6b4a7a, 0x9a6a1f]);
        let brick = random.below(2) == 0;
        let accent = if brick {
            texture::brick(srgb(0x9c5a45), srgb(0xb5aca0), next() as u32)
        } else {
            texture::wallpaper(scale(wall, 0.95), scale(bold, 0.9), next() as u32)
        };
        let floor = one_of(&mut random, &[0xa9743f, 0x8a5a36, 0xb98d5e, 0x6f5040]);
        let woods = [0x5d3a22, 0x9b6b3d, 0xc9a571].map(|c| {
            let seed = next() as u32;
            tiled(keep(texture::timber(srgb(c), seed)), 1.1)
        });
        let plaster = keep(texture::plaster(wall, next() as u32));
        Self {
            floor: tiled(keep(texture::planks(floor, next() as u32)), 1.6),
            accent: tiled(keep(accent), if brick { 0.8 } else { 0.9 }),
            ceiling: tiled(plaster, 2.0).tinted([0.8 / wall[0], 0.8 / wall[1], 0.78 / wall[2]]),
            plaster: tiled(plaster, 1.7),
            woods,
            paint: tiled(keep(texture::plain(paint_seed)), 0.5),
            sofa: tiled(keep(texture::upholstery(bold, next() as u32)), 0.5),
            cloths: [0, 1].map(|_| {
                let (a, b) = (0xd8c9a8, [0xb5523b, 0x2f6f73, 0x3d4f7d][random.below(3)]);
                tiled(keep(texture::woven(srgb(a), srgb(b), next() as u32)), 0.4)
            }),
            curtain: tiled(keep(texture::curtain(scale(bold, 1.1), next() as u32)), 0.9),
            rug: {
                let colours = [scale(bold, 0.8), srgb(0xcbb892), srgb(0x2b2f45)];
                Material::picture(keep(texture::rug(colours, next() as u32)))
            },
            glazes: [(0x2f5d8a, 0xd9d4c5), (0xb5482f, 0xe0b070), (0x4f7a4a, 0xd5d9b0)]
                .map(|(a, b)| tiled(keep(texture::ceramic(srgb(a), srgb(b), next() as u32)), 0.6)),
            door: Material::picture(keep(texture::door(srgb(0xc8bfa9), next() as u32))),
            sheets: (0..sheets)
                .map(|_| Material::picture(keep(texture::text_sheet(0.72, next()))))
                .collect(),
            papers: (0..2)
                .map(|_| Material::picture(keep(texture::text_sheet(0.71, next()))))
                .collect(),
            paintings: (0..4)
                .map(|i| {
                    let texture = match i % 2 {
                        0 => texture::landscape_painting(next() as u32 >> 8),
                        _ => texture::abstract_painting(next()),
                    };
                    Material::picture(keep(texture))
                })
                .collect(),
            calendar: Material::picture(keep(texture::calendar(next()))),
            cartons: [0, 1].map(|_| Material::picture(keep(texture::carton(next())))),
            spines: (0..8).map(|_| Material::picture(keep(texture::spine(next())))).collect(),
            screen: Material::picture(keep(texture::screen(next()))),
            outside: Material::picture(keep(texture::outside(next() as u32 >> 8))),
            mirror: None,
        }
    }

    /// Polishes floor, furniture and glazes, and provides a mirror.
    pub(super) fn polish(&mut self, spec: &GlossSpec) {
        let spread = (spec.spread as f32).to_radians();
        let gloss = Gloss { reflectance: spec.polish as f32, spread };
        if gloss.reflectance > 0.0 {
            self.floor.gloss = Gloss { spread: 2.0 * spread, ..gloss };
            self.woods.iter_mut().chain(&mut self.glazes).for_each(|m| m.gloss = gloss);
        }
        let mirror = self.paint.tinted([0.02; 3]).polished(Gloss::MIRROR);
        self.mirror = spec.mirror.then_some(mirror);
    }
}

/// A colour of book covers, mugs, balls and other small things.
pub(super) fn small_colour(random: &mut Random) -> Rgb {
    const COLOURS: [u32; 12] = [
        0x8e2f2a, 0x20466b, 0x2b6350, 0xc08a2e, 0xd7c7a3, 0x3a2f4d, 0x9d5b34, 0x55707f, 0xe3dccb,
        0x1f2226, 0x6d7f3f, 0xa8443d,
    ];
    scale(one_of(random, &COLOURS), 1.0)
}
