//! Where the nodes of a response sit on the axis of linear values.

use super::NODES;

/// Spacing of the 256 nodes over the domain [0, 1].
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub enum NodeSpacing {
    /// Node `i` at `i/255` (the paper). The darkest 5 % of sRGB code values share one segment.
    #[default]
    Uniform,
    /// Node `i` at `(i/255)^p`, with `p` in [1/8, 8] (held to that range; NaN is 1).
    /// `Power(2.2)` puts the nodes evenly in display space.
    Power(f64),
}

impl NodeSpacing {
    /// Position of node `i` on the axis of linear values.
    pub fn position(&self, i: usize) -> f64 {
        let even = i as f64 / (NODES - 1) as f64;
        match *self {
            Self::Power(p) if !p.is_nan() => even.powf(p.clamp(0.125, 8.0)),
            _ => even,
        }
    }
}
