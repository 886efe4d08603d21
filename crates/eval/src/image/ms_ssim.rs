//! Multi-scale structural similarity (Wang, Simoncelli, Bovik 2003).

use super::check_shapes;
use super::ssim::{Similarity, WINDOW, plane_means};
use crate::EvalError;
use i2slam_geometry::Image;

/// Exponents `β` of the five scales, fine to coarse (Wang et al. 2003, section 3.2).
const EXPONENTS: [f64; 5] = [0.0448, 0.2856, 0.3001, 0.2363, 0.1333];

/// Pictures need a side longer than this: four halvings leave a window.
const SIDE: usize = (WINDOW - 1) << (EXPONENTS.len() - 1);

/// Multi-scale SSIM, in `[0, 1]`, 1 for equal pictures.
///
/// Per channel `SSIM_5^β5 · Π_{k<5} CS_k^βk`, with `CS` the contrast and structure factor of
/// [`ssim`](super::ssim()) on the picture halved `k - 1` times, `β = 0.0448, 0.2856, 0.3001,
/// 0.2363, 0.1333`; factors below zero count as zero; averaged over channels. Halving averages
/// blocks of 2 x 2; an odd side gets one zero before its first pixel. All this is what
/// `pytorch_msssim.ms_ssim(data_range=1)` does, and through it SplaTAM.
/// Pictures whose shorter side is not above 160 px are refused.
pub fn ms_ssim(picture: &Image<f32>, truth: &Image<f32>) -> Result<f64, EvalError> {
    check_shapes(picture, truth)?;
    let side = truth.width.min(truth.height);
    if side <= SIDE {
        let what = "pixels along the shorter side";
        return Err(EvalError::TooFew { what, found: side, needed: SIDE + 1 });
    }
    let mut sum = 0.0;
    for channel in 0..truth.channels {
        let plane = |image: &Image<f32>| Plane {
            width: image.width,
            height: image.height,
            data: image.plane(channel).to_vec(),
        };
        sum += plane_product(plane(picture), plane(truth))?;
    }
    Ok(sum / truth.channels as f64)
}

struct Plane {
    width: usize,
    height: usize,
    data: Vec<f32>,
}

/// The product over scales for one channel.
fn plane_product(mut x: Plane, mut y: Plane) -> Result<f64, EvalError> {
    let mut product = 1.0;
    for (scale, exponent) in EXPONENTS.into_iter().enumerate() {
        let Similarity { whole, contrast } = plane_means(&x.data, &y.data, y.width, y.height);
        if !(whole.is_finite() && contrast.is_finite()) {
            return Err(EvalError::NotFinite { what: "the pictures" });
        }
        let last = scale + 1 == EXPONENTS.len();
        product *= (if last { whole } else { contrast }).max(0.0).powf(exponent);
        if !last {
            (x, y) = (x.halved(), y.halved());
        }
    }
    Ok(product)
}

impl Plane {
    /// Averages over blocks of 2 x 2, with a zero before the first pixel of an odd side.
    fn halved(&self) -> Self {
        let (pad_x, pad_y) = (self.width % 2, self.height % 2);
        let (width, height) = ((self.width + pad_x) / 2, (self.height + pad_y) / 2);
        let at =
            |column: usize, row: usize| match (column.checked_sub(pad_x), row.checked_sub(pad_y)) {
                (Some(column), Some(row)) => self.data[row * self.width + column],
                _ => 0.0,
            };
        let block = |i: usize| {
            let (column, row) = (2 * (i % width), 2 * (i / width));
            let above = at(column, row) + at(column + 1, row);
            0.25 * (above + at(column, row + 1) + at(column + 1, row + 1))
        };
        Self { width, height, data: (0..width * height).map(block).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::grey as noise;

    #[test]
    fn an_odd_side_is_padded_at_its_start() {
        let plane = Plane { width: 3, height: 2, data: vec![1.0, 2.0, 4.0, 3.0, 6.0, 8.0] };
        let half = plane.halved();
        assert_eq!((half.width, half.height), (2, 1));
        assert_eq!(half.data, [1.0, 5.0]);
    }

    #[test]
    fn equal_pictures_give_one_and_opposite_ones_zero() {
        let a = noise(1, 170, 163);
        assert!((ms_ssim(&a, &a).unwrap() - 1.0).abs() < 1e-9);
        let opposite = Image { data: a.data.iter().map(|v| 1.0 - v).collect(), ..a.clone() };
        assert_eq!(ms_ssim(&opposite, &a).unwrap(), 0.0);
    }

    #[test]
    fn poison_and_small_pictures_are_refused() {
        let good = noise(2, 161, 161);
        let mut bad = good.clone();
        bad.data[7] = f32::NAN;
        assert!(matches!(ms_ssim(&bad, &good), Err(EvalError::NotFinite { .. })));
        let small = noise(3, 160, 200);
        let due =
            EvalError::TooFew { what: "pixels along the shorter side", found: 160, needed: 161 };
        assert_eq!(ms_ssim(&small, &small), Err(due));
    }
}
