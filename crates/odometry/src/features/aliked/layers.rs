//! Layers of the network on planes of values: convolutions, deformable convolutions (Dai et al. 2017),
//! pooling and enlargement.

use i2slam_geometry::Image;
use rayon::prelude::*;

/// A convolution of a side of 1 or 3, stride 1 and zeros around the picture; its weights
/// `[output][input][row][column]`.
#[derive(Clone, Debug)]
pub(super) struct Convolution {
    pub(super) inputs: usize,
    pub(super) outputs: usize,
    pub(super) side: usize,
    pub(super) weights: Vec<f32>,
    pub(super) biases: Vec<f32>,
}

impl Convolution {
    /// Convolution of all planes.
    pub(super) fn apply(&self, input: &Image<f32>) -> Image<f32> {
        let (width, height) = (input.width, input.height);
        let mut rows = vec![0.0; width * height * self.outputs];
        // Rows of all outputs one after another, so that they are computed apart.
        let of_row = |(row, out): (usize, &mut [f32])| {
            for (output, line) in out.chunks_exact_mut(width).enumerate() {
                line.fill(self.biases[output]);
                self.add_row(input, (output, row), line);
            }
        };
        rows.par_chunks_mut(width * self.outputs).enumerate().for_each(of_row);
        let mut out = Image::new(width, height, self.outputs);
        for (row, lines) in rows.chunks_exact(width * self.outputs).enumerate() {
            for (output, line) in lines.chunks_exact(width).enumerate() {
                let at = (output * height + row) * width;
                out.data[at..at + width].copy_from_slice(line);
            }
        }
        out
    }

    /// Adds the products for one row of an output.
    fn add_row(&self, input: &Image<f32>, (output, row): (usize, usize), line: &mut [f32]) {
        let (width, reach) = (input.width, self.side / 2);
        for plane in 0..self.inputs {
            for i in 0..self.side {
                let Some(from) = (row + i).checked_sub(reach).filter(|r| *r < input.height) else {
                    continue;
                };
                let from = &input.plane(plane)[from * width..(from + 1) * width];
                for j in 0..self.side {
                    let weight = self.weight(output, plane, i, j);
                    // Column c of the output reads column c + j - reach.
                    let (to, from) = match j.cmp(&reach) {
                        std::cmp::Ordering::Less => (&mut line[1..], &from[..width - 1]),
                        std::cmp::Ordering::Equal => (&mut line[..], from),
                        std::cmp::Ordering::Greater => (&mut line[..width - 1], &from[1..]),
                    };
                    to.iter_mut().zip(from).for_each(|(sum, value)| *sum += weight * value);
                }
            }
        }
    }

    fn weight(&self, output: usize, input: usize, row: usize, column: usize) -> f32 {
        self.weights[((output * self.inputs + input) * self.side + row) * self.side + column]
    }

    /// Products of one output with a column of inputs; of a side of 1.
    pub(super) fn at_point(&self, output: usize, inputs: &[f32]) -> f32 {
        let weights = &self.weights[output * self.inputs..(output + 1) * self.inputs];
        self.biases[output] + weights.iter().zip(inputs).map(|(w, v)| w * v).sum::<f32>()
    }
}

/// A convolution of a side of 3 each of whose taps is moved by offsets that another one computes.
#[derive(Clone, Debug)]
pub(super) struct DeformableConvolution {
    pub(super) offsets: Convolution,
    pub(super) taps: Convolution,
}

