//! Radiance to picture and back, for planar images.
//!
//! The caller renders its map from each virtual camera, [`accumulate`]s the radiance, calls
//! [`Formation::form`], compares with the input picture, and passes the gradient to
//! [`Formation::pull_back`]. Blur is linear in the renders: every virtual camera of a frame
//! receives the same image gradient, times its weight.

use crate::tone::{
    CurveGradient, Even, FrameTone, FrameToneGradient, Locate, NODES, ResponseCurve, Segment,
    above_slope, below_slope, evaluate,
};
use i2slam_geometry::{Image, Real};
use rayon::prelude::*;
use std::iter::repeat;

#[cfg(test)]
mod tests;

/// Radiance to picture, for one frame: `picture_c = CRF_leaky(exposure · white_balance_c · v ·
/// radiance_c)` (eqs. 8 to 11, with the vignetting `v`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Formation<'a, T = f32> {
    /// Exposure and white balance of the frame.
    pub tone: FrameTone<T>,
    /// Response of the camera.
    pub curve: &'a ResponseCurve<T>,
    /// Vignetting of every pixel of the pictures, as [`Vignetting::at_pixels`] gives it; `None` for 1.
    ///
    /// [`Vignetting::at_pixels`]: crate::Vignetting::at_pixels
    pub vignetting: Option<&'a [T]>,
}

impl<T: Real> Formation<'_, T> {
    /// The picture of `hdr`, the radiance averaged over the exposure (planes R, G, B).
    /// `picture` is given the shape of `hdr`. Values leave [0, 1] by at most the leaky clip.
    ///
    /// # Panics
    /// When there is vignetting of another number of pixels.
    pub fn form(&self, hdr: &Image<T>, picture: &mut Image<T>) {
        picture.reshape(hdr.width, hdr.height, hdr.channels);
        let Self { tone, curve, .. } = self;
        for channel in 0..hdr.channels {
            let gains = self.pixel_gains(tone.gains()[channel.min(2)], hdr);
            let segments = curve.segments(channel);
            let (from, to) = (hdr.plane(channel), picture.plane_mut(channel));
            match curve.grid().binned() {
                Some(binned) => form_plane(&binned, segments, gains, from, to),
                None => form_plane(&Even, segments, gains, from, to),
            }
        }
    }

    /// Pulls `d_picture = ∂loss/∂picture` back: `d_hdr` is written (in the shape of `hdr`), the
    /// gradients of tone and curve are added to. Sums run in `f64`, in a fixed order. A
    /// pixel with `d_picture = 0` contributes nothing, whatever its radiance.
    ///
    /// # Panics
    /// When `d_picture` has another shape than `hdr`, or `d_curve` another than the curve, or there is
    /// vignetting of another number of pixels.
    pub fn pull_back(
        &self,
        hdr: &Image<T>,
        d_picture: &Image<T>,
        d_hdr: &mut Image<T>,
        d_tone: &mut FrameToneGradient<T>,
        d_curve: &mut CurveGradient<T>,
    ) {
        assert_same_shape(hdr, d_picture);
        d_hdr.reshape(hdr.width, hdr.height, hdr.channels);
        let Self { tone, curve, .. } = self;
        for channel in 0..hdr.channels {
            let gains = self.pixel_gains(tone.gains()[channel.min(2)], hdr);
            let segments = curve.segments(channel);
            let planes = Planes {
                hdr: hdr.plane(channel),
                d_picture: d_picture.plane(channel),
                d_hdr: d_hdr.plane_mut(channel),
            };
            let d_values = &mut d_curve.values[curve.curve_of(channel)];
            let d_log_gain = match curve.grid().binned() {
                Some(binned) => pull_back_plane(&binned, segments, gains, planes, d_values),
                None => pull_back_plane(&Even, segments, gains, planes, d_values),
            };
            d_tone.log_exposure += d_log_gain;
            d_tone.log_white_balance[channel.min(2)] += d_log_gain;
        }
    }

    fn pixel_gains(&self, gain: T, hdr: &Image<T>) -> PixelGains<'_, T> {
        let pixels = hdr.pixels();
        let fits = self.vignetting.is_none_or(|vignetting| vignetting.len() == pixels);
        assert!(fits, "vignetting of another picture");
        PixelGains { gain, vignetting: self.vignetting }
    }
}

/// Factors between the radiance of pixels and their linear values.
#[derive(Clone, Copy)]
struct PixelGains<'a, T> {
    /// Exposure times white balance.
    gain: T,
    vignetting: Option<&'a [T]>,
}

