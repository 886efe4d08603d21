//! Timestamped poses.

use crate::Pose;

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_the_nearest_within_tolerance() {
        let stamps = [0.0, 1.0, 2.0];
        assert_eq!(nearest_stamp(&stamps, 1.4, 0.5), Some(1));
        assert_eq!(nearest_stamp(&stamps, 1.6, 0.5), Some(2));
        assert_eq!(nearest_stamp(&stamps, 9.0, 0.5), None);
        assert_eq!(nearest_stamp(&[], 0.0, 1.0), None);
    }
}
