//! Points of the map that are followed again where the camera comes back to them.

use super::{MIN_CELL, TrackedPoint, Tracker, cell_size};
use crate::track::point_search::AnchorPatch;
use crate::track::tracks::Observation;

impl Tracker {
    /// Follows tracks on from the last frame, a keyframe in which their landmarks were `found`, in
    /// place of points that began there. Where an older point is followed already, it stays.
    pub(crate) fn resume(&mut self, found: &[(usize, Observation)]) {
        let Some(last) = self.recent.back() else { return };
        let frame = self.tracks.frames - 1;
        let image = last.pyramid.finest();
        let near = (cell_size(image) / 2).max(MIN_CELL / 2) as f32;
        let is_near =
            |a: [f32; 2], b: [f32; 2]| (a[0] - b[0]).abs() < near && (a[1] - b[1]).abs() < near;
        let mut resumed: Vec<TrackedPoint> = Vec::new();
        for (track, o) in found {
            let at = o.raw.map(|v| v as f32);
            let is_older = |p: &&TrackedPoint| p.track < self.first_new_track;
            let is_taken =
                self.points.iter().filter(is_older).chain(&resumed).any(|p| {
                    p.track == *track || (p.hidden_frames == 0 && is_near(p.warp.centre, at))
                });
            let Some(anchor) = (!is_taken).then(|| AnchorPatch::new(&last.pyramid, at)).flatten()
            else {
                continue;
            };
            let known = &mut self.tracks.tracks[*track];
            known.insert(Observation::new(frame, o.raw, o.sigma));
            resumed.push(TrackedPoint::new(*track, at, anchor, frame));
        }
        self.points.retain(|p| {
            let is_replaced = || resumed.iter().any(|r| is_near(r.warp.centre, p.warp.centre));
            p.track < self.first_new_track || !is_replaced()
        });
        self.points.extend(resumed);
        self.end_keyframe();
    }

    /// Makes the last frame, a keyframe, one between keyframes.
    pub(crate) fn drop_keyframe(&mut self) {
        self.tracks.drop_last_keyframe();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::track::tracker::MAX_HIDDEN_FRAMES;
    use i2slam_check::noise;
    use i2slam_geometry::Image;

    /// Random brightness of 6 px blobs, moved to the right by `shift` [px].
    fn room(shift: f32) -> Image<f32> {
        let numbers = noise(3, 40 * 40);
        let at = |i: usize, j: usize| numbers[j * 40 + i] as f32;
        Image::from_fn(96, 72, 1, |_, column, row| {
            let (x, y) = ((column as f32 - shift) / 6.0 + 10.0, row as f32 / 6.0 + 10.0);
            let (i, j, u, v) = (x as usize, y as usize, x.fract(), y.fract());
            let top = at(i, j) * (1.0 - u) + at(i + 1, j) * u;
            let bottom = at(i, j + 1) * (1.0 - u) + at(i + 1, j + 1) * u;
            0.5 + 0.4 * (top * (1.0 - v) + bottom * v)
        })
    }

    /// Points that were lost in the dark go on where they are found again, and none is followed twice.
    #[test]
    fn a_point_that_is_found_again_goes_on_in_its_track() {
        let mut tracker = Tracker::default();
        tracker.track(&room(0.0));
        let first: Vec<usize> = tracker.tracked().collect();
        for _ in 0..=MAX_HIDDEN_FRAMES {
            tracker.track(&Image::new(96, 72, 1));
        }
        assert_eq!(tracker.tracked().count(), 0);
        while !tracker.track(&room(0.0)).is_keyframe {}
        let (frame, fresh) = (tracker.tracks.frames - 1, tracker.tracked().count());
        let seen = |track: &usize| {
            let o = tracker.tracks.tracks[*track].observation_in(0).expect("seen first");
            (*track, Observation::new(frame, o.raw, o.sigma))
        };
        let found: Vec<(usize, Observation)> = first.iter().map(seen).collect();
        tracker.resume(&found);
        assert!(tracker.points.len() <= fresh.max(first.len()) + 2, "{}", tracker.points.len());
        tracker.track(&room(0.5));
        let goes_on = |track: &&usize| {
            let o = tracker.tracks.tracks[**track].observation_in(frame + 1);
            let was = tracker.tracks.tracks[**track].observation_in(0);
            o.zip(was).is_some_and(|(o, was)| (o.raw[0] - was.raw[0] - 0.5).abs() < 0.2)
        };
        let resumed = first.iter().filter(goes_on).count();
        assert!(2 * resumed > first.len(), "{resumed} of {}", first.len());
        tracker.drop_keyframe();
        assert!(!tracker.tracks.keyframes.contains(&frame));
    }
}
