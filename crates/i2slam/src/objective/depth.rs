//! The depth term at the pose of the exposure that fits best (eq. 14).

use i2slam_geometry::Image;
use rayon::prelude::*;

/// `Σ |d(T_j) - d̂|` over the pixels of `mask`, for one virtual camera `j`.
pub(super) fn absolute_error(rendered: &Image<f32>, observed: &Image<f32>, mask: &[bool]) -> f64 {
    let rows = rendered.data.par_chunks(rendered.width.max(1));
    let rows = rows.zip(observed.data.par_chunks(rendered.width.max(1)));
    let sums: Vec<f64> = rows
        .zip(mask.par_chunks(rendered.width.max(1)))
        .map(|((r, o), m)| {
            let pixels = r.iter().zip(o).zip(m).filter(|(_, m)| **m);
            pixels.map(|((r, o), _)| f64::from((r - o).abs())).sum()
        })
        .collect();
    sums.iter().sum()
}

/// The derivative of `weight · Σ |d - d̂|` over the pixels of `mask`.
pub(super) fn gradient(
    rendered: &Image<f32>,
    observed: &Image<f32>,
    mask: &[bool],
    weight: f32,
    d_depth: &mut Image<f32>,
) {
    d_depth.reset(rendered.width, rendered.height, 1);
    for (i, g) in d_depth.data.iter_mut().enumerate() {
        let difference = rendered.data[i] - observed.data[i];
        if mask[i] && difference != 0.0 {
            *g = weight.copysign(difference);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_only_masked_pixels() {
        let image = |data: Vec<f32>| Image { width: 3, height: 1, channels: 1, data };
        let (rendered, observed) = (image(vec![1.0, 2.0, 3.0]), image(vec![1.5, 0.0, 2.0]));
        let mask = [true, false, true];
        assert!((absolute_error(&rendered, &observed, &mask) - 1.5).abs() < 1e-6);
        let mut d = Image::default();
        gradient(&rendered, &observed, &mask, 2.0, &mut d);
        assert_eq!(d.data, vec![-2.0, 0.0, 2.0]);
    }
}
