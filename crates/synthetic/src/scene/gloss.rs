//! The share of light that a surface reflects as a mirror does.

/// A lobe of reflected light around the mirror direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Gloss {
    /// Reflectance at normal incidence, in `[0, 1]`; 0 is matt.
    pub(crate) reflectance: f32,
    /// Standard deviation of directions around the mirror direction along each of two axes
    /// \[rad\]; 0 is a clear image.
    pub(crate) spread: f32,
}

impl Gloss {
    /// No reflection.
    pub(crate) const MATT: Self = Self { reflectance: 0.0, spread: 0.0 };
    /// A silvered mirror.
    pub(crate) const MIRROR: Self = Self { reflectance: 0.92, spread: 0.0 };

    /// `F = F₀ + (1 - F₀)(1 - cos θ)⁵` (Schlick 1994), of the angle between ray and normal; 0 of a
    /// matt surface.
    #[inline]
    pub(crate) fn fresnel(&self, cosine: f32) -> f32 {
        if self.reflectance == 0.0 {
            return 0.0;
        }
        self.reflectance + (1.0 - self.reflectance) * (1.0 - cosine.clamp(0.0, 1.0)).powi(5)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reflectance_rises_from_its_value_at_normal_incidence_to_one() {
        let varnish = Gloss { reflectance: 0.04, spread: 0.0 };
        assert_eq!(varnish.fresnel(1.0), 0.04);
        assert_eq!(varnish.fresnel(0.0), 1.0);
        assert!((varnish.fresnel(0.5) - (0.04 + 0.96 / 32.0)).abs() < 1e-6);
        assert_eq!(Gloss::MATT.fresnel(0.0), 0.0);
    }
}
