//! More keyframes of a finished path: odometry needs few, a map gains from every view.

use crate::result::{Keyframe, Reconstruction, SparseDepth};
use crate::track::tracker::MIN_KEYFRAME_MOTION;
use i2slam_geometry::{Camera, Pose};
use std::collections::BTreeSet;

impl Reconstruction {
    /// Posed frames of a film that would, together with its keyframes, be `most`: each time that in the
    /// middle of the two neighbours between which the picture moves most, of those alone that are usable.
    pub fn frames_between_keyframes(
        &self,
        most: usize,
        is_usable: impl Fn(usize) -> bool,
    ) -> BTreeSet<usize> {
        let mut chosen = BTreeSet::new();
        let Some(depth) = self.median_depth().filter(|_| !self.is_unordered) else { return chosen };
        let least = f64::from(MIN_KEYFRAME_MOTION) * self.camera.width as f64;
        let gap = |[first, last]: [usize; 2]| {
            let usable = |frame: &usize| self.poses[*frame].is_some() && is_usable(*frame);
            let between = (first + 1..last).filter(usable);
            let middle = between.min_by_key(|frame| (2 * frame).abs_diff(first + last))?;
            let motion =
                picture_motion(&self.camera, depth, [self.poses[first]?, self.poses[last]?]);
            (motion >= least).then_some(Gap { frames: [first, middle, last], motion })
        };
        let pairs = self.keyframes.windows(2).map(|pair| [pair[0].index, pair[1].index]);
        let mut gaps: Vec<Gap> = pairs.filter_map(gap).collect();
        while self.keyframes.len() + chosen.len() < most {
            let widest = gaps.iter().enumerate().max_by(|a, b| a.1.motion.total_cmp(&b.1.motion));
            let Some((place, _)) = widest else { break };
            let [first, middle, last] = gaps.remove(place).frames;
            chosen.insert(middle);
            gaps.extend([[first, middle], [middle, last]].into_iter().filter_map(gap));
        }
        chosen
    }

    /// Makes posed frames keyframes, too, each with those landmarks of the keyframe before or after it that it
    /// sees, whichever are more.
    #[must_use]
    pub fn with_keyframes(mut self, frames: &BTreeSet<usize>) -> Self {
        let more: Vec<Keyframe> =
            frames.iter().filter_map(|frame| self.frame_as_keyframe(*frame)).collect();
        self.keyframes.extend(more);
        self.keyframes.sort_by_key(|keyframe| keyframe.index);
        self
    }

    fn frame_as_keyframe(&self, frame: usize) -> Option<Keyframe> {
        let world_from_camera = (*self.poses.get(frame)?)?;
        let next = self.keyframes.partition_point(|keyframe| keyframe.index < frame);
        if self.keyframes.get(next).is_some_and(|keyframe| keyframe.index == frame) {
            return None;
        }
        let around = &self.keyframes[next.saturating_sub(1)..(next + 1).min(self.keyframes.len())];
        let seen = around.iter().map(|keyframe| self.landmarks_in(keyframe, world_from_camera));
        Some(Keyframe {
            index: frame,
            timestamp: self.timestamps[frame],
            world_from_camera,
            depths: seen.max_by_key(Vec::len)?,
        })
    }

    /// Landmarks of a keyframe that are within the picture of a camera.
    fn landmarks_in(&self, keyframe: &Keyframe, world_from_camera: Pose<f64>) -> Vec<SparseDepth> {
        let relative = world_from_camera.inverse() * keyframe.world_from_camera;
        let seen = |landmark: &SparseDepth| {
            let [u, v] = landmark.at;
            let point = relative * self.camera.unproject(u, v, landmark.depth);
            let (u, v) = (point.z > 0.0).then(|| self.camera.project(point))?;
            let is_inside = self.camera.contains(u, v, 0.0);
            is_inside.then_some(SparseDepth { at: [u, v], depth: point.z, ..*landmark })
        };
        keyframe.depths.iter().filter_map(seen).collect()
    }
}

/// Two neighbours among the frames that are chosen so far.
struct Gap {
    /// The first of them, the usable frame nearest to the middle, and the last.
    frames: [usize; 3],
    /// Motion of the picture from the first to the last \[px\].
    motion: f64,
}

