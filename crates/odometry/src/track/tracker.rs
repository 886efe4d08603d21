//! Tracks points through a sequence, also backward from their first keyframe; chooses keyframes.

pub(crate) mod predicted_points;
mod resumption;

use crate::track::corners::detect_corners;
use crate::track::global_translation::estimate_global_translation;
use crate::track::motion_blur::{EqualBlur, SHARES, ShutterShare};
use crate::track::patch::{AffineWarp, RADIUS};
use crate::track::point_search::{
    AnchorPatch, FollowedPoint, TrackOutcome, follow_point, search_point,
};
use crate::track::pyramid::Pyramid;
use crate::track::thumbnail::KeyframeImage;
use crate::track::tracks::{Observation, Track};
use i2slam_compute::median;
use i2slam_geometry::Image;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

/// Cells of a picture, each with one point if it has a corner.
const MAX_CORNERS: f32 = 800.0;
/// Consecutive frames in which a point may be missing.
const MAX_HIDDEN_FRAMES: usize = 3;
/// Correlation below which a keyframe gives a point a new anchor.
const REANCHOR_CORRELATION: f32 = 0.85;
/// A keyframe is due when points have moved by this ratio of the picture's width, ...
pub(crate) const KEYFRAME_DUE_MOTION: f32 = 0.03;
/// ... or when this ratio of the last keyframe's points is left, ...
pub(crate) const KEYFRAME_DUE_OVERLAP: f32 = 0.7;
/// ... or after so many frames in which points have moved by this ratio of the width.
pub(crate) const KEYFRAME_INTERVAL: usize = 8;
pub(crate) const MIN_KEYFRAME_MOTION: f32 = 0.006;
/// Frames before a keyframe through which its new points are tracked backward.
pub(crate) const BACKWARD_FRAMES: usize = 16;
/// A keyframe waits for a frame of this ratio of the median sharpness that is not held out, for so many
/// frames.
const MIN_KEYFRAME_SHARPNESS: f32 = 0.85;
const MAX_KEYFRAME_DELAY: usize = 3;
/// Last keyframes whose pictures are kept, whether points are followed from them or not.
const KEPT_KEYFRAMES: usize = 8;
/// Pictures whose median sharpness is the usual one.
const SHARPNESS_FRAMES: usize = 15;
/// Smallest side of a cell [px].
const MIN_CELL: usize = 8;
/// Points that a keyframe must show: with fewer it could not be registered.
const MIN_POINTS: usize = 12;
/// Correlation of consecutive pictures below which the scene has changed.
const CUT_CORRELATION: f32 = 0.3;
/// Movement of the picture from which on its blur tells the shutter's share [px], and points needed.
const MIN_SHUTTER_MOTION: f32 = 4.0;
const MIN_SHUTTER_POINTS: usize = 24;

/// A point being tracked.
#[derive(Clone, Debug)]
struct TrackedPoint {
    track: usize,
    warp: AffineWarp,
    anchor: AnchorPatch,
    /// Keyframe of the anchor.
    anchor_frame: usize,
    /// Frames since the last measurement.
    hidden_frames: usize,
    /// Whether its position in the last frame is a real one, not an extrapolation.
    is_followed: bool,
    /// Position in the last keyframe.
    at_keyframe: Option<[f32; 2]>,
    correlation: f32,
}

/// A tracked picture.
#[derive(Clone, Debug)]
struct TrackedPicture {
    pyramid: Arc<Pyramid>,
    /// Translation since the picture before [px].
    shift: [f32; 2],
    /// Movement while the shutter was open [px].
    blur: [f32; 2],
}

/// Tracking result of one picture. The index of a track is the number of tracks that began before it.
#[derive(Clone, Debug, Default)]
pub(crate) struct TrackedFrame {
    /// The picture shows another scene than the one before.
    pub(crate) is_cut: bool,
    /// Number of points that were seen in the picture before.
    pub(crate) seen_before: usize,
    /// Observations in the picture of tracks that began before it.
    pub(crate) observed: Vec<(usize, Observation)>,
    /// Tracks that begin with it, with their observations in the frames before.
    pub(crate) started: Vec<Track>,
    /// The picture in small, if it became a keyframe.
    pub(crate) keyframe: Option<Arc<KeyframeImage>>,
}

