//! Light about the mirror direction, on top of what a surface shows in all directions alike.

use super::LitScene;
use super::transport::is_open;
use crate::rgb::{Rgb, mix, plus, scale};
use crate::rng::lattice;
use crate::scene::{Emitter, Gloss, Hit, LightRole, Ray, Vec3, orthonormal_basis};

/// Most reflections along a ray.
const MAX_REFLECTIONS: usize = 3;
/// Rays into a lobe over all samples of a pixel.
const LOBE_RAYS: usize = 64;
/// Distance of ray origins from the surface [m].
const OFFSET: f32 = 1e-3;

/// Purpose number of the hash that turns lobes.
const TURN: u32 = 91;

/// Choices of one of the samples of a pixel, the same in every pixel.
pub(crate) struct Sample {
    /// Choice between two levels of textures, in [-½, ½).
    shift: f32,
    /// Places in a lobe, in standard deviations along two axes.
    lobe: Vec<[f32; 2]>,
}

impl Sample {
    /// Sample `number` of `samples`.
    pub(crate) fn new(number: usize, samples: usize, shift: f32) -> Self {
        let rays = LOBE_RAYS.div_ceil(samples);
        Self { shift, lobe: (number * rays..(number + 1) * rays).map(lobe_offset).collect() }
    }
}

/// The normal distribution along two axes (Box and Muller 1958) at a point of Halton's sequence.
fn lobe_offset(index: usize) -> [f32; 2] {
    let (u, v) = (radical_inverse(index + 1, 3), radical_inverse(index + 1, 5));
    let (sine, cosine) = (std::f64::consts::TAU * v).sin_cos();
    let radius = (-2.0 * (1.0 - u).ln()).sqrt();
    [radius * cosine, radius * sine].map(|x| x as f32)
}

/// The digits of a number behind the point, reversed.
fn radical_inverse(mut number: usize, base: usize) -> f64 {
    let (mut value, mut digit) = (0.0, 1.0 / base as f64);
    while number > 0 {
        value += (number % base) as f64 * digit;
        number /= base;
        digit /= base as f64;
    }
    value
}

/// Choices along one ray of a pixel.
#[derive(Clone, Copy)]
struct Choices<'a> {
    shift: f32,
    lobe: &'a [[f32; 2]],
    /// Column and row: every pixel turns the lobe by an angle of its own, or edges in reflections
    /// would be seen as often as there are rays.
    pixel: [usize; 2],
}

/// Where a ray meets a glossy surface.
struct Polished {
    point: Vec3,
    /// Towards the viewer.
    normal: Vec3,
    /// The mirror direction, unit length.
    mirrored: Vec3,
    gloss: Gloss,
    /// Width of the pixel here, and its growth on a unit of way [m].
    footprint: f32,
    growth: f32,
}

impl LitScene {
    /// Radiance towards the origin of a ray at its hit, `(1 - F) L + F ∫ p(ω) L(ω) dω`: matt light,
    /// and light from about the mirror direction, distributed normally, with Schlick's `F`.
    /// `footprint` is the width of a pixel there [m], `pixel` its column and row.
    #[inline]
    pub(crate) fn radiance(
        &self,
        (ray, hit): (&Ray, &Hit),
        footprint: f32,
        sample: &Sample,
        pixel: [usize; 2],
    ) -> Rgb {
        let choices = Choices { shift: sample.shift, lobe: &sample.lobe, pixel };
        self.radiance_at(ray, hit, footprint, choices, MAX_REFLECTIONS)
    }

    #[inline]
    fn radiance_at(
        &self,
        ray: &Ray,
        hit: &Hit,
        footprint: f32,
        choices: Choices<'_>,
        reflections: usize,
    ) -> Rgb {
        let matt = self.matt_radiance(hit, footprint, choices.shift);
        let gloss = self.scene.surfaces[hit.surface].material.gloss;
        if gloss.reflectance == 0.0 || reflections == 0 {
            return matt;
        }
        let (share, place) = self.polished(ray, hit, footprint, gloss);
        let reflected = self.reflected(&place, choices, reflections - 1);
        mix(matt, reflected, share)
    }

    /// The reflected share, and the geometry of the reflection.
    fn polished(&self, ray: &Ray, hit: &Hit, footprint: f32, gloss: Gloss) -> (f32, Polished) {
        let length = ray.direction.norm();
        let towards = ray.direction * length.recip();
        let outward = self.scene.surfaces[hit.surface].shape.at(hit.st).1;
        let normal = if outward.dot(towards) > 0.0 { -outward } else { outward };
        let cosine = -normal.dot(towards);
        let place = Polished {
            point: ray.origin + ray.direction * hit.t + normal * OFFSET,
            normal,
            mirrored: towards + normal * (2.0 * cosine),
            gloss,
            footprint,
            growth: footprint / (hit.t * length) + gloss.spread,
        };
        (gloss.fresnel(cosine), place)
    }

