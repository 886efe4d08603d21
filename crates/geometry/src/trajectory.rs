//! Timestamped poses.

use crate::{Pose, Tangent};

/// One pose of a trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StampedPose {
    /// Time [s].
    pub timestamp: f64,
    /// The pose at that time.
    pub world_from_camera: Pose<f64>,
}

/// Poses in order of time.
pub type Trajectory = Vec<StampedPose>;

/// The index of the stamp nearest to `timestamp`, if it is at most `tolerance` seconds away.
/// `stamps` must be sorted.
pub fn nearest_stamp(stamps: &[f64], timestamp: f64, tolerance: f64) -> Option<usize> {
    let after = stamps.partition_point(|&s| s < timestamp);
    let candidates = [after.checked_sub(1), (after < stamps.len()).then_some(after)];
    candidates
        .into_iter()
        .flatten()
        .min_by(|&a, &b| (stamps[a] - timestamp).abs().total_cmp(&(stamps[b] - timestamp).abs()))
        .filter(|&i| (stamps[i] - timestamp).abs() <= tolerance)
}

/// The pose at a time on the cubic through the two poses before it and the two after it, in
/// tangents of the last one before (Lagrange): under smooth motion the error falls with the fourth
/// power of the interval. Beside the ends through those that there are; beyond them the last motion
/// goes on. `None` with fewer than two poses. `path` is in order of time, its stamps differ.
pub fn interpolate_pose(path: &[StampedPose], time: f64) -> Option<Pose<f64>> {
    let last = path.len().checked_sub(1).filter(|last| *last > 0)?;
    let after = path.partition_point(|pose| pose.timestamp < time).clamp(1, last);
    let is_within = path[0].timestamp <= time && time <= path[last].timestamp;
    let nodes = match is_within {
        true => &path[after.saturating_sub(2)..(after + 2).min(path.len())],
        false => &path[after - 1..=after],
    };
    let origin = path[after - 1].world_from_camera;
    let mut moved = Tangent::zero();
    for (i, node) in nodes.iter().enumerate() {
        let others = nodes.iter().enumerate().filter(|(j, _)| *j != i).map(|(_, other)| other);
        let weight: f64 =
            others.map(|o| (time - o.timestamp) / (node.timestamp - o.timestamp)).product();
        moved = moved.plus(origin.local(node.world_from_camera).scaled(weight));
    }
    Some(origin.retract(moved))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Rotation, Vec3};

    /// A camera whose coordinates and angles are cubics of time; turns about one axis commute.
    fn cubic(time: f64) -> StampedPose {
        let value = 0.1 + 0.2 * time - 0.3 * time * time + 0.15 * time.powi(3);
        let rotation = Rotation::exp(Vec3::new(0.0, 0.5 * value, 0.0));
        let pose = Pose::new(rotation, Vec3::new(value, -2.0 * value, 1.0));
        StampedPose { timestamp: time, world_from_camera: pose }
    }

    #[test]
    fn cubic_motion_is_interpolated_without_error() {
        let path: Vec<_> = [0.0, 0.9, 2.0, 3.1, 3.9].map(cubic).to_vec();
        for time in [0.9, 1.2, 2.0, 2.9] {
            let found = interpolate_pose(&path, time).expect("enough poses");
            let off = cubic(time).world_from_camera.local(found).to_array();
            assert!(off.iter().all(|v| v.abs() < 1e-12), "{time}: {off:?}");
        }
    }

    #[test]
    fn motion_goes_on_beyond_the_ends() {
        let at = |timestamp: f64, x: f64| StampedPose {
            timestamp,
            world_from_camera: Pose::new(Rotation::identity(), Vec3::new(x, 0.0, 0.0)),
        };
        let path = [at(1.0, 0.0), at(2.0, 1.0), at(3.0, 3.0)];
        for (time, x) in [(0.5, -0.5), (2.0, 1.0), (3.5, 4.0)] {
            let found = interpolate_pose(&path, time).expect("enough poses");
            assert!((found.translation.x - x).abs() < 1e-12, "{time}");
        }
        assert!(interpolate_pose(&path[..1], 1.0).is_none());
    }

    #[test]
    fn finds_the_nearest_within_tolerance() {
        let stamps = [0.0, 1.0, 2.0];
        assert_eq!(nearest_stamp(&stamps, 1.4, 0.5), Some(1));
        assert_eq!(nearest_stamp(&stamps, 1.6, 0.5), Some(2));
        assert_eq!(nearest_stamp(&stamps, 9.0, 0.5), None);
        assert_eq!(nearest_stamp(&[], 0.0, 1.0), None);
    }
}
