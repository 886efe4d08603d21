//! The map's parameters and their gradient.

use super::view_colour::ViewColours;
use i2slam_geometry::Real;
use rayon::prelude::*;

/// Shape of the Gaussians.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Shape {
    /// One standard deviation in all directions; the rotation is ignored.
    Isotropic,
    /// Three standard deviations along rotated axes.
    Anisotropic,
}

/// Conversion from stored colour to linear radiance.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ColourActivation {
    /// `radiance = exp(colour)`: the colour is log-radiance, never negative, without upper bound.
    Exponential,
    /// `radiance = colour`: SplaTAM's raw colour.
    Linear,
}

impl ColourActivation {
    /// Radiance of a stored colour.
    pub fn radiance<T: Real>(self, colour: [T; 3]) -> [T; 3] {
        match self {
            Self::Exponential => colour.map(T::exp),
            Self::Linear => colour,
        }
    }

    /// The colour to store for a radiance; exponential radiance is taken as at least 1e-6.
    pub fn colour<T: Real>(self, radiance: [T; 3]) -> [T; 3] {
        match self {
            Self::Exponential => radiance.map(|v| v.max(T::of(1e-6)).ln()),
            Self::Linear => radiance,
        }
    }
}

/// One Gaussian.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Gaussian<T> {
    /// Centre in the world \[m\].
    pub mean: [T; 3],
    /// Natural logarithm of the standard deviations \[ln m\]; isotropic uses entry 0.
    pub log_scale: [T; 3],
    /// Quaternion w, x, y, z from the Gaussian's axes to the world, of any length but zero.
    pub rotation: [T; 4],
    /// Logit of the opacity: `opacity = 1 / (1 + exp(-logit))`.
    pub opacity_logit: T,
    /// Colour before the [`ColourActivation`].
    pub colour: [T; 3],
}

/// A set of Gaussians, one array per parameter, all of one length.
#[derive(Clone, PartialEq, Debug)]
pub struct GaussianMap<T = f32> {
    /// Balls or ellipsoids.
    pub shape: Shape,
    /// Meaning of the colours.
    pub activation: ColourActivation,
    /// Centres in the world \[m\].
    pub means: Vec<[T; 3]>,
    /// Natural logarithms of the standard deviations \[ln m\]; isotropic uses entry 0 alone.
    pub log_scales: Vec<[T; 3]>,
    /// Quaternions w, x, y, z, not necessarily of unit length; ignored when isotropic.
    pub rotations: Vec<[T; 4]>,
    /// Logits of the opacities.
    pub opacity_logits: Vec<T>,
    /// Colours before the activation.
    pub colours: Vec<[T; 3]>,
    /// Deviations of some colours by the direction from which they are seen.
    pub view_colours: ViewColours<T>,
}

impl<T: Real> GaussianMap<T> {
    /// An empty map.
    pub fn new(shape: Shape, activation: ColourActivation) -> Self {
        Self {
            shape,
            activation,
            means: Vec::new(),
            log_scales: Vec::new(),
            rotations: Vec::new(),
            opacity_logits: Vec::new(),
            colours: Vec::new(),
            view_colours: ViewColours::default(),
        }
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// True if there are none.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// Appends one, with the same colour from everywhere.
    pub fn push(&mut self, gaussian: Gaussian<T>) {
        self.means.push(gaussian.mean);
        self.log_scales.push(gaussian.log_scale);
        self.rotations.push(gaussian.rotation);
        self.opacity_logits.push(gaussian.opacity_logit);
        self.colours.push(gaussian.colour);
    }

    /// The Gaussian at `index`, if there is one.
    pub fn get(&self, index: usize) -> Option<Gaussian<T>> {
        Some(Gaussian {
            mean: *self.means.get(index)?,
            log_scale: *self.log_scales.get(index)?,
            rotation: *self.rotations.get(index)?,
            opacity_logit: *self.opacity_logits.get(index)?,
            colour: *self.colours.get(index)?,
        })
    }

    /// Colour of a Gaussian, before the activation, seen from `origin` \[m\].
    #[inline]
    pub fn colour_from(&self, index: usize, origin: [T; 3]) -> [T; 3] {
        let colour = self.colours[index];
        match self.view_colours.get(index) {
            None => colour,
            Some(view) => {
                let deviation = view.deviation(self.means[index], origin);
                std::array::from_fn(|c| colour[c] + deviation[c])
            }
        }
    }

    /// All Gaussians in order, with their colours on the axis of directions.
    pub fn iter(&self) -> impl Iterator<Item = Gaussian<T>> + '_ {
        (0..self.len()).map_while(|index| self.get(index))
    }

