//! Radiance maps: linear, high-dynamic-range radiance and depth seen from a pose, and gradients by
//! the map and by the pose.
//!
//! * [`RadianceMap`] is the trait of all maps.
//! * [`gaussian`] is 3D Gaussian splatting (Kerbl et al. 2023) with gradients by hand: a plain
//!   `reference` for `f32` and `f64`, and a fast [`gaussian::Rasterizer`].
//! * [`hashgrid`] is a neural field in a multi-resolution hash grid (Müller et al. 2022), likewise a
//!   `reference` and a fast [`hashgrid::FieldRenderer`].

pub mod gaussian;
pub mod hashgrid;
mod radiance_map;
mod shutter_motion;

pub use radiance_map::{RadianceMap, Render, RenderCotangent, View};
pub use shutter_motion::{Moment, MotionGradient, ShutterMotion};
