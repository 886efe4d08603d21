//! The fast lane of the networks: a block of samples at once, a row per sample.

use super::Shape;
use super::product::{OuterProduct, PAD, Product, ROWS, padded};
use pulp::{Arch, Simd, WithSimd};

/// Samples of a block: what all layers hold of it fits the cache nearest to the processor.
pub(crate) const BLOCK: usize = 64;
const _: () = assert!(BLOCK.is_multiple_of(ROWS) && PAD.is_multiple_of(ROWS));

/// A matrix of a network in both orders, padded with zeros.
struct PackedLayer {
    inputs: usize,
    outputs: usize,
    /// `[input][output]`.
    forward: Vec<f32>,
    /// `[output][input]`.
    backward: Vec<f32>,
}

/// The weights of a network, ready for products.
pub(crate) struct Packed {
    layers: Vec<PackedLayer>,
}

impl Packed {
    pub(crate) fn new(shape: &Shape, weights: &[f32]) -> Self {
        let pack = |layer: super::Layer| {
            let (inputs, outputs) = (padded(layer.inputs), padded(layer.outputs));
            let mut forward = vec![0.0; inputs * outputs];
            let mut backward = forward.clone();
            for (i, row) in weights[layer.range()].chunks_exact(layer.outputs).enumerate() {
                for (o, w) in row.iter().enumerate() {
                    forward[i * outputs + o] = *w;
                    backward[o * inputs + i] = *w;
                }
            }
            PackedLayer { inputs, outputs, forward, backward }
        };
        Self { layers: shape.layers().map(pack).collect() }
    }

    /// Zeros for the gradients of the weights, `[input][output]`, padded.
    pub(crate) fn zero_gradient(&self, gradient: &mut Vec<Vec<f32>>) {
        gradient.resize_with(self.layers.len(), Vec::new);
        for (gradient, layer) in gradient.iter_mut().zip(&self.layers) {
            gradient.clear();
            gradient.resize(layer.forward.len(), 0.0);
        }
    }
}

/// Adds padded gradients to those of the weights as stored.
pub(crate) fn add_gradient(shape: &Shape, from: &[Vec<f32>], to: &mut [f32]) {
    for (layer, from) in shape.layers().zip(from) {
        let rows = to[layer.range()].chunks_exact_mut(layer.outputs);
        for (to, from) in rows.zip(from.chunks_exact(padded(layer.outputs))) {
            to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
        }
    }
}

/// Activations of all layers for a block, `BLOCK x width` each.
#[derive(Default)]
pub(crate) struct Activations {
    /// The input, then what every layer gives.
    layers: Vec<Vec<f32>>,
}

impl Activations {
    pub(crate) fn new(packed: &Packed) -> Self {
        let inputs = packed.layers.first().map_or(0, |layer| layer.inputs);
        let widths = std::iter::once(inputs).chain(packed.layers.iter().map(|l| l.outputs));
        Self { layers: widths.map(|width| vec![0.0; BLOCK * width]).collect() }
    }

    pub(crate) fn input(&mut self) -> &mut [f32] {
        self.layers.first_mut().map_or(&mut [], Vec::as_mut_slice)
    }

    pub(crate) fn output(&mut self) -> &mut [f32] {
        self.layers.last_mut().map_or(&mut [], Vec::as_mut_slice)
    }
}

/// From the input of `values` to its output, for `count` samples rounded up to [`ROWS`].
pub(crate) fn forward(arch: Arch, packed: &Packed, count: usize, values: &mut Activations) {
    let rows = count.next_multiple_of(ROWS);
    let last = packed.layers.len() - 1;
    for (l, layer) in packed.layers.iter().enumerate() {
        let (before, after) = values.layers.split_at_mut(l + 1);
        arch.dispatch(Product {
            a: &before[l][..rows * layer.inputs],
            b: &layer.forward,
            c: &mut after[0][..rows * layer.outputs],
            depth: layer.inputs,
            columns: layer.outputs,
            relu: l < last,
        });
    }
}

/// From the output of `cotangents`, zero in rows beyond `count`, to its input; adds to `gradient`
/// when given. `values` are those of the last [`forward`] of as many samples.
pub(crate) fn pull_back(
    arch: Arch,
    packed: &Packed,
    count: usize,
    values: &Activations,
    cotangents: &mut Activations,
    mut gradient: Option<&mut Vec<Vec<f32>>>,
) {
    let rows = count.next_multiple_of(ROWS);
    for (l, layer) in packed.layers.iter().enumerate().rev() {
        let (before, after) = cotangents.layers.split_at_mut(l + 1);
        let input = &values.layers[l][..rows * layer.inputs];
        let d_input = &mut before[l][..rows * layer.inputs];
        let d_output = &after[0][..rows * layer.outputs];
        if let Some(gradient) = &mut gradient {
            arch.dispatch(OuterProduct {
                a: input,
                b: d_output,
                c: &mut gradient[l],
                rows: layer.inputs,
                columns: layer.outputs,
            });
        }
        arch.dispatch(Product {
            a: d_output,
            b: &layer.backward,
            c: d_input,
            depth: layer.outputs,
            columns: layer.inputs,
            relu: false,
        });
        if l > 0 {
            arch.dispatch(Mask { cotangent: d_input, value: input });
        }
    }
}

/// Stop the gradient where `relu` did.
struct Mask<'a> {
    cotangent: &'a mut [f32],
    value: &'a [f32],
}

impl WithSimd for Mask<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for (d, v) in self.cotangent.iter_mut().zip(self.value) {
            *d = if *v > 0.0 { *d } else { 0.0 };
        }
    }
}