impl DeformableConvolution {
    /// Convolution of all planes.
    pub(super) fn apply(&self, input: &Image<f32>) -> Image<f32> {
        let (width, height) = (input.width, input.height);
        let offsets = self.offsets.apply(input);
        let most = width.max(height) as f32 / 4.0;
        let (inputs, outputs) = (self.taps.inputs, self.taps.outputs);
        let of_pixel = |at: usize| -> Vec<f32> {
            let (column, row) = (at % width, at / width);
            let mut sampled = vec![0.0; inputs * 9];
            for tap in 0..9 {
                let offset = |k: usize| offsets.plane(2 * tap + k)[at].clamp(-most, most);
                let y = (row + tap / 3) as f32 - 1.0 + offset(0);
                let x = (column + tap % 3) as f32 - 1.0 + offset(1);
                let corners = bilinear([x, y], [width, height]);
                for plane in 0..inputs {
                    let values = input.plane(plane);
                    sampled[plane * 9 + tap] = corners.iter().map(|(i, w)| w * values[*i]).sum();
                }
            }
            let product = |output: usize| {
                let weights = &self.taps.weights[output * inputs * 9..(output + 1) * inputs * 9];
                self.taps.biases[output]
                    + weights.iter().zip(&sampled).map(|(w, v)| w * v).sum::<f32>()
            };
            (0..outputs).map(product).collect()
        };
        let pixels: Vec<Vec<f32>> = (0..width * height).into_par_iter().map(of_pixel).collect();
        let mut out = Image::new(width, height, outputs);
        for (at, values) in pixels.iter().enumerate() {
            values.iter().enumerate().for_each(|(o, v)| out.data[o * width * height + at] = *v);
        }
        out
    }
}

/// Indices and weights of the pixels around a position, whole numbers in the middle of pixels; zeros
/// lie beyond the border.
pub(super) fn bilinear([x, y]: [f32; 2], [width, height]: [usize; 2]) -> [(usize, f32); 4] {
    let (left, top) = (x.floor(), y.floor());
    let (u, v) = (x - left, y - top);
    let corner = |dx: usize, dy: usize| {
        let weight = if dx == 1 { u } else { 1.0 - u } * if dy == 1 { v } else { 1.0 - v };
        let (column, row) = (left + dx as f32, top + dy as f32);
        let is_inside = column >= 0.0 && row >= 0.0 && column < width as f32 && row < height as f32;
        if is_inside { (row as usize * width + column as usize, weight) } else { (0, 0.0) }
    };
    [corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1)]
}

/// Means of squares of `side` pixels.
pub(super) fn average_pooled(input: &Image<f32>, side: usize) -> Image<f32> {
    input.resized_by_area(input.width / side, input.height / side)
}

/// All planes enlarged by bilinear interpolation, corner on corner.
pub(super) fn enlarged(input: &Image<f32>, width: usize, height: usize) -> Image<f32> {
    let step = |from: usize, to: usize| (from as f32 - 1.0) / (to as f32 - 1.0).max(1.0);
    let steps = [step(input.width, width), step(input.height, height)];
    let columns: Vec<(usize, usize, f32)> =
        (0..width).map(|c| between(c, steps[0], input.width)).collect();
    let mut out = Image::new(width, height, input.channels);
    let of_row = |(index, line): (usize, &mut [f32])| {
        let (channel, row) = (index / height, index % height);
        let (top, bottom, v) = between(row, steps[1], input.height);
        let plane = input.plane(channel);
        let [top, bottom] = [top, bottom].map(|r| &plane[r * input.width..(r + 1) * input.width]);
        for (value, (left, right, u)) in line.iter_mut().zip(&columns) {
            let upper = top[*left] + u * (top[*right] - top[*left]);
            let lower = bottom[*left] + u * (bottom[*right] - bottom[*left]);
            *value = upper + v * (lower - upper);
        }
    };
    out.data.par_chunks_mut(width).enumerate().for_each(of_row);
    out
}

/// The pixels on either side of a pixel of an enlarged picture, and the share of the second.
fn between(at: usize, step: f32, size: usize) -> (usize, usize, f32) {
    let position = at as f32 * step;
    let first = (position as usize).min(size - 1);
    (first, (first + 1).min(size - 1), position - first as f32)
}

/// Scaled exponential linear unit (Klambauer et al. 2017).
pub(super) fn selu(value: f32) -> f32 {
    const SCALE: f32 = 1.050_700_9;
    const ALPHA: f32 = 1.673_263_2;
    SCALE * if value > 0.0 { value } else { ALPHA * (value.exp() - 1.0) }
}

/// The unit applied to all values.
pub(super) fn activated(mut input: Image<f32>) -> Image<f32> {
    input.data.par_iter_mut().for_each(|v| *v = selu(*v));
    input
}
