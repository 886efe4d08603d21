//! Learned perceptual distance (Zhang, Isola, Efros, Shechtman, Wang 2018).

mod convolution;
mod network;

use super::check_shapes;
use crate::EvalError;
use convolution::Features;
use i2slam_geometry::Image;
use network::{MIN_SIDE, Network};
use std::sync::OnceLock;

/// Mean and spread of the pictures that the network was made for, of values in `[-1, 1]`
/// (ImageNet's, R, G, B).
const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
const SCALE: [f32; 3] = [0.458, 0.448, 0.450];

/// Added to the length of a feature before it is divided by.
const EPSILON: f32 = 1e-10;

/// LPIPS v0.1 on AlexNet, 0 for equal pictures, about 1 for unlike ones.
///
/// `d = Σ_l 1/(H_l W_l) Σ_hw Σ_c w_lc (f̂_lc - ĝ_lc)²` (eq. 1) with `f̂`, `ĝ` the rectified
/// outputs of AlexNet's five convolutions for the two pictures, of unit length at every place,
/// and learned weights `w`: `lpips.LPIPS(net='alex')(2 a - 1, 2 b - 1)` of PyPI `lpips`, and
/// `LearnedPerceptualImagePatchSimilarity(net_type='alex', normalize=True)` of torchmetrics.
/// Weights are kept in half precision, which moves `d` by about 1e-5.
///
/// Takes pictures R, G, B in `[0, 1]` of at least 31 x 31 pixels.
pub fn lpips(picture: &Image<f32>, truth: &Image<f32>) -> Result<f64, EvalError> {
    static NETWORK: OnceLock<Network> = OnceLock::new();
    check_shapes(picture, truth)?;
    if truth.channels != 3 {
        let (first, second) = (vec![truth.channels], vec![3]);
        return Err(EvalError::ShapeMismatch { what: "picture and R, G, B", first, second });
    }
    let side = truth.width.min(truth.height);
    if side < MIN_SIDE {
        let what = "pixels along the shorter side";
        return Err(EvalError::TooFew { what, found: side, needed: MIN_SIDE });
    }
    // Rectification would turn a NaN into a number.
    if [picture, truth].iter().any(|image| image.data.iter().any(|v| !v.is_finite())) {
        return Err(EvalError::NotFinite { what: "the pictures" });
    }
    let network = NETWORK.get_or_init(Network::unpack);
    let (ours, theirs) =
        rayon::join(|| network.features(input(picture)), || network.features(input(truth)));
    let layers = ours.iter().zip(&theirs).zip(&network.heads);
    Ok(layers.map(|((a, b), head)| layer_distance(a, b, head)).sum())
}

/// Channels of a pixel together, normalised.
fn input(image: &Image<f32>) -> Features {
    let mut data = Vec::with_capacity(image.data.len());
    for pixel in 0..image.pixels() {
        for c in 0..3 {
            data.push((2.0 * image.plane(c)[pixel] - 1.0 - SHIFT[c]) / SCALE[c]);
        }
    }
    Features { width: image.width, height: image.height, channels: 3, data }
}

/// Mean over places of the weighted squared difference of unit features.
fn layer_distance(a: &Features, b: &Features, head: &[f32]) -> f64 {
    let places = a.data.chunks_exact(a.channels).zip(b.data.chunks_exact(b.channels));
    let sum: f64 = places
        .map(|(a, b)| {
            let (la, lb) = (length(a), length(b));
            let square = |((a, b), w): ((&f32, &f32), &f32)| w * (a / la - b / lb).powi(2);
            f64::from(a.iter().zip(b).zip(head).map(square).sum::<f32>())
        })
        .sum();
    sum / (a.width * a.height) as f64
}

fn length(feature: &[f32]) -> f32 {
    feature.iter().map(|v| v * v).sum::<f32>().sqrt() + EPSILON
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::picture as noise;

    #[test]
    fn equal_pictures_have_no_distance_and_the_order_does_not_matter() {
        let (a, b) = (noise(1, 64, 48), noise(2, 64, 48));
        assert_eq!(lpips(&a, &a).unwrap(), 0.0);
        let (ab, ba) = (lpips(&a, &b).unwrap(), lpips(&b, &a).unwrap());
        assert!(ab > 0.01 && (ab - ba).abs() < 1e-6, "{ab} {ba}");
    }

    #[test]
    fn all_black_pictures_have_a_distance() {
        let (black, a) = (Image::new(64, 48, 3), noise(3, 64, 48));
        assert_eq!(lpips(&black, &black).unwrap(), 0.0);
        assert!(lpips(&black, &a).unwrap() > 0.5);
    }

    #[test]
    fn what_cannot_be_judged_is_an_error() {
        let good = noise(4, 40, 31);
        let mut bad = good.clone();
        bad.data[100] = f32::NAN;
        assert!(matches!(lpips(&bad, &good), Err(EvalError::NotFinite { .. })));
        let small = noise(5, 40, 30);
        assert!(matches!(lpips(&small, &small), Err(EvalError::TooFew { found: 30, .. })));
        let grey = Image::<f32>::new(40, 40, 1);
        assert!(matches!(lpips(&grey, &grey), Err(EvalError::ShapeMismatch { .. })));
    }

    #[test]
    fn costs_less_than_three_tenths_of_a_second() {
        let (a, b) = (noise(6, 320, 240), noise(7, 320, 240));
        let once = |_| {
            let start = std::time::Instant::now();
            assert!(lpips(&a, &b).unwrap() > 0.0);
            start.elapsed().as_secs_f64()
        };
        let best = (0..5).map(once).fold(f64::INFINITY, f64::min);
        assert!(best < 0.3, "{best} s for 320 x 240");
    }
}
