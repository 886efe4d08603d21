//! One plane of a picture: the loops that run for every pixel of every iteration, in eight parts
//! on all threads. Sums are those of the parts, in their order.

use crate::tone::{Locate, NODES, Segment, above_slope, below_slope, evaluate};
use i2slam_geometry::Real;
use rayon::prelude::*;

/// Parts of a plane. Fixed, so that sums do not depend on the number of threads.
const PARTS: usize = 8;

fn part(pixels: usize) -> usize {
    pixels.div_ceil(PARTS).max(1)
}

/// `picture = CRF_leaky(gain · hdr)`.
pub(super) fn form<T: Real>(
    locate: &(impl Locate<T> + Sync),
    segments: &[Segment<T>],
    gain: T,
    hdr: &[T],
    picture: &mut [T],
) {
    let part = part(hdr.len());
    picture.par_chunks_mut(part).zip(hdr.par_chunks(part)).for_each(|(picture, hdr)| {
        for (value, &radiance) in picture.iter_mut().zip(hdr) {
            *value = evaluate(locate, segments, gain * radiance);
        }
    });
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
    locate: &(impl Locate<T> + Sync),
    segments: &[Segment<T>],
    gain: T,
    planes: Planes<'_, T>,
    d_values: &mut [T],
) -> T {
    let mut parts = [const { Sums { nodes: [[0.0; 2]; NODES], log_gain: 0.0 } }; PARTS];
    let part = part(planes.hdr.len());
    let work = planes.hdr.par_chunks(part).zip(planes.d_picture.par_chunks(part));
    let work = work.zip(planes.d_hdr.par_chunks_mut(part)).zip(parts.par_iter_mut());
    work.for_each(|(((hdr, d_picture), d_hdr), sums)| {
        pull_back_part(locate, segments, gain, Planes { hdr, d_picture, d_hdr }, sums);
    });
    for i in 0..segments.len() {
        let sum = |side: usize| parts.iter().map(|part| part.nodes[i][side]).sum::<f64>();
        let (all, right) = (sum(0), sum(1));
        d_values[i] += T::of(all - right);
        d_values[i + 1] += T::of(right);
    }
    T::of(parts.iter().map(|part| part.log_gain).sum())
}

/// Of the pixels of one part.
struct Sums {
    /// Per segment, `Σ ȳ` and `Σ w ȳ`.
    nodes: [[f64; 2]; NODES],
    log_gain: f64,
}

fn pull_back_part<T: Real>(
    locate: &impl Locate<T>,
    segments: &[Segment<T>],
    gain: T,
    planes: Planes<'_, T>,
    sums: &mut Sums,
) {
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
            sums.nodes[i][0] += d_value.to_f64();
            sums.nodes[i][1] += (share * d_value).to_f64();
            segment.slope
        };
        let d_x = d_value * slope;
        *d_radiance = d_x * gain;
        sums.log_gain += (d_x * x).to_f64();
    }
}
