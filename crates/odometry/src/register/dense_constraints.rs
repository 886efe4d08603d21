//! Dense constraints: relative poses of frames and keyframes by alignment of picture and depth.
//!
//! Points use a few hundred pixels of a picture. Where depth is exact, all of them together locate a
//! frame several times as well; where it is not, the information of the alignment says so.

use crate::alignment::{DenseConstraint, DensePyramid, DenseView, ExposureMotion, align};
use crate::bundle::RelativePoseFactor;
use crate::depth::depth_map::DepthMap;
use crate::depth::registration::register_depth;
use crate::online::revisits::MIN_REVISIT_AGE;
use crate::progress::Stage;
use crate::rolling_shutter::frame_motion::FrameMotion;
use crate::rolling_shutter::readout::{median_frame_interval, pose_later};
use crate::sfm_state::SfmState;
use i2slam_geometry::{Camera, Image, Pose, Tangent};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fmt::{self, Debug, Formatter};
use std::sync::Arc;

/// Keyframes before and after one that it is aligned to.
const KEYFRAME_REACH: usize = 3;
/// Keyframes to which a frame is aligned that came long after the one before it.
const REVISITED_KEYFRAMES: usize = 2;
/// Points that a keyframe and a frame share, at least.
const MIN_SHARED_POINTS: usize = 8;
/// Keyframes to which a new one is aligned when it comes.
pub(crate) const RECENT_KEYFRAMES: usize = 1;
/// Share of the frame interval for which the shutter is taken to be open: the difference of the
/// blur of two pictures is a small correction.
const OPEN_SHARE: f64 = 0.5;
/// Frames that are aligned at once, and keyframes up to which another frame is added to them. Prepared
/// pictures of those keyframes are kept, and of one frame for each thread.
const MAX_BATCH_FRAMES: usize = 16;
const MAX_BATCH_KEYFRAMES: usize = 6;

/// A keyframe and a frame that is aligned to it.
type Pair = (usize, usize);

/// Aligns all frames to the keyframes around them.
pub(crate) fn add_dense_constraints(state: &mut SfmState) {
    if !state.is_metric() || state.pictures.is_empty() {
        return;
    }
    let keyframes: Vec<usize> =
        state.tracks.keyframes.iter().copied().filter(|f| state.poses[*f].is_some()).collect();
    state.relative_poses = Arc::new(constraints(state, &pairs(state, &keyframes)));
}

/// All pairs that are aligned, in order of keyframes.
fn pairs(state: &SfmState, keyframes: &[usize]) -> Vec<Pair> {
    let mut frames: Vec<Vec<usize>> = (0..keyframes.len())
        .map(|place| frames_around(keyframes, place, state.poses.len()))
        .collect();
    for (place, keyframe) in keyframes.iter().enumerate() {
        frames[place].retain(|frame| state.shared_count(*keyframe, *frame) >= MIN_SHARED_POINTS);
    }
    for (place, frame) in revisits(state, keyframes) {
        frames[place].push(frame);
    }
    let of = |(keyframe, frames): (&usize, Vec<usize>)| {
        frames.into_iter().map(|frame| (*keyframe, frame)).collect::<Vec<_>>()
    };
    keyframes.iter().zip(frames).flat_map(of).collect()
}

