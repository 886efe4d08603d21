//! Convolution with rectification on the CPU: a small matrix product without a copy of patches.

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// Output channels whose weights are interleaved.
pub(super) const GROUP: usize = 32;
/// Pixels computed together, which share every load of weights.
const PIXELS: usize = 6;
/// Pixels per parallel task.
const TASK_PIXELS: usize = 36;

/// Feature maps, channels of a pixel together: `data[(row * width + column) * channels + c]`.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Features {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) channels: usize,
    pub(super) data: Vec<f32>,
}

/// `y_o = max(0, b_o + Σ w_o,row,column,c x)` over a square window.
pub(super) struct Convolution {
    pub(super) inputs: usize,
    /// A multiple of [`GROUP`].
    pub(super) outputs: usize,
    /// Side of the window.
    pub(super) side: usize,
    pub(super) stride: usize,
    /// Zeros around the input.
    pub(super) padding: usize,
    /// `[output / GROUP][row][column][input][GROUP]`.
    pub(super) weights: Vec<f32>,
    pub(super) biases: Vec<f32>,
}

impl Convolution {
    /// Width or height of the result.
    pub(super) fn output_size(&self, size: usize) -> usize {
        (size + 2 * self.padding - self.side) / self.stride + 1
    }

    /// The result for an input at least as large as the window less its padding.
    pub(super) fn apply(&self, input: &Features) -> Features {
        let (width, height) = (self.output_size(input.width), self.output_size(input.height));
        let padded = input.padded(self.padding);
        let mut data = vec![0.0; width * height * self.outputs];
        let arch = Arch::new();
        data.par_chunks_mut(TASK_PIXELS * self.outputs).enumerate().for_each(|(task, out)| {
            let (layer, input, first) = (self, &padded, task * TASK_PIXELS);
            arch.dispatch(ConvolutionTask { layer, input, width, first, out });
        });
        Features { width, height, channels: self.outputs, data }
    }
}

/// Computes the pixels `first..` of the result, as many as `out` holds.
struct ConvolutionTask<'a> {
    layer: &'a Convolution,
    /// With its padding.
    input: &'a Features,
    /// Of the result.
    width: usize,
    first: usize,
    out: &'a mut [f32],
}

impl WithSimd for ConvolutionTask<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { layer, input, width, first, out } = self;
        let pixels = out.len() / layer.outputs;
        let window = layer.side * layer.side * layer.inputs;
        for group in 0..layer.outputs / GROUP {
            let weights = &layer.weights[group * window * GROUP..(group + 1) * window * GROUP];
            for block in (0..pixels).step_by(PIXELS) {
                // Pixels beyond the end repeat the last one and are not written.
                let start = |p: usize| {
                    let pixel = first + (block + p).min(pixels - 1);
                    let (column, row) = (pixel % width, pixel / width);
                    (row * input.width + column) * layer.stride * input.channels
                };
                let starts: [usize; PIXELS] = std::array::from_fn(start);
                for part in (0..GROUP).step_by(2 * S::F32_LANES) {
                    let sums = products(simd, layer, input, weights, starts, part);
                    for (p, sum) in sums.iter().enumerate().take(pixels - block) {
                        let place = (block + p) * layer.outputs + group * GROUP + part;
                        let biases = &layer.biases[group * GROUP + part..];
                        write_rectified(simd, *sum, biases, &mut out[place..]);
                    }
                }
            }
        }
    }
}

/// `Σ w x` of [`PIXELS`] pixels for the outputs `part..` of a group.
#[inline(always)]
fn products<S: Simd>(
    simd: S,
    layer: &Convolution,
    input: &Features,
    weights: &[f32],
    starts: [usize; PIXELS],
    part: usize,
) -> [[S::f32s; 2]; PIXELS] {
    let mut sums = [[simd.splat_f32s(0.0); 2]; PIXELS];
    let length = layer.side * layer.inputs;
    for (row, weights) in weights.chunks_exact(length * GROUP).enumerate() {
        let from = row * input.width * input.channels;
        let patch = starts.map(|s| &input.data[s + from..][..length]);
        for (k, weights) in weights.chunks_exact(GROUP).enumerate() {
            let lanes = &S::as_simd_f32s(&weights[part..part + 2 * S::F32_LANES]).0[..2];
            for p in 0..PIXELS {
                let x = simd.splat_f32s(patch[p][k]);
                sums[p][0] = simd.mul_add_e_f32s(x, lanes[0], sums[p][0]);
                sums[p][1] = simd.mul_add_e_f32s(x, lanes[1], sums[p][1]);
            }
        }
    }
    sums
}

