//! Positions of features of photographs, refined by alignment of patches.
//!
//! A detector places a feature to a pixel or two, in each photograph anew. Around a landmark a patch of
//! one photograph is aligned with all others, by an affine warp that starts from their poses: positions
//! agree to a fraction of a pixel then. Pictures are those that are kept of keyframes, of at most 160 000
//! pixels.

use crate::multiview::landmark::{Landmark, warp_between_views};
use crate::multiview::lens_distortion::undistort;
use crate::multiview::whitening::Whitening;
use crate::sfm_state::SfmState;
use crate::track::patch::{AffineWarp, PatchTemplate};
use crate::track::point_search::{MIN_ANCHOR_CORRELATION, anchor_whitening, position_whitening};
use crate::track::tracks::{Observation, Track};
use i2slam_geometry::{Image, Pose, Vec3};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Largest move of a position in its picture as kept [px].
const MAX_MOVE: f32 = 2.0;

/// A photograph as its picture was kept, and the size of the full one over that of it.
struct Picture {
    image: Image<f32>,
    scale: f64,
}

/// Refines the positions of all observations that a landmark explains; where patches do not align they
/// stay.
pub(crate) fn refine_positions(state: &mut SfmState) {
    let images = state.tracks.keyframe_images.iter();
    let pictures: BTreeMap<usize, Picture> = images
        .map(|image| (image.frame, Picture { image: image.picture(), scale: image.scale }))
        .collect();
    let refined_of = |(track, landmark): (&Track, &Option<Landmark>)| match landmark {
        Some(landmark) => refined_observations(state, &pictures, track, landmark),
        None => Vec::new(),
    };
    let tracks = state.tracks.tracks.par_iter().zip(&state.landmarks);
    let refined: Vec<Vec<Observation>> = tracks.map(refined_of).collect();
    for (track, observations) in state.tracks.tracks.iter_mut().zip(refined) {
        for observation in observations {
            let place = track.observation_in_mut(observation.frame);
            place.into_iter().for_each(|place| *place = observation);
        }
    }
}

/// Observations of a track whose patches align with that of one of them, and that one.
fn refined_observations(
    state: &SfmState,
    pictures: &BTreeMap<usize, Picture>,
    track: &Track,
    landmark: &Landmark,
) -> Vec<Observation> {
    let seen: Vec<(&Observation, Pose<f64>)> = track
        .observations
        .iter()
        .filter(|o| !o.is_outlier && pictures.contains_key(&o.frame))
        .filter_map(|o| Some((o, state.poses[o.frame]?)))
        .collect();
    let Some(&(anchor, anchor_pose)) = most_central(&seen, landmark.position()) else {
        return Vec::new();
    };
    let Picture { image, scale } = &pictures[&anchor.frame];
    let at = |o: &Observation, scale: f64| o.raw().map(|v| (v / scale) as f32);
    let Some(template) = PatchTemplate::<8>::new(image, at(anchor, *scale)) else {
        return Vec::new();
    };
    let aligned = |(o, pose): &(&Observation, Pose<f64>)| {
        let Picture { image, scale } = &pictures[&o.frame];
        let centre = at(o, *scale);
        let matrix = warp_between_views(&state.camera, landmark, &anchor_pose, pose)?;
        let found = template.align(image, AffineWarp { matrix, centre })?;
        let [x, y] = found.warp.centre;
        let is_near = (x - centre[0]).hypot(y - centre[1]) < MAX_MOVE;
        (is_near && found.correlation > MIN_ANCHOR_CORRELATION).then(|| {
            let to = found.warp.centre.map(|v| f64::from(v) * scale);
            placed(state, o, to, position_whitening(&found, *scale))
        })
    };
    let others = seen.iter().filter(|(o, _)| o.frame != anchor.frame);
    let mut out: Vec<Observation> = others.filter_map(aligned).collect();
    if !out.is_empty() {
        // The landmark is what this photograph shows at the place of its feature.
        out.push(placed(state, anchor, anchor.raw(), anchor_whitening(&template, *scale)));
    }
    out
}

/// The observation whose view of a point is nearest to all others.
fn most_central<'a, 'b>(
    seen: &'a [(&'b Observation, Pose<f64>)],
    point: Vec3<f64>,
) -> Option<&'a (&'b Observation, Pose<f64>)> {
    let direction = |pose: &Pose<f64>| {
        let ray = pose.translation - point;
        ray * ray.norm().recip()
    };
    let sum = seen.iter().fold(Vec3::zero(), |sum, (_, pose)| sum + direction(pose));
    let alike = |pose: &Pose<f64>| direction(pose).dot(sum);
    seen.iter().max_by(|a, b| alike(&a.1).total_cmp(&alike(&b.1)))
}

