//! Light on surfaces, computed once: direct light with soft shadows, then reflections.

mod atlas;
mod gloss;
mod transport;

use crate::rgb::{Rgb, luminance, plus, scale, times};
use crate::scene::{Hit, LightRole, Scene};
use crate::spec::Spec;
use atlas::Atlas;
pub(crate) use gloss::Sample;
use transport::{direct_light, reflected_light};

/// Number of reflections.
const BOUNCES: usize = 3;
/// Size of the texels of reflected light relative to those of direct light.
const REFLECTED_TEXEL_RATIO: f32 = 5.0;
/// Median radiance of a lit room, for which exposures with the Reinhard response are near 1.
const MEDIAN_RADIANCE: f32 = 0.28;

/// A scene with precomputed light, so that radiance is a lookup.
pub(crate) struct LitScene {
    pub(crate) scene: Scene,
    light: Atlas,
    /// Factor from computed light to output radiance.
    gain: f32,
    /// Radiance of a white pixel of the outside.
    outside: f32,
}

impl LitScene {
    /// Radiance leaving the surface at a hit without gloss (the same in all directions), for a
    /// footprint [m].
    #[inline]
    fn matt_radiance(&self, hit: &Hit, footprint: f32, shift: f32) -> Rgb {
        let surface = &self.scene.surfaces[hit.surface];
        let colour = self.scene.colour(surface, hit.st, footprint, shift);
        match surface.material.role {
            LightRole::Matt => {
                let light = self.light.sample(hit.surface, hit.st);
                scale(times(colour, light), self.gain * std::f32::consts::FRAC_1_PI)
            }
            LightRole::Pane => scale(colour, self.outside),
            LightRole::Glow | LightRole::Lamp => {
                scale(colour, self.gain * surface.material.radiance)
            }
        }
    }
}

/// Computes the light of a scene.
pub(crate) fn compute_light(scene: Scene, spec: &Spec) -> LitScene {
    let texel = spec.light.texel as f32;
    let sun = scale([1.0, 0.93, 0.80], spec.light.sun as f32);
    let mut direct = Atlas::new(&scene, texel);
    let patches = direct.patches.clone();
    direct.fill(&scene, |surface, index, st, [column, row]| {
        let number = patches[index].first + row * patches[index].width + column;
        direct_light(&scene, surface.shape.at(st), sun, spec.seed, number as u64)
    });
    let mut reflected = Atlas::new(&scene, REFLECTED_TEXEL_RATIO * texel);
    for _ in 0..BOUNCES {
        let mut next = Atlas::new(&scene, REFLECTED_TEXEL_RATIO * texel);
        next.fill(&scene, |surface, _, st, place| {
            reflected_light(&scene, (&direct, &reflected), surface.shape.at(st), place)
        });
        next.smooth(2);
        next.values.iter_mut().for_each(|v| *v = scale(*v, spec.light.reflections as f32));
        reflected = next;
    }
    let mut light = Atlas::new(&scene, texel);
    light.fill(&scene, |_, index, st, [column, row]| {
        let patch = patches[index];
        let own = direct.values[patch.first + row * patch.width + column];
        plus(own, reflected.sample(index, st))
    });
    scale_light(scene, light, spec)
}

/// Scales light to a median room radiance, and the outside relative to it.
fn scale_light(scene: Scene, light: Atlas, spec: &Spec) -> LitScene {
    let mut levels: Vec<(f32, f32)> = Vec::new();
    for (index, surface) in scene.surfaces.iter().enumerate() {
        let patch = light.patches[index];
        let [width, height] = surface.shape.extent();
        let area = width * height / (patch.width * patch.height) as f32;
        if surface.material.role == LightRole::Matt {
            let colour = scene.mean_colour(surface);
            let texels = &light.values[patch.first..patch.first + patch.width * patch.height];
            levels.extend(texels.iter().map(|&e| (luminance(times(colour, e)), area)));
        }
    }
    levels.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * levels.iter().map(|l| f64::from(l.1)).sum::<f64>();
    let mut below = 0.0;
    let median = levels.iter().find(|level| {
        below += f64::from(level.1);
        below >= half
    });
    let median = median.map_or(1.0, |level| level.0) * std::f32::consts::FRAC_1_PI;
    let pane = scene.surfaces.iter().find(|s| s.material.role == LightRole::Pane);
    let bright = pane.map_or(1.0, |pane| luminance(scene.mean_colour(pane)));
    let outside = MEDIAN_RADIANCE * (spec.light.window_stops as f32).exp2() / bright;
    LitScene { gain: MEDIAN_RADIANCE / median.max(1e-9), outside, scene, light }
}