/// Constraints of all pairs, in order. Every frame is prepared once and aligned to all of its
/// keyframes; keyframes stay prepared from batch to batch.
fn constraints(state: &SfmState, pairs: &[Pair]) -> Vec<RelativePoseFactor> {
    let mut views: BTreeMap<usize, Option<PreparedView>> = BTreeMap::new();
    let mut found: Vec<Option<RelativePoseFactor>> = vec![None; pairs.len()];
    let batches = batches(pairs);
    let total = batches.len();
    for (done, Batch { frames, keyframes }) in batches.into_iter().enumerate() {
        state.progress.report(Stage::BundleAdjustment, done, total);
        views.retain(|keyframe, _| keyframes.contains(keyframe));
        let missing: Vec<usize> =
            keyframes.into_iter().filter(|keyframe| !views.contains_key(keyframe)).collect();
        let prepared = missing.into_par_iter().map(|keyframe| (keyframe, prepare(state, keyframe)));
        views.extend(prepared.collect::<Vec<_>>());
        let aligned = |(frame, places): &(usize, Vec<usize>)| {
            let own = if views.contains_key(frame) { None } else { prepare(state, *frame) };
            let view = views.get(frame).map_or(own.as_ref(), Option::as_ref);
            let constraint = |place: &usize| {
                let (keyframe, _) = pairs[*place];
                let reference = views.get(&keyframe)?.as_ref()?;
                constraint(state, (keyframe, reference), (*frame, view?))
            };
            places.iter().map(|place| (*place, constraint(place))).collect::<Vec<_>>()
        };
        let aligned: Vec<_> = frames.par_iter().map(aligned).collect();
        aligned.into_iter().flatten().for_each(|(place, constraint)| found[place] = constraint);
    }
    found.into_iter().flatten().collect()
}

/// Frames that are aligned at once.
#[derive(Default)]
struct Batch {
    /// Every frame with the places of its pairs.
    frames: Vec<(usize, Vec<usize>)>,
    /// Keyframes that they are aligned to.
    keyframes: BTreeSet<usize>,
}

/// All pairs, in order of frames.
fn batches(pairs: &[Pair]) -> Vec<Batch> {
    let mut places: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (place, (_, frame)) in pairs.iter().enumerate() {
        places.entry(*frame).or_default().push(place);
    }
    let mut out: Vec<Batch> = Vec::new();
    for (frame, places) in places {
        let is_full = |batch: &Batch| {
            batch.frames.len() >= MAX_BATCH_FRAMES || batch.keyframes.len() >= MAX_BATCH_KEYFRAMES
        };
        if out.last().is_none_or(is_full) {
            out.push(Batch::default());
        }
        if let Some(batch) = out.last_mut() {
            batch.keyframes.extend(places.iter().map(|place| pairs[*place].0));
            batch.frames.push((frame, places));
        }
    }
    out
}

/// A frame prepared for alignment, unless cancelled.
fn prepare(state: &SfmState, frame: usize) -> Option<PreparedView> {
    if state.progress.is_cancelled() { None } else { PreparedView::new(state, frame) }
}

/// Frames between one keyframe and those before and after it, where these came soon, and a few
/// keyframes after it.
fn frames_around(keyframes: &[usize], place: usize, frames: usize) -> Vec<usize> {
    let keyframe = keyframes[place];
    let before = place.checked_sub(1).map(|place| keyframes[place]);
    let after = keyframes.get(place + 1).copied().unwrap_or(frames);
    let is_soon = |first: usize, last: usize| last - first <= MIN_REVISIT_AGE;
    let earlier = match before {
        Some(before) if is_soon(before, keyframe) => before + 1..keyframe,
        Some(_) => keyframe..keyframe,
        None => 0..keyframe,
    };
    let later = if is_soon(keyframe, after) { keyframe + 1..after } else { 0..0 };
    let next = keyframes.iter().skip(place + 1).take(KEYFRAME_REACH).copied();
    earlier.chain(later).chain(next).collect()
}