    /// Mean radiance over the lobe. Lamps are small and bright: their share of a lobe is computed,
    /// not met by chance.
    fn reflected(&self, place: &Polished, choices: Choices<'_>, reflections: usize) -> Rgb {
        let Gloss { spread, .. } = place.gloss;
        if spread == 0.0 {
            return self.along(place, place.mirrored, choices, reflections);
        }
        let (x, y) = turned_basis(place.mirrored, choices.pixel);
        let one = Choices { lobe: &choices.lobe[..1], ..choices };
        let mut sum = [0.0; 3];
        for [a, b] in choices.lobe {
            let direction = place.mirrored + x * (spread * a) + y * (spread * b);
            sum = plus(sum, self.along(place, direction, one, reflections));
        }
        plus(scale(sum, 1.0 / choices.lobe.len() as f32), self.lamps_in_lobe(place))
    }

    /// Radiance that arrives along a direction; of lamps only where the image is clear.
    fn along(
        &self,
        place: &Polished,
        direction: Vec3,
        choices: Choices<'_>,
        reflections: usize,
    ) -> Rgb {
        // Parts of a lobe below the surface are folded up.
        let below = direction.dot(place.normal).min(0.0);
        let direction = direction - place.normal * (2.0 * below);
        let direction = direction * direction.norm().recip();
        let ray = Ray { origin: place.point, direction, from: 0.0, to: f32::INFINITY };
        let Some(hit) = self.scene.first_hit(&ray) else { return [0.0; 3] };
        let role = self.scene.surfaces[hit.surface].material.role;
        if role == LightRole::Lamp && place.gloss.spread > 0.0 {
            return [0.0; 3];
        }
        let footprint = place.footprint + place.growth * hit.t;
        self.radiance_at(&ray, &hit, footprint, choices, reflections)
    }

    fn lamps_in_lobe(&self, place: &Polished) -> Rgb {
        let mut sum = [0.0; 3];
        for emitter in &self.scene.emitters {
            let Emitter::Ball { centre, radius, radiance } = *emitter else { continue };
            let towards = centre - place.point;
            let share = share_of_lobe(place, towards, radius);
            if share > 1e-6 && is_open(&self.scene, place.point, towards) {
                sum = plus(sum, scale(radiance, self.gain * share));
            }
        }
        sum
    }
}

/// Two unit vectors orthogonal to a unit vector, turned by an angle that the pixel chooses.
fn turned_basis(axis: Vec3, [column, row]: [usize; 2]) -> (Vec3, Vec3) {
    let (x, y) = orthonormal_basis(axis);
    let angle = std::f32::consts::TAU * lattice(column as i32, row as i32, TURN);
    let (sine, cosine) = angle.sin_cos();
    (x * cosine + y * sine, y * cosine - x * sine)
}

