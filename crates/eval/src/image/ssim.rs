//! Structural similarity (Wang, Bovik, Sheikh, Simoncelli 2004).

use super::check_shapes;
use crate::EvalError;
use i2slam_geometry::Image;

/// Side of the window [px].
pub(super) const WINDOW: usize = 11;
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
    let side = truth.width.min(truth.height);
    if side < WINDOW {
        let what = "pixels along the shorter side";
        return Err(EvalError::TooFew { what, found: side, needed: WINDOW });
    }
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
/// window around *every* pixel, the picture continued by zeros. Equal borders of zeros raise it a
/// little. Pictures of any size.
pub fn ssim_padded(picture: &Image<f32>, truth: &Image<f32>) -> Result<f64, EvalError> {
    check_shapes(picture, truth)?;
    ssim(&padded(picture), &padded(truth))
}

/// With zeros around it, so that there is a window for every pixel.
fn padded(image: &Image<f32>) -> Image<f32> {
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
pub(super) struct Similarity {
    /// Of the SSIM map.
    pub(super) whole: f64,
    /// Of its second factor, `(2 σxy + C2) / (σx² + σy² + C2)`: contrast and structure.
    pub(super) contrast: f64,
}

/// Means of the maps of one `height x width` plane, both sides at least [`WINDOW`].
pub(super) fn plane_means(x: &[f32], y: &[f32], width: usize, height: usize) -> Similarity {
    let weights = window();
    let (columns, rows) = (width - WINDOW + 1, height - WINDOW + 1);
    let mut tall = Moments::new(width);
    let mut full = Moments::new(columns);
    let mut sum = Similarity::default();
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
    Similarity { whole: sum.whole / windows, contrast: sum.contrast / windows }
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
    fn add_similarity(&self, sum: &mut Similarity) {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::picture as noise;

    #[test]
    fn equal_pictures_give_one_and_the_order_does_not_matter() {
        let (a, b) = (noise(1, 20, 15), noise(2, 20, 15));
        assert!((ssim(&a, &a).unwrap() - 1.0).abs() < 1e-6);
        assert!((ssim(&a, &b).unwrap() - ssim(&b, &a).unwrap()).abs() < 1e-9);
        assert!(ssim(&a, &b).unwrap() < 0.2);
    }

    #[test]
    fn costs_less_than_twenty_milliseconds() {
        let (a, b) = (noise(7, 320, 240), noise(8, 320, 240));
        let once = |_| {
            let start = std::time::Instant::now();
            assert!(ssim(&a, &b).unwrap() < 0.2);
            start.elapsed().as_secs_f64()
        };
        let best = (0..10).map(once).fold(f64::INFINITY, f64::min);
        assert!(best < 0.020, "{best} s for 320 x 240 x 3");
    }

    #[test]
    fn constant_pictures_have_the_luminance_term() {
        let flat = |v| Image { width: 12, height: 13, channels: 1, data: vec![v; 156] };
        let expected = (2.0 * 0.2 * 0.6 + 1e-4) / (0.04 + 0.36 + 1e-4);
        assert!((ssim(&flat(0.2), &flat(0.6)).unwrap() - expected).abs() < 1e-5);
    }

    #[test]
    fn one_window_by_the_definition() {
        let (a, b) = (noise(3, 11, 11), noise(4, 11, 11));
        let weight = |i: usize| (-((i as f64 - 5.0) / 1.5).powi(2) / 2.0).exp();
        let total: f64 = (0..11).map(weight).sum::<f64>().powi(2);
        let mean = |f: &dyn Fn(usize) -> f64| -> f64 {
            (0..121).map(|i| weight(i / 11) * weight(i % 11) / total * f(i)).sum()
        };
        let mut expected = 0.0;
        for c in 0..3 {
            let (x, y) = (|i: usize| f64::from(a.plane(c)[i]), |i: usize| f64::from(b.plane(c)[i]));
            let (mx, my) = (mean(&x), mean(&y));
            let (vx, vy) = (mean(&|i| (x(i) - mx).powi(2)), mean(&|i| (y(i) - my).powi(2)));
            let xy = mean(&|i| (x(i) - mx) * (y(i) - my));
            expected += (2.0 * mx * my + 1e-4) * (2.0 * xy + 9e-4)
                / ((mx * mx + my * my + 1e-4) * (vx + vy + 9e-4))
                / 3.0;
        }
        assert!((ssim(&a, &b).unwrap() - expected).abs() < 1e-5);
    }

    #[test]
    fn poison_and_small_pictures_are_refused() {
        let good = noise(5, 20, 15);
        let mut bad = good.clone();
        bad.data[3] = f32::NAN;
        assert!(matches!(ssim(&bad, &good), Err(EvalError::NotFinite { .. })));
        let small = noise(6, 20, 10);
        assert!(matches!(ssim(&small, &small), Err(EvalError::TooFew { found: 10, .. })));
        assert!(matches!(ssim(&small, &good), Err(EvalError::ShapeMismatch { .. })));
    }
}
