//! Sharp pictures with what the pictures taken show and the map does not.
//!
//! A render is softer than the sharp picture, the picture taken noisy and blurred. The residual of image
//! formation is added to the render, in radiance `L`, with a weight that grows as it is trusted,
//!
//! ```text
//! L = L_render + w (L_taken - L_formed),    w = α / (1 + s² + (b / B)²) · 1 / (1 + e² / E²)
//! ```
//!
//! Without blur `L_formed` is `L_render`, and `1 / (1 + s² + …)` the weight of the mean of two estimates whose
//! deviations have the ratio `√(s² + (b / B)²)`: `s` is the slope from the frame's tone to the shown one,
//! which amplifies noise, `b` the motion in the picture [px], with that of a row that is read before or
//! after the middle of the exposure. The last factor reduces what passed through the picture: `e` is the rms of the
//! residual around a pixel, as picture values. `α` is the opacity: holes of the render are filled, those
//! of the formed picture are not. Clipped values and pixels beyond the taken picture are left out.

use super::Viewer;
use crate::objective::form_picture;
use crate::reconstruction::FrameEstimate;
use i2slam_formation::{Formation, ResponseCurve};
use i2slam_geometry::Image;
use std::ops::RangeInclusive;

/// Motion `B` [px] that doubles the variance of a picture taken.
const UNIT_MOTION: f64 = 2.0;
/// Residual `E` at which its weight falls to a half: several times what noise and softness of maps leave.
const UNIT_RESIDUAL: f32 = 0.1;
/// Half the side of the square in which the residual is averaged [px].
const HALF_SQUARE: usize = 2;
/// Picture values outside of which a pixel is taken for clipped.
const UNCLIPPED: RangeInclusive<f32> = 0.01..=0.98;
/// Least slope of a response that is told from a level one.
const MIN_SLOPE: f32 = 1e-3;

impl Viewer<'_> {
    /// Linear radiance at mid-exposure of a frame with what `taken`, its picture, shows beyond the map; noise
    /// counts as in a picture with the tone of `shown`. The render alone if `taken` has another
    /// size, or blur was not modelled, so that motion is unknown.
    pub fn restored_hdr(
        &mut self,
        frame: &FrameEstimate,
        taken: &Image<f32>,
        shown: &FrameEstimate,
    ) -> Image<f32> {
        let mut radiance = self.hdr(frame.middle());
        let shape = |image: &Image<f32>| (image.width, image.height, image.channels);
        if !self.reconstruction.config.formation.blur || shape(taken) != shape(&radiance) {
            return radiance;
        }
        let formed = self.blurred(frame);
        let mut weights = weights_of_residual(taken, &formed);
        let opacity = self.opacity(frame.middle());
        weights.iter_mut().zip(&opacity.data).for_each(|(weight, opacity)| *weight *= opacity);
        let motion: Vec<f32> =
            (0..radiance.height).map(|row| relative_motion(frame, row, radiance.height)).collect();
        let curves = [self.curve(frame), self.curve(shown)];
        let lens = &self.reconstruction.vignetting;
        let vignetting = (!lens.is_none()).then(|| lens.at_pixels(&self.camera.cast()));
        for channel in 0..radiance.channels {
            let tone =
                |curve, gains: [f32; 3]| ChannelTone { curve, channel, gain: gains[channel] };
            let tones = match &curves {
                [Some(own), Some(its)] => {
                    Some([tone(own, frame.tone.gains()), tone(its, shown.tone.gains())])
                }
                _ => None,
            };
            let pictures = taken.plane(channel).iter().zip(formed.plane(channel));
            let values = radiance.plane_mut(channel).iter_mut().zip(pictures).enumerate();
            for (pixel, (value, (&taken, &formed))) in values {
                if !is_compared(taken, formed) {
                    continue;
                }
                let light = vignetting.as_ref().map_or(1.0, |all| all[pixel]);
                let (residual, slope) = match &tones {
                    Some([own, its]) => own.dimmed(light).residual([taken, formed], its),
                    None => (taken - formed, 1.0),
                };
                let variance = slope.powi(2) + motion[pixel / opacity.width].powi(2);
                *value = (*value + weights[pixel] / (1.0 + variance) * residual).max(0.0);
            }
        }
        radiance
    }

    /// `radiance` with the exposure, white balance and response of a frame, without vignetting.
    pub fn toned(&self, radiance: &Image<f32>, frame: &FrameEstimate) -> Image<f32> {
        let curve = self.curve(frame);
        let tone = curve.as_ref();
        let tone = tone.map(|curve| Formation { tone: frame.tone, curve, vignetting: None });
        let mut picture = Image::default();
        form_picture(tone.as_ref(), radiance, &mut picture);
        picture
    }
}

