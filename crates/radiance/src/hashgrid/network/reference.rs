//! The plain lane of the networks: one input at a time.

use super::Shape;
use i2slam_geometry::Real;

/// The input and what every layer gives (after `relu`; the last one without it).
pub(crate) fn forward<T: Real>(shape: &Shape, weights: &[T], input: Vec<T>) -> Vec<Vec<T>> {
    let mut values = vec![input];
    for (l, layer) in shape.layers().enumerate() {
        let mut out = vec![T::zero(); layer.outputs];
        let rows = weights[layer.range()].chunks(layer.outputs);
        for (x, row) in values[l].iter().zip(rows) {
            out.iter_mut().zip(row).for_each(|(out, w)| *out += *x * *w);
        }
        if l + 2 < shape.widths.len() {
            out.iter_mut().for_each(|v| *v = v.max(T::zero()));
        }
        values.push(out);
    }
    values
}

/// Adds `∂L/∂weights` to `gradient` if given; returns `∂L/∂input`. `values` are [`forward`]'s.
pub(crate) fn pull_back<T: Real>(
    shape: &Shape,
    weights: &[T],
    values: &[Vec<T>],
    cotangent: Vec<T>,
    mut gradient: Option<&mut [T]>,
) -> Vec<T> {
    let mut d_out = cotangent;
    for (l, layer) in shape.layers().enumerate().rev() {
        let input = &values[l];
        if let Some(gradient) = &mut gradient {
            let rows = gradient[layer.range()].chunks_mut(layer.outputs);
            for (x, row) in input.iter().zip(rows) {
                row.iter_mut().zip(&d_out).for_each(|(g, d)| *g += *x * *d);
            }
        }
        let rows = weights[layer.range()].chunks(layer.outputs);
        let dot = |row: &[T]| row.iter().zip(&d_out).map(|(w, d)| *w * *d).sum::<T>();
        let hidden = l > 0;
        let passes = |x: &T| !hidden || *x > T::zero();
        d_out = rows.zip(input).map(|(r, x)| if passes(x) { dot(r) } else { T::zero() }).collect();
    }
    d_out
}