/// Motion of the picture from one pose to another, at a depth \[px\].
fn picture_motion(camera: &Camera<f64>, depth: f64, [from, to]: [Pose<f64>; 2]) -> f64 {
    let motion = from.local(to).to_array();
    let length = |part: &[f64]| part.iter().map(|x| x * x).sum::<f64>().sqrt();
    camera.fx * (length(&motion[..3]) / depth + length(&motion[3..]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_geometry::Vec3;

    const CAMERA: Camera<f64> =
        Camera { width: 320, height: 240, fx: 250.0, fy: 250.0, cx: 160.0, cy: 120.0 };
    const DEPTH: f64 = 2.0;

    /// Nine frames that move to the right by so much each, the first and the last of them keyframes.
    fn path(step: f64) -> Reconstruction {
        let at = |frame: usize| Pose {
            translation: Vec3::new(step * frame as f64, 0.0, 0.0),
            ..Pose::identity()
        };
        let landmarks = |frame: usize| -> Vec<SparseDepth> {
            let points = (0..20).map(|i| Vec3::new(0.1 * f64::from(i) - 0.8, 0.1, DEPTH));
            let seen = points.map(|point| CAMERA.project(at(frame).inverse() * point));
            let inside = seen.filter(|(u, v)| CAMERA.contains(*u, *v, 0.0));
            inside.map(|(u, v)| SparseDepth { at: [u, v], depth: DEPTH, variance: 1e-4 }).collect()
        };
        let keyframe = |frame: usize| Keyframe {
            index: frame,
            timestamp: frame as f64,
            world_from_camera: at(frame),
            depths: landmarks(frame),
        };
        Reconstruction {
            camera: CAMERA,
            distortion: None,
            focal_deviation: None,
            rolling_shutter_readout: 0.0,
            poses: (0..9).map(|frame| Some(at(frame))).collect(),
            online_poses: Vec::new(),
            deviations: vec![None; 9],
            timestamps: (0..9).map(f64::from).collect(),
            depth_model: None,
            has_given_poses: false,
            keyframes: vec![keyframe(0), keyframe(8)],
            is_unordered: false,
            warnings: Vec::new(),
        }
    }

    fn chosen(found: &Reconstruction, most: usize, held_out: Option<usize>) -> Vec<usize> {
        found.frames_between_keyframes(most, |frame| Some(frame) != held_out).into_iter().collect()
    }

    #[test]
    fn the_widest_gaps_are_halved() {
        assert_eq!(chosen(&path(0.05), 3, None), [4]);
        assert_eq!(chosen(&path(0.05), 5, None), [2, 4, 6]);
        assert_eq!(chosen(&path(0.05), 100, None), [1, 2, 3, 4, 5, 6, 7]);
        // The camera rests in the first half.
        let mut found = path(0.05);
        (0..4).for_each(|frame| found.poses[frame] = found.poses[4]);
        assert_eq!(chosen(&found, 4, None), [4, 6]);
    }

    #[test]
    fn frames_held_out_lost_or_at_the_same_place_are_left_out() {
        assert_eq!(chosen(&path(0.05), 3, Some(4)), [3]);
        let mut found = path(0.05);
        (1..7).for_each(|frame| found.poses[frame] = None);
        assert_eq!(chosen(&found, 9, None), [7]);
        // 0.5 px altogether.
        assert!(chosen(&path(0.0005), 9, None).is_empty());
        let photographs = Reconstruction { is_unordered: true, ..path(0.05) };
        assert!(chosen(&photographs, 9, None).is_empty());
    }

    #[test]
    fn landmarks_of_a_neighbour_are_where_the_frame_sees_them() {
        let found = path(0.05).with_keyframes(&BTreeSet::from([0, 2, 6, 9]));
        let indices: Vec<usize> = found.keyframes.iter().map(|keyframe| keyframe.index).collect();
        assert_eq!(indices, [0, 2, 6, 8]);
        for [near, between] in [[0, 1], [3, 2]].map(|pair| pair.map(|k| &found.keyframes[k])) {
            let count = between.depths.len();
            assert!(count > 10 && count <= near.depths.len(), "{count}");
            for landmark in &between.depths {
                let [u, v] = landmark.at;
                let point = between.world_from_camera * CAMERA.unproject(u, v, landmark.depth);
                let place = (point.x + 0.8) / 0.1;
                assert!((place - place.round()).abs() < 1e-9 && (point.y - 0.1).abs() < 1e-9);
                assert!((point.z - DEPTH).abs() < 1e-9);
            }
        }
    }
}
