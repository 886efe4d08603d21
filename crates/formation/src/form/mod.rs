//! The seam: radiance to picture and back, for planar images.
//!
//! A host renders its map from each virtual camera, [`accumulate`]s the radiance, calls
//! [`Formation::form`], compares with the picture taken, and hands the difference to
//! [`Formation::pull_back`]. Blur is linear in the renders, so every virtual camera of a frame
//! receives the same image cotangent, times its weight.

mod blur;
mod planes;
#[cfg(test)]
mod tests;

pub use blur::{accumulate, scale_into};

use crate::tone::{CurveGradient, Even, FrameTone, FrameToneGradient, ResponseCurve};
use i2slam_geometry::{Image, Real};

/// How the radiance of one frame becomes its picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Formation<'a, T> {
    /// `picture = radiance`, without clipping: no tone mapping at all.
    Identity,
    /// `picture_c = CRF_leaky(exposure · white_balance_c · radiance_c)` (eqs. 8 to 11).
    Tone {
        /// Exposure and white balance of the frame.
        tone: &'a FrameTone<T>,
        /// Response of the camera.
        curve: &'a ResponseCurve<T>,
    },
}

impl<'a, T: Real> Formation<'a, T> {
    /// Formation through exposure, white balance and response.
    pub fn new(tone: &'a FrameTone<T>, curve: &'a ResponseCurve<T>) -> Self {
        Self::Tone { tone, curve }
    }

    /// Formation without tone mapping.
    pub fn identity() -> Self {
        Self::Identity
    }

    /// The picture of `hdr`, the radiance averaged over the exposure (planes R, G, B).
    /// `picture` is given the shape of `hdr`. Values leave [0, 1] by at most the leaky clip.
    pub fn form(&self, hdr: &Image<T>, picture: &mut Image<T>) {
        blur::shape_like(hdr, picture);
        let Self::Tone { tone, curve } = self else {
            picture.data.copy_from_slice(&hdr.data);
            return;
        };
        for channel in 0..hdr.channels {
            let gain = tone.gains()[channel.min(2)];
            let segments = curve.segments(channel);
            let (from, to) = (hdr.plane(channel), picture.plane_mut(channel));
            match curve.grid().binned() {
                Some(binned) => planes::form(&binned, segments, gain, from, to),
                None => planes::form(&Even, segments, gain, from, to),
            }
        }
    }

    /// Pulls `d_picture = ∂loss/∂picture` back: `d_hdr` is written (in the shape of `hdr`), the
    /// gradients of tone and curve are added to. Sums run in `f64`, in a fixed order. A
    /// pixel with `d_picture = 0` contributes nothing, whatever its radiance.
    ///
    /// # Panics
    /// When `d_picture` has another shape than `hdr`, or `d_curve` another than the curve.
    pub fn pull_back(
        &self,
        hdr: &Image<T>,
        d_picture: &Image<T>,
        d_hdr: &mut Image<T>,
        d_tone: &mut FrameToneGradient<T>,
        d_curve: &mut CurveGradient<T>,
    ) {
        blur::assert_same_shape(hdr, d_picture);
        blur::shape_like(hdr, d_hdr);
        let Self::Tone { tone, curve } = self else {
            d_hdr.data.copy_from_slice(&d_picture.data);
            return;
        };
        for channel in 0..hdr.channels {
            let gain = tone.gains()[channel.min(2)];
            let segments = curve.segments(channel);
            let planes = planes::Planes {
                hdr: hdr.plane(channel),
                d_picture: d_picture.plane(channel),
                d_hdr: d_hdr.plane_mut(channel),
            };
            let d_values = &mut d_curve.values[curve.curve_of(channel)];
            let d_log_gain = match curve.grid().binned() {
                Some(binned) => planes::pull_back(&binned, segments, gain, planes, d_values),
                None => planes::pull_back(&Even, segments, gain, planes, d_values),
            };
            d_tone.log_exposure += d_log_gain;
            d_tone.log_white_balance[channel.min(2)] += d_log_gain;
        }
    }
}