/// Tracker of points through a sequence.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tracker {
    /// Number of pictures, and of tracks.
    pub(crate) frames: usize,
    tracks: usize,
    points: Vec<TrackedPoint>,
    /// Last frames, newest at the back.
    recent: VecDeque<TrackedPicture>,
    /// Keyframes of the points' anchors.
    anchors: BTreeMap<usize, TrackedPicture>,
    shutter: ShutterShare,
    /// Sharpness of the last [`SHARPNESS_FRAMES`] pictures.
    sharpness: VecDeque<f32>,
    /// The last frame from which points began, points there, and the first track that began in it.
    last_keyframe: usize,
    keyframe_points: usize,
    first_new_track: usize,
    /// Frames for which a keyframe has been due.
    frames_due: usize,
}

impl Tracker {
    /// Tracks all points into the next picture. One that is held out of maps becomes a keyframe only as the
    /// first, after a cut, or where one has been due for [`MAX_KEYFRAME_DELAY`] pictures.
    pub(crate) fn track(&mut self, picture: &Image<f32>, is_held_out: bool) -> TrackedFrame {
        let frame = self.frames;
        let pyramid = Arc::new(Pyramid::new(picture));
        let mut next = TrackedPicture { pyramid, shift: [0.0; 2], blur: [0.0; 2] };
        let mut tracked = self.track_points(&mut next, frame);
        let image = next.pyramid.finest();
        self.sharpness.push_back(sharpness(image));
        if self.sharpness.len() > SHARPNESS_FRAMES {
            self.sharpness.pop_front();
        }
        if frame == 0 || tracked.is_cut || self.keyframe_is_due(image, is_held_out) {
            tracked.started = self.begin_keyframe(&next, frame);
            tracked.keyframe = Some(Arc::new(KeyframeImage::new(&next.pyramid, frame)));
        }
        self.frames += 1;
        self.recent.push_back(next);
        if self.recent.len() > BACKWARD_FRAMES {
            self.recent.pop_front();
        }
        tracked
    }

    /// The last picture.
    pub(crate) fn last_picture(&self) -> Option<&Arc<Pyramid>> {
        self.recent.back().map(|picture| &picture.pyramid)
    }

    /// Tracks all points, and finds translation and blur of the picture.
    fn track_points(&mut self, next: &mut TrackedPicture, frame: usize) -> TrackedFrame {
        let mut tracked = TrackedFrame::default();
        let Some(last) = self.recent.back() else { return tracked };
        let (coarse, scale) = last.pyramid.coarsest();
        let (translation, correlation) =
            estimate_global_translation(coarse, next.pyramid.coarsest().0);
        next.shift = translation.map(|v| v * scale);
        let pair = [last.pyramid.as_ref(), next.pyramid.as_ref()];
        let follow = |p: &TrackedPoint| follow_point(p.warp, p.is_followed, pair, next.shift);
        let followed: Vec<FollowedPoint> = self.points.par_iter().map(follow).collect();
        tracked.seen_before = self.points.iter().filter(|p| p.hidden_frames == 0).count();
        let motion = self.picture_motion(&followed).unwrap_or(next.shift);
        if motion[0].hypot(motion[1]) >= MIN_SHUTTER_MOTION {
            self.compare_shutter_shares(&followed, &next.pyramid, motion);
        }
        next.blur = motion.map(|v| v * self.shutter.value());
        let outcomes = self.search_points(&followed, next);
        for (point, outcome) in self.points.iter_mut().zip(&outcomes) {
            (point.is_followed, point.warp) = (outcome.is_followed, outcome.warp);
            let Some(correlation) = outcome.correlation() else {
                point.hidden_frames += 1;
                continue;
            };
            (point.correlation, point.hidden_frames) = (correlation, 0);
            tracked.observed.extend(outcome.observation(frame).map(|o| (point.track, o)));
        }
        // Both tests must agree: a flash spoils the correlation, fast motion loses points.
        let is_cut =
            correlation < CUT_CORRELATION && 3 * tracked.observed.len() < self.points.len();
        self.points.retain(|p| p.hidden_frames <= MAX_HIDDEN_FRAMES && !is_cut);
        if is_cut {
            self.recent.clear();
        }
        TrackedFrame { is_cut, ..tracked }
    }

