//! The free numbers of a camera response.

use super::{CurveGradient, Grid, NODES, NodeSpacing, ResponseCurve, StartCurve, repair};
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
    spacing: NodeSpacing,
    start: StartCurve,
    grid: Arc<Grid<T>>,
}

impl<T: Real> CameraResponse<T> {
    /// `curves` copies of the start curve (0 is taken as 1). Channel `c` of a picture uses curve
    /// `min(c, curves - 1)`: 1 for a monochrome response, 3 for one per channel.
    pub fn new(curves: usize, start: StartCurve, spacing: NodeSpacing) -> Self {
        let curve = (0..NODES).map(|i| T::of(start.evaluate(spacing.position(i)))).collect();
        Self {
            nodes: vec![curve; curves.max(1)],
            spacing,
            start,
            grid: Arc::new(Grid::new(spacing)),
        }
    }

    /// Where the nodes sit.
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
        let values = self.nodes.iter().map(|nodes| repair::plausible(&checked(nodes))).collect();
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
                let d_nodes = repair::pull_back(&checked(nodes), &checked(d_values));
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