/// Exposure, white balance and response of one channel of a picture.
struct ChannelTone<'a> {
    curve: &'a ResponseCurve<f32>,
    channel: usize,
    gain: f32,
}

impl ChannelTone<'_> {
    /// The tone where the lens passes a share of the light.
    fn dimmed(&self, light: f32) -> Self {
        Self { gain: self.gain * light, ..*self }
    }

    /// Difference of the radiances of two values of a picture, and the slope from its values to those of `shown`.
    fn residual(&self, [taken, formed]: [f32; 2], shown: &Self) -> (f32, f32) {
        let [taken, formed] = [taken, formed].map(|y| self.curve.inverse(self.channel, y));
        let radiance = formed / self.gain;
        let slopes = [shown, self].map(|tone| {
            tone.gain * tone.curve.slope(self.channel, tone.gain * radiance).max(MIN_SLOPE)
        });
        ((taken - formed) / self.gain, slopes[0] / slopes[1])
    }
}

/// True if both values are inside the range of the response.
fn is_compared(taken: f32, formed: f32) -> bool {
    UNCLIPPED.contains(&taken) && UNCLIPPED.contains(&formed)
}

/// Motion in a row of a frame's picture: blur, and what the camera moves between the row and the middle of
/// the exposure [units of motion].
fn relative_motion(frame: &FrameEstimate, row: usize, height: usize) -> f32 {
    let lag = frame.readout * ((row as f64 + 0.5) / height as f64 - 0.5);
    (frame.blur_length / UNIT_MOTION * 1.0_f64.hypot(lag)) as f32
}

/// Weights by the mean square of the residual around every pixel, of the values that are compared.
fn weights_of_residual(taken: &Image<f32>, formed: &Image<f32>) -> Vec<f32> {
    let pixels = taken.width * taken.height;
    let (mut squares, mut counts) = (vec![0.0; pixels], vec![0.0; pixels]);
    for (i, (a, b)) in taken.data.iter().zip(&formed.data).enumerate() {
        if is_compared(*a, *b) {
            squares[i % pixels] += (a - b).powi(2);
            counts[i % pixels] += 1.0;
        }
    }
    let size = (taken.width, taken.height);
    let means = square_means(&squares, size).into_iter().zip(square_means(&counts, size));
    means.map(|(sum, n)| n / (n + sum / UNIT_RESIDUAL.powi(2)).max(f32::MIN_POSITIVE)).collect()
}

/// Means over squares of `2 HALF_SQUARE + 1` pixels a side, of their part within the picture.
fn square_means(plane: &[f32], (width, height): (usize, usize)) -> Vec<f32> {
    let line = |plane: &[f32], pixel: usize, (at, length): (usize, usize), stride: usize| {
        let first = at.saturating_sub(HALF_SQUARE);
        let count = (at + HALF_SQUARE + 1).min(length) - first;
        let start = pixel - (at - first) * stride;
        (0..count).map(|i| plane[start + i * stride]).sum::<f32>() / count as f32
    };
    let rows: Vec<f32> = (0..plane.len()).map(|p| line(plane, p, (p % width, width), 1)).collect();
    (0..rows.len()).map(|p| line(&rows, p, (p / width, height), width)).collect()
}

#[cfg(test)]
mod tests {
    use super::super::pose_optimization::tests::room;
    use super::*;
    use crate::reconstruction::Map;
    use i2slam_check::noise;
    use i2slam_formation::ShutterPoses;
    use i2slam_geometry::{Pose, Tangent};

    /// A pattern that the map does not have, as picture values.
    const DETAIL: f32 = 0.01;

    fn turning(angle: f64, exposure: f32) -> FrameEstimate {
        let room = room();
        let rotated =
            |angle| Pose::identity().retract(Tangent::from_array([0.0, 0.0, 0.0, 0.0, angle, 0.0]));
        let mut frame = FrameEstimate {
            shutter: ShutterPoses { start: rotated(-0.5 * angle), end: rotated(0.5 * angle) },
            blur_length: angle * room.camera.fx,
            ..room.virtual_frame(0, Pose::identity())
        };
        frame.tone.log_exposure = exposure.ln();
        frame
    }

    /// Mean share of the detail in the picture of `frame` that is in the restored picture with the tone of
    /// `shown`, each as the other shows it.
    fn share_of_detail(frame: &FrameEstimate, shown: &FrameEstimate) -> f64 {
        let room = room();
        let mut viewer = room.viewer();
        let mut taken = viewer.blurred(frame);
        let detail: Vec<f32> =
            noise(5, taken.data.len()).iter().map(|v| DETAIL * v.signum() as f32).collect();
        taken.data.iter_mut().zip(&detail).for_each(|(v, d)| *v += d);
        let restored = viewer.restored_hdr(frame, &taken, shown);
        let (restored, render) = (viewer.toned(&restored, frame), viewer.sharp(frame));
        let differences = restored.data.iter().zip(&render.data).map(|(a, b)| a - b);
        let products: f32 = differences.zip(&detail).map(|(a, d)| a * d).sum();
        f64::from(products / detail.iter().map(|d| d * d).sum::<f32>())
    }

