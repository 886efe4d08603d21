//! Rooms: geometry, materials and ray casting.

mod builder;
mod bvh;
mod furniture;
mod gloss;
mod library;
mod objects;
mod room;
mod shape;
mod still_life;

use crate::rgb::Rgb;
use crate::texture::{Decoder, Texture};
pub(crate) use bvh::Bvh;
pub(crate) use gloss::Gloss;
pub(crate) use room::furnished_room;
pub(crate) use shape::{Hit, Ray, Shape, orthonormal_basis};
pub(crate) use still_life::MIDDLE as STILL_LIFE_MIDDLE;

/// Points and directions in the world.
pub(crate) type Vec3 = i2slam_geometry::Vec3<f32>;

/// LightRole of a surface in light transport.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum LightRole {
    /// Reflects (Lambert).
    Matt,
    /// Emits light that is found by hemisphere rays: glowing shades, displays.
    Glow,
    /// Emits light that is sampled as an [`Emitter`]: bulbs.
    Lamp,
    /// A window pane: shows the outside and lets the sun in.
    Pane,
}

/// Texture mapping and material of a surface.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Material {
    /// Index of the texture.
    pub(crate) texture: usize,
    /// Factor on its colours.
    pub(crate) tint: Rgb,
    /// Side of one repetition [m]; `None`: stretched over the surface once.
    pub(crate) tile: Option<f32>,
    /// LightRole in light transport.
    pub(crate) role: LightRole,
    /// Radiance of white, for emitters.
    pub(crate) radiance: f32,
    /// Light reflected about the mirror direction, on top of the diffuse light.
    pub(crate) gloss: Gloss,
}

/// A shape with its material.
pub(crate) struct Surface {
    pub(crate) shape: Shape,
    pub(crate) material: Material,
    /// Repetitions of the texture over the surface.
    pub(crate) repeats: [f32; 2],
    /// Texture coordinates of the surface's origin [repetitions].
    pub(crate) start: [f32; 2],
    /// Texels of level 0 per metre.
    pub(crate) texels_per_metre: f32,
}

/// A source of light that is sampled.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Emitter {
    /// A rectangle that shines to the side of `normal`.
    Rectangle { origin: Vec3, edges: [Vec3; 2], normal: Vec3, radiance: Rgb },
    /// A ball.
    Ball { centre: Vec3, radius: f32, radiance: Rgb },
}

/// Place of the desk at its wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct DeskPlace {
    /// Foot of the wall behind the desk's middle [m].
    pub(crate) x: f64,
    pub(crate) y: f64,
    /// Direction along the wall to the right, for one who faces it [rad].
    pub(crate) yaw: f64,
}

impl DeskPlace {
    /// A point of the floor before the desk, `along` the wall to the right of its middle and
    /// `away` from the wall [m].
    pub(crate) fn at(&self, along: f64, away: f64) -> [f64; 2] {
        let (sine, cosine) = self.yaw.sin_cos();
        [self.x + cosine * along + sine * away, self.y + sine * along - cosine * away]
    }
}

/// A furnished room.
pub(crate) struct Scene {
    pub(crate) surfaces: Vec<Surface>,
    pub(crate) textures: Vec<Texture>,
    pub(crate) decoder: Decoder,
    pub(crate) emitters: Vec<Emitter>,
    pub(crate) bvh: Bvh,
    /// Towards the sun, unit length.
    pub(crate) sun: Option<Vec3>,
    pub(crate) desk: DeskPlace,
}

impl Scene {
    /// The first surface along a ray, between its ends.
    #[inline]
    pub(crate) fn first_hit(&self, ray: &Ray) -> Option<Hit> {
        self.bvh.first_hit(ray)
    }

    /// Colour of the material at `(s, t)` of a surface, read for a footprint [m]; `shift` in
    /// [-½, ½) chooses between two levels, so that averages over samples blend them.
    #[inline]
    pub(crate) fn colour(
        &self,
        surface: &Surface,
        st: [f32; 2],
        footprint: f32,
        shift: f32,
    ) -> Rgb {
        let u = surface.start[0] + st[0] * surface.repeats[0];
        let v = surface.start[1] + st[1] * surface.repeats[1];
        let texels = (footprint * surface.texels_per_metre).max(1e-6);
        // The bits of a float are its logarithm, straight between powers of two: near enough.
        let logarithm = texels.to_bits() as f32 * (1.0 / (1 << 23) as f32) - 127.0;
        // Several samples are averaged in every pixel: half a level sharper than one sample needs,
        // which cancels the half that rounding would add.
        let level = (logarithm + shift).max(0.0) as i32;
        let colour = self.textures[surface.material.texture].sample(&self.decoder, u, v, level);
        crate::rgb::times(colour, surface.material.tint)
    }

    /// Mean colour of a surface.
    pub(crate) fn mean_colour(&self, surface: &Surface) -> Rgb {
        crate::rgb::times(self.textures[surface.material.texture].mean, surface.material.tint)
    }
}