    /// Compares the anchors of all followed points with the next picture.
    fn search_points(
        &self,
        followed: &[FollowedPoint],
        next: &TrackedPicture,
    ) -> Vec<TrackOutcome> {
        let equal: BTreeMap<usize, EqualBlur> =
            self.anchors.iter().map(|(frame, anchor)| (*frame, anchor.equal_blur(next))).collect();
        let search = |(p, followed): (&TrackedPoint, &FollowedPoint)| {
            let equal = equal.get(&p.anchor_frame).unwrap_or(&EqualBlur::AsTheyAre);
            search_point(&p.anchor, p.warp, followed, &next.pyramid, equal)
        };
        self.points.par_iter().zip(followed).map(search).collect()
    }

    /// Median movement of the points that were followed [px]; `None` for few.
    fn picture_motion(&self, followed: &[FollowedPoint]) -> Option<[f32; 2]> {
        let moved = |(p, f): (&TrackedPoint, &FollowedPoint)| {
            let at = f.found?.warp.centre;
            Some([at[0] - p.warp.centre[0], at[1] - p.warp.centre[1]])
        };
        let all: Vec<[f32; 2]> = self.points.iter().zip(followed).filter_map(moved).collect();
        let along = |i: usize| median(&mut all.iter().map(|m| m[i]).collect::<Vec<_>>());
        (all.len() >= MIN_POINTS).then_some([along(0)?, along(1)?])
    }

    /// Compares the points of the sharpest keyframe with a picture that has moved by `motion` [px],
    /// for every share of the shutter.
    fn compare_shutter_shares(
        &mut self,
        followed: &[FollowedPoint],
        next: &Pyramid,
        motion: [f32; 2],
    ) {
        let all = || self.points.iter().zip(followed).filter(|(_, f)| f.found.is_some());
        let has_points = |(frame, _): &(&usize, &TrackedPicture)| {
            all().filter(|(p, _)| p.anchor_frame == **frame).count() >= MIN_SHUTTER_POINTS
        };
        let sharpest = self
            .anchors
            .iter()
            .filter(has_points)
            .min_by(|a, b| a.1.blur_length().total_cmp(&b.1.blur_length()));
        let Some((frame, anchor)) = sharpest else { return };
        let points: Vec<_> = all().filter(|(p, _)| p.anchor_frame == *frame).collect();
        let correlations = SHARES.map(|share| {
            let blur = motion.map(|v| v * share);
            let equal = EqualBlur::new((&anchor.pyramid, anchor.blur), (next, blur));
            let search = |(p, followed): &(&TrackedPoint, &FollowedPoint)| {
                let outcome = search_point(&p.anchor, p.warp, followed, next, &equal);
                f64::from(outcome.correlation().unwrap_or(0.0))
            };
            let found: Vec<f64> = points.par_iter().map(search).collect();
            found.iter().sum::<f64>() / points.len() as f64
        });
        self.shutter.add(correlations);
    }

    /// True if enough has changed, and the picture is sharp enough to start points in and not held out.
    fn keyframe_is_due(&mut self, image: &Image<f32>, is_held_out: bool) -> bool {
        let is_measured = |p: &&TrackedPoint| p.hidden_frames == 0;
        let moved = |p: &TrackedPoint| {
            p.at_keyframe.map(|k| (p.warp.centre[0] - k[0]).hypot(p.warp.centre[1] - k[1]))
        };
        let mut motions: Vec<f32> =
            self.points.iter().filter(is_measured).filter_map(moved).collect();
        let overlap = motions.len() as f32 / self.keyframe_points.max(1) as f32;
        let motion = median(&mut motions).unwrap_or(f32::INFINITY);
        let width = image.width as f32;
        let is_late = self.frames >= self.last_keyframe + KEYFRAME_INTERVAL
            && motion > MIN_KEYFRAME_MOTION * width;
        if motion < KEYFRAME_DUE_MOTION * width && overlap > KEYFRAME_DUE_OVERLAP && !is_late {
            self.frames_due = 0;
            return false;
        }
        if self.is_textureless(image) {
            self.frames_due = 0;
            return false;
        }
        self.frames_due += 1;
        let usual = median(&mut Vec::from_iter(self.sharpness.iter().copied())).unwrap_or(0.0);
        let now = self.sharpness.back().copied().unwrap_or(0.0);
        let is_good = now >= MIN_KEYFRAME_SHARPNESS * usual && !is_held_out;
        is_good || self.frames_due > MAX_KEYFRAME_DELAY
    }

