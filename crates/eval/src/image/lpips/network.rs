//! AlexNet's convolutions and the heads of LPIPS, from the file that comes with the crate.

use super::convolution::{Convolution, Features, GROUP};

/// Half precision, layout in `assets/README.md`.
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

/// Pictures need at least so many pixels a side: the second pooling needs three.
pub(super) const MIN_SIDE: usize = 31;

/// The network.
pub(super) struct Network {
    layers: Vec<Convolution>,
    /// Weights of the channels of each layer, none below zero.
    pub(super) heads: Vec<Vec<f32>>,
}

impl Network {
    /// Unpacks the weights.
    pub(super) fn unpack() -> Self {
        let mut values =
            WEIGHTS.chunks_exact(2).map(|b| from_half(u16::from_le_bytes([b[0], b[1]])));
        let mut take = |count: usize| -> Vec<f32> { values.by_ref().take(count).collect() };
        let layers = LAYERS.map(|[inputs, outputs, side, stride, padding]| {
            let weights = grouped(&take(outputs * inputs * side * side), inputs, outputs, side);
            let biases = take(outputs);
            Convolution { inputs, outputs, side, stride, padding, weights, biases }
        });
        Self { layers: layers.into(), heads: LAYERS.map(|[_, outputs, ..]| take(outputs)).into() }
    }

    /// The rectified outputs of all layers for an input of at least [`MIN_SIDE`].
    pub(super) fn features(&self, input: Features) -> Vec<Features> {
        let mut all: Vec<Features> = Vec::with_capacity(LAYERS.len());
        for (layer, pooled) in self.layers.iter().zip(POOLED) {
            let last = all.last().unwrap_or(&input);
            let next = if pooled { layer.apply(&last.pooled()) } else { layer.apply(last) };
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

/// IEEE 754 half precision to single precision, exactly.
fn from_half(half: u16) -> f32 {
    let sign = if half >> 15 == 1 { -1.0 } else { 1.0 };
    let (exponent, mantissa) = (i32::from(half >> 10 & 31), f32::from(half & 1023));
    let magnitude = match exponent {
        0 => mantissa * (-24_f32).exp2(),
        31 if mantissa == 0.0 => f32::INFINITY,
        31 => f32::NAN,
        _ => (1024.0 + mantissa) * ((exponent - 25) as f32).exp2(),
    };
    sign * magnitude
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_precision_by_hand() {
        let known = [
            (0x3c00, 1.0),
            (0xc000, -2.0),
            (0x7bff, 65504.0),
            (0x0400, 6.103_515_6e-5),
            (0x0001, 5.960_464_5e-8),
            (0x3555, 0.333_251_95),
            (0x7c00, f32::INFINITY),
        ];
        for (half, due) in known {
            assert_eq!(from_half(half), due, "{half:#06x}");
        }
        assert!(from_half(0x7e00).is_nan());
    }

    #[test]
    fn weights_are_finite_and_heads_not_negative() {
        let network = Network::unpack();
        assert!(network.layers.iter().all(|l| l.weights.iter().all(|w| w.is_finite())));
        assert!(network.heads.iter().flatten().all(|&w| (0.0..10.0).contains(&w)));
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
