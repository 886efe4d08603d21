//! SSIM (Wang, Bovik, Sheikh, Simoncelli 2004) and MS-SSIM (Wang, Simoncelli, Bovik 2003).

use super::{check_shapes, check_side};
use crate::EvalError;
use i2slam_geometry::Image;

/// Side of the window [px].
const WINDOW: usize = 11;
/// Standard deviation of the Gaussian window [px].
const SIGMA: f64 = 1.5;
/// `(K1 L)²` with `K1 = 0.01` and data range `L = 1`.
const C1: f64 = 0.01 * 0.01;
/// `(K2 L)²` with `K2 = 0.03` and data range `L = 1`.
const C2: f64 = 0.03 * 0.03;

/// Mean SSIM, in `[-1, 1]`, 1 for equal pictures.
///
/// Per channel and window, with Gaussian weights `w` (11 x 11, σ = 1.5, sum 1),
/// `SSIM = (2 μx μy + C1)(2 σxy + C2) / ((μx² + μy² + C1)(σx² + σy² + C2))`, where
/// `μx = Σ w x`, `σx² = Σ w x² - μx²`, `σxy = Σ w x y - μx μy` (eq. 13-16). Averaged over all
/// windows that lie inside the picture, then over channels: scikit-image's
/// `structural_similarity(gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
/// data_range=1)`. Pictures smaller than a window are refused.
///
/// Rows are filtered first along columns, then along rows; working memory is a few rows. In f64:
/// in flat parts `Σ w x² - μx²` cancels, and f32 would be off by 1e-4.
pub fn ssim(picture: &Image<f32>, truth: &Image<f32>) -> Result<f64, EvalError> {
    check_shapes(picture, truth)?;
    check_side(truth, WINDOW)?;
    let sum: f64 = (0..truth.channels)
        .map(|c| plane_means(picture.plane(c), truth.plane(c), truth.width, truth.height).whole)
        .sum();
    if sum.is_finite() {
        Ok(sum / truth.channels as f64)
    } else {
        Err(EvalError::NotFinite { what: "the pictures" })
    }
}

/// Mean SSIM as 3D Gaussian splatting and MonoGS compute it, in `[-1, 1]`: as [`ssim`], but over a
/// window around *every* pixel, the picture continued by zeros.
pub fn ssim_padded(picture: &Image<f32>, truth: &Image<f32>) -> Result<f64, EvalError> {
    check_shapes(picture, truth)?;
    ssim(&zero_padded(picture), &zero_padded(truth))
}

/// Pads with zeros, so that there is a window for every pixel.
fn zero_padded(image: &Image<f32>) -> Image<f32> {
    let border = WINDOW / 2;
    let mut out = Image::new(image.width + 2 * border, image.height + 2 * border, image.channels);
    for (i, row) in image.data.chunks_exact(image.width).enumerate() {
        let (channel, row_of) = (i / image.height, i % image.height);
        let start = (channel * out.height + row_of + border) * out.width + border;
        out.data[start..start + image.width].copy_from_slice(row);
    }
    out
}

/// Means over the windows of one plane.
#[derive(Clone, Copy, Default)]
struct SsimMeans {
    /// Mean of the SSIM map.
    whole: f64,
    /// Mean of its second factor, `(2 σxy + C2) / (σx² + σy² + C2)`: contrast and structure.
    contrast: f64,
}

/// Means of the maps of one `height x width` plane, both sides at least [`WINDOW`].
fn plane_means(x: &[f32], y: &[f32], width: usize, height: usize) -> SsimMeans {
    let weights = window();
    let (columns, rows) = (width - WINDOW + 1, height - WINDOW + 1);
    let mut tall = Moments::new(width);
    let mut full = Moments::new(columns);
    let mut sum = SsimMeans::default();
    for row in 0..rows {
        tall.clear();
        for (k, &w) in weights.iter().enumerate() {
            let start = (row + k) * width;
            tall.add_products(w, &x[start..start + width], &y[start..start + width]);
        }
        full.clear();
        for (k, &w) in weights.iter().enumerate() {
            full.add_shifted(w, &tall, k);
        }
        full.add_similarity(&mut sum);
    }
    let windows = (rows * columns) as f64;
    SsimMeans { whole: sum.whole / windows, contrast: sum.contrast / windows }
}

