//! Gaussians as viewers of 3D Gaussian splatting expect them (Kerbl et al. 2023).

use i2slam::formation::{FrameTone, ResponseCurve};
use i2slam::geometry::{Rotation, Vec3};
use i2slam::radiance::gaussian::{GaussianMap, Shape};

/// The zeroth real spherical harmonic, `1 / (2 √π)`: colour = 0.5 + C0 · f_dc.
pub(crate) const HARMONIC_ZERO: f32 = 0.282_094_8;

/// One Gaussian as viewers expect it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Splat {
    /// Mean [m].
    pub mean: [f32; 3],
    /// Colour: a picture value from 0 to 1, or linear radiance.
    pub colour: [f32; 3],
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
    /// The harmonic coefficients of its colour, the same from all directions.
    pub(crate) fn harmonics(&self) -> [f32; 3] {
        self.colour.map(|c| (c - 0.5) / HARMONIC_ZERO)
    }

    /// Opacity from 0 to 1.
    pub(crate) fn opacity(&self) -> f32 {
        1.0 / (1.0 + (-self.opacity_logit).exp())
    }

    /// The Gaussian in a rotated world.
    pub(crate) fn rotated(self, rotation: Rotation<f64>) -> Self {
        let mean = rotation.rotate(Vec3::from_array(self.mean.map(f64::from)));
        let [w, x, y, z] = self.rotation.map(f64::from);
        let turned = (rotation * Rotation { w, v: Vec3::new(x, y, z) }).normalized();
        let Vec3 { x, y, z } = turned.v;
        Self {
            mean: mean.to_array().map(|v| v as f32),
            rotation: [turned.w, x, y, z].map(|v| v as f32),
            ..self
        }
    }
}

/// The Gaussians of a map, in its order.
pub(crate) fn splats(map: &GaussianMap<f32>, display: &Display) -> Vec<Splat> {
    (0..map.len()).map(|i| splat(map, i, display)).collect()
}

fn splat(map: &GaussianMap<f32>, i: usize, display: &Display) -> Splat {
    let isotropic = map.shape == Shape::Isotropic;
    let (log_scale, rotation) = (map.log_scales[i], map.rotations[i]);
    let norm = rotation.iter().map(|v| v * v).sum::<f32>().sqrt();
    let turned = !isotropic && norm.is_finite() && norm > 0.0;
    Splat {
        mean: map.means[i],
        colour: display.colour(map.activation.radiance(map.colours[i])),
        opacity_logit: map.opacity_logits[i],
        log_scale: if isotropic { [log_scale[0]; 3] } else { log_scale },
        rotation: if turned { rotation.map(|v| v / norm) } else { [1.0, 0.0, 0.0, 0.0] },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rotated_splat_keeps_its_shape() {
        let splat = Splat {
            mean: [1.0, 2.0, 3.0],
            colour: [0.5; 3],
            opacity_logit: 0.0,
            log_scale: [-4.0, -3.0, -2.0],
            rotation: [0.5, 0.5, -0.5, 0.5],
        };
        let rotation = Rotation::exp(Vec3::new(0.3, -0.4, 1.1));
        let turned = splat.rotated(rotation);
        let axis = |splat: &Splat, axis: Vec3<f64>| {
            let [w, x, y, z] = splat.rotation.map(f64::from);
            Rotation { w, v: Vec3::new(x, y, z) }.rotate(axis)
        };
        for one in [Vec3::new(1.0, 0.0, 0.0), Vec3::new(0.0, 0.0, 1.0)] {
            let (now, due) = (axis(&turned, one), rotation.rotate(axis(&splat, one)));
            assert!((now - due).norm() < 1e-6, "{now:?} {due:?}");
        }
        let due = rotation.rotate(Vec3::new(1.0, 2.0, 3.0)).to_array();
        assert!(turned.mean.iter().zip(due).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-6));
        assert_eq!((turned.log_scale, turned.opacity()), (splat.log_scale, 0.5));
    }
}
