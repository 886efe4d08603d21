//! Axes of exported worlds.

use i2slam::geometry::{Rotation, Vec3};
use std::f64::consts::FRAC_PI_2;

/// Which way is up in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axes {
    /// y down, z forward, as a camera's (COLMAP, PLY files of Gaussians).
    YDown,
    /// y up, z backward (glTF).
    YUp,
    /// z up, y forward (nerfstudio).
    ZUp,
}

impl Axes {
    /// The rotation from [`Axes::YDown`].
    pub(crate) fn rotation(self) -> Rotation<f64> {
        match self {
            Self::YDown => Rotation::identity(),
            Self::YUp => Rotation { w: 0.0, v: Vec3::new(1.0, 0.0, 0.0) },
            Self::ZUp => Rotation::exp(Vec3::new(-FRAC_PI_2, 0.0, 0.0)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn up_and_forward_are_where_they_should_be() {
        let (up, forward) = (Vec3::new(0.0, -1.0, 0.0), Vec3::new(0.0, 0.0, 1.0));
        let is = |a: Vec3<f64>, b: [f64; 3]| (a - Vec3::from_array(b)).norm() < 1e-12;
        let turned = |axes: Axes, v| axes.rotation().rotate(v);
        assert!(is(turned(Axes::YUp, up), [0.0, 1.0, 0.0]));
        assert!(is(turned(Axes::YUp, forward), [0.0, 0.0, -1.0]));
        assert!(is(turned(Axes::ZUp, up), [0.0, 0.0, 1.0]));
        assert!(is(turned(Axes::ZUp, forward), [0.0, 1.0, 0.0]));
        assert!(is(turned(Axes::YDown, up), [0.0, -1.0, 0.0]));
    }
}