    /// Keeps the Gaussians whose entry in `keep` is true or missing, in order.
    pub fn retain(&mut self, keep: &[bool]) {
        retain_by(&mut self.means, keep);
        retain_by(&mut self.log_scales, keep);
        retain_by(&mut self.rotations, keep);
        retain_by(&mut self.opacity_logits, keep);
        retain_by(&mut self.colours, keep);
        self.view_colours.retain(keep);
    }

    /// Converts to another scalar type.
    pub fn cast<U: Real>(&self) -> GaussianMap<U> {
        fn vectors<T: Real, U: Real, const N: usize>(from: &[[T; N]]) -> Vec<[U; N]> {
            from.iter().map(|v| v.map(|x| U::of(x.to_f64()))).collect()
        }
        GaussianMap {
            shape: self.shape,
            activation: self.activation,
            means: vectors(&self.means),
            log_scales: vectors(&self.log_scales),
            rotations: vectors(&self.rotations),
            opacity_logits: self.opacity_logits.iter().map(|&x| U::of(x.to_f64())).collect(),
            colours: vectors(&self.colours),
            view_colours: self.view_colours.cast(),
        }
    }
}

/// Keeps the entries marked in `keep`, in order.
pub(crate) fn retain_by<V>(values: &mut Vec<V>, keep: &[bool]) {
    let mut marks = keep.iter();
    values.retain(|_| *marks.next().unwrap_or(&true));
}

/// `∂L/∂parameter` for each parameter of a [`GaussianMap`](super::GaussianMap), summed over all
/// calls of `pull_back` since the last [`reset`](Self::reset).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MapGradient<T = f32> {
    /// With respect to the centres.
    pub means: Vec<[T; 3]>,
    /// With respect to the logarithms of the standard deviations; isotropic has entry 0 alone.
    pub log_scales: Vec<[T; 3]>,
    /// With respect to the quaternions as stored (before normalising); zero when isotropic.
    pub rotations: Vec<[T; 4]>,
    /// With respect to the logits of the opacities.
    pub opacity_logits: Vec<T>,
    /// With respect to the colours as stored (before the activation).
    pub colours: Vec<[T; 3]>,
    /// With respect to the coefficients of the view colours.
    pub view_colours: Vec<[T; 3]>,
    /// Gaussians that contributed to a pixel whose cotangent was not zero.
    pub seen: Vec<bool>,
}

impl<T: Real> MapGradient<T> {
    /// Zeros for a map.
    pub fn new<U: Real>(map: &GaussianMap<U>) -> Self {
        let mut gradient = Self::default();
        gradient.reset(map);
        gradient
    }

    pub(crate) fn len(&self) -> usize {
        self.means.len()
    }

    /// Sets all to zero, for a map, keeping the allocation.
    pub fn reset<U: Real>(&mut self, map: &GaussianMap<U>) {
        let count = map.len();
        self.means.resize(count, [T::zero(); 3]);
        self.log_scales.resize(count, [T::zero(); 3]);
        self.rotations.resize(count, [T::zero(); 4]);
        self.opacity_logits.resize(count, T::zero());
        self.colours.resize(count, [T::zero(); 3]);
        self.seen.resize(count, false);
        self.view_colours.resize(map.view_colours.coefficients().len(), [T::zero(); 3]);
        self.par_rows(&map.view_colours, RESET_ROWS).for_each(GradientRows::clear);
    }

    pub(crate) fn rows(&mut self) -> GradientRows<'_, T> {
        GradientRows {
            view_colours: &mut self.view_colours,
            means: &mut self.means,
            log_scales: &mut self.log_scales,
            rotations: &mut self.rotations,
            opacity_logits: &mut self.opacity_logits,
            colours: &mut self.colours,
            seen: &mut self.seen,
            first_view_row: 0,
        }
    }

    /// Chunks of `count` rows, to write.
    pub(crate) fn par_rows<U: Real>(
        &mut self,
        layout: &ViewColours<U>,
        count: usize,
    ) -> impl IndexedParallelIterator<Item = GradientRows<'_, T>> {
        let view_colours = layout.chunks(&mut self.view_colours, self.means.len(), count);
        let places = self.means.par_chunks_mut(count).zip(self.log_scales.par_chunks_mut(count));
        let shapes = self.rotations.par_chunks_mut(count);
        let shapes = shapes.zip(self.opacity_logits.par_chunks_mut(count));
        let colours = self.colours.par_chunks_mut(count).zip(view_colours);
        let colours = colours.zip(self.seen.par_chunks_mut(count));
        places.zip(shapes).zip(colours).map(|(((means, log_scales), shapes), (colours, seen))| {
            let ((rotations, opacity_logits), (colours, views)) = (shapes, colours);
            let (first_view_row, view_colours) = views;
            GradientRows {
                means,
                log_scales,
                rotations,
                opacity_logits,
                colours,
                view_colours,
                first_view_row,
                seen,
            }
        })
    }
}

