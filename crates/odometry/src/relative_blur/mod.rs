//! Motion of photographs during their exposures, from how much less contrast each shows of a place
//! than others do.
//!
//! A photograph that moves by `v` pixels shows the frequency `ω` of a surface with the power
//! `P(ω) sinc²(ω·v / 2)`. Around a landmark two photographs show the same `P`, so that the ratio of
//! their powers depends on both motions alone, not on the surface; it uses no phases, so that patches
//! may be some pixels off. The motions of all photographs are those whose ratios differ least from the
//! measured ones. What all photographs share cannot be told from a soft scene: of motions that explain
//! the ratios equally well the shortest are taken. The sign of a motion leaves no trace.

mod patch_pairs;
mod search;

use crate::dense::MAX_PHOTOGRAPH_DISTANCE;
use crate::dense::view_selection::overlap_ratio;
use crate::result::Keyframe;
use crate::track::pyramid::Pyramid;
use i2slam_compute::{CancellationToken, median};
use i2slam_geometry::{Camera, Image, Tangent};
use patch_pairs::{PatchPair, View, compare_patches};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Exponent of an average camera response: motion averages light, not picture values.
const RESPONSE_EXPONENT: f32 = 2.2;
/// Photographs that one is compared with, and ratio of its picture that they show.
const MAX_VIEWS: usize = 8;
const MIN_OVERLAP: f64 = 0.3;

/// Motion of the camera from start to end of the exposure of every photograph, as a rotation about the
/// axes across the optical one, of either sign; `None` where a photograph cannot be read, or shows nothing
/// that one up to [`MAX_PHOTOGRAPH_DISTANCE`] before or after it shows, or after cancellation.
///
/// `load` gives the picture of a photograph, without lens distortion, in the size of `camera`; it is
/// called once for each, in order.
pub fn photograph_motions(
    camera: &Camera<f64>,
    photographs: &[Keyframe],
    load: &mut dyn FnMut(usize) -> Option<Arc<Image<f32>>>,
    cancellation: &CancellationToken,
) -> Vec<Option<Tangent<f64>>> {
    let compared: Vec<Vec<usize>> =
        (0..photographs.len()).map(|number| compared_views(camera, photographs, number)).collect();
    let (mut pyramids, mut pairs) = (BTreeMap::<usize, Pyramid>::new(), Vec::<PatchPair>::new());
    let is_of_size =
        |image: &Arc<Image<f32>>| (image.width, image.height) == (camera.width, camera.height);
    for number in 0..photographs.len() {
        if cancellation.is_cancelled() {
            return vec![None; photographs.len()];
        }
        let Some(picture) = load(number).filter(is_of_size) else { continue };
        pyramids.retain(|earlier, _| earlier + MAX_PHOTOGRAPH_DISTANCE >= number);
        pyramids.insert(number, Pyramid::new(&linear(&picture)));
        let both_ways =
            pyramids.keys().flat_map(|earlier| [(number, *earlier), (*earlier, number)]);
        let due: Vec<(usize, usize)> =
            both_ways.filter(|(from, to)| compared[*from].contains(to)).collect();
        let view = |number: usize| View {
            number,
            keyframe: &photographs[number],
            pyramid: &pyramids[&number],
        };
        let compare =
            |&(from, to): &(usize, usize)| compare_patches(camera, [&view(from), &view(to)]);
        let found: Vec<Vec<PatchPair>> = due.par_iter().map(compare).collect();
        pairs.extend(found.into_iter().flatten());
    }
    let longer_side = camera.width.max(camera.height) as f32;
    let found = search::search_motions(photographs.len(), longer_side, &pairs, cancellation);
    found.into_iter().map(|motion| Some(rotation(camera, motion?))).collect()
}

/// The photographs that show most of what one shows.
fn compared_views(camera: &Camera<f64>, photographs: &[Keyframe], number: usize) -> Vec<usize> {
    let own = &photographs[number];
    let mut depths: Vec<f64> = own.depths.iter().map(|point| point.depth).collect();
    let Some(depth) = median(&mut depths).filter(|depth| *depth > 0.0) else { return Vec::new() };
    let overlap = |other: usize| {
        let pose = photographs[other].world_from_camera;
        (overlap_ratio(camera, own.world_from_camera, pose, depth), other)
    };
    let is_near =
        |other: &usize| *other != number && other.abs_diff(number) <= MAX_PHOTOGRAPH_DISTANCE;
    let near = (0..photographs.len()).filter(is_near).map(overlap);
    let mut views: Vec<(f64, usize)> = near.filter(|(ratio, _)| *ratio >= MIN_OVERLAP).collect();
    views.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    views.into_iter().take(MAX_VIEWS).map(|(_, other)| other).collect()
}

/// A picture in linear light, up to the response of its camera.
fn linear(picture: &Image<f32>) -> Image<f32> {
    let mut out = picture.clone();
    out.data.iter_mut().for_each(|value| *value = value.max(0.0).powf(RESPONSE_EXPONENT));
    out
}

/// The rotation that moves the middle of the picture by `motion` [px].
fn rotation(camera: &Camera<f64>, motion: [f32; 2]) -> Tangent<f64> {
    let [u, v] = motion.map(f64::from);
    Tangent::from_array([0.0, 0.0, 0.0, v / camera.fy, -u / camera.fx, 0.0])
}

#[cfg(test)]
mod tests;