/// Share of a lobe that a ball takes, `min(1, ρ²/2s² exp(-δ²/2s²))`, `s² = σ² + ρ²/4`: the density
/// of the lobe, widened by the disc of angular radius `ρ`, at the angle `δ` between disc and mirror
/// direction, times the disc's solid angle.
fn share_of_lobe(place: &Polished, towards: Vec3, radius: f32) -> f32 {
    if towards.dot(place.normal) <= 0.0 {
        return 0.0;
    }
    let disc = radius / towards.norm();
    let cross = place.mirrored.cross(towards).norm();
    let angle = cross.atan2(place.mirrored.dot(towards));
    let variance = place.gloss.spread.powi(2) + 0.25 * disc * disc;
    (0.5 * disc * disc / variance * (-0.5 * angle * angle / variance).exp()).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::compute_light;
    use crate::scene::{Surface, furnished_room};
    use crate::spec::Spec;

    fn place(spread: f32) -> Polished {
        Polished {
            point: Vec3::zero(),
            normal: Vec3::new(0.0, 0.0, 1.0),
            mirrored: Vec3::new(0.0, 0.6, 0.8),
            gloss: Gloss { reflectance: 0.04, spread },
            footprint: 0.0,
            growth: 0.0,
        }
    }

    /// Against directions drawn from the lobe, which are counted.
    #[test]
    fn a_lamp_takes_its_share_of_the_lobe() {
        let (mirrored, spread) = (place(0.0).mirrored, 0.05);
        let (x, y) = orthonormal_basis(mirrored);
        for (radius, off) in [(0.02_f32, 0.0_f32), (0.02, 0.06), (0.05, 0.03), (0.05, 0.1)] {
            let towards = (mirrored + x * off.tan()) * 2.0;
            let towards = towards * (2.0 / towards.norm());
            let draws = 20_000;
            let met = (0..draws).filter(|&i| {
                let [a, b] = lobe_offset(i);
                let direction = mirrored + x * (spread * a) + y * (spread * b);
                let cosine = direction.dot(towards) / (2.0 * direction.norm());
                cosine > (radius / 2.0).atan().cos()
            });
            let counted = met.count() as f32 / draws as f32;
            let found = share_of_lobe(&place(spread), towards, radius);
            assert!(
                (found - counted).abs() < 0.1 * counted + 2e-3,
                "{radius} {off}: {found} {counted}"
            );
        }
        assert_eq!(share_of_lobe(&place(0.0), mirrored * 2.0, 0.1), 1.0, "a mirror shows the lamp");
        assert_eq!(share_of_lobe(&place(spread), -mirrored, 0.1), 0.0, "below the surface");
    }

    /// A room with a mirror on polished floor, in coarse light.
    fn polished_room() -> LitScene {
        let mut spec = Spec { seed: 2, ..Spec::default() };
        (spec.light.texel, spec.gloss.polish, spec.gloss.mirror) = (0.3, 0.06, true);
        compute_light(furnished_room(&spec), &spec)
    }

    #[test]
    fn a_mirror_shows_what_lies_in_the_mirror_direction() {
        let lit = polished_room();
        let is_mirror = |s: &Surface| s.material.gloss == Gloss::MIRROR;
        let mirror = lit.scene.surfaces.iter().find(|s| is_mirror(s)).expect("a mirror");
        let sample = Sample::new(0, 1, 0.0);
        for st in [[0.3, 0.4], [0.6, 0.2], [0.5, 0.8]] {
            let (point, normal) = mirror.shape.at(st);
            let side = orthonormal_basis(normal).0;
            let away = (normal + side * 0.4) * 0.9;
            let ray = Ray { origin: point + away, direction: -away, from: 0.0, to: 2.0 };
            let hit = lit.scene.first_hit(&ray).expect("the mirror");
            assert!(is_mirror(&lit.scene.surfaces[hit.surface]));
            let seen = lit.radiance((&ray, &hit), 1e-3, &sample, [3, 5]);
            let direction = normal - side * 0.4;
            let origin = point + normal * OFFSET;
            let ray = Ray { origin, direction, from: 0.0, to: f32::INFINITY };
            let hit = lit.scene.first_hit(&ray).expect("the room");
            let there = lit.radiance((&ray, &hit), 1e-3, &sample, [3, 5]);
            for channel in 0..3 {
                let (seen, there) = (seen[channel], there[channel]);
                assert!(seen > 0.85 * there && seen < 1.0 * there + 0.05, "{seen} {there}");
            }
        }
    }

    #[test]
    fn a_polished_floor_changes_its_colour_with_the_direction_of_view() {
        let lit = polished_room();
        let sample = Sample::new(0, 1, 0.0);
        // The first surface of a room is its floor.
        let (point, normal) = lit.scene.surfaces[0].shape.at([0.2, 0.5]);
        let side = orthonormal_basis(normal).0;
        let view = |towards: Vec3| {
            let ray = Ray { origin: point + towards, direction: -towards, from: 0.0, to: 2.0 };
            let hit = lit.scene.first_hit(&ray).filter(|hit| hit.surface == 0)?;
            Some(lit.radiance((&ray, &hit), 1e-3, &sample, [3, 5])[1])
        };
        let views = (0..8).filter_map(|i| view((normal + side * (0.4 * i as f32)) * 0.1));
        let views: Vec<f32> = views.collect();
        let (low, high) = views.iter().fold((f32::MAX, 0.0_f32), |(a, b), &v| (a.min(v), b.max(v)));
        assert!(views.len() > 5 && high > 1.1 * low, "{views:?}");
    }

    #[test]
    fn samples_of_a_pixel_fill_the_lobe_together() {
        let all = (0..9).flat_map(|number| Sample::new(number, 9, 0.0).lobe);
        let all: Vec<[f32; 2]> = all.collect();
        assert_eq!(all.len(), 72);
        for axis in 0..2 {
            let mean = all.iter().map(|o| o[axis]).sum::<f32>() / 72.0;
            let variance = all.iter().map(|o| o[axis] * o[axis]).sum::<f32>() / 72.0;
            assert!(mean.abs() < 0.15 && (variance - 1.0).abs() < 0.25, "{mean} {variance}");
        }
        assert_eq!(Sample::new(3, 64, 0.0).lobe.len(), 1);
    }
}
