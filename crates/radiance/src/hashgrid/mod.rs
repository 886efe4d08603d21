//! A radiance field in a multi-resolution hash grid with small networks: instant-ngp (Müller et
//! al. 2022) in the form of torch-ngp, with radiance of any height instead of colours in `[0, 1]`.
//!
//! * [`HashGridField`]: the parameters, and what they mean.
//! * [`FieldRenderer`]: batches of rays from any number of frames, forward and back, for training.
//! * [`HashGridMap`]: a field with its occupancy, a [`RadianceMap`](crate::RadianceMap) as it is
//!   saved.
//! * [`Occupancy`]: which parts of a ray are sampled.
//! * [`FieldAdam`]: the optimiser.
//!
//! Two lanes compute it: [`mod@reference`], plain and generic over the scalar, which renders
//! samples that it is given, and [`FieldRenderer`], fast.

mod archive;
mod encoding;
mod field;
mod march;
mod memory;
mod network;
mod occupancy;
mod optimizer;
mod ray;
mod render;
mod settings;

#[cfg(test)]
mod tests;

pub use archive::{FieldFileError, HashGridMap};
pub use field::{FieldGradient, FieldParameters, HashGridField};
pub use occupancy::Occupancy;
pub use optimizer::{FieldAdam, decayed_rate};
pub use ray::{Ray, Sample};
pub use render::{FieldRenderer, RayGradient, RayRender, reference};
pub use settings::{FieldSettings, MarchSettings, OccupancySettings, SettingsError};