    /// Whether a picture has too few points and corners for a keyframe.
    fn is_textureless(&self, image: &Image<f32>) -> bool {
        let followed: Vec<[f32; 2]> =
            self.points.iter().filter(|p| p.hidden_frames == 0).map(|p| p.warp.centre).collect();
        followed.len() < MIN_POINTS
            && followed.len() + new_corners(image, &followed).len() < MIN_POINTS
    }

    /// Gives points that have changed a new anchor and starts points in empty cells; returns the
    /// tracks of those.
    fn begin_keyframe(&mut self, next: &TrackedPicture, frame: usize) -> Vec<Track> {
        (self.frames_due, self.last_keyframe) = (0, frame);
        self.first_new_track = self.tracks;
        for point in &mut self.points {
            let is_aged = point.hidden_frames == 0 && point.correlation < REANCHOR_CORRELATION;
            if let Some(anchor) =
                is_aged.then(|| AnchorPatch::new(&next.pyramid, point.warp.centre)).flatten()
            {
                (point.anchor, point.warp) = (anchor, AffineWarp::translation(point.warp.centre));
                point.anchor_frame = frame;
            }
        }
        let taken: Vec<[f32; 2]> = self.points.iter().map(|p| p.warp.centre).collect();
        let corners = new_corners(next.pyramid.finest(), &taken);
        let equal: Vec<EqualBlur> =
            self.recent.par_iter().rev().map(|before| next.equal_blur(before)).collect();
        let start = |at: &[f32; 2]| self.start_point(next, *at, frame, &equal);
        let started: Vec<Option<(TrackedPoint, Track)>> = corners.par_iter().map(start).collect();
        let mut tracks = Vec::new();
        for (point, track) in started.into_iter().flatten() {
            self.points.push(TrackedPoint { track: self.tracks, ..point });
            self.tracks += 1;
            tracks.push(track);
        }
        self.anchors.insert(frame, next.clone());
        self.end_keyframe();
        tracks
    }

    /// Distance along either axis within which two points are not both followed: half a cell [px].
    fn nearest_distance(&self) -> f32 {
        let half = self.recent.back().map_or(0, |last| cell_size(last.pyramid.finest()) / 2);
        half.max(MIN_CELL / 2) as f32
    }

    /// Starts to measure motion and overlap from the last keyframe, and drops anchors without points.
    fn end_keyframe(&mut self) {
        for point in &mut self.points {
            point.at_keyframe = (point.hidden_frames == 0).then_some(point.warp.centre);
        }
        self.keyframe_points = self.points.iter().filter(|p| p.hidden_frames == 0).count();
        let used: BTreeSet<usize> = self.points.iter().map(|p| p.anchor_frame).collect();
        let last = self.anchors.keys().rev().nth(KEPT_KEYFRAMES).copied();
        self.anchors.retain(|frame, _| used.contains(frame) || Some(*frame) > last);
    }

    /// A point that begins in `next`, with its observations in the frames before, newest first in
    /// `equal`.
    fn start_point(
        &self,
        next: &TrackedPicture,
        at: [f32; 2],
        frame: usize,
        equal: &[EqualBlur],
    ) -> Option<(TrackedPoint, Track)> {
        let anchor = AnchorPatch::new(&next.pyramid, at)?;
        let mut observations =
            vec![Observation::whitened(frame, at.map(f64::from), anchor.whitening())];
        let (mut warp, mut here) = (AffineWarp::translation(at), next);
        for (i, (before, equal)) in self.recent.iter().rev().zip(equal).enumerate() {
            let pair = [here.pyramid.as_ref(), before.pyramid.as_ref()];
            let followed = follow_point(warp, true, pair, here.shift.map(|v| -v));
            let outcome = search_point(&anchor, warp, &followed, &before.pyramid, equal);
            let Some(observation) = outcome.observation(frame - 1 - i) else { break };
            observations.push(observation);
            (warp, here) = (outcome.warp, before);
        }
        observations.reverse();
        Some((TrackedPoint::new(0, at, anchor, frame), Track { observations }))
    }
}

