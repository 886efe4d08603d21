//! Radiance maps: linear, high-dynamic-range radiance and depth seen from a pose, and the way
//! back from a derivative of the picture to derivatives of the map and of the pose.
//!
//! * [`RadianceMap`] is the seam: everything above it works with any map.
//! * [`gaussian`] is 3D Gaussian splatting (Kerbl et al. 2023) with gradients by hand, a plain
//!   `reference` lane for `f32` and `f64`, and a fast `cpu` lane ([`gaussian::Rasterizer`]).
//! * [`hashgrid`] is a neural field in a multi-resolution hash grid (Müller et al. 2022), in the
//!   same two lanes ([`hashgrid::FieldRenderer`]).

pub mod gaussian;
pub mod hashgrid;
mod seam;

pub use seam::{RadianceMap, Render, RenderCotangent, View};
