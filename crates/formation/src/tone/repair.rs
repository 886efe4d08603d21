//! From free numbers to a physically plausible response, and the gradient back.
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

/// The smallest total rise that is still divided by.
const MIN_RISE: f64 = 1e-12;

struct Steps {
    /// `d'_i`.
    shifted: Vec<f64>,
    /// The first place of the smallest derivative, if that is negative.
    lowest: Option<usize>,
    /// `C_255`.
    rise: f64,
}

fn steps(nodes: &[f64]) -> Steps {
    let mut shifted: Vec<f64> = nodes.windows(2).map(|w| w[1] - w[0]).collect();
    let lowest = (0..shifted.len())
        .reduce(|best, i| if shifted[i] < shifted[best] { i } else { best })
        .filter(|&i| shifted[i] < 0.0);
    if let Some(lowest) = lowest {
        let shift = -shifted[lowest];
        shifted.iter_mut().for_each(|d| *d += shift);
    }
    let rise = shifted.iter().sum();
    Steps { shifted, lowest, rise }
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
fn pull_back_normalisation(steps: &Steps, d_values: &[f64]) -> Vec<f64> {
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
