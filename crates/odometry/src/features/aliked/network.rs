//! The network: planes of scores and features of a picture.

use super::layers::{Convolution, DeformableConvolution, activated, average_pooled, enlarged};
use half::f16;
use i2slam_geometry::Image;
use std::sync::LazyLock;

/// Weights in half precision, layout in `assets/README.md`.
static WEIGHTS: &[u8] = include_bytes!("../../../assets/aliked_t16_f16.bin");

/// Feature planes at each pixel, and those that each of four resolutions gives.
pub(super) const FEATURES: usize = 64;
const PER_RESOLUTION: usize = FEATURES / 4;
/// Planes of the blocks.
const BLOCKS: [usize; 4] = [8, 16, 32, 64];
/// Positions around a keypoint that its descriptor is made of.
pub(super) const POSITIONS: usize = 16;
/// Sides of pictures are enlarged to multiples of this [px].
const MULTIPLE: usize = 32;

/// The network, unpacked once.
pub(super) static NETWORK: LazyLock<Network> = LazyLock::new(Network::unpack);

/// ALIKED's tiny network with 16 positions.
pub(super) struct Network {
    first: [Convolution; 2],
    second: Block<Convolution>,
    third: Block<DeformableConvolution>,
    fourth: Block<DeformableConvolution>,
    aggregation: [Convolution; 4],
    scores: [Convolution; 4],
    pub(super) descriptor: DescriptorHead,
}

/// Two convolutions beside a shortcut.
struct Block<C> {
    convolutions: [C; 2],
    shortcut: Convolution,
}

/// Layers that make a descriptor.
pub(super) struct DescriptorHead {
    /// From the features around a keypoint to offsets of positions: one of a side of 3, one of 1.
    pub(super) offsets: [Convolution; 2],
    pub(super) sampled: Convolution,
    /// `[position][feature][element]`.
    pub(super) aggregation: Vec<f32>,
}

/// Planes of one value and of [`FEATURES`] values at each pixel.
pub(super) struct FeatureMaps {
    /// In (0, 1).
    pub(super) scores: Image<f32>,
    /// Of length 1 at each pixel.
    pub(super) features: Image<f32>,
}

/// Reads the weights one after another.
struct Weights<I>(I);

impl<I: Iterator<Item = f32>> Weights<I> {
    fn take(&mut self, count: usize) -> Vec<f32> {
        self.0.by_ref().take(count).collect()
    }

    fn convolution(&mut self, [inputs, outputs, side]: [usize; 3], is_biased: bool) -> Convolution {
        let weights = self.take(outputs * inputs * side * side);
        let biases = if is_biased { self.take(outputs) } else { vec![0.0; outputs] };
        Convolution { inputs, outputs, side, weights, biases }
    }

    fn deformable(&mut self, inputs: usize, outputs: usize) -> DeformableConvolution {
        let offsets = self.convolution([inputs, 18, 3], true);
        DeformableConvolution { offsets, taps: self.convolution([inputs, outputs, 3], true) }
    }

    fn deformable_block(&mut self, inputs: usize, outputs: usize) -> Block<DeformableConvolution> {
        Block {
            convolutions: [self.deformable(inputs, outputs), self.deformable(outputs, outputs)],
            shortcut: self.convolution([inputs, outputs, 1], true),
        }
    }
}

