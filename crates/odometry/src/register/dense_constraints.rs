//! Dense constraints: relative poses of frames and keyframes by alignment of picture and depth.
//!
//! Points use a few hundred pixels of a picture. Where depth is exact, all of them together locate a
//! frame several times as well; where it is not, the information of the alignment says so.

use crate::alignment::{DenseConstraint, DensePyramid, DenseView, ExposureMotion, align};
use crate::bundle::RelativePoseFactor;
use crate::depth::depth_map::DepthMap;
use crate::depth::registration::register_depth;
use crate::progress::Stage;
use crate::rolling_shutter::readout::{camera_velocity, median_frame_interval};
use crate::sfm_state::SfmState;
use i2slam_geometry::{Camera, Image, Pose, Tangent};
use rayon::prelude::*;
use std::collections::VecDeque;
use std::fmt::{self, Debug, Formatter};
use std::ops::Range;
use std::sync::Arc;

/// Keyframes before and after one that it is aligned to.
const KEYFRAME_REACH: usize = 3;
/// Keyframes to which a new one is aligned when it comes.
pub(crate) const RECENT_KEYFRAMES: usize = 1;
/// Share of the frame interval for which the shutter is taken to be open: the difference of the
/// blur of two pictures is a small correction.
const OPEN_SHARE: f64 = 0.5;
/// Frames from the first keyframe on whose prepared pictures are kept at once, some 50 bytes per
/// pixel each.
const MAX_PART_FRAMES: usize = 24;

/// Aligns all frames to the keyframes around them.
pub(crate) fn add_dense_constraints(state: &mut SfmState) {
    if !state.is_metric() || state.pictures.is_empty() {
        return;
    }
    state.progress.report(Stage::BundleAdjustment, 0, 0);
    let keyframes: Vec<usize> =
        state.tracks.keyframes.iter().copied().filter(|f| state.poses[*f].is_some()).collect();
    let mut found = Vec::new();
    for part in parts(&keyframes) {
        found.extend(constraints(state, &keyframes, part));
    }
    state.relative_poses = Arc::new(found);
}

/// Runs of keyframes, by place, whose frames are prepared together.
fn parts(keyframes: &[usize]) -> Vec<Range<usize>> {
    let (mut out, mut begin) = (Vec::new(), 0);
    for place in 1..=keyframes.len() {
        let is_full = |next: &usize| next - keyframes[begin] >= MAX_PART_FRAMES;
        if keyframes.get(place).is_none_or(is_full) {
            out.push(begin..place);
            begin = place;
        }
    }
    out
}

/// Constraints of a run of keyframes, in order; every frame around them is prepared once.
fn constraints(
    state: &SfmState,
    keyframes: &[usize],
    part: Range<usize>,
) -> Vec<RelativePoseFactor> {
    let pairs: Vec<(usize, usize)> = part
        .flat_map(|place| {
            let frames = frames_around(keyframes, place, state.poses.len());
            frames.into_iter().map(move |frame| (keyframes[place], frame))
        })
        .collect();
    let mut frames: Vec<usize> = pairs.iter().flat_map(|(a, b)| [*a, *b]).collect();
    frames.sort_unstable();
    frames.dedup();
    let views: Vec<Option<PreparedView>> =
        frames
            .par_iter()
            .map(|frame| {
                if state.progress.is_cancelled() { None } else { PreparedView::new(state, *frame) }
            })
            .collect();
    let view = |frame: usize| views[frames.binary_search(&frame).ok()?].as_ref();
    let found: Vec<Option<RelativePoseFactor>> = pairs
        .par_iter()
        .map(|(reference, frame)| {
            if state.progress.is_cancelled() {
                return None;
            }
            constraint(state, (*reference, view(*reference)?), (*frame, view(*frame)?))
        })
        .collect();
    found.into_iter().flatten().collect()
}

/// Frames between the keyframes before and after one, and a few keyframes after it.
fn frames_around(keyframes: &[usize], place: usize, frames: usize) -> Vec<usize> {
    let before = place.checked_sub(1).map_or(0, |place| keyframes[place] + 1);
    let after = keyframes.get(place + 1).copied().unwrap_or(frames);
    let near = (before..after).filter(|frame| *frame != keyframes[place]);
    let later = keyframes.iter().skip(place + 1).take(KEYFRAME_REACH).copied();
    near.chain(later).collect()
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
        let velocity = camera_velocity(&state.poses, &state.timestamps, frame, interval);
        let velocity = velocity.unwrap_or_else(Tangent::zero);
        let registered = |map: &DepthMap| {
            let later = map.timestamp + state.depth_model.delay - state.timestamps[frame];
            let colour_from_depth = Pose::identity().retract(velocity.scaled(later));
            let scale = camera.fx / state.camera.fx;
            let shift = state.depth_model.shift.map(|v| scale * v);
            register_depth(&map.depth, &camera, shift, &colour_from_depth.inverse())
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
