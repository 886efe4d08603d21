//! Light that arrives from other surfaces.

use super::atlas::Atlas;
use super::direct::across;
use crate::rgb::{Rgb, plus, scale, times};
use crate::rng::lattice;
use crate::scene::{Ray, Role, Scene, Vec3};

/// Rays over the hemisphere.
const RAYS: usize = 64;

/// Irradiance from what is seen over the hemisphere, given the light there. Neighbouring texels
/// turn the same rays differently; [`Atlas::smooth`] over four texels a side evens them out.
pub(super) fn reflected_light(
    scene: &Scene,
    (direct, reflected): (&Atlas, &Atlas),
    (point, normal): (Vec3, Vec3),
    texel: [usize; 2],
) -> Rgb {
    let (x, y) = across(normal);
    let origin = point + normal * 1e-3;
    let turn = lattice((texel[0] % 4) as i32, (texel[1] % 4) as i32, 77);
    let shift = lattice((texel[0] % 4) as i32, (texel[1] % 4) as i32, 78);
    let mut sum = [0.0; 3];
    for ray in 0..RAYS {
        // Cosine-weighted directions on a golden spiral: E = π/N Σ L.
        let height = (ray as f32 + shift) / RAYS as f32;
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
            match surface.skin.role {
                // Counted as direct light.
                Role::Lamp | Role::Pane => [0.0; 3],
                Role::Glow => scale(colour, surface.skin.radiance * std::f32::consts::PI),
                Role::Matt => {
                    let light = direct.nearest(hit.surface, hit.st);
                    times(colour, plus(light, reflected.nearest(hit.surface, hit.st)))
                }
            },
        );
    }
    scale(sum, 1.0 / RAYS as f32)
}