/// Adds the biases, cuts at zero and writes.
#[inline(always)]
fn write_rectified<S: Simd>(simd: S, sum: [S::f32s; 2], biases: &[f32], out: &mut [f32]) {
    let biases = S::as_simd_f32s(&biases[..2 * S::F32_LANES]).0;
    let out = S::as_mut_simd_f32s(&mut out[..2 * S::F32_LANES]).0;
    for i in 0..2 {
        out[i] = simd.max_f32s(simd.add_f32s(sum[i], biases[i]), simd.splat_f32s(0.0));
    }
}

impl Features {
    /// With `border` zeros on every side.
    fn padded(&self, border: usize) -> Self {
        let (width, height) = (self.width + 2 * border, self.height + 2 * border);
        let mut data = vec![0.0; width * height * self.channels];
        let length = self.width * self.channels;
        for (row, values) in self.data.chunks_exact(length).enumerate() {
            let start = ((row + border) * width + border) * self.channels;
            data[start..start + length].copy_from_slice(values);
        }
        Self { width, height, channels: self.channels, data }
    }

    /// Max pooling over windows of 3 x 3 with stride 2.
    pub(super) fn max_pooled(&self) -> Self {
        let (width, height) = ((self.width - 3) / 2 + 1, (self.height - 3) / 2 + 1);
        let mut data = vec![f32::NEG_INFINITY; width * height * self.channels];
        for (pixel, out) in data.chunks_exact_mut(self.channels).enumerate() {
            let (column, row) = (2 * (pixel % width), 2 * (pixel / width));
            for place in 0..9 {
                let from = (row + place / 3) * self.width + column + place % 3;
                let values = &self.data[from * self.channels..(from + 1) * self.channels];
                for (o, v) in out.iter_mut().zip(values) {
                    *o = o.max(*v);
                }
            }
        }
        Self { width, height, channels: self.channels, data }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::noise::values as noise;

    /// Reference implementation in f64.
    fn reference(layer: &Convolution, input: &Features, pixel: usize, output: usize) -> f64 {
        let width = layer.output_size(input.width);
        let (left, top) = (pixel % width * layer.stride, pixel / width * layer.stride);
        let mut sum = f64::from(layer.biases[output]);
        let (side, inputs) = (layer.side, layer.inputs);
        for place in 0..side * side * inputs {
            let (c, column, row) =
                (place % inputs, left + place / inputs % side, top + place / inputs / side);
            let inside = |at: usize, size: usize| {
                (layer.padding..size + layer.padding).contains(&at).then(|| at - layer.padding)
            };
            let at = inside(column, input.width).zip(inside(row, input.height));
            let Some((column, row)) = at else { continue };
            let x = input.data[(row * input.width + column) * inputs + c];
            let group = output / GROUP * side * side * inputs + place;
            let w = layer.weights[group * GROUP + output % GROUP];
            sum += f64::from(w) * f64::from(x);
        }
        sum.max(0.0)
    }

    #[test]
    fn agrees_with_the_definition() {
        for (seed, side, stride, padding) in [(1, 3, 1, 1), (2, 5, 1, 2), (3, 4, 3, 0)] {
            let layer = Convolution {
                inputs: 5,
                outputs: 64,
                side,
                stride,
                padding,
                weights: noise(seed, side * side * 5 * 64),
                biases: noise(seed + 10, 64),
            };
            let data = noise(seed + 20, 13 * 11 * 5);
            let input = Features { width: 13, height: 11, channels: 5, data };
            let out = layer.apply(&input);
            for (i, &value) in out.data.iter().enumerate() {
                let due = reference(&layer, &input, i / 64, i % 64);
                assert!((f64::from(value) - due).abs() < 1e-4, "{i}: {value} expected {due}");
            }
            assert!(out.data.iter().filter(|v| **v > 0.0).count() > out.data.len() / 4);
        }
    }

    #[test]
    fn pooling_by_hand() {
        let data = (0..6 * 5).map(|i| if i == 14 { 99.0 } else { i as f32 }).collect();
        let pooled = Features { width: 6, height: 5, channels: 1, data }.max_pooled();
        assert_eq!((pooled.width, pooled.height), (2, 2));
        assert_eq!(pooled.data, [99.0, 99.0, 99.0, 99.0]);
        let data = (0..2 * 49).map(|i| -(i as f32)).collect();
        let pooled = Features { width: 7, height: 7, channels: 2, data }.max_pooled();
        assert_eq!(pooled.data[..4], [0.0, -1.0, -4.0, -5.0]);
        assert_eq!(pooled.data.len(), 18);
    }
}