/// Frames long after a keyframe and before the next one, which came while the camera saw known
/// places again, with the places of the keyframes that share most points with each.
fn revisits(state: &SfmState, keyframes: &[usize]) -> Vec<(usize, usize)> {
    let mut place_of = vec![None; state.poses.len()];
    keyframes.iter().enumerate().for_each(|(place, frame)| place_of[*frame] = Some(place));
    let ends = keyframes.iter().skip(1).copied().chain([state.poses.len()]);
    let gaps = keyframes.iter().zip(ends).filter(|(first, end)| *end - **first > MIN_REVISIT_AGE);
    let frames: Vec<usize> = gaps.flat_map(|(first, end)| first + 1..end).collect();
    let of_frame = |frame: &usize| {
        let mut counts: BTreeMap<usize, usize> = BTreeMap::new();
        for track in &state.by_frame[*frame] {
            let seen = state.tracks.tracks[*track].observations.iter();
            seen.filter_map(|o| place_of[o.frame])
                .for_each(|place| *counts.entry(place).or_default() += 1);
        }
        let mut counts: Vec<(usize, usize)> = counts.into_iter().collect();
        counts.retain(|(_, count)| *count >= MIN_SHARED_POINTS);
        counts.sort_by_key(|(place, count)| (usize::MAX - count, *place));
        counts.truncate(REVISITED_KEYFRAMES);
        counts.into_iter().map(|(place, _)| (place, *frame)).collect::<Vec<_>>()
    };
    let found: Vec<Vec<(usize, usize)>> = frames.par_iter().map(of_frame).collect();
    found.into_iter().flatten().collect()
}

/// Prepared pictures of the last keyframes, to which a new one is aligned.
#[derive(Clone, Default)]
pub(crate) struct RecentKeyframes(VecDeque<(usize, Arc<PreparedView>)>);

impl Debug for RecentKeyframes {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.0.iter().map(|(frame, _)| frame)).finish()
    }
}

impl RecentKeyframes {
    /// Aligns a new keyframe to the last ones, in a map whose lengths are those of depth.
    pub(crate) fn align(&mut self, state: &mut SfmState, frame: usize) {
        if state.is_unscaled {
            return;
        }
        let Some(view) = PreparedView::new(state, frame) else { return };
        let aligned = |(reference, known): &(usize, Arc<PreparedView>)| {
            if state.shared_count(*reference, frame) < MIN_SHARED_POINTS {
                return None;
            }
            constraint(state, (*reference, known), (frame, &view))
        };
        let found: Vec<_> = self.0.par_iter().filter_map(aligned).collect();
        Arc::make_mut(&mut state.relative_poses).extend(found);
        self.0.push_back((frame, Arc::new(view)));
        if self.0.len() > RECENT_KEYFRAMES {
            self.0.pop_front();
        }
    }
}

/// Relative pose of a frame in a reference; `None` if they do not align.
fn constraint(
    state: &SfmState,
    (first, reference): (usize, &PreparedView),
    (second, frame): (usize, &PreparedView),
) -> Option<RelativePoseFactor> {
    let start = state.poses[first]?.inverse() * state.poses[second]?;
    let DenseConstraint { reference_from_frame, information, .. } =
        align(reference.view(), frame.view(), start)?;
    Some(RelativePoseFactor { first, second, first_from_second: reference_from_frame, information })
}

/// A frame prepared for alignment.
pub(crate) struct PreparedView {
    pictures: DensePyramid,
    motion: ExposureMotion,
}

impl PreparedView {
    /// `None` for a frame without picture or pose.
    fn new(state: &SfmState, frame: usize) -> Option<Self> {
        let picture = state.pictures.get(frame)?.as_ref()?.picture();
        let camera = camera_of(&state.camera, &picture);
        let interval = median_frame_interval(&state.timestamps)?;
        let around = FrameMotion::new(&state.poses, &state.timestamps, frame, interval);
        let velocity = around.map_or_else(Tangent::zero, |around| around.velocity);
        let registered = |map: &DepthMap| {
            let later = map.timestamp + state.depth_model.delay - state.timestamps[frame];
            let then = pose_later(&state.poses, &state.timestamps, frame, (later, interval));
            let depth_from_colour = state.poses[frame]
                .zip(then)
                .map_or_else(Pose::identity, |(now, then)| then.inverse() * now);
            let scale = camera.fx / state.camera.fx;
            let shift = state.depth_model.shift.map(|v| scale * v);
            register_depth(map.readings().depth(), &camera, shift, &depth_from_colour)
        };
        let depth = state.depth_maps.get(frame).and_then(Option::as_ref).map(registered);
        let motion = ExposureMotion {
            velocity,
            exposure: OPEN_SHARE * interval,
            readout: state.readout * interval,
        };
        Some(Self { pictures: DensePyramid::new(&camera, &picture, depth.as_ref()), motion })
    }

