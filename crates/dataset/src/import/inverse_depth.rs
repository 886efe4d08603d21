//! Dense depth or inverse depth on a grid of its own, with variance, resampled to the images.

use super::source::as_valid_f32;
use crate::DatasetError;
use crate::formats::npy::NpyArray;
use i2slam_geometry::{Camera, Image, Tap};

/// Ratio of neighbouring inverse depths from which they count as two surfaces.
const SURFACE_RATIO: f64 = 1.2;

/// Quantity that a variance belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum VarianceKind {
    Depth,
    InverseDepth,
}

/// Maps of depth or inverse depth, one per keyframe.
#[derive(Clone, Debug)]
pub(super) struct InverseDepth {
    pub(super) values: NpyArray,
    pub(super) is_inverse: bool,
    /// Same shape as `values`.
    pub(super) variance: Option<(NpyArray, VarianceKind)>,
    /// Camera of the maps.
    pub(super) camera: Camera<f64>,
    /// Depth beyond this is invalid.
    pub(super) max_depth: f64,
}

impl InverseDepth {
    /// Depth and variance of a keyframe in the pixels of `camera`, which shares centre and
    /// orientation with the maps' camera; 0 where there is no depth.
    ///
    /// Inverse depth `d` is interpolated linearly, because it is linear in the image of a plane; at
    /// depth discontinuities and beside invalid pixels the nearest value is used. The variance of `d`
    /// is interpolated alike; that of depth is `Σ_z = Σ_d / d⁴` (first order; Rosinol et al. 2023,
    /// section 3.2).
    pub(super) fn resample(
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
                let Some(sample) = self.sample_at(&inverse, self.camera.project(ray)) else {
                    continue;
                };
                let d = sample.value_in(&inverse);
                let z = d.recip();
                if z > self.max_depth {
                    continue;
                }
                let at = row * camera.width + column;
                let spread = spread.as_ref().map(|spread| sample.value_in(spread) * z.powi(4));
                let Some((z, spread)) = as_valid_f32(z, spread) else { continue };
                depth.data[at] = z;
                if let (Some(variance), Some(spread)) = (&mut variance, spread) {
                    variance.data[at] = spread;
                }
            }
        }
        Ok((depth, variance))
    }

    /// Reads inverse depth (0: none) and its variance, if there is one.
    fn read(&self, record: usize) -> Result<(Vec<f64>, Option<Vec<f64>>), DatasetError> {
        let mut inverse = self.values.slice(record)?;
        if !self.is_inverse {
            inverse.iter_mut().for_each(|z| *z = z.recip());
        }
        inverse.iter_mut().filter(|d| !(d.is_finite() && **d > 0.0)).for_each(|d| *d = 0.0);
        let Some((array, kind)) = &self.variance else { return Ok((inverse, None)) };
        let mut spread = array.slice(record)?;
        for (spread, d) in spread.iter_mut().zip(&mut inverse) {
            if *kind == VarianceKind::Depth {
                *spread *= d.powi(4);
            }
            if !(spread.is_finite() && *spread > 0.0) {
                *d = 0.0;
            }
        }
        Ok((inverse, Some(spread)))
    }

    /// Chooses the sample of a map at `(u, v)`; `None` where it has no depth.
    fn sample_at(&self, inverse: &[f64], (u, v): (f64, f64)) -> Option<Sample> {
        let (width, height) = (self.camera.width, self.camera.height);
        // Maps of an eighth of the size cover slightly less than the image: their edge is repeated.
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
            Some(tap) => Some(Sample::Bilinear(tap)),
            None => (inverse[nearest] > 0.0).then_some(Sample::Nearest(nearest)),
        }
    }
}

/// Whether four neighbouring inverse depths are valid and similar enough to lie on one surface.
fn is_one_surface(around: [f64; 4]) -> bool {
    let least = around.into_iter().fold(f64::INFINITY, f64::min);
    let most = around.into_iter().fold(0.0, f64::max);
    least > 0.0 && most < SURFACE_RATIO * least
}

/// Interpolation weights, or a single pixel.
enum Sample {
    Bilinear(Tap<f64>),
    Nearest(usize),
}

impl Sample {
    fn value_in(&self, plane: &[f64]) -> f64 {
        match self {
            Self::Bilinear(tap) => tap.sample(plane).0,
            Self::Nearest(index) => plane[*index],
        }
    }
}
