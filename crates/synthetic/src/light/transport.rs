//! Direct light from lamps, windows and the sun, and one reflection of it.

use super::atlas::Atlas;
use crate::rgb::{Rgb, plus, scale, times};
use crate::rng::{between32, lattice, stream};
use crate::scene::{Emitter, LightRole, Ray, Scene, Vec3, orthonormal_basis};
use i2slam_compute::Random;

/// Shadow rays to each light source.
const EMITTER_SAMPLES: usize = 16;
/// Rays towards the sun.
const SUN_SAMPLES: usize = 8;
/// Radius of the sun with its haze [rad]: blurs the edges of its patches.
const SUN_RADIUS: f32 = 0.012;
/// Distance of ray origins from the surface [m].
const OFFSET: f32 = 1e-3;

/// Irradiance at a point, without reflections. `number` seeds the choice of sample points.
pub(super) fn direct_light(
    scene: &Scene,
    (point, normal): (Vec3, Vec3),
    sun: Rgb,
    seed: u64,
    number: u64,
) -> Rgb {
    let mut random = stream(seed, 11, number);
    let origin = point + normal * OFFSET;
    let mut sum = sunlight(scene, origin, normal, sun, &mut random);
    for emitter in &scene.emitters {
        sum = plus(sum, from_emitter(scene, origin, normal, emitter, &mut random));
    }
    sum
}

pub(super) fn is_open(scene: &Scene, origin: Vec3, towards: Vec3) -> bool {
    let ray = Ray { origin, direction: towards, from: 0.0, to: 0.9995 };
    let lets_through = |role| matches!(role, LightRole::Lamp | LightRole::Pane);
    scene.first_hit(&ray).is_none_or(|hit| lets_through(scene.surfaces[hit.surface].material.role))
}

/// `E = 1/N Σ L cos θ cos θ' A / r²` over points of the source.
fn from_emitter(
    scene: &Scene,
    origin: Vec3,
    normal: Vec3,
    emitter: &Emitter,
    random: &mut Random,
) -> Rgb {
    let (side, mut sum) = ((EMITTER_SAMPLES as f32).sqrt() as usize, 0.0);
    let radiance = match *emitter {
        Emitter::Rectangle { radiance, .. } | Emitter::Ball { radiance, .. } => radiance,
    };
    if !is_facing(origin, normal, emitter) {
        return [0.0; 3];
    }
    for sample in 0..side * side {
        let a = ((sample % side) as f32 + random.uniform() as f32) / side as f32;
        let b = ((sample / side) as f32 + random.uniform() as f32) / side as f32;
        let (towards, area) = sample_emitter(origin, emitter, a, b);
        let distance2 = towards.norm_squared();
        let direction = towards * distance2.sqrt().recip();
        let cosine = normal.dot(direction);
        let facing = match *emitter {
            Emitter::Rectangle { normal, .. } => -normal.dot(direction),
            Emitter::Ball { .. } => 1.0,
        };
        if cosine > 0.0 && facing > 0.0 && is_open(scene, origin, towards) {
            sum += cosine * facing * area / distance2.max(0.01);
        }
    }
    scale(radiance, sum / (side * side) as f32)
}

/// Whether any corner of the source lies in front of the surface.
fn is_facing(origin: Vec3, normal: Vec3, emitter: &Emitter) -> bool {
    match *emitter {
        Emitter::Rectangle { origin: o, edges: [e, f], .. } => {
            [o, o + e, o + f, o + e + f].into_iter().any(|p| normal.dot(p - origin) > 0.0)
        }
        Emitter::Ball { centre, radius, .. } => normal.dot(centre - origin) > -radius,
    }
}

/// Vector to a sample point of the source, and the area that the sample represents.
fn sample_emitter(origin: Vec3, emitter: &Emitter, a: f32, b: f32) -> (Vec3, f32) {
    match *emitter {
        Emitter::Rectangle { origin: o, edges: [e, f], .. } => {
            (o + e * a + f * b - origin, e.norm() * f.norm())
        }
        Emitter::Ball { centre, radius, .. } => {
            let axis = centre - origin;
            let (x, y) = orthonormal_basis(axis * axis.norm().recip());
            let (sine, cosine) = (std::f32::consts::TAU * b).sin_cos();
            let r = radius * a.sqrt();
            (axis + x * (r * cosine) + y * (r * sine), std::f32::consts::PI * radius * radius)
        }
    }
}

fn sunlight(scene: &Scene, origin: Vec3, normal: Vec3, sun: Rgb, random: &mut Random) -> Rgb {
    let Some(towards) = scene.sun else { return [0.0; 3] };
    let cosine = normal.dot(towards);
    if cosine <= 0.0 {
        return [0.0; 3];
    }
    let (x, y) = orthonormal_basis(towards);
    let mut open = 0;
    for _ in 0..SUN_SAMPLES {
        let mut draw = || between32(random, -SUN_RADIUS, SUN_RADIUS);
        let direction = towards + x * draw() + y * draw();
        let ray = Ray { origin, direction, from: 0.0, to: f32::INFINITY };
        let through =
            |hit: crate::scene::Hit| scene.surfaces[hit.surface].material.role == LightRole::Pane;
        open += usize::from(scene.first_hit(&ray).is_some_and(through));
    }
    scale(sun, cosine * open as f32 / SUN_SAMPLES as f32)
}

/// Rays over the hemisphere.
const HEMISPHERE_RAYS: usize = 64;

/// Irradiance from all other surfaces over the hemisphere, given the light on them. Neighbouring
/// texels rotate the same rays differently; [`Atlas::smooth`] over four texels a side averages them.
pub(super) fn reflected_light(
    scene: &Scene,
    (direct, reflected): (&Atlas, &Atlas),
    (point, normal): (Vec3, Vec3),
    texel: [usize; 2],
) -> Rgb {
    let (x, y) = orthonormal_basis(normal);
    let origin = point + normal * 1e-3;
    let turn = lattice((texel[0] % 4) as i32, (texel[1] % 4) as i32, 77);
    let shift = lattice((texel[0] % 4) as i32, (texel[1] % 4) as i32, 78);
    let mut sum = [0.0; 3];
    for ray in 0..HEMISPHERE_RAYS {
        // Cosine-weighted directions on a golden spiral: E = π/N Σ L.
        let height = (ray as f32 + shift) / HEMISPHERE_RAYS as f32;
        let (sine, cosine) = (std::f32::consts::TAU * (turn + ray as f32 * 0.618_034)).sin_cos();
        let flat = height.sqrt();
        let up = normal * (1.0 - height).max(0.0).sqrt();
        let direction = up + x * (flat * cosine) + y * (flat * sine);
        let ray = Ray { origin, direction, from: 0.0, to: f32::INFINITY };
        let Some(hit) = scene.first_hit(&ray) else { continue };
        let surface = &scene.surfaces[hit.surface];
        let colour = scene.mean_colour(surface);
        sum = plus(
            sum,
            match surface.material.role {
                // These are sampled as direct light.
                LightRole::Lamp | LightRole::Pane => [0.0; 3],
                LightRole::Glow => scale(colour, surface.material.radiance * std::f32::consts::PI),
                LightRole::Matt => {
                    let light = direct.nearest(hit.surface, hit.st);
                    times(colour, plus(light, reflected.nearest(hit.surface, hit.st)))
                }
            },
        );
    }
    scale(sum, 1.0 / HEMISPHERE_RAYS as f32)
}
