//! Construction of surfaces: blocks, quads, discs, balls, frustums.

use super::{Emitter, Gloss, LightRole, Material, Shape, Surface, Vec3};
use crate::rgb::{Rgb, scale};
use crate::texture::Texture;
use i2slam_compute::Random;

/// Local frame of an object: x right, y away from the viewer, z up.
#[derive(Clone, Copy, Debug)]
pub(super) struct LocalFrame {
    pub(super) origin: Vec3,
    /// Direction of local x [rad], from the world's x axis.
    pub(super) yaw: f32,
}

impl LocalFrame {
    pub(super) fn new(x: f32, y: f32, yaw: f32) -> Self {
        Self { origin: Vec3::new(x, y, 0.0), yaw }
    }

    /// A local direction in the world.
    pub(super) fn turn(&self, [x, y, z]: [f32; 3]) -> Vec3 {
        let (s, c) = self.yaw.sin_cos();
        Vec3::new(c * x - s * y, s * x + c * y, z)
    }

    /// A local point in the world.
    pub(super) fn point(&self, local: [f32; 3]) -> Vec3 {
        self.origin + self.turn(local)
    }

    /// A place on top of, or beside, this one.
    pub(super) fn at(&self, local: [f32; 3], turn: f32) -> Self {
        Self { origin: self.point(local), yaw: self.yaw + turn }
    }
}

impl Material {
    /// Tiled paint.
    pub(super) fn tiled(texture: usize, tile: f32, tint: Rgb) -> Self {
        Self { tile: Some(tile), tint, ..Self::picture(texture) }
    }

    /// A picture over the whole surface.
    pub(super) fn picture(texture: usize) -> Self {
        let (tint, role) = ([1.0; 3], LightRole::Matt);
        Self { texture, tint, tile: None, role, radiance: 0.0, gloss: Gloss::MATT }
    }

    /// Replaces the tint.
    pub(super) fn tinted(self, tint: Rgb) -> Self {
        Self { tint, ..self }
    }

    /// Gives the material a lobe of reflected light.
    pub(super) fn polished(self, gloss: Gloss) -> Self {
        Self { gloss, ..self }
    }

    /// Makes the material emit light.
    pub(super) fn emitting(self, role: LightRole, radiance: f32) -> Self {
        Self { role, radiance, ..self }
    }
}

/// Surfaces, textures and lights of a room under construction.
pub(super) struct Builder {
    pub(super) surfaces: Vec<Surface>,
    pub(super) textures: Vec<Texture>,
    pub(super) emitters: Vec<Emitter>,
    /// Chooses sizes, colours and places.
    pub(super) random: Random,
}

impl Builder {
    /// An empty room.
    pub(super) fn new(random: Random) -> Self {
        Self { surfaces: Vec::new(), textures: Vec::new(), emitters: Vec::new(), random }
    }

    /// Adds a texture and returns its index.
    pub(super) fn texture(&mut self, texture: Texture) -> usize {
        self.textures.push(texture);
        self.textures.len() - 1
    }

    /// Adds a shape. Tiles start at an offset that depends on the number of surfaces, so that equal
    /// boards differ, unless `start` [m] is given.
    pub(super) fn add(&mut self, shape: Shape, material: Material, start: Option<[f32; 2]>) {
        let extent = shape.extent();
        let size = self.textures[material.texture].size as f32;
        let (repeats, texels) = match material.tile {
            Some(tile) => (extent.map(|e| e / tile), size / tile),
            None => ([1.0; 2], size / extent[0].max(extent[1])),
        };
        let golden = self.surfaces.len() as f32 * 0.618_034;
        let start = match (material.tile, start) {
            (Some(tile), Some(start)) => start.map(|s| s / tile),
            (Some(_), None) => [golden.fract(), (golden * 1.7).fract()],
            (None, _) => [0.0; 2],
        };
        self.surfaces.push(Surface { shape, material, repeats, start, texels_per_metre: texels });
    }

    /// A rectangle from its upper left corner.
    pub(super) fn quad(&mut self, origin: Vec3, right: Vec3, down: Vec3, material: Material) {
        self.add(Shape::quad(origin, right, down, false), material, None);
    }

    /// A rectangle from its local upper left corner.
    pub(super) fn panel(
        &mut self,
        place: &LocalFrame,
        [corner, right, down]: [[f32; 3]; 3],
        material: Material,
    ) {
        self.quad(place.point(corner), place.turn(right), place.turn(down), material);
    }

    /// A block between two local corners with another material on its `front`.
    pub(super) fn block_with_front(
        &mut self,
        place: &LocalFrame,
        low: [f32; 3],
        high: [f32; 3],
        sides: Material,
        front: Material,
    ) {
        let d: [f32; 3] = std::array::from_fn(|i| high[i] - low[i]);
        let mut face = |corner: [f32; 3], right: [f32; 3], down: [f32; 3], material: Material| {
            self.panel(place, [corner, right, down], material);
        };
        let down = [0.0, 0.0, -d[2]];
        let [x0, y0, z0] = low;
        let [x1, y1, z1] = high;
        face([x0, y0, z1], [d[0], 0.0, 0.0], down, front);
        face([x1, y1, z1], [-d[0], 0.0, 0.0], down, sides);
        face([x0, y1, z1], [0.0, -d[1], 0.0], down, sides);
        face([x1, y0, z1], [0.0, d[1], 0.0], down, sides);
        face([x0, y1, z1], [d[0], 0.0, 0.0], [0.0, -d[1], 0.0], sides);
        if z0 + place.origin.z > 0.02 {
            face([x0, y0, z0], [d[0], 0.0, 0.0], [0.0, d[1], 0.0], sides);
        }
    }

    /// A block of one material.
    pub(super) fn block(
        &mut self,
        place: &LocalFrame,
        low: [f32; 3],
        high: [f32; 3],
        material: Material,
    ) {
        self.block_with_front(place, low, high, material, material);
    }

    /// An upright frustum from `z0` to `z1` with its ends.
    pub(super) fn frustum(
        &mut self,
        place: &LocalFrame,
        [z0, z1]: [f32; 2],
        radii: [f32; 2],
        material: Material,
    ) {
        self.tube(place, [z0, z1], radii, material);
        for (z, radius, side) in [(z1, radii[1], 1.0), (z0, radii[0], -1.0)] {
            if radius > 0.0 && !(side < 0.0 && place.origin.z + z0 < 0.02) {
                let corner = place.point([-radius, side * radius, z]);
                let right = place.turn([2.0 * radius, 0.0, 0.0]);
                let down = place.turn([0.0, -side * 2.0 * radius, 0.0]);
                self.add(Shape::quad(corner, right, down, true), material, None);
            }
        }
    }

    /// An upright frustum without ends.
    pub(super) fn tube(
        &mut self,
        place: &LocalFrame,
        [z0, z1]: [f32; 2],
        radii: [f32; 2],
        material: Material,
    ) {
        let base = place.point([0.0, 0.0, z0]);
        self.add(Shape::Frustum { base, height: z1 - z0, radii }, material, None);
    }

    /// A ball.
    pub(super) fn ball(&mut self, centre: Vec3, radius: f32, material: Material) {
        self.add(Shape::Ball { centre, radius }, material, None);
    }

    /// A bulb that lights the room.
    pub(super) fn bulb(
        &mut self,
        centre: Vec3,
        radius: f32,
        material: Material,
        colour: Rgb,
        radiance: f32,
    ) {
        self.ball(centre, radius, material.tinted(colour).emitting(LightRole::Lamp, radiance));
        self.emitters.push(Emitter::Ball { centre, radius, radiance: scale(colour, radiance) });
    }
}
