//! Following points from picture to picture.
//!
//! Points begin in keyframes, wherever none is followed, and are looked for backward from there,
//! too. How one point is found again is told in `sight`.

use crate::track::corners::find_corners;
use crate::track::global_translation::find_shift;
use crate::track::patch::{RADIUS, Warp};
use crate::track::point_search::{Anchor, SIGMA, Sight, find};
use crate::track::pyramid::Pyramid;
use crate::track::thumbnail::Look;
use crate::track::tracks::{Observation, Track, Tracks};
use i2slam_compute::median;
use i2slam_geometry::Image;
use rayon::prelude::*;
use std::collections::VecDeque;
use std::sync::Arc;

/// Cells of a picture, each with a point of its own if it shows a corner.
const CELLS: f32 = 800.0;
/// Frames in a row in which a point may be hidden.
const HIDDEN: usize = 3;
/// Correlation below which a keyframe gives a point a new anchor.
const AGED_CORRELATION: f32 = 0.85;
/// A keyframe is due when points have moved by this share of the picture's width, ...
const KEYFRAME_MOTION: f32 = 0.03;
/// ... or when this share of those of the last one is left.
const KEYFRAME_OVERLAP: f32 = 0.7;
/// ... or after so many frames in which they have moved by this share of the width at least.
const KEYFRAME_INTERVAL: usize = 8;
const SLOW_MOTION: f32 = 0.006;
/// Frames before a keyframe in which points that begin there are looked for, too.
const BACKWARD: usize = 16;
/// A keyframe waits for a frame of this share of the usual sharpness, for so many frames.
const SHARP_ENOUGH: f32 = 0.85;
const MAX_WAIT: usize = 3;
/// A picture that shows fewer points is no keyframe: nothing could be posed by it.
const MIN_POINTS: usize = 12;
/// Pictures this unlike their predecessor begin another scene.
const CUT_CORRELATION: f32 = 0.3;

/// A point that is being followed.
#[derive(Clone, Debug)]
struct Point {
    track: usize,
    warp: Warp,
    anchor: Anchor,
    /// Frames since it was last seen for certain.
    hidden: usize,
    /// Whether its place in the last frame is known at least roughly.
    is_near: bool,
    /// Position in the last keyframe.
    at_keyframe: Option<[f32; 2]>,
    correlation: f32,
}

/// Tracking summary of one picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameReport {
    /// Points followed into it.
    pub points: usize,
    /// Their median motion since the last picture [px].
    pub motion: f64,
    /// The picture shows another scene than the one before.
    pub is_cut: bool,
    /// The picture became a keyframe.
    pub is_keyframe: bool,
}

/// Points followed through a sequence.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tracker {
    tracks: Tracks,
    points: Vec<Point>,
    /// The last frames, the newest at the back, each with its move since the one before [px].
    recent: VecDeque<(Pyramid, [f32; 2])>,
    sharpness: Vec<f32>,
    /// Points that the last keyframe had.
    keyframe_points: usize,
    /// Frames for which a keyframe has been due.
    due: usize,
}

impl Tracker {
    /// Follows all points into the next picture.
    pub(crate) fn follow(&mut self, picture: &Image<f32>) -> FrameReport {
        let frame = self.tracks.frames;
        let next = Pyramid::new(picture);
        let mut said =
            FrameReport { points: 0, motion: 0.0, is_cut: false, is_keyframe: frame == 0 };
        let shift = self.find_again(&next, frame, &mut said);
        self.sharpness.push(sharpness(next.finest()));
        said.is_keyframe = frame == 0 || said.is_cut || self.keyframe_is_due(next.finest());
        if said.is_keyframe {
            self.begin_keyframe(&next, frame, shift);
        }
        self.tracks.frames += 1;
        self.recent.push_back((next, shift));
        if self.recent.len() > BACKWARD {
            self.recent.pop_front();
        }
        said
    }

    /// All tracks so far.
    pub(crate) fn finish(self) -> Tracks {
        self.tracks
    }

    /// Follows all points; returns the move of the whole picture [px].
    fn find_again(&mut self, next: &Pyramid, frame: usize, said: &mut FrameReport) -> [f32; 2] {
        let Some((last, _)) = self.recent.back() else { return [0.0; 2] };
        let shift = find_shift(last.coarsest().0, next.coarsest().0);
        let by = shift.by.map(|v| v * last.coarsest().1);
        let look = |p: &Point| find(&p.anchor, p.warp, p.is_near, last, next, by);
        let sights: Vec<Sight> = self.points.par_iter().map(look).collect();
        let mut motions = Vec::new();
        for (point, sight) in self.points.iter_mut().zip(&sights) {
            let from = point.warp.centre;
            (point.is_near, point.warp) = (sight.is_near(), sight.warp());
            let Sight::Certain { correlation, .. } = sight else {
                point.hidden += 1;
                continue;
            };
            let to = point.warp.centre;
            motions.push((to[0] - from[0]).hypot(to[1] - from[1]));
            (point.correlation, point.hidden) = (*correlation, 0);
            self.tracks.tracks[point.track].observations.extend(sight.observation(frame));
        }
        let found = motions.len();
        let is_cut = shift.correlation < CUT_CORRELATION && 3 * found < self.points.len();
        self.points.retain(|p| p.hidden <= HIDDEN && !is_cut);
        *said = FrameReport {
            points: found,
            motion: f64::from(median(&mut motions).unwrap_or(0.0)),
            is_cut,
            is_keyframe: false,
        };
        if is_cut {
            self.recent.clear();
        }
        by
    }

