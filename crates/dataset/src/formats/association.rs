//! Association by time: colour with depth images, poses with images.

use i2slam_geometry::nearest_stamp;

/// Limits of the association of colour with depth.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AssociationRules {
    /// Partners must be closer in time than this [s].
    pub(crate) tolerance: f64,
    /// Frames must follow the last kept one by more than this [s].
    pub(crate) minimum_gap: f64,
}

/// The associated stream, and counts of what was dropped from it.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Association {
    /// Indices into the colour and the depth list, in order of time.
    pub(crate) pairs: Vec<(usize, usize)>,
    /// Colour images without a depth image in time.
    pub(crate) without_depth: usize,
    /// Colour images without a ground-truth pose in time.
    pub(crate) without_pose: usize,
    /// Pairs that follow the last kept one too closely.
    pub(crate) too_close: usize,
    /// The smallest distance in time between a colour and a depth image [s].
    pub(crate) nearest_gap: f64,
}

/// Pairs every colour stamp with the nearest depth stamp (and demands a pose in time where
/// `poses` are given), then thins: the association of SplaTAM's TUM loader. All stamps sorted [s].
pub(crate) fn associate(
    colour: &[f64],
    depth: &[f64],
    poses: Option<&[f64]>,
    rules: AssociationRules,
) -> Association {
    let mut result = Association { nearest_gap: f64::INFINITY, ..Association::default() };
    let mut last_kept = f64::NEG_INFINITY;
    for (i, &stamp) in colour.iter().enumerate() {
        let Some(j) = nearest_stamp(depth, stamp, f64::INFINITY) else { break };
        let gap = (depth[j] - stamp).abs();
        result.nearest_gap = result.nearest_gap.min(gap);
        let has_pose = poses.is_none_or(|poses| {
            nearest_stamp(poses, stamp, rules.tolerance)
                .is_some_and(|k| (poses[k] - stamp).abs() < rules.tolerance)
        });
        if gap >= rules.tolerance {
            result.without_depth += 1;
        } else if !has_pose {
            result.without_pose += 1;
        } else if stamp - last_kept <= rules.minimum_gap {
            result.too_close += 1;
        } else {
            last_kept = stamp;
            result.pairs.push((i, j));
        }
    }
    result
}

/// Pairs of poses and images.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct PoseAssociation {
    /// Indices of a pose and its image, in order of time.
    pub(crate) pairs: Vec<(usize, usize)>,
    /// Smallest distance in time between any pose and image [s].
    pub(crate) nearest_gap: f64,
    /// Largest distance in time between a pose and its image [s].
    pub(crate) widest_gap: f64,
}

/// Pairs poses with images that are mutual nearest neighbours in time, less than `tolerance` [s]
/// apart. Both lists sorted [s].
pub(crate) fn associate_poses(poses: &[f64], images: &[f64], tolerance: f64) -> PoseAssociation {
    let mut associated =
        PoseAssociation { nearest_gap: f64::INFINITY, ..PoseAssociation::default() };
    for (pose, &stamp) in poses.iter().enumerate() {
        let Some(image) = nearest_stamp(images, stamp, f64::INFINITY) else { break };
        let gap = (images[image] - stamp).abs();
        associated.nearest_gap = associated.nearest_gap.min(gap);
        let back = nearest_stamp(poses, images[image], f64::INFINITY);
        if gap < tolerance && back == Some(pose) {
            associated.widest_gap = associated.widest_gap.max(gap);
            associated.pairs.push((pose, image));
        }
    }
    associated
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULES: AssociationRules = AssociationRules { tolerance: 0.08, minimum_gap: 1.0 / 32.0 };

    #[test]
    fn pairs_with_the_nearest_depth_inside_the_tolerance() {
        let a = associate(&[0.0, 1.0, 2.0], &[0.07, 0.99, 2.09], None, RULES);
        assert_eq!(a.pairs, vec![(0, 0), (1, 1)]);
        assert_eq!((a.without_depth, a.too_close), (1, 0));
        assert!((a.nearest_gap - 0.01).abs() < 1e-12);
    }

    #[test]
    fn thins_against_the_last_kept_frame() {
        let stamps = [0.0, 0.03, 0.06, 0.0915, 0.125];
        let a = associate(&stamps, &stamps, None, RULES);
        assert_eq!(a.pairs, vec![(0, 0), (2, 2), (3, 3), (4, 4)]);
        assert_eq!(a.too_close, 1);
        let all = associate(&stamps, &stamps, None, AssociationRules { minimum_gap: 0.0, ..RULES });
        assert_eq!(all.pairs.len(), 5);
    }

    #[test]
    fn thirty_frames_a_second_are_all_kept() {
        let stamps: Vec<f64> = (0..80).map(|i| (i as f64 / 30.0 * 1e6).round() / 1e6).collect();
        assert_eq!(associate(&stamps, &stamps, None, RULES).pairs.len(), 80);
    }

    #[test]
    fn frames_outside_the_ground_truth_are_dropped() {
        let stamps = [0.0, 1.0, 2.0];
        let a = associate(&stamps, &stamps, Some(&[0.95, 2.05]), RULES);
        assert_eq!(a.pairs, vec![(1, 1), (2, 2)]);
        assert_eq!(a.without_pose, 1);
    }

    #[test]
    fn a_sparse_pose_takes_one_image() {
        let associated =
            associate_poses(&[0.034, 0.2], &[0.0, 0.033, 0.066, 0.1, 0.133, 0.166, 0.2], 0.08);
        assert_eq!(associated.pairs, vec![(0, 1), (1, 6)]);
        assert!((associated.widest_gap - 0.001).abs() < 1e-12);
    }

    #[test]
    fn the_nearest_of_dense_poses_is_taken() {
        let poses: Vec<f64> = (0..20).map(|i| 0.01 * f64::from(i)).collect();
        assert_eq!(
            associate_poses(&poses, &[0.0, 0.031, 0.068], 0.08).pairs,
            vec![(0, 0), (3, 1), (7, 2)]
        );
    }

    #[test]
    fn other_clocks_and_duplicates_do_not_pair() {
        let associated = associate_poses(&[5.0, 6.0], &[0.0, 1.0], 0.08);
        assert_eq!((associated.pairs.len(), associated.nearest_gap), (0, 4.0));
        assert_eq!(associate_poses(&[1.0, 1.0], &[1.0, 2.0], 0.08).pairs, vec![(0, 0)]);
        assert!(associate_poses(&[1.0], &[], 0.08).pairs.is_empty());
    }
}
