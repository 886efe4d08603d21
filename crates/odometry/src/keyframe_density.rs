//! More keyframes of a finished path: odometry needs few, a map gains from every view.

use crate::result::{Keyframe, Reconstruction, SparseDepth};
use crate::track::tracker::MIN_KEYFRAME_MOTION;
use i2slam_geometry::{Camera, Pose};

impl Reconstruction {
    /// Makes posed frames of a film keyframes, too, with the landmarks of those around them, until there are
    /// `most`: each time that in the middle of the two neighbours between which the picture moves most, but no
    /// frame that `is_held_out`.
    #[must_use]
    pub fn with_keyframes_between(
        mut self,
        most: usize,
        is_held_out: impl Fn(usize) -> bool,
    ) -> Self {
        let Some(depth) = self.median_depth().filter(|_| !self.is_unordered) else { return self };
        let least = f64::from(MIN_KEYFRAME_MOTION) * self.camera.width as f64;
        let usable: Vec<bool> = (0..self.poses.len())
            .map(|frame| self.poses[frame].is_some() && !is_held_out(frame))
            .collect();
        let gap = |pair: [&Keyframe; 2]| Gap {
            frame: middle_frame(&usable, pair.map(|keyframe| keyframe.index)),
            motion: picture_motion(&self.camera, depth, pair.map(|k| k.world_from_camera)),
        };
        let mut gaps: Vec<Gap> =
            self.keyframes.windows(2).map(|pair| gap([&pair[0], &pair[1]])).collect();
        while self.keyframes.len() < most {
            let widest = gaps.iter().enumerate().filter(|(_, gap)| gap.motion >= least);
            let open = widest.filter_map(|(place, gap)| Some((place, gap.frame?, gap.motion)));
            let Some((place, frame, _)) = open.max_by(|a, b| a.2.total_cmp(&b.2)) else { break };
            let around = [&self.keyframes[place], &self.keyframes[place + 1]];
            let Some(between) = keyframe_between(&self, frame, around) else { break };
            let halves = [[around[0], &between], [&between, around[1]]].map(gap);
            gaps.splice(place..=place, halves);
            self.keyframes.insert(place + 1, between);
        }
        self
    }
}

/// Two neighbouring keyframes.
struct Gap {
    /// The frame that can be a keyframe between them.
    frame: Option<usize>,
    /// Motion of the picture from one to the other \[px\].
    motion: f64,
}

/// The usable frame nearest to the middle between two.
fn middle_frame(usable: &[bool], [first, last]: [usize; 2]) -> Option<usize> {
    let between = (first + 1..last).filter(|frame| usable[*frame]);
    between.min_by_key(|frame| (2 * frame).abs_diff(first + last))
}

/// Motion of the picture from one pose to another, at a depth \[px\].
fn picture_motion(camera: &Camera<f64>, depth: f64, [from, to]: [Pose<f64>; 2]) -> f64 {
    let motion = from.local(to).to_array();
    let length = |part: &[f64]| part.iter().map(|x| x * x).sum::<f64>().sqrt();
    camera.fx * (length(&motion[..3]) / depth + length(&motion[3..]))
}

/// A frame as a keyframe, with the landmarks of two others that it sees.
fn keyframe_between(
    found: &Reconstruction,
    frame: usize,
    around: [&Keyframe; 2],
) -> Option<Keyframe> {
    let world_from_camera = found.poses[frame]?;
    let seen = |keyframe: &Keyframe| {
        let relative = world_from_camera.inverse() * keyframe.world_from_camera;
        let camera = &found.camera;
        let project = move |landmark: &SparseDepth| {
            let [u, v] = landmark.at;
            let point = relative * camera.unproject(u, v, landmark.depth);
            let (u, v) = (point.z > 0.0).then(|| camera.project(point))?;
            let is_inside = camera.contains(u, v, 0.0);
            is_inside.then_some(SparseDepth { at: [u, v], depth: point.z, ..*landmark })
        };
        keyframe.depths.iter().filter_map(project).collect::<Vec<SparseDepth>>()
    };
    Some(Keyframe {
        index: frame,
        timestamp: found.timestamps[frame],
        world_from_camera,
        depths: around.map(seen).concat(),
    })
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

    fn keyframes(found: &Reconstruction) -> Vec<usize> {
        found.keyframes.iter().map(|keyframe| keyframe.index).collect()
    }

    #[test]
    fn the_widest_gaps_are_halved() {
        assert_eq!(keyframes(&path(0.05).with_keyframes_between(3, |_| false)), [0, 4, 8]);
        assert_eq!(keyframes(&path(0.05).with_keyframes_between(5, |_| false)), [0, 2, 4, 6, 8]);
        let all: Vec<usize> = (0..9).collect();
        assert_eq!(keyframes(&path(0.05).with_keyframes_between(100, |_| false)), all);
    }

    #[test]
    fn frames_held_out_lost_or_at_the_same_place_are_none() {
        assert_eq!(keyframes(&path(0.05).with_keyframes_between(3, |f| f == 4)), [0, 3, 8]);
        let mut found = path(0.05);
        (1..7).for_each(|frame| found.poses[frame] = None);
        assert_eq!(keyframes(&found.with_keyframes_between(9, |_| false)), [0, 7, 8]);
        // 0.5 px altogether.
        assert_eq!(keyframes(&path(0.0005).with_keyframes_between(9, |_| false)), [0, 8]);
        let photographs = Reconstruction { is_unordered: true, ..path(0.05) };
        assert_eq!(keyframes(&photographs.with_keyframes_between(9, |_| false)), [0, 8]);
    }

    #[test]
    fn landmarks_of_both_neighbours_are_where_the_frame_sees_them() {
        let found = path(0.05).with_keyframes_between(3, |_| false);
        let [first, between, last] = &found.keyframes[..] else { panic!("{found:?}") };
        assert!(between.depths.len() > first.depths.len().max(last.depths.len()));
        for landmark in &between.depths {
            let [u, v] = landmark.at;
            let point = between.world_from_camera * CAMERA.unproject(u, v, landmark.depth);
            let place = (point.x + 0.8) / 0.1;
            assert!((place - place.round()).abs() < 1e-9 && (point.y - 0.1).abs() < 1e-9);
            assert!((point.z - DEPTH).abs() < 1e-9);
        }
    }
}