/// The Gaussian window along one axis.
fn window() -> [f64; WINDOW] {
    let weight = |i: usize| {
        let d = i as f64 - (WINDOW / 2) as f64;
        (-0.5 * (d / SIGMA).powi(2)).exp()
    };
    let raw: [f64; WINDOW] = std::array::from_fn(weight);
    let sum: f64 = raw.iter().sum();
    raw.map(|w| w / sum)
}

/// One row of weighted sums; the two squares are only ever needed together.
struct Moments {
    x: Vec<f64>,
    y: Vec<f64>,
    squares: Vec<f64>,
    product: Vec<f64>,
}

impl Moments {
    fn new(columns: usize) -> Self {
        let row = || vec![0.0; columns];
        Self { x: row(), y: row(), squares: row(), product: row() }
    }

    fn clear(&mut self) {
        for row in [&mut self.x, &mut self.y, &mut self.squares, &mut self.product] {
            row.fill(0.0);
        }
    }

    /// Adds `w` times `x`, `y`, `x² + y²`, `x y`.
    fn add_products(&mut self, w: f64, x: &[f32], y: &[f32]) {
        let n = self.x.len();
        let (x, y) = (&x[..n], &y[..n]);
        let (sum_x, sum_y) = (&mut self.x[..n], &mut self.y[..n]);
        let (squares, product) = (&mut self.squares[..n], &mut self.product[..n]);
        for i in 0..n {
            let (x, y) = (f64::from(x[i]), f64::from(y[i]));
            let (wx, wy) = (w * x, w * y);
            sum_x[i] += wx;
            sum_y[i] += wy;
            squares[i] += wx * x + wy * y;
            product[i] += wx * y;
        }
    }

    /// Adds `w` times the row `from`, read `shift` columns further right.
    fn add_shifted(&mut self, w: f64, from: &Self, shift: usize) {
        let add = |sum: &mut [f64], row: &[f64]| {
            for (s, v) in sum.iter_mut().zip(&row[shift..]) {
                *s += w * v;
            }
        };
        add(&mut self.x, &from.x);
        add(&mut self.y, &from.y);
        add(&mut self.squares, &from.squares);
        add(&mut self.product, &from.product);
    }

    /// Adds the similarity of all columns.
    fn add_similarity(&self, sum: &mut SsimMeans) {
        for i in 0..self.x.len() {
            let (xy, xx_yy) =
                (self.x[i] * self.y[i], self.x[i] * self.x[i] + self.y[i] * self.y[i]);
            let luminance = (2.0 * xy + C1) / (xx_yy + C1);
            let contrast = (2.0 * (self.product[i] - xy) + C2) / (self.squares[i] - xx_yy + C2);
            sum.whole += luminance * contrast;
            sum.contrast += contrast;
        }
    }
}

/// Exponents `β` of the five scales, fine to coarse (Wang et al. 2003, section 3.2).
const EXPONENTS: [f64; 5] = [0.0448, 0.2856, 0.3001, 0.2363, 0.1333];

/// Smallest side of an image [px], of which four halvings leave a window.
const MIN_SIDE: usize = ((WINDOW - 1) << (EXPONENTS.len() - 1)) + 1;

