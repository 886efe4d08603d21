//! Pixels of blurred keyframes with what sharp keyframes show at the places that they saw.
//!
//! A pixel of a blurred keyframe moves over the surface that the map shows while the shutter is open; a
//! keyframe without blur shows the light of these places one by one. See
//! [`i2slam_formation::response_estimate::estimate_power`].

use super::context::MappingContext;
use super::keyframe::Keyframe;
use super::mapper::Mapper;
use super::surface_pairs::{PictureSample, View};
use crate::objective::blur_length;
use i2slam_formation::response_estimate::MOMENTS;
use i2slam_geometry::{Camera, Image};
use rayon::prelude::*;

/// Blur of a picture that counts as blurred \[px\].
const MIN_BLUR: f64 = 2.0;
/// Blur of the other picture over that, at most: what it has itself hides a sixteenth of the variance.
const MAX_BLUR_RATIO: f64 = 0.25;
/// Most blurred keyframes, the most blurred ones.
const MAX_BLURRED: usize = 8;
/// Sharp keyframes that each is compared with, the nearest in time.
const SHARP_PER_BLURRED: usize = 2;
/// Pixels of a blurred picture, about.
const PIXELS: usize = 5000;

/// A pixel of a blurred keyframe, and the samples of a sharp one at moments of its exposure.
pub(crate) struct MovedPixel {
    pub(super) blurred: PictureSample,
    pub(super) sharp: [PictureSample; MOMENTS],
}

/// Pixels of a blurred keyframe that a sharp one explains.
pub(crate) struct BlurredView {
    /// Place of the blurred keyframe among all.
    pub(super) keyframe: usize,
    pub(super) pixels: Vec<MovedPixel>,
}

/// Pixels of pairs of a blurred and a sharp keyframe, as far as depth rendered from the map does not
/// hide them. None of keyframes that are all alike.
pub(crate) fn compare_blurred_keyframes(
    mapper: &mut dyn Mapper,
    context: &MappingContext<'_>,
) -> Vec<BlurredView> {
    let blur: Vec<f64> =
        context.keyframes.iter().map(|keyframe| blur_of(context, keyframe)).collect();
    let mut blurred: Vec<usize> = (0..blur.len()).filter(|&k| blur[k] >= MIN_BLUR).collect();
    blurred.sort_by(|&a, &b| blur[b].total_cmp(&blur[a]).then(a.cmp(&b)));
    blurred.truncate(MAX_BLURRED);
    let mut pairs = Vec::new();
    for k in blurred {
        let mut sharp: Vec<usize> =
            (0..blur.len()).filter(|&other| blur[other] <= MAX_BLUR_RATIO * blur[k]).collect();
        sharp.sort_by_key(|other| other.abs_diff(k));
        pairs.extend(sharp.into_iter().take(SHARP_PER_BLURRED).map(|other| (k, other)));
    }
    let mut view = |k: usize| View::new(mapper, context, &context.keyframes[k]);
    let views: Option<Vec<(usize, [View; 2])>> =
        pairs.into_iter().map(|(k, other)| Some((k, [view(k)?, view(other)?]))).collect();
    let of_pair = |(keyframe, [blurred, sharp]): &(usize, [View; 2])| {
        let pixels = moved_pixels(blurred, sharp, context.camera, context.valid_mask);
        BlurredView { keyframe: *keyframe, pixels }
    };
    views.unwrap_or_default().par_iter().map(of_pair).collect()
}

/// Blur of a keyframe over the depth of its observation \[px\]; `NaN`, neither blurred nor sharp, without
/// depth.
fn blur_of(context: &MappingContext<'_>, keyframe: &Keyframe) -> f64 {
    let (shutter, observation) =
        (&context.frames[keyframe.frame].shutter, keyframe.observation.get());
    match observation.depth.data.iter().any(|depth| *depth > 0.0) {
        true => blur_length(context.camera, shutter, &observation.depth),
        false => f64::NAN,
    }
}

pub(super) fn moved_pixels(
    blurred: &View,
    sharp: &View,
    camera: &Camera<f64>,
    valid_mask: Option<&Image<bool>>,
) -> Vec<MovedPixel> {
    let stride = ((camera.pixels() as f64 / PIXELS as f64).sqrt().ceil() as usize).max(1);
    let rows = (stride / 2..camera.height).step_by(stride);
    let places =
        rows.flat_map(|row| (stride / 2..camera.width).step_by(stride).map(move |c| (c, row)));
    let pixel = |(column, row): (usize, usize)| {
        let mut samples = [None; MOMENTS];
        for (moment, sample) in samples.iter_mut().enumerate() {
            let time = (moment as f64 + 0.5) / MOMENTS as f64 - 0.5;
            let place = Camera::<f64>::pixel_centre(column, row);
            let point = blurred.surface_point(camera, place, time)?;
            *sample = Some(sharp.cubic_sample_of(camera, valid_mask, point)?);
        }
        let sharp = samples.into_iter().collect::<Option<Vec<PictureSample>>>()?;
        let blurred = blurred.pixel(camera, valid_mask, (column, row))?;
        Some(MovedPixel { blurred, sharp: sharp.try_into().ok()? })
    };
    places.filter_map(pixel).collect()
}