impl TrackedPoint {
    /// A point of a track whose anchor is at a position of a frame.
    fn new(track: usize, at: [f32; 2], anchor: AnchorPatch, anchor_frame: usize) -> Self {
        Self {
            track,
            warp: AffineWarp::translation(at),
            anchor,
            anchor_frame,
            hidden_frames: 0,
            is_followed: true,
            at_keyframe: None,
            correlation: 1.0,
        }
    }
}

impl TrackedPicture {
    /// Length of the blur [px].
    fn blur_length(&self) -> f32 {
        self.blur[0].hypot(self.blur[1])
    }

    /// This picture as the first and another one as the second, with equal blur.
    fn equal_blur(&self, other: &Self) -> EqualBlur {
        EqualBlur::new((&self.pyramid, self.blur), (&other.pyramid, other.blur))
    }
}

/// True if two positions differ by less than `near` along both axes.
fn is_near(a: [f32; 2], b: [f32; 2], near: f32) -> bool {
    (a[0] - b[0]).abs() < near && (a[1] - b[1]).abs() < near
}

/// Corners in cells without a tracked point; some 600 of 800 cells have one.
fn new_corners(image: &Image<f32>, taken: &[[f32; 2]]) -> Vec<[f32; 2]> {
    detect_corners(image, cell_size(image), RADIUS + 2, taken)
}

/// Side of a cell [px].
fn cell_size(image: &Image<f32>) -> usize {
    (((image.width * image.height) as f32 / MAX_CORNERS).sqrt() as usize).max(MIN_CELL)
}

/// Mean difference of neighbours over brightness: lowered by blur, hardly by exposure.
fn sharpness(image: &Image<f32>) -> f32 {
    let differences: f32 = image
        .data
        .chunks_exact(image.width)
        .map(|row| row.windows(2).map(|p| (p[1] - p[0]).abs()).sum::<f32>())
        .sum();
    differences / image.data.iter().sum::<f32>().max(1e-6)
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::noise;

    fn picture(value: impl Fn(usize, usize) -> f32) -> Image<f32> {
        Image::from_fn(96, 72, 1, |_, column, row| value(column, row))
    }

    /// Black or nearly even pictures make no keyframes; the next textured one does.
    #[test]
    fn pictures_without_points_are_no_keyframes() {
        let wave = |i: usize, j: usize| (0.7 * i as f32).sin() * (0.6 * j as f32).cos();
        let room = picture(|i, j| 0.5 + 0.3 * wave(i, j));
        for spread in [0.0, 0.002] {
            let mut tracker = Tracker::default();
            let mut is_keyframe =
                |picture: &Image<f32>| tracker.track(picture, false).keyframe.is_some();
            assert!(is_keyframe(&room));
            let of_noise = |seed| {
                let n = noise(seed, 96 * 72);
                picture(|i, j| spread * (1.0 + n[j * 96 + i] as f32))
            };
            let keyframes = (0..40).filter(|seed| is_keyframe(&of_noise(*seed))).count();
            assert!(keyframes <= 1, "{keyframes}");
            assert!((0..=MAX_KEYFRAME_DELAY).any(|_| is_keyframe(&room)));
        }
    }

    /// Of pictures that move, those held out are keyframes only where all are.
    #[test]
    fn pictures_that_are_held_out_are_no_keyframes() {
        let wave = |i: f32, j: f32| (0.7 * i).sin() * (0.6 * j).cos() + (0.23 * i + 0.31 * j).sin();
        let keyframes = |is_held_out: &dyn Fn(usize) -> bool| -> Vec<usize> {
            let mut tracker = Tracker::default();
            let mut is_keyframe = |number: usize| {
                let moved = 2.0 * number as f32;
                let picture = picture(|i, j| 0.5 + 0.15 * wave(i as f32 + moved, j as f32));
                tracker.track(&picture, is_held_out(number)).keyframe.is_some()
            };
            (0..40).filter(|number| is_keyframe(*number)).collect()
        };
        let (free, even) = (keyframes(&|_| false), keyframes(&|number| number % 2 == 0));
        assert!(free[1..].iter().any(|number| number % 2 == 0), "{free:?}");
        assert!(even[1..].iter().all(|number| number % 2 == 1), "{even:?}");
        assert!(2 * even.len() > free.len(), "{free:?} {even:?}");
        let last = keyframes(&|number| number > 0);
        assert!(last.len() > 2 && last.len() <= free.len(), "{free:?} {last:?}");
    }
}
