//! Points of the map that are followed again where the camera comes back to them.

use super::{TrackedPoint, Tracker, is_near};
use crate::track::point_search::AnchorPatch;
use crate::track::tracks::Observation;

impl Tracker {
    /// Follows tracks on from the last frame, a keyframe in which their landmarks were `found`, in
    /// place of points that began there. Where an older point is followed already, it stays.
    pub(crate) fn resume(&mut self, found: &[(usize, Observation)]) {
        let Some(last) = self.recent.back() else { return };
        let frame = self.frames - 1;
        let near = self.nearest_distance();
        let mut resumed: Vec<TrackedPoint> = Vec::new();
        for (track, o) in found {
            let at = o.raw().map(|v| v as f32);
            let is_older = |p: &&TrackedPoint| p.track < self.first_new_track;
            let is_taken = self.points.iter().filter(is_older).chain(&resumed).any(|p| {
                p.track == *track || (p.hidden_frames == 0 && is_near(p.warp.centre, at, near))
            });
            let Some(anchor) = (!is_taken).then(|| AnchorPatch::new(&last.pyramid, at)).flatten()
            else {
                continue;
            };
            resumed.push(TrackedPoint::new(*track, at, anchor, frame));
        }
        self.points.retain(|p| {
            let is_replaced =
                || resumed.iter().any(|r| is_near(r.warp.centre, p.warp.centre, near));
            p.track < self.first_new_track || !is_replaced()
        });
        self.points.extend(resumed);
        self.end_keyframe();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::moved_blobs;
    use crate::track::tracker::MAX_HIDDEN_FRAMES;
    use i2slam_geometry::Image;

    /// Points that were lost in the dark go on where they are found again, and none is followed twice.
    #[test]
    fn a_point_that_is_found_again_goes_on_in_its_track() {
        let mut tracker = Tracker::default();
        let first = tracker.track(&moved_blobs(0.0), false).started;
        for _ in 0..=MAX_HIDDEN_FRAMES {
            tracker.track(&Image::new(96, 72, 1), false);
        }
        let again =
            (0..9).map(|_| tracker.track(&moved_blobs(0.0), false)).find(|t| t.keyframe.is_some());
        let again = again.expect("a keyframe");
        assert!(again.observed.is_empty());
        let frame = tracker.frames - 1;
        let seen = |track: usize| {
            let o = first[track].observations[0];
            (track, Observation::whitened(frame, o.raw(), *o.whitening()))
        };
        let found: Vec<(usize, Observation)> = (0..first.len()).map(seen).collect();
        tracker.resume(&found);
        let most = again.started.len().max(first.len()) + 2;
        assert!(tracker.points.len() <= most, "{}", tracker.points.len());
        let next = tracker.track(&moved_blobs(0.5), false).observed;
        let goes_on = |(track, o): &&(usize, Observation)| {
            let was = first.get(*track).map(|track| track.observations[0].raw()[0]);
            was.is_some_and(|was| (o.raw()[0] - was - 0.5).abs() < 0.2)
        };
        let resumed = next.iter().filter(goes_on).count();
        assert!(2 * resumed > first.len(), "{resumed} of {}", first.len());
    }
}
