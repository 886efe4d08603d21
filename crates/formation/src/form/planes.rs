//! One plane of a picture: the loops that run for every pixel of every iteration.

use crate::tone::{Locate, NODES, Segment, above_slope, below_slope, evaluate};
use i2slam_geometry::Real;

/// `picture = CRF_leaky(gain · hdr)`.
pub(super) fn form<T: Real>(
    locate: &impl Locate<T>,
    segments: &[Segment<T>],
    gain: T,
    hdr: &[T],
    picture: &mut [T],
) {
    for (value, &radiance) in picture.iter_mut().zip(hdr) {
        *value = evaluate(locate, segments, gain * radiance);
    }
}

/// The planes that one channel is pulled back through.
pub(super) struct Planes<'a, T> {
    pub(super) hdr: &'a [T],
    pub(super) d_picture: &'a [T],
    /// Written.
    pub(super) d_hdr: &'a mut [T],
}

/// Writes `d_hdr`, adds to `d_values` (one number per node), returns `∂loss/∂ln gain`.
///
/// Between nodes `i` and `i + 1` the curve is `(1 - w) v_i + w v_{i+1}`: per segment, the sums
/// of `ȳ` and of `w ȳ` over its pixels are all that the nodes need.
pub(super) fn pull_back<T: Real>(
    locate: &impl Locate<T>,
    segments: &[Segment<T>],
    gain: T,
    planes: Planes<'_, T>,
    d_values: &mut [T],
) -> T {
    let mut sums = [[0.0_f64; 2]; NODES];
    let mut d_log_gain = 0.0_f64;
    let pixels = planes.hdr.iter().zip(planes.d_picture).zip(planes.d_hdr);
    for ((&radiance, &d_value), d_radiance) in pixels {
        if d_value == T::zero() {
            *d_radiance = T::zero();
            continue;
        }
        let x = gain * radiance;
        let slope = if x < T::zero() {
            below_slope()
        } else if x > T::one() {
            above_slope(x)
        } else {
            let i = locate.locate(segments, x);
            let segment = &segments[i];
            let share = (x - segment.start) * segment.inverse_width;
            sums[i][0] += d_value.to_f64();
            sums[i][1] += (share * d_value).to_f64();
            segment.slope
        };
        let d_x = d_value * slope;
        *d_radiance = d_x * gain;
        d_log_gain += (d_x * x).to_f64();
    }
    for (i, [all, right]) in sums.iter().enumerate().take(segments.len()) {
        d_values[i] += T::of(all - right);
        d_values[i + 1] += T::of(*right);
    }
    T::of(d_log_gain)
}
