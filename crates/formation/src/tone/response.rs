//! Parameters of a camera response, and the plausible curve that they stand for.
//!
//! A response rises, from 0 at 0 to 1 at 1. The paper's rule (after Liu et al. 2020) for nodes
//! `g_0 .. g_255`, with `d_i = g_{i+1} - g_i`:
//!
//! ```text
//! d'_i = d_i + max(0, -min_j d_j)        shift by the smallest negative derivative
//! C_k  = Σ_{i<k} d'_i
//! CRF(node k) = C_k / C_255              normalise
//! ```
//!
//! Derivatives are taken per node, whatever the spacing. Nodes without any rise left after the
//! shift (constant, or falling evenly) stand for the curve of even steps, with no gradient.

use super::{CurveGradient, Grid, NODES, NodeSpacing, ResponseCurve, StartCurve};
use i2slam_geometry::Real;
use std::sync::Arc;

/// One response curve for all channels, or one per channel, as free node values `g`.
///
/// Any numbers are allowed: [`curve`](Self::curve) makes them plausible. Adding a constant to
/// all nodes of a curve, or scaling them by a positive one, changes nothing.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraResponse<T> {
    /// 1 or 3 lists of [`NODES`] free values.
    pub nodes: Vec<Vec<T>>,
    /// Values of the curve it began with, at the nodes.
    initial: Vec<T>,
    spacing: NodeSpacing,
    start: StartCurve,
    grid: Arc<Grid<T>>,
}

impl<T: Real> CameraResponse<T> {
    /// `curves` copies of the start curve (0 is taken as 1). Channel `c` of a picture uses curve
    /// `min(c, curves - 1)`: 1 for a monochrome response, 3 for one per channel.
    pub fn new(curves: usize, start: StartCurve, spacing: NodeSpacing) -> Self {
        let curve = (0..NODES).map(|i| start.evaluate(spacing.position(i))).collect();
        Self::of_nodes(vec![curve; curves.max(1)], start, spacing)
    }

    /// The response of given nodes, 1 or 3 lists of [`NODES`]; the first list is the curve that it
    /// begins with.
    ///
    /// # Panics
    /// Without a list.
    pub fn of_nodes(nodes: Vec<Vec<f64>>, start: StartCurve, spacing: NodeSpacing) -> Self {
        let cast = |values: &Vec<f64>| values.iter().map(|&v| T::of(v)).collect::<Vec<T>>();
        Self {
            initial: cast(&nodes[0]),
            nodes: nodes.iter().map(cast).collect(),
            spacing,
            start,
            grid: Arc::new(Grid::new(spacing)),
        }
    }

    /// Values at the nodes of the curve that it began with.
    pub fn initial(&self) -> &[T] {
        &self.initial
    }

    /// The response whose linear values are those of this one, raised to a power: its nodes are spaced
    /// farther apart or closer, and nothing is interpolated. Node spacings end at exponents of 1/8 and 12.
    pub fn raised(&self, power: f64) -> Self {
        let spacing = NodeSpacing::Power(power * self.spacing.exponent());
        Self { spacing, grid: Arc::new(Grid::new(spacing)), ..self.clone() }
    }

    /// The response whose linear values are those of this one, raised to a power for each of its curves; it is
    /// interpolated between the nodes.
    ///
    /// # Panics
    /// With another number of powers than curves.
    pub fn raised_by_channel(&self, powers: &[f64]) -> Self {
        assert_eq!(powers.len(), self.nodes.len(), "one power for each curve");
        let curve = self.curve();
        let value = |channel: usize, node: usize| {
            let position = self.spacing.position(node).powf(powers[channel].recip());
            curve.evaluate(channel, T::of(position))
        };
        let nodes = (0..powers.len()).map(|c| (0..NODES).map(|i| value(c, i)).collect()).collect();
        Self { nodes, ..self.clone() }
    }

    /// Spacing of the nodes.
    pub fn spacing(&self) -> NodeSpacing {
        self.spacing
    }

    /// The curve this response started from.
    pub fn start(&self) -> StartCurve {
        self.start
    }