impl<'a, T: Real> PixelGains<'a, T> {
    /// Vignetting from pixel `first` on.
    fn vignetting_from(&self, first: usize) -> Option<&'a [T]> {
        self.vignetting.map(|all| &all[first..])
    }
}

/// `hdr += weight · radiance`: one virtual camera's share of the exposure.
///
/// # Panics
/// When the images are of different shape.
pub fn accumulate<T: Real>(hdr: &mut Image<T>, weight: T, radiance: &Image<T>) {
    assert_same_shape(hdr, radiance);
    for (sum, &r) in hdr.data.iter_mut().zip(&radiance.data) {
        *sum += weight * r;
    }
}

/// `d_radiance = weight · d_hdr`: the gradient of one virtual camera's render. `d_radiance` is
/// given the shape of `d_hdr`.
pub fn scale_into<T: Real>(d_hdr: &Image<T>, weight: T, d_radiance: &mut Image<T>) {
    d_radiance.reshape(d_hdr.width, d_hdr.height, d_hdr.channels);
    for (d, &sum) in d_radiance.data.iter_mut().zip(&d_hdr.data) {
        *d = weight * sum;
    }
}

pub(super) fn assert_same_shape<T: Real>(a: &Image<T>, b: &Image<T>) {
    let shape = |image: &Image<T>| (image.width, image.height, image.channels, image.data.len());
    assert_eq!(shape(a), shape(b), "images of different shape");
}

/// Parts of a plane. Fixed, so that sums do not depend on the number of threads.
const PARTS: usize = 8;

fn part(pixels: usize) -> usize {
    pixels.div_ceil(PARTS).max(1)
}

/// `picture = CRF_leaky(gain · hdr)`.
fn form_plane<T: Real>(
    locate: &(impl Locate<T> + Sync),
    segments: &[Segment<T>],
    gains: PixelGains<'_, T>,
    hdr: &[T],
    picture: &mut [T],
) {
    let part = part(hdr.len());
    let work = picture.par_chunks_mut(part).zip(hdr.par_chunks(part)).enumerate();
    work.for_each(|(i, planes)| match gains.vignetting_from(i * part) {
        None => form_part(locate, segments, repeat(gains.gain), planes),
        Some(v) => form_part(locate, segments, v.iter().map(|&v| gains.gain * v), planes),
    });
}

fn form_part<T: Real>(
    locate: &impl Locate<T>,
    segments: &[Segment<T>],
    gains: impl Iterator<Item = T>,
    (picture, hdr): (&mut [T], &[T]),
) {
    for ((value, &radiance), gain) in picture.iter_mut().zip(hdr).zip(gains) {
        *value = evaluate(locate, segments, gain * radiance);
    }
}

/// The planes that one channel is pulled back through.
struct Planes<'a, T> {
    hdr: &'a [T],
    d_picture: &'a [T],
    /// Written.
    d_hdr: &'a mut [T],
}

/// Writes `d_hdr`, adds to `d_values` (one number per node), returns `∂loss/∂ln gain`.
///
/// Between nodes `i` and `i + 1` the curve is `(1 - w) v_i + w v_{i+1}`: per segment, the sums
/// of `ȳ` and of `w ȳ` over its pixels are all that the nodes need.
fn pull_back_plane<T: Real>(
    locate: &(impl Locate<T> + Sync),
    segments: &[Segment<T>],
    gains: PixelGains<'_, T>,
    planes: Planes<'_, T>,
    d_values: &mut [T],
) -> T {
    let mut parts = [const { Sums { nodes: [[0.0; 2]; NODES], log_gain: 0.0 } }; PARTS];
    let part = part(planes.hdr.len());
    let work = planes.hdr.par_chunks(part).zip(planes.d_picture.par_chunks(part));
    let work = work.zip(planes.d_hdr.par_chunks_mut(part)).zip(parts.par_iter_mut());
    work.enumerate().for_each(|(i, (((hdr, d_picture), d_hdr), sums))| {
        let (planes, gain) = (Planes { hdr, d_picture, d_hdr }, gains.gain);
        match gains.vignetting_from(i * part) {
            None => pull_back_part(locate, segments, repeat(gain), planes, sums),
            Some(v) => pull_back_part(locate, segments, v.iter().map(|&v| gain * v), planes, sums),
        }
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
    gains: impl Iterator<Item = T>,
    planes: Planes<'_, T>,
    sums: &mut Sums,
) {
    let pixels = planes.hdr.iter().zip(planes.d_picture).zip(planes.d_hdr).zip(gains);
    for (((&radiance, &d_value), d_radiance), gain) in pixels {
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
