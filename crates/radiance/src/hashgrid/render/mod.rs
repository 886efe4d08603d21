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

mod chunk;
mod cpu_backward;
mod cpu_forward;
mod rays;
pub mod reference;
mod renderer;
mod view;

pub use rays::{RayGradient, RayRender};
pub use renderer::FieldRenderer;
