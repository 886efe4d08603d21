//! Pixels of blurred keyframes with what sharper keyframes show at the places that they saw.
//!
//! A pixel of a blurred keyframe moves over the surface that the map shows while the shutter is open; a
//! sharper keyframe shows the light of these places one by one, but for its own blur, which the blurred one
//! gets as well. See [`i2slam_formation::blur_estimate::estimate_power`].

use super::context::MappingContext;
use super::keyframe::Keyframe;
use super::mapper::Mapper;
use super::view::{MomentSamples, View, place_within};
use crate::objective::blur_length;
use i2slam_formation::blur_estimate::SHARP_PICTURES;
use i2slam_geometry::{Camera, Image};
use rayon::prelude::*;

/// Blur of a picture that counts as blurred \[px\].
const MIN_BLUR: f64 = 2.0;
/// Blur of the other picture over that, at most.
const MAX_BLUR_RATIO: f64 = 0.5;
/// Most blurred keyframes, the most blurred ones.
const MAX_BLURRED: usize = 16;
/// Pixels of a blurred picture, about.
const PIXELS: usize = 3000;

/// A pixel of a blurred keyframe at moments of the exposures of sharper ones, and of these at moments of its
/// exposure.
pub(crate) struct MovedPixel {
    pub(super) blurred: [MomentSamples; SHARP_PICTURES],
    pub(super) sharp: [MomentSamples; SHARP_PICTURES],
}

/// Pixels of a blurred keyframe that sharp ones explain.
pub(crate) struct BlurredView {
    pub(super) pixels: Vec<MovedPixel>,
}

/// Pixels of blurred keyframes in the sharp ones nearest in time, as far as depth rendered from the map
/// does not hide them. None of keyframes that are all alike.
pub(crate) fn compare_blurred_keyframes(
    mapper: &mut dyn Mapper,
    context: &MappingContext<'_>,
) -> Vec<BlurredView> {
    let blur: Vec<f64> =
        context.keyframes.iter().map(|keyframe| blur_of(context, keyframe)).collect();
    let mut blurred: Vec<usize> = (0..blur.len()).filter(|&k| blur[k] >= MIN_BLUR).collect();
    blurred.sort_by(|&a, &b| blur[b].total_cmp(&blur[a]).then(a.cmp(&b)));
    blurred.truncate(MAX_BLURRED);
    let mut view = |k: usize| View::new(mapper, context, &context.keyframes[k]);
    let of_keyframe = |k: usize| {
        let mut sharp: Vec<usize> =
            (0..blur.len()).filter(|&other| blur[other] <= MAX_BLUR_RATIO * blur[k]).collect();
        sharp.sort_by_key(|other| other.abs_diff(k));
        let [first, second, ..] = sharp[..] else { return None };
        let sharp = [view(first)?, view(second)?];
        let pixels = moved_pixels(&view(k)?, &sharp, context.camera, context.valid_mask);
        Some(BlurredView { pixels })
    };
    blurred.into_iter().filter_map(of_keyframe).collect()
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
    sharp: &[View; SHARP_PICTURES],
    camera: &Camera<f64>,
    valid_mask: Option<&Image<bool>>,
) -> Vec<MovedPixel> {
    let stride = ((camera.pixels() as f64 / PIXELS as f64).sqrt().ceil() as usize).max(1);
    let pixel = |pixel: (usize, usize)| {
        let place = place_within(pixel);
        let point = blurred.surface_point(camera, place, 0.0)?;
        let samples = |sharp: &View| {
            let in_sharp = sharp.place_of(camera, valid_mask, point)?;
            let shown = blurred.samples_along(camera, valid_mask, (sharp, in_sharp))?;
            Some((shown, sharp.samples_along(camera, valid_mask, (blurred, place))?))
        };
        let [(shown, seen), (other_shown, other_seen)] = [samples(&sharp[0])?, samples(&sharp[1])?];
        Some(MovedPixel { blurred: [shown, other_shown], sharp: [seen, other_seen] })
    };
    let row = |row: usize| {
        let columns = (stride / 2..camera.width).step_by(stride);
        columns.filter_map(|column| pixel((column, row))).collect::<Vec<MovedPixel>>()
    };
    let rows: Vec<usize> = (stride / 2..camera.height).step_by(stride).collect();
    rows.into_par_iter().flat_map_iter(row).collect()
}
