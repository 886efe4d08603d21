//! Inverse depth on a grid of its own, and its variance, looked up where a picture has its pixels.

use super::keyframe::measured;
use super::npy::Array;
use crate::DatasetError;
use i2slam_geometry::{Camera, Image, Tap};

/// Neighbours whose inverse depths differ by this factor lie on two surfaces.
const ONE_SURFACE: f64 = 1.2;

/// What a variance is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Variance {
    OfDepth,
    OfInverse,
}

/// Maps of depth or inverse depth, one a keyframe.
#[derive(Clone, Debug)]
pub(super) struct InverseDepth {
    pub(super) values: Array,
    pub(super) is_inverse: bool,
    /// As large as `values`.
    pub(super) variance: Option<(Array, Variance)>,
    /// The camera of the maps' pixels.
    pub(super) camera: Camera<f64>,
    /// Depth beyond this is none.
    pub(super) max_depth: f64,
}

impl InverseDepth {
    /// Depth and variance of a keyframe in the pixels of `camera`, which stands where the maps'
    /// does. 0 where there is no depth.
    ///
    /// Inverse depth `d` is interpolated, which is linear over the picture of a plane; beyond the
    /// outermost pixel centres theirs are repeated. Beside a pixel without depth, and between
    /// pixels whose inverse depths differ by a fifth, the nearest is taken. The variance of `d` is
    /// interpolated alike, and that of depth is `Σ_z = Σ_d / d⁴` (first order; Rosinol et al. 2023,
    /// section 3.2).
    pub(super) fn at(
        &self,
        record: usize,
        camera: &Camera<f64>,
    ) -> Result<(Image<f32>, Option<Image<f32>>), DatasetError> {
        let (inverse, spread) = self.read(record)?;
        let mut depth = Image::new(camera.width, camera.height, 1);
        let mut variance = spread.is_some().then(|| depth.clone());
        for row in 0..camera.height {
            for column in 0..camera.width {
                let (u, v) = Camera::<f64>::pixel_centre(column, row);
                let ray = camera.unproject(u, v, 1.0);
                let Some(place) = self.place(&inverse, self.camera.project(ray)) else { continue };
                let d = place.of(&inverse);
                let z = d.recip();
                if z > self.max_depth {
                    continue;
                }
                let at = row * camera.width + column;
                let spread = spread.as_ref().map(|spread| place.of(spread) * z.powi(4));
                let Some((z, spread)) = measured(z, spread) else { continue };
                depth.data[at] = z;
                if let (Some(variance), Some(spread)) = (&mut variance, spread) {
                    variance.data[at] = spread;
                }
            }
        }
        Ok((depth, variance))
    }

    /// Inverse depth (0: none) and its variance, where there is one.
    fn read(&self, record: usize) -> Result<(Vec<f64>, Option<Vec<f64>>), DatasetError> {
        let mut inverse = self.values.slice(record)?;
        if !self.is_inverse {
            inverse.iter_mut().for_each(|z| *z = z.recip());
        }
        inverse.iter_mut().filter(|d| !(d.is_finite() && **d > 0.0)).for_each(|d| *d = 0.0);
        let Some((array, kind)) = &self.variance else { return Ok((inverse, None)) };
        let mut spread = array.slice(record)?;
        for (spread, d) in spread.iter_mut().zip(&mut inverse) {
            if *kind == Variance::OfDepth {
                *spread *= d.powi(4);
            }
            if !(spread.is_finite() && *spread > 0.0) {
                *d = 0.0;
            }
        }
        Ok((inverse, Some(spread)))
    }

    /// Where a map is read at `(u, v)`; `None` where it has no depth.
    fn place(&self, inverse: &[f64], (u, v): (f64, f64)) -> Option<Place> {
        let (width, height) = (self.camera.width, self.camera.height);
        // Maps of an eighth of the size have their first pixel at the picture's first: the last one
        // stands for what lies beyond it.
        if !self.camera.contains(u, v, -0.5) {
            return None;
        }
        // A tap needs a pixel to the right of and below it.
        let within = |at: f64, side: usize| at.clamp(0.5, (side as f64 - 0.5 - 1e-9).max(0.5));
        let tap = Tap::new(width, height, within(u, width), within(v, height));
        let all = tap.filter(|tap| is_one_surface(tap.values(inverse)));
        let at = |at: f64, side: usize| (at.max(0.0) as usize).min(side - 1);
        let nearest = at(v, height) * width + at(u, width);
        match all {
            Some(tap) => Some(Place::Between(tap)),
            None => (inverse[nearest] > 0.0).then_some(Place::At(nearest)),
        }
    }
}

/// Whether inverse depths around a place are all known, and near enough to lie on one surface:
/// between two of them there is nothing.
fn is_one_surface(around: [f64; 4]) -> bool {
    let least = around.into_iter().fold(f64::INFINITY, f64::min);
    let most = around.into_iter().fold(0.0, f64::max);
    least > 0.0 && most < ONE_SURFACE * least
}

/// A place in a map.
enum Place {
    Between(Tap<f64>),
    At(usize),
}

impl Place {
    fn of(&self, plane: &[f64]) -> f64 {
        match self {
            Self::Between(tap) => tap.sample(plane).0,
            Self::At(index) => plane[*index],
        }
    }
}