    #[test]
    fn detail_of_a_still_picture_counts_half_and_less_with_motion_and_noise() {
        let still = turning(0.0, 1.0);
        let share = share_of_detail(&still, &still);
        assert!((0.43..0.51).contains(&share), "{share}");
        // 4 px are two units, and blur leaves the formed picture softer than the render.
        let moved = share_of_detail(&turning(4.0 / 90.0, 1.0), &still);
        assert!((0.1..0.25).contains(&moved), "{moved}");
        // Twice the exposure multiplies noise by 2^(1/2.4) or so: a share of 1 / (1 + 1.8) or so.
        let dark = share_of_detail(&turning(0.0, 0.5), &still);
        assert!((0.28..0.45).contains(&dark), "{dark}");
    }

    #[test]
    fn little_is_left_of_what_passed_through_the_picture() {
        let (room, frame) = (room(), turning(0.0, 1.0));
        let mut viewer = room.viewer();
        let mut taken = viewer.blurred(&frame);
        let size = (taken.width, taken.height);
        for (pixel, value) in taken.data.iter_mut().enumerate() {
            let (column, row) = (pixel % size.0, pixel / size.0 % size.1);
            if (30..60).contains(&column) && (20..50).contains(&row) {
                *value = (*value + 0.4).min(0.95);
            }
        }
        let restored = viewer.restored_hdr(&frame, &taken, &frame);
        let (restored, render) = (viewer.toned(&restored, &frame), viewer.sharp(&frame));
        let traces = restored.data.iter().zip(&render.data).map(|(a, b)| (a - b).abs());
        let most = traces.clone().fold(0.0, f32::max);
        let mean = traces.sum::<f32>() / (3.0 * 30.0 * 30.0);
        assert!(most < 0.08 && mean < 0.03, "{most} {mean}");
    }

    /// Rows far from the middle of a long readout show another moment.
    #[test]
    fn rows_that_are_read_late_count_less() {
        let frame = FrameEstimate { readout: 4.0, ..turning(2.0 / 90.0, 1.0) };
        let rows = [0, 36, 71].map(|row| relative_motion(&frame, row, 72));
        assert!((rows[1] - 1.0).abs() < 0.01 && rows[0] > 2.0 && rows[2] > 2.0, "{rows:?}");
    }

    #[test]
    fn a_value_that_is_no_number_changes_nothing_around_it() {
        let (room, frame) = (room(), turning(0.0, 1.0));
        let mut viewer = room.viewer();
        let mut taken = viewer.blurred(&frame);
        taken.data.iter_mut().for_each(|v| *v += DETAIL);
        let due = viewer.restored_hdr(&frame, &taken, &frame);
        taken.data[3000] = f32::NAN;
        let found = viewer.restored_hdr(&frame, &taken, &frame);
        for (pixel, (found, due)) in found.data.iter().zip(&due.data).enumerate() {
            assert!(pixel == 3000 || (found - due).abs() < 1e-3, "{pixel}: {found} {due}");
        }
    }

    /// The formed picture is darker in a hole, the render filled there.
    #[test]
    fn holes_are_not_filled_twice() {
        let mut room = room();
        let Map::Gaussians(map) = &mut room.map else { unreachable!("Gaussians") };
        map.opacity_logits.iter_mut().for_each(|logit| *logit = -1.5);
        let (mut viewer, frame) = (room.viewer(), turning(0.0, 1.0));
        let taken = viewer.sharp(&frame);
        let restored = viewer.restored_hdr(&frame, &taken, &frame);
        let (restored, render) = (viewer.toned(&restored, &frame), taken);
        let brighter = restored.data.iter().zip(&render.data).map(|(a, b)| (a - b).max(0.0));
        let mean = brighter.sum::<f32>() / render.data.len() as f32;
        assert!(mean < 0.01, "{mean}");
    }

    #[test]
    fn clipped_values_and_pictures_of_another_size_change_nothing() {
        let (room, frame) = (room(), turning(0.0, 1.0));
        let mut viewer = room.viewer();
        let render = viewer.hdr(frame.middle());
        let mut taken = viewer.blurred(&frame);
        taken.data.iter_mut().for_each(|v| *v = 1.0);
        assert_eq!(viewer.restored_hdr(&frame, &taken, &frame), render);
        let small = taken.resized_by_area(48, 36);
        assert_eq!(viewer.restored_hdr(&frame, &small, &frame), render);
    }
}
