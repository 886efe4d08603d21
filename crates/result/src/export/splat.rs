//! Gaussians as viewers of 3D Gaussian splatting expect them (Kerbl et al. 2023).

use super::harmonics;
use i2slam::formation::{FrameTone, ResponseCurve};
use i2slam::geometry::{Pose, Rotation, Vec3};
use i2slam::radiance::gaussian::{GaussianMap, Shape};
use rayon::prelude::*;

/// The zeroth real spherical harmonic, `1 / (2 √π)`: colour = 0.5 + C0 · f_dc.
pub(crate) const HARMONIC_ZERO: f32 = 0.282_094_8;

/// One Gaussian as viewers expect it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Splat {
    /// Mean [m].
    pub mean: [f32; 3],
    /// Colour: a picture value from 0 to 1, or linear radiance; on the axis of the directions from
    /// which it was seen.
    pub colour: [f32; 3],
    /// Coefficients of harmonics whose sum is the colour less 0.5, where it depends on the direction.
    pub view: Option<[[f32; 3]; harmonics::COUNT]>,
    /// Logit of the opacity.
    pub opacity_logit: f32,
    /// Natural logarithms of the standard deviations [log m].
    pub log_scale: [f32; 3],
    /// World-from-Gaussian unit quaternion `w, x, y, z`.
    pub rotation: [f32; 4],
}

/// How radiance becomes the colour of a file.
pub enum Display {
    /// As a picture: with exposure, white balance and response, cut to `[0, 1]`. None with `tone`
    /// off, where radiance is picture values already.
    Formed(Option<(FrameTone<f32>, ResponseCurve<f32>)>),
    /// Linear radiance as it is.
    Linear,
}

impl Display {
    /// The colour of a radiance.
    pub(crate) fn colour(&self, radiance: [f32; 3]) -> [f32; 3] {
        match self {
            Self::Linear => radiance,
            Self::Formed(None) => radiance.map(|v| v.clamp(0.0, 1.0)),
            Self::Formed(Some((tone, curve))) => {
                let gains = tone.gains();
                std::array::from_fn(|c| curve.evaluate(c, gains[c] * radiance[c]).clamp(0.0, 1.0))
            }
        }
    }
}

impl Splat {
    /// The harmonic coefficients of its colour.
    pub(crate) fn harmonics(&self) -> [[f32; 3]; harmonics::COUNT] {
        self.view.unwrap_or_else(|| {
            let mut constant = [[0.0; 3]; harmonics::COUNT];
            constant[0] = self.colour.map(|c| (c - 0.5) / HARMONIC_ZERO);
            constant
        })
    }

    /// The colour seen from a point, as viewers show it: not below 0.
    pub(crate) fn colour_from(&self, origin: Vec3<f64>) -> [f32; 3] {
        let Some(view) = &self.view else { return self.colour };
        let ray = Vec3::from_array(self.mean).cast() - origin;
        let terms = harmonics::basis(ray * ray.norm().recip());
        std::array::from_fn(|c| {
            let sum: f64 = terms.iter().zip(view).map(|(t, row)| t * f64::from(row[c])).sum();
            (0.5 + sum as f32).max(0.0)
        })
    }

    /// Adds to the colour as far as it stays within `[0, 1]`, from all directions alike.
    pub(crate) fn shift(&mut self, by: [f32; 3]) {
        let before = self.colour;
        self.colour = std::array::from_fn(|c| (before[c] + by[c]).clamp(0.0, 1.0));
        if let Some(view) = &mut self.view {
            (0..3).for_each(|c| view[0][c] += (self.colour[c] - before[c]) / HARMONIC_ZERO);
        }
    }

    /// Opacity from 0 to 1.
    pub(crate) fn opacity(&self) -> f32 {
        1.0 / (1.0 + (-self.opacity_logit).exp())
    }
}

/// The Gaussians of a map, in its order, in the world of a file.
pub(crate) fn splats(
    map: &GaussianMap<f32>,
    display: &Display,
    file_from_world: Pose<f64>,
) -> Vec<Splat> {
    (0..map.len()).into_par_iter().map(|i| splat(map, i, display, file_from_world)).collect()
}

fn splat(map: &GaussianMap<f32>, i: usize, display: &Display, file_from_world: Pose<f64>) -> Splat {
    let turn = file_from_world.rotation;
    let isotropic = map.shape == Shape::Isotropic;
    let (log_scale, [w, x, y, z]) = (map.log_scales[i], map.rotations[i].map(f64::from));
    let own = Rotation::from_wxyz(w, x, y, z).filter(|_| !isotropic);
    let Rotation { w, v: Vec3 { x, y, z } } =
        own.map_or_else(Rotation::identity, |own| (turn * own).normalized());
    let mean = file_from_world * Vec3::from_array(map.means[i]).cast();
    let (colour, activation) = (map.colours[i], map.activation);
    let view = map.view_colours.get(i);
    Splat {
        mean: mean.cast::<f32>().to_array(),
        colour: display.colour(activation.radiance(colour)),
        view: view.map(|view| harmonics::fit(colour, view, (display, activation), turn)),
        opacity_logit: map.opacity_logits[i],
        log_scale: if isotropic { [log_scale[0]; 3] } else { log_scale },
        rotation: [w, x, y, z].map(|v| v as f32),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam::radiance::gaussian::{ColourActivation, Gaussian};

    #[test]
    fn a_moved_splat_keeps_its_shape() {
        let mut map = GaussianMap::new(Shape::Anisotropic, ColourActivation::Linear);
        map.push(Gaussian {
            mean: [1.0, 2.0, 3.0],
            log_scale: [-4.0, -3.0, -2.0],
            rotation: [1.0, 1.0, -1.0, 1.0],
            opacity_logit: 0.0,
            colour: [0.5; 3],
        });
        let (turn, shift) = (Rotation::exp(Vec3::new(0.3, -0.4, 1.1)), Vec3::new(0.5, -1.0, 2.0));
        let [before, after] = [Pose::identity(), Pose::new(turn, shift)]
            .map(|file_from_world| splats(&map, &Display::Linear, file_from_world)[0]);
        let axis = |splat: &Splat, axis: Vec3<f64>| {
            let [w, x, y, z] = splat.rotation.map(f64::from);
            Rotation { w, v: Vec3::new(x, y, z) }.rotate(axis)
        };
        for one in [Vec3::new(1.0, 0.0, 0.0), Vec3::new(0.0, 0.0, 1.0)] {
            let (now, due) = (axis(&after, one), turn.rotate(axis(&before, one)));
            assert!((now - due).norm() < 1e-6, "{now:?} {due:?}");
        }
        let due = (turn.rotate(Vec3::new(1.0, 2.0, 3.0)) + shift).to_array();
        assert!(after.mean.iter().zip(due).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-6));
        assert_eq!((after.log_scale, after.opacity()), (before.log_scale, 0.5));
        assert_eq!(before.rotation, [0.5, 0.5, -0.5, 0.5]);
    }
}
