//! Points of earlier keyframes that are searched in the last picture where a map predicts them.

use super::{MIN_CELL, TrackedPicture, TrackedPoint, Tracker, cell_size};
use crate::track::motion_blur::EqualBlur;
use crate::track::patch::AffineWarp;
use crate::track::point_search::{AnchorPatch, FollowedPoint, TrackOutcome, search_point};
use crate::track::tracks::Observation;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// A point of a keyframe where a map predicts it in the last picture.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PredictedPoint {
    pub(crate) track: usize,
    /// Keyframe, and position there [px].
    pub(crate) keyframe: usize,
    pub(crate) at: [f32; 2],
    /// Warp of its surroundings from there into the last picture.
    pub(crate) warp: AffineWarp,
}

/// A predicted point that was found.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FoundPoint {
    pub(crate) point: PredictedPoint,
    pub(crate) outcome: TrackOutcome,
    pub(crate) observation: Observation,
}

impl Tracker {
    /// Keyframes whose pictures are kept, in order, each with the length of its blur [px].
    pub(crate) fn kept_keyframes(&self) -> impl Iterator<Item = (usize, f32)> {
        self.anchors.iter().map(|(frame, picture)| (*frame, picture.blur_length()))
    }

    /// Translation of the picture over the last `frames` [px]; `None` where it is not known any more.
    pub(crate) fn translation_over(&self, frames: usize) -> Option<[f32; 2]> {
        let first = self.recent.len().checked_sub(frames)?;
        let shifts = self.recent.range(first..).map(|picture| picture.shift);
        Some(shifts.fold([0.0; 2], |sum, shift| [sum[0] + shift[0], sum[1] + shift[1]]))
    }

    /// Searches the last picture for points where they are predicted; those found within `most` [px] of there.
    ///
    /// A patch agrees with a smear of itself anywhere between the ends, and blur is known roughly: to the
    /// deviation of a position comes that of a place within the smear by which the pictures differ.
    pub(crate) fn search_predicted(&self, points: &[PredictedPoint], most: f32) -> Vec<FoundPoint> {
        let Some(last) = self.recent.back() else { return Vec::new() };
        let compare = |(frame, keyframe): (&usize, &TrackedPicture)| {
            let smear = (last.blur_length().powi(2) - keyframe.blur_length().powi(2)).abs().sqrt();
            (*frame, (keyframe.equal_blur(last), f64::from(smear) / 12_f64.sqrt()))
        };
        let equal: BTreeMap<usize, (EqualBlur, f64)> = self.anchors.iter().map(compare).collect();
        let search = |point: &PredictedPoint| {
            let (equal, sigma) = equal.get(&point.keyframe)?;
            let anchor = self.anchor(point)?;
            let predicted = FollowedPoint::predicted(point.warp.centre);
            let outcome = search_point(&anchor, point.warp, &predicted, &last.pyramid, equal);
            let found = outcome.observation(self.frames - 1)?;
            let observation = found.with_sigma(found.sigma().hypot(*sigma));
            let [x, y] = [0, 1].map(|i| outcome.warp.centre[i] - point.warp.centre[i]);
            (x.hypot(y) < most).then_some(FoundPoint { point: *point, outcome, observation })
        };
        points.par_iter().filter_map(search).collect()
    }

    /// Follows points on from where they were found in the last picture, in place of those near them that
    /// began in the last keyframe, and no longer follows the tracks that went astray.
    pub(crate) fn follow_found(&mut self, found: &[FoundPoint], astray: &[usize]) {
        let Some(last) = self.recent.back() else { return };
        let near = (cell_size(last.pyramid.finest()) / 2).max(MIN_CELL / 2) as f32;
        let is_near =
            |a: [f32; 2], b: [f32; 2]| (a[0] - b[0]).abs() < near && (a[1] - b[1]).abs() < near;
        let replaced: BTreeSet<usize> =
            found.iter().map(|f| f.point.track).chain(astray.iter().copied()).collect();
        let is_replaced = |p: &TrackedPoint| {
            let is_new = p.track >= self.first_new_track;
            let is_found = || found.iter().any(|f| is_near(f.outcome.warp.centre, p.warp.centre));
            replaced.contains(&p.track) || (is_new && is_found())
        };
        let stay = self.points.iter().filter(|p| !is_replaced(p)).cloned();
        let again = |found: &FoundPoint| {
            let FoundPoint { point, outcome, .. } = found;
            let began =
                TrackedPoint::new(point.track, point.at, self.anchor(point)?, point.keyframe);
            let correlation = outcome.correlation?;
            Some(TrackedPoint { warp: outcome.warp, correlation, ..began })
        };
        self.points = stay.chain(found.iter().filter_map(again)).collect();
    }

    /// The patch of a point in its keyframe.
    fn anchor(&self, point: &PredictedPoint) -> Option<AnchorPatch> {
        AnchorPatch::new(&self.anchors.get(&point.keyframe)?.pyramid, point.at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::moved_blobs;
    use i2slam_geometry::Image;

    #[test]
    fn points_are_found_near_their_predictions_and_followed_on() {
        let mut tracker = Tracker::default();
        let first = tracker.track(&moved_blobs(0.0), false).started;
        for _ in 0..5 {
            tracker.track(&Image::new(96, 72, 1), false);
        }
        tracker.track(&moved_blobs(20.0), false);
        let predicted = |off: f32| -> Vec<PredictedPoint> {
            let point = |(track, began): (usize, &crate::track::tracks::Track)| {
                let at = began.observations[0].raw().map(|v| v as f32);
                let warp = AffineWarp::translation([at[0] + 20.0 + off, at[1]]);
                PredictedPoint { track, keyframe: 0, at, warp }
            };
            first.iter().enumerate().map(point).filter(|p| p.warp.centre[0] < 85.0).collect()
        };
        let points = predicted(2.0);
        let found = tracker.search_predicted(&points, 4.0);
        assert!(10 * found.len() > 7 * points.len(), "{} of {}", found.len(), points.len());
        for f in &found {
            let [x, y] = f.observation.raw();
            let off = [x - f64::from(f.point.at[0]) - 20.0, y - f64::from(f.point.at[1])];
            assert!(off[0].hypot(off[1]) < 0.1, "{off:?}");
        }
        let by_chance = tracker.search_predicted(&predicted(12.0), 4.0).len();
        assert!(5 * by_chance < found.len(), "{by_chance} of {}", found.len());
        tracker.follow_found(&found[1..], &[found[0].point.track]);
        let next = tracker.track(&moved_blobs(20.5), false).observed;
        let follows = |track: usize| next.iter().any(|(t, _)| *t == track);
        assert!(!follows(found[0].point.track));
        let followed = found[1..].iter().filter(|f| follows(f.point.track)).count();
        assert!(10 * followed > 9 * (found.len() - 1), "{followed} of {}", found.len());
    }
}
