//! Memory of a field and of its training, known before anything is allocated.

use super::field::HashGridField;
use super::network::product::padded;
use super::render::{RAYS, RayGradient, RayRender, RenderedSample};
use super::{FieldSettings, Ray, SettingsError};

/// Bytes of a number.
const NUMBER: u64 = size_of::<f32>() as u64;

/// Bytes of an occupancy cell: its density, and its bits as occupied and as allowed.
const CELL: u64 = NUMBER + 1;

/// Numbers of a sample beside its encoding: position, and derivatives by exponents.
const SAMPLE_NUMBERS: u64 = 3 + 4;

impl FieldSettings {
    /// Memory while a field is trained [bytes]: its numbers, their gradient, two moments, the step
    /// of every sixteenth, and a copy in the result.
    ///
    /// # Errors
    ///
    /// Settings out of their ranges.
    pub fn training_bytes(&self) -> Result<u64, SettingsError> {
        let numbers = HashGridField::<f32>::parameter_count(*self)? as u64;
        Ok(numbers * (5 * NUMBER + 1))
    }

    /// Memory of an occupancy grid with so many cells along an edge [bytes].
    pub fn occupancy_bytes(cells: u32) -> u64 {
        u64::from(cells.min(512)).pow(3) * CELL
    }

    /// Memory of a step on so many rays with so many samples each [bytes]: renders, cotangents and
    /// derivatives of rays; encodings of samples, their slopes and derivatives; and for every chunk
    /// of rays the derivatives by all weights of the networks.
    ///
    /// # Errors
    ///
    /// Settings out of their ranges.
    pub fn ray_bytes(&self, rays: u64, samples: u64) -> Result<u64, SettingsError> {
        let field = HashGridField::<f32>::without_parameters(*self)?;
        let width = padded(self.levels * self.features) as u64;
        let shapes = [&field.density_shape, &field.colour_shape];
        let layers = shapes.into_iter().flat_map(|shape| shape.layers());
        let weights: u64 =
            layers.map(|layer| (padded(layer.inputs) * padded(layer.outputs)) as u64).sum();
        let sample = size_of::<RenderedSample>() as u64 + (SAMPLE_NUMBERS + 5 * width) * NUMBER;
        let ray = size_of::<Ray>() + 2 * size_of::<RayRender>() + size_of::<RayGradient>();
        let chunks = rays.div_ceil(RAYS as u64).saturating_mul(weights * NUMBER);
        let per_ray = (ray as u64).saturating_add(samples.saturating_mul(sample));
        Ok(rays.saturating_mul(per_ray).saturating_add(chunks))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_has_as_many_numbers_as_it_takes_memory_for() {
        let settings = FieldSettings { log2_table: 8, ..FieldSettings::cube([0.0; 3], 1.0) };
        let field = HashGridField::<f32>::new(settings, 0).expect("valid");
        let parameters = field.parameters();
        let numbers = parameters.table.len() + parameters.density.len() + parameters.colour.len();
        assert_eq!(settings.training_bytes(), Ok(21 * numbers as u64));
        let bad = FieldSettings { levels: 0, ..settings };
        assert!(bad.training_bytes().is_err() && bad.ray_bytes(1, 1).is_err());
    }

    #[test]
    fn extreme_settings_are_estimated_and_not_allocated() {
        let largest = FieldSettings {
            levels: FieldSettings::MAX_LEVELS,
            log2_table: FieldSettings::MAX_LOG2_TABLE,
            features: 8,
            hidden_width: 1024,
            finest_resolution: 1 << 20,
            ..FieldSettings::cube([0.0; 3], 1.0)
        };
        assert!(largest.training_bytes().expect("valid") > 40_000_000_000);
        // 4.6 MB of weights for each 64 rays.
        let rays = largest.ray_bytes(1_000_000_000_000, 16).expect("valid");
        assert!(rays > 70_000_000_000_000_000, "{rays}");
        assert_eq!(largest.ray_bytes(u64::MAX, 16), Ok(u64::MAX));
        let usual = FieldSettings::cube([0.0; 3], 1.0).ray_bytes(4096, 16).expect("valid");
        assert!((20_000_000..200_000_000).contains(&usual), "{usual}");
    }
}