/// An observation at another position as the lens shows it.
fn placed(
    state: &SfmState,
    observation: &Observation,
    raw: [f64; 2],
    whitening: Whitening,
) -> Observation {
    let new = Observation::whitened(observation.frame, raw, whitening);
    new.moved_to(undistort(&state.camera, state.distortion, raw))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::camera;
    use crate::track::pyramid::Pyramid;
    use crate::track::thumbnail::KeyframeImage;
    use crate::track::tracks::Tracks;
    use i2slam_check::noise;
    use i2slam_geometry::Rotation;
    use std::sync::Arc;

    const DEPTH: f64 = 2.0;

    /// Places before a wall, to the sides of which they turn.
    fn pose(frame: usize) -> Pose<f64> {
        let side = frame as f64 - 1.0;
        let turn = Rotation::exp(Vec3::new(0.05 * side, -0.3 * side, 0.2 * side));
        Pose::new(turn, Vec3::new(0.6 * side, 0.0, 0.1 * side * side))
    }

    /// A picture of the wall, brighter from frame to frame.
    fn picture(frame: usize) -> Pyramid {
        let (pose, camera) = (pose(frame), camera());
        let wall = |x: f64, y: f64| {
            let wave = |i: usize| {
                let (turn, size) = (2.4 * i as f64, 6.0 + 3.0 * i as f64);
                (size * (x * turn.cos() + y * turn.sin()) + (i * i) as f64).sin()
            };
            (0..16).map(wave).sum::<f64>()
        };
        let brightness = |column: usize, row: usize| {
            let through = pose * camera.unproject(column as f64 + 0.5, row as f64 + 0.5, 1.0);
            let ray = through - pose.translation;
            let on_wall = pose.translation + ray * ((DEPTH - pose.translation.z) / ray.z);
            (0.4 + 0.1 * frame as f64 + 0.03 * wall(on_wall.x, on_wall.y)) as f32
        };
        let (width, height) = (camera.width, camera.height);
        Pyramid::new(&Image::from_fn(width, height, 1, |_, column, row| brightness(column, row)))
    }

    fn point(track: usize) -> Vec3<f64> {
        Vec3::new(0.12 * (track % 7) as f64 - 0.36, 0.12 * (track / 7) as f64 - 0.3, DEPTH)
    }

    fn seen(track: usize, frame: usize) -> [f64; 2] {
        camera().project(pose(frame).inverse() * point(track)).into()
    }

    /// Three photographs of 42 points whose features are off by up to 0.8 px.
    fn state() -> SfmState {
        let track = |track: usize| {
            let off = noise(track as u64, 6);
            let observation = |frame: usize| {
                let at = seen(track, frame);
                let at = [0, 1].map(|i| at[i] + 0.8 * off[2 * frame + i]);
                Observation::new(frame, at, 2.0)
            };
            Track { observations: (0..3).map(observation).collect() }
        };
        let tracks =
            Tracks { tracks: (0..42).map(track).collect(), frames: 3, ..Tracks::default() };
        let images: Vec<_> =
            (0..3).map(|frame| Arc::new(KeyframeImage::new(&picture(frame), frame))).collect();
        let mut state = SfmState::new(camera(), tracks.with_keyframes(images.iter()));
        state.poses = (0..3).map(|frame| Some(pose(frame))).collect();
        state.triangulate_missing();
        state
    }

    /// Root mean square distance of the features from where the points that the central photograph shows
    /// at its features are seen.
    fn inconsistency(state: &SfmState) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for track in &state.tracks.tracks {
            let at = track.observations[1].at();
            let through = pose(1) * camera().unproject(at[0], at[1], 1.0);
            let ray = through - pose(1).translation;
            let shown = pose(1).translation + ray * ((DEPTH - pose(1).translation.z) / ray.z);
            for frame in [0, 2] {
                let (u, v) = camera().project(pose(frame).inverse() * shown);
                let [x, y] = track.observations[frame].at();
                (sum, count) = (sum + (x - u).powi(2) + (y - v).powi(2), count + 1.0);
            }
        }
        (sum / count).sqrt()
    }

    #[test]
    fn features_of_photographs_agree_to_a_fraction_of_a_pixel() {
        let mut state = state();
        let before = inconsistency(&state);
        refine_positions(&mut state);
        let after = inconsistency(&state);
        assert!(before > 0.6 && after < 0.15, "{before} {after}");
        let observations = state.tracks.tracks.iter().flat_map(|track| &track.observations);
        assert!(observations.filter(|o| o.sigma() < 0.6).count() > 110);
    }

    #[test]
    fn features_of_other_places_stay() {
        let mut state = state();
        // The first photograph shows the points elsewhere.
        for track in &mut state.tracks.tracks {
            let moved = track.observations[0].raw().map(|v| v + 25.0);
            track.observations[0] = Observation::new(0, moved, 2.0);
        }
        let before: Vec<_> = state.tracks.tracks.iter().map(|t| t.observations[0]).collect();
        refine_positions(&mut state);
        let same =
            before.iter().zip(&state.tracks.tracks).filter(|(o, t)| **o == t.observations[0]);
        assert!(same.count() > 36);
    }
}
