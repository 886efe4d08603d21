//! Volume rendering (equations 1 and 2 of the paper).
//!
//! A ray with samples `i` of density `σ_i`, length `δ_i` \[m\], radiance `c_i` and depth `d_i`:
//!
//! ```text
//! f_i = exp(-σ_i δ_i)     T_i = Π_{j<i} f_j     w_i = T_i (1 - f_i)
//! radiance Σ w_i c_i      depth Σ w_i d_i       opacity Σ w_i
//!
//! v_i = ⟨∂L/∂radiance, c_i⟩ + d_i ∂L/∂depth + ∂L/∂opacity
//! ∂L/∂(σ_i δ_i) = T_i f_i v_i - Σ_{j>i} w_j v_j          ∂L/∂c_i = w_i ∂L/∂radiance
//! ```
//!
//! The depths of the samples are not differentiated; positions `origin + d_i direction`, lengths
//! `δ_i = step_i |direction|` and the direction that the colour network sees are.

use i2slam_geometry::{Real, Vec3};

mod chunk;
mod cpu_backward;
mod cpu_forward;
pub mod reference;
mod renderer;
mod view;

pub(super) use chunk::{RAYS, RenderedSample};
pub use renderer::FieldRenderer;

/// Render of a ray; also `∂L/∂` of each of its numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RayRender<T = f32> {
    /// Linear radiance `Σ w c`, R, G, B.
    pub radiance: [T; 3],
    /// `Σ w d` \[units of the ray's direction\]. Not divided by the opacity.
    pub depth: T,
    /// `Σ w` in `[0, 1]`.
    pub opacity: T,
}

impl<T: Real> RayRender<T> {
    /// Adds a sample of weight `weight`.
    pub(crate) fn add(&mut self, weight: T, colour: &[T; 3], depth: T) {
        for c in 0..3 {
            self.radiance[c] += weight * colour[c];
        }
        self.depth += weight * depth;
        self.opacity += weight;
    }

    /// `v`: the derivative by the weight of a sample, `self` being `∂L/∂render`.
    pub(crate) fn by_weight(&self, colour: &[T; 3], depth: T) -> T {
        let radiance: T = (0..3).map(|c| self.radiance[c] * colour[c]).sum();
        radiance + self.depth * depth + self.opacity
    }
}

/// `∂L/∂ray`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RayGradient<T = f32> {
    /// By the origin, in the world.
    pub origin: Vec3<T>,
    /// By the direction, in the world, its length included.
    pub direction: Vec3<T>,
}

impl<T: Real> RayGradient<T> {
    /// Adds the derivatives by the unit vector along `direction` and by its length.
    pub(crate) fn add_shape(&mut self, direction: Vec3<T>, by_unit: Vec3<T>, by_length: T) {
        let length = direction.norm();
        let unit = direction * (T::one() / length);
        let tangential = by_unit + -(unit * unit.dot(by_unit));
        self.direction += tangential * (T::one() / length) + unit * by_length;
    }
}
