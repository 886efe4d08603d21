//! The response as a tabulated curve of straight pieces, with leaky branches outside [0, 1] (eq.
//! 11), so that clipped pixels still have a gradient.

use super::{Even, Grid, Locate};
use i2slam_geometry::Real;
use std::sync::Arc;

/// Half of the range of picture values that a slope is taken over, and the darkest one of it: that of 0 has no
/// logarithm.
const SLOPE_HALF_WIDTH: f64 = 0.02;
const MIN_SLOPE_VALUE: f64 = 1e-3;

/// The straight piece between two nodes, everything a pixel needs in one place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Segment<T> {
    /// Position of the left node.
    pub(crate) start: T,
    /// Curve value at the left node.
    pub(crate) value: T,
    /// Rise per unit of linear value.
    pub(crate) slope: T,
    /// 1 / (right node - left node).
    pub(crate) inverse_width: T,
}

/// A monotone response with CRF(0) = 0 and CRF(1) = 1, one curve for all channels or one each.
///
/// Made by [`CameraResponse::curve`](super::CameraResponse::curve).
#[derive(Clone, Debug, PartialEq)]
pub struct ResponseCurve<T> {
    pub(super) grid: Arc<Grid<T>>,
    segments: Vec<Vec<Segment<T>>>,
    values: Vec<Vec<T>>,
}

/// Gradient with respect to the curve's values at its nodes. Pixels add to it;
/// [`CameraResponse::pull_back`](super::CameraResponse::pull_back) takes it to the free nodes.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct CurveGradient<T> {
    /// One list per curve, one number per node.
    pub values: Vec<Vec<T>>,
}

impl<T: Real> CurveGradient<T> {
    /// Zero, in the shape of `curve`.
    pub fn zero(curve: &ResponseCurve<T>) -> Self {
        Self { values: curve.values.iter().map(|v| vec![T::zero(); v.len()]).collect() }
    }
}

impl<T: Real> ResponseCurve<T> {
    /// `values` holds one list per curve, as long as the grid.
    pub(super) fn new(grid: Arc<Grid<T>>, values: Vec<Vec<f64>>) -> Self {
        let segments = values.iter().map(|v| segments(&grid.positions, v)).collect();
        let values = values.into_iter().map(|v| v.into_iter().map(T::of).collect()).collect();
        Self { grid, segments, values }
    }

    /// Number of curves: 1 for all channels, or one per channel.
    pub fn curves(&self) -> usize {
        self.values.len()
    }

    /// Which curve channel `channel` uses.
    pub fn curve_of(&self, channel: usize) -> usize {
        channel.min(self.curves() - 1)
    }

    /// Values of the curve of `channel` at its nodes, from 0 to 1.
    pub fn values(&self, channel: usize) -> &[T] {
        &self.values[self.curve_of(channel)]
    }

    /// Positions of the nodes on the axis of linear values, from 0 to 1.
    pub fn positions(&self) -> &[T] {
        &self.grid.positions
    }

    /// Picture value of the linear value `x`, leaky outside [0, 1] (eq. 11).
    pub fn evaluate(&self, channel: usize, x: T) -> T {
        let segments = self.segments(channel);
        match self.grid.binned() {
            Some(binned) => evaluate(&binned, segments, x),
            None => evaluate(&Even, segments, x),
        }
    }

    /// Slope of [`evaluate`](Self::evaluate) at `x`; at a node, of one of its two sides.
    pub fn slope(&self, channel: usize, x: T) -> T {
        self.evaluate_with_slope(channel, x).1
    }

    /// [`evaluate`](Self::evaluate) and [`slope`](Self::slope) at `x`.
    #[inline]
    pub fn evaluate_with_slope(&self, channel: usize, x: T) -> (T, T) {
        if x < T::zero() {
            return (below_value(x), below_slope());
        }
        if x > T::one() {
            return (above_value(x), above_slope(x));
        }
        let segments = self.segments(channel);
        let segment = match self.grid.binned() {
            Some(binned) => binned.locate(segments, x),
            None => Even.locate(segments, x),
        };
        let segment = &segments[segment];
        (segment.value + segment.slope * (x - segment.start), segment.slope)
    }

    /// Smallest linear value in [0, 1] whose picture value is `y`, by binary search.
    ///
    /// `y` outside [0, 1] is clipped to it; NaN stays NaN. Where the curve is level, the left
    /// end of the level part comes back.
    pub fn inverse(&self, channel: usize, y: T) -> T {
        if y.is_nan() {
            return y;
        }
        let y = y.max(T::zero()).min(T::one());
        let (values, positions) = (self.values(channel), self.positions());
        let right = values.partition_point(|&v| v < y).min(values.len() - 1);
        let Some(left) = right.checked_sub(1) else { return T::zero() };
        let share = (y - values[left]) / (values[right] - values[left]);
        positions[left] + (positions[right] - positions[left]) * share.min(T::one())
    }

    /// Logarithm of the linear value of the picture value `y`; finite for all of [0, 1].
    pub fn log_linear(&self, channel: usize, y: f64) -> f64 {
        self.inverse(channel, T::of(y)).max(T::min_positive_value()).to_f64().ln()
    }

    /// Slope of [`log_linear`](Self::log_linear) between picture values 0.02 below and above `y`: that between
    /// neighbouring nodes is not smooth.
    pub fn log_linear_slope(&self, channel: usize, y: f64) -> f64 {
        let (low, high) =
            ((y - SLOPE_HALF_WIDTH).max(MIN_SLOPE_VALUE), (y + SLOPE_HALF_WIDTH).min(1.0));
        (self.log_linear(channel, high) - self.log_linear(channel, low)) / (high - low)
    }

    pub(crate) fn segments(&self, channel: usize) -> &[Segment<T>] {
        &self.segments[self.curve_of(channel)]
    }

    pub(crate) fn grid(&self) -> &Grid<T> {
        &self.grid
    }
}

/// One pixel of eq. 11.
#[inline(always)]
pub(crate) fn evaluate<T: Real>(locate: &impl Locate<T>, segments: &[Segment<T>], x: T) -> T {
    if x < T::zero() {
        below_value(x)
    } else if x > T::one() {
        above_value(x)
    } else {
        let segment = &segments[locate.locate(segments, x)];
        segment.value + segment.slope * (x - segment.start)
    }
}

fn segments<T: Real>(positions: &[T], values: &[f64]) -> Vec<Segment<T>> {
    positions
        .windows(2)
        .zip(values.windows(2))
        .map(|(x, y)| {
            let inverse_width = (x[1].to_f64() - x[0].to_f64()).recip();
            Segment {
                start: x[0],
                value: T::of(y[0]),
                slope: T::of((y[1] - y[0]) * inverse_width),
                inverse_width: T::of(inverse_width),
            }
        })
        .collect()
}

const ALPHA: f64 = 0.01;

/// `α x`, for `x < 0`.
#[inline(always)]
pub(crate) fn below_value<T: Real>(x: T) -> T {
    T::of(ALPHA) * x
}

/// Slope below 0.
#[inline(always)]
pub(crate) fn below_slope<T: Real>() -> T {
    T::of(ALPHA)
}

/// `1 + α (1 - 1/√x)`, for `x > 1`.
#[inline(always)]
pub(crate) fn above_value<T: Real>(x: T) -> T {
    T::one() + T::of(ALPHA) * (T::one() - x.sqrt().recip())
}

/// `α/2 · x^(-3/2)`, for `x > 1`.
#[inline(always)]
pub(crate) fn above_slope<T: Real>(x: T) -> T {
    T::of(0.5 * ALPHA) / (x * x.sqrt())
}
