//! Motion of photographs during their exposures, from how much less contrast each shows of a place
//! than others do.
//!
//! A photograph that moves by `v` pixels shows the frequency `ω` of a surface with the power
//! `P(ω) sinc²(ω·v / 2)`. Around a landmark two photographs show the same `P`, so that the ratio of
//! their powers tells of both motions, whatever the surface looks like, and although patches may be
//! some pixels off. The motions of all photographs are those whose ratios differ least from the
//! measured ones. What all photographs share cannot be told from a soft scene: of motions that explain
//! the ratios equally well the shortest are taken. The sign of a motion leaves no trace.

mod patch_pairs;
mod search;

use crate::dense::MAX_PHOTOGRAPH_DISTANCE;
use crate::dense::view_selection::{PHOTOGRAPHS, select_views};
use crate::result::Keyframe;
use crate::track::pyramid::Pyramid;
use i2slam_compute::{CancellationToken, median};
use i2slam_geometry::{Camera, Image, Pose, Tangent};
use patch_pairs::{PatchPair, View, compare_patches};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Exponent of an average camera response: motion averages light, not picture values.
const RESPONSE_EXPONENT: f32 = 2.2;

/// Motion of the camera from start to end of the exposure of every photograph, as a rotation about the
/// axes across the optical one, of either sign; `None` where a photograph shares no surface with others.
///
/// `load` gives the picture of a photograph, without lens distortion, in the size of `camera`; it is
/// called once for each, in order.
pub fn photograph_motions(
    camera: &Camera<f64>,
    photographs: &[Keyframe],
    load: &mut dyn FnMut(usize) -> Option<Arc<Image<f32>>>,
    cancellation: &CancellationToken,
) -> Vec<Option<Tangent<f64>>> {
    let matched: Vec<Vec<usize>> =
        (0..photographs.len()).map(|number| matched_views(camera, photographs, number)).collect();
    let (mut pyramids, mut pairs) = (BTreeMap::<usize, Pyramid>::new(), Vec::<PatchPair>::new());
    for number in 0..photographs.len() {
        let Some(picture) = load(number).filter(|_| !cancellation.is_cancelled()) else { continue };
        pyramids.retain(|earlier, _| earlier + MAX_PHOTOGRAPH_DISTANCE >= number);
        let view =
            |number: usize, pyramid| View { number, keyframe: &photographs[number], pyramid };
        let own = Pyramid::new(&linear(&picture));
        for (&earlier, pyramid) in &pyramids {
            let both = [view(number, &own), view(earlier, pyramid)];
            if matched[number].contains(&earlier) {
                pairs.extend(compare_patches(camera, [&both[0], &both[1]]));
            }
            if matched[earlier].contains(&number) {
                pairs.extend(compare_patches(camera, [&both[1], &both[0]]));
            }
        }
        pyramids.insert(number, own);
    }
    let longer_side = camera.width.max(camera.height) as f32;
    let found = search::search_motions(photographs.len(), longer_side, &pairs, cancellation);
    found.into_iter().map(|motion| Some(rotation(camera, motion?))).collect()
}

/// The photographs that show most of what one shows.
fn matched_views(camera: &Camera<f64>, photographs: &[Keyframe], number: usize) -> Vec<usize> {
    let own = &photographs[number];
    let mut depths: Vec<f64> = own.depths.iter().map(|point| point.depth).collect();
    let Some(depth) = median(&mut depths).filter(|depth| *depth > 0.0) else { return Vec::new() };
    let is_other =
        |other: &usize| *other != number && other.abs_diff(number) <= MAX_PHOTOGRAPH_DISTANCE;
    let pose = |other: usize| (other, photographs[other].world_from_camera);
    let others: Vec<(usize, Pose<f64>)> =
        (0..photographs.len()).filter(is_other).map(pose).collect();
    select_views(camera, own.world_from_camera, &others, depth, PHOTOGRAPHS)
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
