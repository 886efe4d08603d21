//! Rows of the picture that are exposed one after another.

use super::points::Points;
use i2slam_compute::simd::Lanes;
use i2slam_geometry::{Tangent, Vec3};
use pulp::Simd;

/// When a row is exposed, and where the camera is then.
///
/// The row through image position `v` sees the moment `s` of the exposure at
/// `s + readout (v/H - ½)`, and at time `s` a point `X` of the camera lies at
/// `Exp(s ω) X + s ν` in the camera at mid-exposure of the middle row.
pub(super) struct Rolling {
    /// [exposures]
    pub(super) readout: f32,
    /// Height of the picture at this level [px].
    pub(super) height: f32,
    /// `ν` [m per exposure] and `ω` [rad per exposure].
    speed: Vec3<f32>,
    spin: Vec3<f32>,
}

impl Rolling {
    pub(super) fn new(readout: f64, height: f64, velocity: Tangent<f64>) -> Self {
        let (speed, spin) = (velocity.translation.cast(), velocity.rotation.cast());
        Self { readout: readout as f32, height: height as f32, speed, spin }
    }

    /// Place of a row between the top edge (-½) and the bottom edge (½).
    #[inline(always)]
    pub(super) fn place<S: Simd>(&self, simd: S, v: Lanes<S>) -> Lanes<S> {
        v * Lanes::splat(simd, 1.0 / self.height) - Lanes::splat(simd, 0.5)
    }

    /// Time at which a row at `place` sees the moment `offset` of the exposure.
    #[inline(always)]
    pub(super) fn time<S: Simd>(&self, simd: S, place: Lanes<S>, offset: f32) -> Lanes<S> {
        place.mul_add(Lanes::splat(simd, self.readout), Lanes::splat(simd, offset))
    }

    /// `Exp(s ω) X = X + (sin sθ / θ) ω × X + ((1 - cos sθ) / θ²) ω × (ω × X)` by series, exact to
    /// single precision for turns of less than a radian.
    #[inline(always)]
    pub(super) fn turned<S: Simd>(&self, simd: S, s: Lanes<S>, point: Points<S>) -> Points<S> {
        let number = |value: f32| Lanes::splat(simd, value);
        let spin = Points::splat(simd, self.spin);
        let angle = s * s * number(self.spin.dot(self.spin));
        let series = |terms: [f32; 4]| {
            let [a, b, c, d] = terms.map(number);
            d.mul_add(angle, c).mul_add(angle, b).mul_add(angle, a)
        };
        let sine = s * series([1.0, -1.0 / 6.0, 1.0 / 120.0, -1.0 / 5040.0]);
        let cosine = s * s * series([0.5, -1.0 / 24.0, 1.0 / 720.0, -1.0 / 40_320.0]);
        let once = spin.cross(point);
        spin.cross(once).mul_add(cosine, once.mul_add(sine, point))
    }

    /// `s ν`.
    #[inline(always)]
    pub(super) fn moved<S: Simd>(&self, simd: S, s: Lanes<S>) -> Points<S> {
        Points::splat(simd, self.speed).scaled(s)
    }

    /// `ν + ω × Exp(s ω) X`: how fast the turned point moves [per exposure].
    #[inline(always)]
    pub(super) fn rate<S: Simd>(&self, simd: S, turned: Points<S>) -> Points<S> {
        let one = Lanes::splat(simd, 1.0);
        Points::splat(simd, self.spin).cross(turned).mul_add(one, Points::splat(simd, self.speed))
    }
}