    /// The physically plausible curve of these nodes: monotone, CRF(0) = 0, CRF(1) = 1.
    ///
    /// # Panics
    /// When `nodes` was given a shape other than the one it was made with.
    pub fn curve(&self) -> ResponseCurve<T> {
        let values = self.nodes.iter().map(|nodes| plausible(&checked(nodes))).collect();
        ResponseCurve::new(Arc::clone(&self.grid), values)
    }

    /// Gradient with respect to the curve, taken through normalisation and shift to the nodes;
    /// the shape is that of `nodes`.
    ///
    /// # Panics
    /// When `nodes` or `d_curve` is of another shape.
    pub fn pull_back(&self, d_curve: &CurveGradient<T>) -> Vec<Vec<T>> {
        assert_eq!(self.nodes.len(), d_curve.values.len(), "gradient of another response");
        self.nodes
            .iter()
            .zip(&d_curve.values)
            .map(|(nodes, d_values)| {
                let d_nodes = pull_back(&checked(nodes), &checked(d_values));
                d_nodes.into_iter().map(T::of).collect()
            })
            .collect()
    }
}

/// The numbers in `f64`: sums over a curve are taken there.
fn checked<T: Real>(nodes: &[T]) -> Vec<f64> {
    assert_eq!(nodes.len(), NODES, "a response curve has {NODES} nodes");
    nodes.iter().map(|&v| v.to_f64()).collect()
}

/// The smallest total rise that is still divided by.
const MIN_RISE: f64 = 1e-12;

struct NodeIncrements {
    /// `d'_i`.
    shifted: Vec<f64>,
    /// The first place of the smallest derivative, if that is negative.
    lowest: Option<usize>,
    /// `C_255`.
    rise: f64,
}

fn steps(nodes: &[f64]) -> NodeIncrements {
    let mut shifted: Vec<f64> = nodes.windows(2).map(|w| w[1] - w[0]).collect();
    let lowest = (0..shifted.len())
        .reduce(|best, i| if shifted[i] < shifted[best] { i } else { best })
        .filter(|&i| shifted[i] < 0.0);
    if let Some(lowest) = lowest {
        let shift = -shifted[lowest];
        shifted.iter_mut().for_each(|d| *d += shift);
    }
    let rise = shifted.iter().sum();
    NodeIncrements { shifted, lowest, rise }
}

/// Values of the plausible curve at the nodes; 0 first, 1 last.
pub(super) fn plausible(nodes: &[f64]) -> Vec<f64> {
    let steps = steps(nodes);
    if steps.rise < MIN_RISE {
        let last = nodes.len().saturating_sub(1).max(1) as f64;
        return (0..nodes.len()).map(|i| i as f64 / last).collect();
    }
    let mut sum = 0.0;
    let risen = steps.shifted.iter().map(|d| {
        sum += d;
        sum / steps.rise
    });
    std::iter::once(0.0).chain(risen).collect()
}

/// Cotangent of [`plausible`]'s values to cotangent of the nodes. Where several derivatives are
/// the smallest, the first one carries the shift (a subgradient).
pub(super) fn pull_back(nodes: &[f64], d_values: &[f64]) -> Vec<f64> {
    let mut d_nodes = vec![0.0; nodes.len()];
    let steps = steps(nodes);
    if steps.rise < MIN_RISE {
        return d_nodes;
    }
    let mut d_steps = pull_back_normalisation(&steps, d_values);
    if let Some(lowest) = steps.lowest {
        let total: f64 = d_steps.iter().sum();
        d_steps[lowest] -= total;
    }
    for (i, d) in d_steps.into_iter().enumerate() {
        d_nodes[i + 1] += d;
        d_nodes[i] -= d;
    }
    d_nodes
}

/// `∂/∂d'_i = (Σ_{k>i} v̄_k - Σ_k v̄_k v_k) / C_255`, where `v_k = C_k / C_255`.
fn pull_back_normalisation(steps: &NodeIncrements, d_values: &[f64]) -> Vec<f64> {
    let (mut sum, mut along) = (0.0, 0.0);
    for (step, d) in steps.shifted.iter().zip(&d_values[1..]) {
        sum += step;
        along += d * sum / steps.rise;
    }
    let mut later = 0.0;
    let mut d_steps: Vec<f64> = d_values[1..]
        .iter()
        .rev()
        .map(|d| {
            later += d;
            (later - along) / steps.rise
        })
        .collect();
    d_steps.reverse();
    d_steps
}
