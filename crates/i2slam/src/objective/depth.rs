//! The depth term at the pose of the exposure that fits best (eq. 14).

use super::Observation;
use i2slam_geometry::Image;
use rayon::prelude::*;

/// `Σ w |d(T_j) - d̂|` over the pixels of `mask`, for one virtual camera `j`; the weights are how
/// far the depth is trusted.
pub(super) fn absolute_error(
    rendered: &Image<f32>,
    observation: &Observation,
    mask: &[bool],
) -> f64 {
    let width = rendered.width.max(1);
    let rows = rendered.data.par_chunks(width).zip(observation.depth.data.par_chunks(width));
    let sums: Vec<f64> = rows
        .zip(mask.par_chunks(width))
        .enumerate()
        .map(|(row, ((r, o), m))| {
            let pixels = r.iter().zip(o).zip(m).enumerate().filter(|(_, (_, m))| **m);
            let weight = |column: usize| f64::from(observation.depth_trust(row * width + column));
            pixels.map(|(c, ((r, o), _))| weight(c) * f64::from((r - o).abs())).sum()
        })
        .collect();
    sums.iter().sum()
}

/// The derivative of `weight · Σ w |d - d̂|` over the pixels of `mask`.
pub(super) fn gradient(
    rendered: &Image<f32>,
    observation: &Observation,
    mask: &[bool],
    weight: f32,
    d_depth: &mut Image<f32>,
) {
    d_depth.reset(rendered.width, rendered.height, 1);
    for (i, g) in d_depth.data.iter_mut().enumerate() {
        let difference = rendered.data[i] - observation.depth.data[i];
        if mask[i] && difference != 0.0 {
            *g = (weight * observation.depth_trust(i)).copysign(difference);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(data: [f32; 3]) -> Image<f32> {
        Image { width: 3, height: 1, channels: 1, data: data.to_vec() }
    }

    #[test]
    fn counts_only_masked_pixels() {
        let observation = Observation::new(Image::new(3, 1, 3), image([1.5, 0.0, 2.0]));
        let rendered = image([1.0, 2.0, 3.0]);
        let mask = [true, false, true];
        assert!((absolute_error(&rendered, &observation, &mask) - 1.5).abs() < 1e-6);
        let mut d = Image::default();
        gradient(&rendered, &observation, &mask, 2.0, &mut d);
        assert_eq!(d.data, vec![-2.0, 0.0, 2.0]);
    }

    /// Deviations of 1 and 4 hundredths of the depth: full weight, and a quarter.
    #[test]
    fn estimated_depth_counts_by_its_deviation() {
        let variance = image([1e-4, 1.0, 6.4e-3]);
        let depth = image([1.0, 0.0, 2.0]);
        let observation = Observation::estimated(Image::new(3, 1, 3), depth, variance);
        let (rendered, mask) = (image([2.0, 1.0, 4.0]), [true, false, true]);
        assert!((absolute_error(&rendered, &observation, &mask) - 1.5).abs() < 1e-5);
        let mut d = Image::default();
        gradient(&rendered, &observation, &mask, 2.0, &mut d);
        assert!((d.data[0] - 2.0).abs() < 1e-5 && (d.data[2] - 0.5).abs() < 1e-5);
    }
}