/// Rows that are set to zero in one task.
const RESET_ROWS: usize = 8192;

/// A range of rows of a [`MapGradient`], to write.
pub(crate) struct GradientRows<'a, T> {
    pub(crate) means: &'a mut [[T; 3]],
    pub(crate) log_scales: &'a mut [[T; 3]],
    pub(crate) rotations: &'a mut [[T; 4]],
    pub(crate) opacity_logits: &'a mut [T],
    pub(crate) colours: &'a mut [[T; 3]],
    /// Coefficients of the view colours of these Gaussians.
    pub(crate) view_colours: &'a mut [[T; 3]],
    /// Number of the first of these coefficients in the map.
    pub(crate) first_view_row: usize,
    pub(crate) seen: &'a mut [bool],
}

impl<T: Real> GradientRows<'_, T> {
    fn clear(self) {
        self.means.fill([T::zero(); 3]);
        self.log_scales.fill([T::zero(); 3]);
        self.rotations.fill([T::zero(); 4]);
        self.opacity_logits.fill(T::zero());
        self.colours.fill([T::zero(); 3]);
        self.view_colours.fill([T::zero(); 3]);
        self.seen.fill(false);
    }

    pub(crate) fn add(&mut self, row: usize, g: &Gaussian<T>, seen: bool) {
        (0..3).for_each(|k| self.means[row][k] += g.mean[k]);
        (0..3).for_each(|k| self.log_scales[row][k] += g.log_scale[k]);
        (0..4).for_each(|k| self.rotations[row][k] += g.rotation[k]);
        (0..3).for_each(|k| self.colours[row][k] += g.colour[k]);
        self.opacity_logits[row] += g.opacity_logit;
        self.seen[row] |= seen;
    }
}

#[cfg(test)]
mod tests {
    use super::super::view_colour::Cone;
    use super::*;

    fn gaussian(i: usize) -> Gaussian<f32> {
        let v = i as f32;
        Gaussian {
            mean: [v, 0.0, 1.0],
            log_scale: [-v; 3],
            rotation: [1.0, v, 0.0, 0.0],
            opacity_logit: v,
            colour: [0.5, v, 0.1],
        }
    }

    #[test]
    fn retain_keeps_rows_together() {
        let mut map = GaussianMap::new(Shape::Anisotropic, ColourActivation::Linear);
        (0..5).for_each(|i| map.push(gaussian(i)));
        map.retain(&[true, false, false, true, true]);
        let kept: Vec<_> = map.iter().collect();
        assert_eq!(kept, vec![gaussian(0), gaussian(3), gaussian(4)]);
        assert_eq!(map.cast::<f64>().cast::<f32>(), map);
    }

    fn map(count: usize) -> GaussianMap<f32> {
        let mut map = GaussianMap::new(Shape::Anisotropic, ColourActivation::Linear);
        (0..count).for_each(|i| map.push(gaussian(i)));
        let cone = Cone { rotation: [1.0, 0.0, 0.0, 0.0], spread: 0.5 };
        (0..count).step_by(3).for_each(|i| map.view_colours.push(i, cone, &[[1.0; 3]; 2]));
        map
    }

    #[test]
    fn a_reset_gradient_is_that_of_a_new_one() {
        let count = RESET_ROWS + 3;
        let (less, more) = (map(count), map(count + 9));
        let mut gradient = MapGradient::new(&map(count + 5));
        for row in 0..count + 5 {
            gradient.rows().add(row, &gaussian(row), true);
        }
        gradient.view_colours.fill([1.0; 3]);
        gradient.reset(&less);
        assert_eq!(gradient, MapGradient::new(&less));
        gradient.reset(&more);
        assert_eq!(gradient, MapGradient::new(&more));
    }

    #[test]
    fn colour_inverts_radiance() {
        for activation in [ColourActivation::Exponential, ColourActivation::Linear] {
            let back = activation.radiance(activation.colour([0.2_f64, 1.0, 30.0]));
            i2slam_check::assert_close("radiance", &back, &[0.2, 1.0, 30.0], 1e-12);
        }
    }
}