    /// Whether enough has changed, and the picture is sharp enough to start points in.
    fn keyframe_is_due(&mut self, image: &Image<f32>) -> bool {
        let seen = |p: &&Point| p.hidden == 0;
        let moved = |p: &Point| {
            p.at_keyframe.map(|k| (p.warp.centre[0] - k[0]).hypot(p.warp.centre[1] - k[1]))
        };
        let mut motions: Vec<f32> = self.points.iter().filter(seen).filter_map(moved).collect();
        let overlap = motions.len() as f32 / self.keyframe_points.max(1) as f32;
        let motion = median(&mut motions).unwrap_or(f32::INFINITY);
        let width = image.width as f32;
        let last = self.tracks.keyframes.last().copied().unwrap_or(0);
        let late = self.tracks.frames >= last + KEYFRAME_INTERVAL && motion > SLOW_MOTION * width;
        if motion < KEYFRAME_MOTION * width && overlap > KEYFRAME_OVERLAP && !late {
            self.due = 0;
            return false;
        }
        if self.is_empty(image) {
            self.due = 0;
            return false;
        }
        self.due += 1;
        let recent = self.sharpness.len().saturating_sub(15);
        let usual = median(&mut self.sharpness[recent..].to_vec()).unwrap_or(0.0);
        let now = self.sharpness.last().copied().unwrap_or(0.0);
        now >= SHARP_ENOUGH * usual || self.due > MAX_WAIT
    }

    /// Whether a picture shows hardly anything that is followed or could be.
    fn is_empty(&self, image: &Image<f32>) -> bool {
        let followed: Vec<[f32; 2]> =
            self.points.iter().filter(|p| p.hidden == 0).map(|p| p.warp.centre).collect();
        followed.len() < MIN_POINTS
            && followed.len() + new_corners(image, &followed).len() < MIN_POINTS
    }

    /// Gives aged points a new anchor and starts new points where there are none.
    fn begin_keyframe(&mut self, next: &Pyramid, frame: usize, shift: [f32; 2]) {
        self.due = 0;
        self.tracks.keyframes.push(frame);
        Arc::make_mut(&mut self.tracks.looks).push(Look::new(next, frame));
        for point in &mut self.points {
            let is_aged = point.hidden == 0 && point.correlation < AGED_CORRELATION;
            if let Some(anchor) = is_aged.then(|| Anchor::new(next, point.warp.centre)).flatten() {
                (point.anchor, point.warp) = (anchor, Warp::at(point.warp.centre));
            }
        }
        let taken: Vec<[f32; 2]> = self.points.iter().map(|p| p.warp.centre).collect();
        let corners = new_corners(next.finest(), &taken);
        let started: Vec<Option<(Point, Track)>> =
            corners.par_iter().map(|at| self.start(next, *at, frame, shift)).collect();
        for (mut point, track) in started.into_iter().flatten() {
            point.track = self.tracks.tracks.len();
            self.points.push(point);
            self.tracks.tracks.push(track);
        }
        for point in &mut self.points {
            point.at_keyframe = (point.hidden == 0).then_some(point.warp.centre);
        }
        self.keyframe_points = self.points.iter().filter(|p| p.hidden == 0).count();
    }
}

impl Tracker {
    /// A point that begins in `next`, with its sights in the frames before.
    fn start(
        &self,
        next: &Pyramid,
        at: [f32; 2],
        frame: usize,
        shift: [f32; 2],
    ) -> Option<(Point, Track)> {
        let anchor = Anchor::new(next, at)?;
        let mut observations = vec![Observation::new(frame, at.map(f64::from), SIGMA)];
        let (mut warp, mut here, mut by) = (Warp::at(at), next, shift);
        for (i, (before, shift)) in self.recent.iter().rev().enumerate() {
            let sight = find(&anchor, warp, true, here, before, by.map(|v| -v));
            let Some(observation) = sight.observation(frame - 1 - i) else { break };
            observations.push(observation);
            (warp, here, by) = (sight.warp(), before, *shift);
        }
        observations.reverse();
        let point = Point {
            track: 0,
            warp: Warp::at(at),
            anchor,
            hidden: 0,
            is_near: true,
            at_keyframe: None,
            correlation: 1.0,
        };
        Some((point, Track { observations }))
    }
}

/// Where points may begin beside those that are followed.
fn new_corners(image: &Image<f32>, taken: &[[f32; 2]]) -> Vec<[f32; 2]> {
    find_corners(image, cell_size(image), RADIUS + 2, taken)
}

/// Side of the cells of which each gets one point [px]: some 600 points a picture.
fn cell_size(image: &Image<f32>) -> usize {
    (((image.width * image.height) as f32 / CELLS).sqrt() as usize).max(8)
}

/// Mean difference of neighbours, relative to the mean brightness: blur lowers it, exposure hardly.
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
        let (width, height) = (96, 72);
        let data = (0..width * height).map(|i| value(i % width, i / width)).collect();
        Image { width, height, channels: 1, data }
    }

    /// Nothing to follow, black or all but even, makes no keyframes; what comes after does.
    #[test]
    fn pictures_without_points_are_no_keyframes() {
        let wave = |i: usize, j: usize| (0.7 * i as f32).sin() * (0.6 * j as f32).cos();
        let room = picture(|i, j| 0.5 + 0.3 * wave(i, j));
        for spread in [0.0, 0.002] {
            let mut tracker = Tracker::default();
            tracker.follow(&room);
            for seed in 0..40 {
                let n = noise(seed, 96 * 72);
                tracker.follow(&picture(|i, j| spread * (1.0 + n[j * 96 + i] as f32)));
            }
            assert!((0..=MAX_WAIT).any(|_| tracker.follow(&room).is_keyframe));
            let keyframes = tracker.finish().keyframes;
            assert!(keyframes.len() <= 3, "{keyframes:?}");
        }
    }
}