/// Multi-scale SSIM, in `[0, 1]`, 1 for equal pictures.
///
/// Per channel `SSIM_5^β5 · Π_{k<5} CS_k^βk`, with `CS` the contrast and structure factor of
/// [`ssim`] on the picture halved `k - 1` times, `β = 0.0448, 0.2856, 0.3001,
/// 0.2363, 0.1333`; factors below zero count as zero; averaged over channels. Halving averages
/// blocks of 2 x 2; an odd side gets one zero before its first pixel. All this is what
/// `pytorch_msssim.ms_ssim(data_range=1)` does, and through it SplaTAM.
/// Pictures whose shorter side is not above 160 px are refused.
pub fn ms_ssim(picture: &Image<f32>, truth: &Image<f32>) -> Result<f64, EvalError> {
    check_shapes(picture, truth)?;
    check_side(truth, MIN_SIDE)?;
    let mut sum = 0.0;
    for channel in 0..truth.channels {
        let plane = |image: &Image<f32>| Image {
            channels: 1,
            data: image.plane(channel).to_vec(),
            ..*image
        };
        sum += plane_product(plane(picture), plane(truth))?;
    }
    Ok(sum / truth.channels as f64)
}

/// The product over scales for one channel.
fn plane_product(mut x: Image<f32>, mut y: Image<f32>) -> Result<f64, EvalError> {
    let mut product = 1.0;
    for (scale, exponent) in EXPONENTS.into_iter().enumerate() {
        let SsimMeans { whole, contrast } = plane_means(&x.data, &y.data, y.width, y.height);
        if !(whole.is_finite() && contrast.is_finite()) {
            return Err(EvalError::NotFinite { what: "the pictures" });
        }
        let last = scale + 1 == EXPONENTS.len();
        product *= (if last { whole } else { contrast }).max(0.0).powf(exponent);
        if !last {
            (x, y) = (halved(&x), halved(&y));
        }
    }
    Ok(product)
}

/// Averages over blocks of 2 x 2 of one plane, with a zero before the first pixel of an odd side.
fn halved(plane: &Image<f32>) -> Image<f32> {
    let (pad_x, pad_y) = (plane.width % 2, plane.height % 2);
    let at = |column: usize, row: usize| match (column.checked_sub(pad_x), row.checked_sub(pad_y)) {
        (Some(column), Some(row)) => plane.at(0, column, row),
        _ => 0.0,
    };
    Image::from_fn(plane.width.div_ceil(2), plane.height.div_ceil(2), 1, |_, column, row| {
        let (column, row) = (2 * column, 2 * row);
        let above = at(column, row) + at(column + 1, row);
        0.25 * (above + at(column, row + 1) + at(column + 1, row + 1))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::noise::picture as noise;

    type Metric = fn(&Image<f32>, &Image<f32>) -> Result<f64, EvalError>;

    #[test]
    fn equal_pictures_give_one_and_opposite_ones_zero_in_ms_ssim() {
        let a = noise(1, 170, 163, 1);
        let opposite = Image { data: a.data.iter().map(|v| 1.0 - v).collect(), ..a.clone() };
        for metric in [ssim, ssim_padded, ms_ssim] {
            assert!((metric(&a, &a).unwrap() - 1.0).abs() < 1e-9);
        }
        assert_eq!(ms_ssim(&opposite, &a).unwrap(), 0.0);
    }

    #[test]
    fn poison_and_small_pictures_are_refused() {
        for (metric, needed) in [(ssim as Metric, 11), (ms_ssim, 161)] {
            let good = noise(2, needed, needed, 1);
            let mut bad = good.clone();
            bad.data[7] = f32::NAN;
            assert!(matches!(metric(&bad, &good), Err(EvalError::NotFinite { .. })));
            let small = noise(3, needed - 1, 200, 1);
            let (what, found) = ("pixels along the shorter side", needed - 1);
            let due = EvalError::TooFew { what, found, needed };
            assert_eq!(metric(&small, &small), Err(due));
            assert!(matches!(metric(&small, &good), Err(EvalError::ShapeMismatch { .. })));
        }
    }

    #[test]
    fn constant_pictures_have_the_luminance_term() {
        let flat = |v| Image { width: 12, height: 13, channels: 1, data: vec![v; 156] };
        let expected = (2.0 * 0.2 * 0.6 + 1e-4) / (0.04 + 0.36 + 1e-4);
        assert!((ssim(&flat(0.2), &flat(0.6)).unwrap() - expected).abs() < 1e-5);
    }
}
