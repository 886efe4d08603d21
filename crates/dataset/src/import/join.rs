//! Which pose belongs to which picture, by time.

use i2slam_geometry::nearest_stamp;

/// Pairs of poses and pictures.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Joined {
    /// Places of a pose and of its picture, in order of time.
    pub(super) pairs: Vec<(usize, usize)>,
    /// Smallest distance in time between any pose and picture [s].
    pub(super) nearest_gap: f64,
    /// Largest distance in time between a pose and its picture [s].
    pub(super) widest_gap: f64,
}

/// Pairs a pose with a picture where each is the nearest of the other, less than `tolerance` [s]
/// away. Both lists of stamps in order of time [s].
pub(super) fn join(poses: &[f64], pictures: &[f64], tolerance: f64) -> Joined {
    let mut joined = Joined { nearest_gap: f64::INFINITY, ..Joined::default() };
    for (pose, &stamp) in poses.iter().enumerate() {
        let Some(picture) = nearest_stamp(pictures, stamp, f64::INFINITY) else { break };
        let gap = (pictures[picture] - stamp).abs();
        joined.nearest_gap = joined.nearest_gap.min(gap);
        let back = nearest_stamp(poses, pictures[picture], f64::INFINITY);
        if gap < tolerance && back == Some(pose) {
            joined.widest_gap = joined.widest_gap.max(gap);
            joined.pairs.push((pose, picture));
        }
    }
    joined
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sparse_pose_takes_one_picture() {
        let joined = join(&[0.034, 0.2], &[0.0, 0.033, 0.066, 0.1, 0.133, 0.166, 0.2], 0.08);
        assert_eq!(joined.pairs, vec![(0, 1), (1, 6)]);
        assert!((joined.widest_gap - 0.001).abs() < 1e-12);
    }

    #[test]
    fn of_dense_poses_the_nearest_are_taken() {
        let poses: Vec<f64> = (0..20).map(|i| 0.01 * f64::from(i)).collect();
        assert_eq!(join(&poses, &[0.0, 0.031, 0.068], 0.08).pairs, vec![(0, 0), (3, 1), (7, 2)]);
    }

    #[test]
    fn other_clocks_and_doubles_do_not_pair() {
        let joined = join(&[5.0, 6.0], &[0.0, 1.0], 0.08);
        assert_eq!((joined.pairs.len(), joined.nearest_gap), (0, 4.0));
        assert_eq!(join(&[1.0, 1.0], &[1.0, 2.0], 0.08).pairs, vec![(0, 0)]);
        assert!(join(&[1.0], &[], 0.08).pairs.is_empty());
    }
}
