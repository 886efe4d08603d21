//! Vignetting, exposure, noise, one colour and a covered lens on a picture.

use super::Degradation;
use super::vignetting::falloff;
use crate::rng::{gaussian, stream};
use crate::sensor::with_noise;
use i2slam_geometry::{Camera, Image};

/// Exposure change of a covered lens [stops].
const COVERED_STOPS: f64 = -11.0;
/// Picture value of a grey frame.
const GREY: f32 = 128.0 / 255.0;

impl Degradation {
    /// The degraded picture of a frame.
    pub(super) fn degrade_colour(
        &self,
        colour: &Image<f32>,
        camera: &Camera<f64>,
        frame: usize,
    ) -> Image<f32> {
        let mut out = colour.clone();
        if self.is_grey(frame) {
            out.data.fill(GREY);
            return out;
        }
        let covered = if self.covers(frame) { COVERED_STOPS } else { 0.0 };
        let gain = (self.stops(frame) + covered).exp2() as f32;
        let lens = falloff(self);
        let (size, centre) = ((camera.width, camera.height), (camera.cx, camera.cy));
        if gain == 1.0 && self.sensor_noise.is_none() && lens.is_none() {
            return out;
        }
        let mut random = stream(self.seed, 22, frame as u64);
        self.change_light(&mut out, |pixel, linear| {
            let mut exposed = linear * gain;
            if let Some(lens) = &lens {
                exposed *= lens.at_pixel(size, centre, pixel);
            }
            match &self.sensor_noise {
                Some(noise) => with_noise(exposed, noise, gaussian(&mut random)),
                None => exposed,
            }
        });
        out
    }

    /// A picture with the exposure step of a frame.
    pub(super) fn exposed(&self, mut picture: Image<f32>, frame: usize) -> Image<f32> {
        let gain = self.stops(frame).exp2() as f32;
        self.change_light(&mut picture, |_, linear| linear * gain);
        picture
    }

    /// Changes a picture's linear values, given by the response, of pixel after pixel in each channel.
    fn change_light(&self, picture: &mut Image<f32>, mut change: impl FnMut(usize, f32) -> f32) {
        for channel in 0..3 {
            let linear: Vec<f32> = (0..=LEVELS)
                .map(|i| self.response.invert(i as f32 / LEVELS as f32, channel))
                .collect();
            for (pixel, value) in picture.plane_mut(channel).iter_mut().enumerate() {
                let changed = change(pixel, linear_value(&linear, *value));
                *value = self.response.apply(changed, channel);
            }
        }
    }
}

/// Number of values at which the inverse response is tabulated.
const LEVELS: usize = 1020;

/// Looks up the tabulated inverse response. White is lowered by four steps of 1/1020 to stay finite.
fn linear_value(table: &[f32], value: f32) -> f32 {
    let at = (value.clamp(0.0, 1.0) * LEVELS as f32).min((LEVELS - 4) as f32);
    let below = at as usize;
    table[below] + (table[below + 1] - table[below]) * (at - below as f32)
}