impl Network {
    fn unpack() -> Self {
        let values = WEIGHTS.chunks_exact(2).map(|b| f16::from_le_bytes([b[0], b[1]]).to_f32());
        let mut weights = Weights(values);
        let [a, b, c, d] = BLOCKS;
        Self {
            first: [weights.convolution([3, a, 3], true), weights.convolution([a, a, 3], true)],
            second: Block {
                convolutions: [
                    weights.convolution([a, b, 3], true),
                    weights.convolution([b, b, 3], true),
                ],
                shortcut: weights.convolution([a, b, 1], true),
            },
            third: weights.deformable_block(b, c),
            fourth: weights.deformable_block(c, d),
            aggregation: BLOCKS.map(|n| weights.convolution([n, PER_RESOLUTION, 1], false)),
            scores: [[FEATURES, 8, 1], [8, 4, 3], [4, 4, 3], [4, 1, 3]]
                .map(|shape| weights.convolution(shape, false)),
            descriptor: DescriptorHead {
                offsets: [
                    weights.convolution([FEATURES, 2 * POSITIONS, 3], true),
                    weights.convolution([2 * POSITIONS, 2 * POSITIONS, 1], true),
                ],
                sampled: weights.convolution([FEATURES, FEATURES, 1], false),
                aggregation: weights.take(POSITIONS * FEATURES * FEATURES),
            },
        }
    }

    /// Scores and features of a picture of one plane, which stands for all three.
    pub(super) fn apply(&self, brightness: &Image<f32>) -> FeatureMaps {
        let (width, height) = (brightness.width, brightness.height);
        let padded = [width, height].map(|n| n.next_multiple_of(MULTIPLE));
        let margin = [(padded[0] - width) / 2, (padded[1] - height) / 2];
        let picture = Image::from_fn(padded[0], padded[1], 3, |_, column, row| {
            let column = column.saturating_sub(margin[0]).min(width - 1);
            brightness.at(0, column, row.saturating_sub(margin[1]).min(height - 1))
        });
        let first = activated(self.first[1].apply(&activated(self.first[0].apply(&picture))));
        let second = self.second.apply(&average_pooled(&first, 2), Convolution::apply);
        let third = self.third.apply(&average_pooled(&second, 4), DeformableConvolution::apply);
        let fourth = self.fourth.apply(&average_pooled(&third, 4), DeformableConvolution::apply);
        let mut features = Image::new(padded[0], padded[1], FEATURES);
        let resolutions = [first, second, third, fourth];
        let parts = features.data.chunks_exact_mut(PER_RESOLUTION * picture.pixels());
        for ((part, layer), planes) in parts.zip(&self.aggregation).zip(&resolutions) {
            let own = activated(layer.apply(planes));
            part.copy_from_slice(&enlarged(&own, padded[0], padded[1]).data);
        }
        let scores = self.scores(&features);
        normalise(&mut features);
        let cut = |image: &Image<f32>| {
            Image::from_fn(width, height, image.channels, |channel, column, row| {
                image.at(channel, column + margin[0], row + margin[1])
            })
        };
        FeatureMaps { scores: cut(&scores), features: cut(&features) }
    }

    fn scores(&self, features: &Image<f32>) -> Image<f32> {
        let [first, rest @ ..] = &self.scores;
        let last = rest.iter().fold(first.apply(features), |v, layer| layer.apply(&activated(v)));
        let mut scores = last;
        scores.data.iter_mut().for_each(|v| *v = 1.0 / (1.0 + (-*v).exp()));
        scores
    }
}

impl<C> Block<C> {
    fn apply(
        &self,
        input: &Image<f32>,
        convolve: impl Fn(&C, &Image<f32>) -> Image<f32>,
    ) -> Image<f32> {
        let [first, second] = &self.convolutions;
        let mut out = convolve(second, &activated(convolve(first, input)));
        let beside = self.shortcut.apply(input);
        out.data.iter_mut().zip(&beside.data).for_each(|(a, b)| *a += b);
        activated(out)
    }
}

/// Scales the features of each pixel to length 1.
fn normalise(features: &mut Image<f32>) {
    let pixels = features.pixels();
    let mut lengths = vec![0.0_f32; pixels];
    for plane in features.data.chunks_exact(pixels) {
        lengths.iter_mut().zip(plane).for_each(|(sum, v)| *sum += v * v);
    }
    lengths.iter_mut().for_each(|sum| *sum = sum.sqrt().max(1e-12).recip());
    for plane in features.data.chunks_exact_mut(pixels) {
        plane.iter_mut().zip(&lengths).for_each(|(v, scale)| *v *= scale);
    }
}
