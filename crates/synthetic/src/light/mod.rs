//! Light on surfaces, computed once: direct light with soft shadows, then reflections.

mod atlas;
mod bake;
mod direct;
mod gather;

pub(crate) use bake::{LitScene, light_up};
