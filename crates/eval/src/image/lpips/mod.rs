//! Learned perceptual distance (Zhang, Isola, Efros, Shechtman, Wang 2018).

mod convolution;

use super::{check_shapes, check_side};
use crate::EvalError;
use convolution::{Convolution, Features, GROUP};
use half::f16;
use i2slam_geometry::Image;
use std::sync::OnceLock;

/// Mean of ImageNet's values in `[-1, 1]`, R, G, B.
const IMAGE_MEAN: [f32; 3] = [-0.030, -0.088, -0.188];
/// Standard deviation of ImageNet's values in `[-1, 1]`, R, G, B.
const IMAGE_DEVIATION: [f32; 3] = [0.458, 0.448, 0.450];

/// Added to the length of a feature vector before dividing by it.
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
    check_side(truth, MIN_SIDE)?;
    // Checked here because rectification turns a NaN into a number.
    if [picture, truth].iter().any(|image| image.data.iter().any(|v| !v.is_finite())) {
        return Err(EvalError::NotFinite { what: "the pictures" });
    }
    let network = NETWORK.get_or_init(Network::unpack);
    let (ours, theirs) = rayon::join(
        || network.features(normalised(picture)),
        || network.features(normalised(truth)),
    );
    let layers = ours.iter().zip(&theirs).zip(&network.heads);
    Ok(layers.map(|((a, b), head)| layer_distance(a, b, head)).sum())
}

/// Normalises an image, with the channels of a pixel adjacent.
fn normalised(image: &Image<f32>) -> Features {
    let mut data = Vec::with_capacity(image.data.len());
    for pixel in 0..image.pixels() {
        for c in 0..3 {
            data.push((2.0 * image.plane(c)[pixel] - 1.0 - IMAGE_MEAN[c]) / IMAGE_DEVIATION[c]);
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

/// Weights in half precision, layout in `assets/README.md`.
static WEIGHTS: &[u8] = include_bytes!("../../../assets/lpips_alex_f16.bin");

/// Inputs, outputs, side, stride, padding of the convolutions.
const LAYERS: [[usize; 5]; 5] = [
    [3, 64, 11, 4, 2],
    [64, 192, 5, 1, 2],
    [192, 384, 3, 1, 1],
    [384, 256, 3, 1, 1],
    [256, 256, 3, 1, 1],
];

/// Layers whose input is pooled first.
const POOLED: [bool; 5] = [false, true, true, false, false];

/// Number of values in the file.
const COUNT: usize = {
    let (mut sum, mut i) = (0, 0);
    while i < LAYERS.len() {
        let [inputs, outputs, side, ..] = LAYERS[i];
        sum += outputs * (inputs * side * side + 2);
        i += 1;
    }
    sum
};

const _: () = assert!(WEIGHTS.len() == 2 * COUNT, "the file of weights has another size");

/// Smallest side of an image [px]: the second pooling needs three.
const MIN_SIDE: usize = 31;

/// AlexNet's convolutions and the heads of LPIPS.
struct Network {
    layers: Vec<Convolution>,
    /// Weights of the channels of each layer, none below zero.
    heads: Vec<Vec<f32>>,
}

impl Network {
    /// Unpacks the weights.
    fn unpack() -> Self {
        let mut values = WEIGHTS.chunks_exact(2).map(|b| f16::from_le_bytes([b[0], b[1]]).to_f32());
        let mut take = |count: usize| -> Vec<f32> { values.by_ref().take(count).collect() };
        let layers = LAYERS.map(|[inputs, outputs, side, stride, padding]| {
            let weights = grouped(&take(outputs * inputs * side * side), inputs, outputs, side);
            let biases = take(outputs);
            Convolution { inputs, outputs, side, stride, padding, weights, biases }
        });
        Self { layers: layers.into(), heads: LAYERS.map(|[_, outputs, ..]| take(outputs)).into() }
    }

    /// The rectified outputs of all layers for an input of at least [`MIN_SIDE`].
    fn features(&self, input: Features) -> Vec<Features> {
        let mut all: Vec<Features> = Vec::with_capacity(LAYERS.len());
        for (layer, pooled) in self.layers.iter().zip(POOLED) {
            let last = all.last().unwrap_or(&input);
            let next = if pooled { layer.apply(&last.max_pooled()) } else { layer.apply(last) };
            all.push(next);
        }
        all
    }
}

/// `[output][input][row][column]` to `[output / GROUP][row][column][input][GROUP]`.
fn grouped(weights: &[f32], inputs: usize, outputs: usize, side: usize) -> Vec<f32> {
    let window = side * side;
    let mut packed = vec![0.0; weights.len()];
    for (i, &w) in weights.iter().enumerate() {
        let (place, input, output) = (i % window, i / window % inputs, i / window / inputs);
        let row = (output / GROUP * window + place) * inputs + input;
        packed[row * GROUP + output % GROUP] = w;
    }
    debug_assert_eq!(packed.len(), inputs * outputs * window);
    packed
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::noise::picture as noise;

    #[test]
    fn equal_pictures_have_no_distance_and_the_order_does_not_matter() {
        let (a, b) = (noise(1, 64, 48, 3), noise(2, 64, 48, 3));
        for equal in [&a, &Image::new(64, 48, 3)] {
            assert_eq!(lpips(equal, equal).unwrap(), 0.0);
        }
        let (ab, ba) = (lpips(&a, &b).unwrap(), lpips(&b, &a).unwrap());
        assert!(ab > 0.01 && (ab - ba).abs() < 1e-6, "{ab} {ba}");
    }

    #[test]
    fn invalid_input_is_refused() {
        let good = noise(4, 40, 31, 3);
        let mut bad = good.clone();
        bad.data[100] = f32::NAN;
        assert!(matches!(lpips(&bad, &good), Err(EvalError::NotFinite { .. })));
        let small = noise(5, 40, 30, 3);
        assert!(matches!(lpips(&small, &small), Err(EvalError::TooFew { found: 30, .. })));
        let grey = Image::<f32>::new(40, 40, 1);
        assert!(matches!(lpips(&grey, &grey), Err(EvalError::ShapeMismatch { .. })));
    }

    #[test]
    fn the_smallest_picture_passes() {
        let data = vec![0.5; MIN_SIDE * MIN_SIDE * 3];
        let input = Features { width: MIN_SIDE, height: MIN_SIDE, channels: 3, data };
        let sizes: Vec<_> =
            Network::unpack().features(input).iter().map(|f| (f.width, f.channels)).collect();
        assert_eq!(sizes, [(7, 64), (3, 192), (1, 384), (1, 256), (1, 256)]);
    }
}
