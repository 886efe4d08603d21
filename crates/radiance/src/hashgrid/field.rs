//! The parameters of the field, and derivatives by them.

use super::encoding::{self, Level, harmonics::HARMONICS};
use super::network::Shape;
use super::{FieldSettings, SettingsError};
use i2slam_compute::Random;
use i2slam_geometry::Real;

/// Radiance and density in a cube, stored in tables and two small networks.
///
/// With `e(x)` the encoding of a position and `h(n)` the harmonics of a direction,
///
/// ```text
/// (a, g) = density network(e(x))         σ = exp(a)      [1/m]
/// b      = colour network(h(n), g)       c = exp(b)      linear radiance, R, G, B
/// ```
///
/// where `exp` takes its argument as at most ±15, for value and slope alike, and passes the
/// gradient on beyond.
#[derive(Clone, Debug, PartialEq)]
pub struct HashGridField<T = f32> {
    settings: FieldSettings,
    pub(crate) levels: Vec<Level>,
    pub(crate) density_shape: Shape,
    pub(crate) colour_shape: Shape,
    pub(crate) parameters: FieldParameters<T>,
}

/// One number per parameter of a field: the parameters themselves or `∂L/∂parameter`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FieldParameters<T = f32> {
    /// Entries of all levels, from coarse to fine, `features` numbers each.
    pub table: Vec<T>,
    /// Weights of the density network, layer after layer, `[input][output]`.
    pub density: Vec<T>,
    /// Weights of the colour network, `[input][output]`; inputs are harmonics, then geometry.
    pub colour: Vec<T>,
}

/// `∂L/∂parameter` of a field, summed since the last [`reset`](FieldParameters::reset).
pub type FieldGradient<T = f32> = FieldParameters<T>;

impl<T: Real> FieldParameters<T> {
    /// Zeros for every parameter of `field`.
    pub fn zeros(field: &HashGridField<T>) -> Self {
        let of = |values: &Vec<T>| vec![T::zero(); values.len()];
        let p = &field.parameters;
        Self { table: of(&p.table), density: of(&p.density), colour: of(&p.colour) }
    }

    /// Sets all to zero.
    pub fn reset(&mut self) {
        self.table.fill(T::zero());
        self.density.fill(T::zero());
        self.colour.fill(T::zero());
    }

    /// Zeros those of all but the `count` coarsest grids, so that a step leaves the finer ones.
    pub fn keep_levels(&mut self, field: &HashGridField<T>, count: usize) {
        if let Some(level) = field.levels.get(count) {
            self.table[level.first * field.settings.features..].fill(T::zero());
        }
    }

    fn cast<U: Real>(&self) -> FieldParameters<U> {
        let of = |values: &[T]| values.iter().map(|&v| U::of(Real::to_f64(v))).collect();
        FieldParameters {
            table: of(&self.table),
            density: of(&self.density),
            colour: of(&self.colour),
        }
    }

    pub(crate) fn fits(&self, other: &Self) -> bool {
        let lengths = |p: &Self| [p.table.len(), p.density.len(), p.colour.len()];
        lengths(self) == lengths(other)
    }
}

impl<T: Real> HashGridField<T> {
    /// A field before training: entries uniform in ±1e-4, weights uniform in ±1/√inputs.
    pub fn new(settings: FieldSettings, seed: u64) -> Result<Self, SettingsError> {
        let mut field = Self::zeros(settings)?;
        let mut random = Random::new(seed);
        let mut fill = |values: &mut [T], range: f64| {
            values.iter_mut().for_each(|v| *v = T::of((2.0 * random.uniform() - 1.0) * range));
        };
        let parameters = &mut field.parameters;
        fill(&mut parameters.table, 1e-4);
        for (shape, weights) in [
            (&field.density_shape, &mut parameters.density),
            (&field.colour_shape, &mut parameters.colour),
        ] {
            for layer in shape.layers() {
                fill(&mut weights[layer.range()], 1.0 / (layer.inputs as f64).sqrt());
            }
        }
        Ok(field)
    }

    pub(crate) fn zeros(settings: FieldSettings) -> Result<Self, SettingsError> {
        let mut field = Self::without_parameters(settings)?;
        let [table, density, colour] = field.lengths().map(|length| vec![T::zero(); length]);
        field.parameters = FieldParameters { table, density, colour };
        Ok(field)
    }

    /// Shapes alone.
    pub(super) fn without_parameters(settings: FieldSettings) -> Result<Self, SettingsError> {
        settings.check()?;
        let (width, geometry) = (settings.hidden_width, settings.geometry_features);
        let inputs = settings.levels * settings.features;
        Ok(Self {
            settings,
            levels: encoding::levels(&settings),
            density_shape: Shape::new(inputs, width, settings.density_layers, 1 + geometry),
            colour_shape: Shape::new(HARMONICS + geometry, width, settings.colour_layers, 3),
            parameters: FieldParameters::default(),
        })
    }

    /// Numbers of the table, the density network and the colour network.
    fn lengths(&self) -> [usize; 3] {
        let entries: usize = self.levels.iter().map(|level| level.entries).sum();
        let weights = [self.density_shape.weights(), self.colour_shape.weights()];
        [entries * self.settings.features, weights[0], weights[1]]
    }

    /// Number of parameters of a field of these settings, without making it.
    pub fn parameter_count(settings: FieldSettings) -> Result<usize, SettingsError> {
        Ok(Self::without_parameters(settings)?.lengths().iter().sum())
    }

    /// The settings.
    pub fn settings(&self) -> &FieldSettings {
        &self.settings
    }

    /// The parameters.
    pub fn parameters(&self) -> &FieldParameters<T> {
        &self.parameters
    }

    /// The table, the weights of the density network and those of the colour network, to write.
    pub fn parameters_mut(&mut self) -> [&mut [T]; 3] {
        let p = &mut self.parameters;
        [&mut p.table, &mut p.density, &mut p.colour]
    }

    /// Converts to another scalar type.
    pub fn cast<U: Real>(&self) -> HashGridField<U> {
        HashGridField {
            settings: self.settings,
            levels: self.levels.clone(),
            density_shape: self.density_shape.clone(),
            colour_shape: self.colour_shape.clone(),
            parameters: self.parameters.cast(),
        }
    }

    /// The affine map from the world to the unit cube, `x = p · scale + offset`.
    pub(crate) fn to_unit(&self) -> (T, [T; 3]) {
        let scale = 0.5 / self.settings.bound;
        (T::of(scale), self.settings.centre.map(|c| T::of(0.5 - c * scale)))
    }
}

/// Bound of the argument of exponentials.
pub(crate) const EXPONENT_MAX: f64 = 15.0;

/// `exp` of the argument cut to ±15.
pub(crate) fn truncated_exp<T: Real>(x: T) -> T {
    x.max(T::of(-EXPONENT_MAX)).min(T::of(EXPONENT_MAX)).exp()
}