    fn view(&self) -> DenseView<'_> {
        DenseView { pictures: &self.pictures, motion: self.motion }
    }
}

/// The camera of a picture that was halved some times.
fn camera_of(camera: &Camera<f64>, picture: &Image<f32>) -> Camera<f64> {
    let mut small = *camera;
    while small.width > picture.width {
        let (width, height) = (small.width / 2, small.height / 2);
        let [fx, fy, cx, cy] = [small.fx, small.fy, small.cx, small.cy].map(|v| 0.5 * v);
        small = Camera { width, height, fx, fy, cx, cy };
    }
    small
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;
    use crate::track::tracks::Observation;
    use i2slam_geometry::{Rotation, Vec3};

    /// Keyframes while a camera walks on for 60 frames; then it stays where frame 20 was.
    fn walk_and_return() -> SfmState {
        let place = |frame: usize| if frame < 60 { frame } else { 20 };
        let pose = |frame: usize| {
            Pose::new(Rotation::identity(), Vec3::new(0.1 * place(frame) as f64, 0.0, 0.0))
        };
        let observe = |point: Vec3<f64>, frame: usize, _: &[f64]| {
            let (u, v) = fixtures::camera().project(pose(frame).inverse() * point);
            Some([u, v])
        };
        let mut state = fixtures::state((160, 12, 1), [100.0; 2], pose, observe);
        state.tracks.keyframes = (0..60).step_by(5).collect();
        let known = state.by_frame[20].clone();
        let again = |frame: usize| {
            let at = |track: &usize| state.tracks.tracks[*track].observation_in(20).copied();
            let seen = known.iter().filter_map(|track| Some((*track, at(track)?)));
            seen.map(|(track, o)| (track, Observation::whitened(frame, o.at(), *o.whitening())))
                .collect::<Vec<_>>()
        };
        let observations: Vec<_> = (70..160).flat_map(again).collect();
        state.add_observations(observations);
        state
    }

    #[test]
    fn frames_of_a_known_place_are_aligned_to_the_keyframes_that_show_it() {
        let state = walk_and_return();
        let keyframes = state.tracks.keyframes.clone();
        let pairs = pairs(&state, &keyframes);
        let references = |frame: usize| -> Vec<usize> {
            pairs.iter().filter(|(_, f)| *f == frame).map(|(keyframe, _)| *keyframe).collect()
        };
        assert_eq!(references(23), [20, 25]);
        for frame in [100, 159] {
            let found = references(frame);
            assert!(found.len() == 2 && found.contains(&20), "{frame}: {found:?}");
        }
    }

    #[test]
    fn every_pair_is_aligned_once_beside_a_few_keyframes() {
        let state = walk_and_return();
        let pairs = pairs(&state, &state.tracks.keyframes);
        let batches = batches(&pairs);
        let frames = batches.iter().flat_map(|batch| &batch.frames);
        let mut aligned = vec![0; pairs.len()];
        for (frame, places) in frames.clone() {
            places.iter().for_each(|place| aligned[*place] += 1);
            assert!(places.iter().all(|place| pairs[*place].1 == *frame));
        }
        assert_eq!(aligned, vec![1; pairs.len()]);
        assert!(frames.is_sorted_by_key(|(frame, _)| *frame));
        for Batch { frames, keyframes } in &batches {
            let places = frames.iter().flat_map(|(_, places)| places);
            assert!(places.map(|place| pairs[*place].0).all(|k| keyframes.contains(&k)));
            assert!(frames.len() <= MAX_BATCH_FRAMES);
            assert!(keyframes.len() < MAX_BATCH_KEYFRAMES + KEYFRAME_REACH, "{keyframes:?}");
        }
    }
}
