//! Points of earlier keyframes that are searched in the last picture where a map predicts them.

use super::{TrackedPicture, TrackedPoint, Tracker, is_near};
use crate::multiview::whitening::Whitening;
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
    /// Keyframe, and the position that was measured there [px].
    pub(crate) keyframe: usize,
    pub(crate) at_keyframe: [f32; 2],
    /// Warp of its surroundings from there into the last picture, where its centre is predicted.
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

    /// Translation of the picture over the last `frames` [px]; `None` beyond a cut or the kept pictures.
    pub(crate) fn translation_over(&self, frames: usize) -> Option<[f32; 2]> {
        // The first picture after a cut is moved against another scene.
        let first = self.recent.len().checked_sub(frames).filter(|first| *first > 0)?;
        let shifts = self.recent.range(first..).map(|picture| picture.shift);
        Some(shifts.fold([0.0; 2], |sum, shift| [sum[0] + shift[0], sum[1] + shift[1]]))
    }

    /// Searches the last picture for points where they are predicted; those found within `most` [px] of there.
    ///
    /// A patch agrees with a smear of itself anywhere between the ends, and blur is known roughly: to the
    /// deviation of a position comes that of a place within the smear by which the pictures differ.
    pub(crate) fn search_predicted(&self, points: &[PredictedPoint], most: f32) -> Vec<FoundPoint> {
        let Some(last) = self.recent.back().filter(|_| !points.is_empty()) else {
            return Vec::new();
        };
        let used: BTreeSet<usize> = points.iter().map(|point| point.keyframe).collect();
        let compare = |(frame, keyframe): (&usize, &TrackedPicture)| {
            let smear = (last.blur_length().powi(2) - keyframe.blur_length().powi(2)).abs().sqrt();
            (*frame, (keyframe.equal_blur(last), f64::from(smear) / 12_f64.sqrt()))
        };
        let shown = self.anchors.iter().filter(|(frame, _)| used.contains(frame));
        let equal: BTreeMap<usize, (EqualBlur, f64)> = shown.map(compare).collect();
        let search = |point: &PredictedPoint| {
            let (equal, smear_sigma) = equal.get(&point.keyframe)?;
            let anchor = self.anchor(point)?;
            let predicted = FollowedPoint::not_followed(point.warp.centre);
            let outcome = search_point(&anchor, point.warp, &predicted, &last.pyramid, equal);
            let found = outcome.observation(self.frames - 1)?;
            let observation = found.with_added_error(&Whitening::isotropic(*smear_sigma));
            let [x, y] = [0, 1].map(|i| outcome.warp.centre[i] - point.warp.centre[i]);
            (x.hypot(y) < most).then_some(FoundPoint { point: *point, outcome, observation })
        };
        points.par_iter().filter_map(search).collect()
    }

    /// Follows points on from where they were found in the last picture, in place of those near them that
    /// began there, if it is a keyframe, and no longer follows the tracks that went astray.
    pub(crate) fn follow_found(&mut self, found: &[FoundPoint], astray: &[usize]) {
        let near = self.nearest_distance();
        let replaced: BTreeSet<usize> =
            found.iter().map(|f| f.point.track).chain(astray.iter().copied()).collect();
        let is_keyframe = self.last_keyframe + 1 == self.frames;
        let is_replaced = |p: &TrackedPoint| {
            let is_new = is_keyframe && p.track >= self.first_new_track;
            let is_found =
                || found.iter().any(|f| is_near(f.outcome.warp.centre, p.warp.centre, near));
            replaced.contains(&p.track) || (is_new && is_found())
        };
        let stay = self.points.iter().filter(|p| !is_replaced(p)).cloned();
        let again = |found: &FoundPoint| {
            let FoundPoint { point, outcome, .. } = found;
            let at = point.at_keyframe;
            let began = TrackedPoint::new(point.track, at, self.anchor(point)?, point.keyframe);
            let correlation = outcome.correlation()?;
            let at_keyframe = (point.keyframe == self.last_keyframe).then_some(at);
            Some(TrackedPoint { warp: outcome.warp, correlation, at_keyframe, ..began })
        };
        self.points = stay.chain(found.iter().filter_map(again)).collect();
        if is_keyframe {
            self.end_keyframe();
        }
    }

    /// The patch of a point in its keyframe.
    fn anchor(&self, point: &PredictedPoint) -> Option<AnchorPatch> {
        AnchorPatch::new(&self.anchors.get(&point.keyframe)?.pyramid, point.at_keyframe)
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
                let at_keyframe @ [x, y] = began.observations[0].raw().map(|v| v as f32);
                let warp = AffineWarp::translation([x + 20.0 + off, y]);
                PredictedPoint { track, keyframe: 0, at_keyframe, warp }
            };
            first.iter().enumerate().map(point).filter(|p| p.warp.centre[0] < 85.0).collect()
        };
        let points = predicted(2.0);
        let found = tracker.search_predicted(&points, 4.0);
        assert!(10 * found.len() > 7 * points.len(), "{} of {}", found.len(), points.len());
        for f in &found {
            let [x, y] = f.observation.raw();
            let [u, v] = f.point.at_keyframe.map(f64::from);
            let off = [x - u - 20.0, y - v];
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
