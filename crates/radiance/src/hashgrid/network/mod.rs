//! Small fully connected networks without biases: `y = W_n relu(W_{n-1} … relu(W_1 x))`.
//!
//! Weights lie layer after layer, each `[input][output]`, row-major.

pub(crate) mod cpu;
pub(crate) mod product;
pub(crate) mod reference;

/// The widths of a network.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Shape {
    /// Inputs, units of each hidden layer, outputs: at least two numbers.
    pub(crate) widths: Vec<usize>,
}

impl Shape {
    /// `hidden` layers of `width` units between inputs and outputs.
    pub(crate) fn new(inputs: usize, width: usize, hidden: usize, outputs: usize) -> Self {
        let mut widths = vec![width; hidden + 2];
        (widths[0], widths[hidden + 1]) = (inputs, outputs);
        Self { widths }
    }

    /// `(inputs, outputs, first weight)` of each layer.
    pub(crate) fn layers(&self) -> impl DoubleEndedIterator<Item = Layer> + ExactSizeIterator + '_ {
        (1..self.widths.len()).map(|l| Layer {
            inputs: self.widths[l - 1],
            outputs: self.widths[l],
            first: (1..l).map(|l| self.widths[l - 1] * self.widths[l]).sum(),
        })
    }

    /// Number of weights.
    pub(crate) fn weights(&self) -> usize {
        self.layers().map(|layer| layer.inputs * layer.outputs).sum()
    }
}

/// One matrix of a network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Layer {
    pub(crate) inputs: usize,
    pub(crate) outputs: usize,
    /// Its first weight.
    pub(crate) first: usize,
}

impl Layer {
    /// Its weights.
    pub(crate) fn range(&self) -> std::ops::Range<usize> {
        self.first..self.first + self.inputs * self.outputs
    }
}
