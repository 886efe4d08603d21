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
    fn colour_pairs_with_the_nearest_depth_and_frames_are_thinned() {
        let all = AssociationRules { minimum_gap: 0.0, ..RULES };
        let close = [0.0, 0.03, 0.06, 0.0915, 0.125];
        let (one, two) = ([0.0, 1.0, 2.0], [0.07, 0.99, 2.09]);
        // Pairs, then frames without depth, without a pose, and too close to the one before.
        for (colour, depth, poses, rules, pairs, dropped) in [
            (&one[..], &two[..], None, RULES, vec![(0, 0), (1, 1)], [1, 0, 0]),
            (&close, &close, None, RULES, vec![(0, 0), (2, 2), (3, 3), (4, 4)], [0, 0, 1]),
            (&close, &close, None, all, (0..5).map(|i| (i, i)).collect(), [0, 0, 0]),
            (&one, &one, Some(&[0.95, 2.05][..]), RULES, vec![(1, 1), (2, 2)], [0, 1, 0]),
        ] {
            let a = associate(colour, depth, poses, rules);
            assert_eq!(a.pairs, pairs);
            assert_eq!([a.without_depth, a.without_pose, a.too_close], dropped);
        }
        assert!((associate(&one, &two, None, RULES).nearest_gap - 0.01).abs() < 1e-12);
        let stamps: Vec<f64> = (0..80).map(|i| (i as f64 / 30.0 * 1e6).round() / 1e6).collect();
        assert_eq!(associate(&stamps, &stamps, None, RULES).pairs.len(), 80);
    }

    #[test]
    fn poses_pair_with_images_that_are_mutually_nearest() {
        let dense: Vec<f64> = (0..20).map(|i| 0.01 * f64::from(i)).collect();
        let video = [0.0, 0.033, 0.066, 0.1, 0.133, 0.166, 0.2];
        for (poses, images, pairs) in [
            (&[0.034, 0.2][..], &video[..], vec![(0, 1), (1, 6)]),
            (&dense, &[0.0, 0.031, 0.068], vec![(0, 0), (3, 1), (7, 2)]),
            (&[1.0, 1.0], &[1.0, 2.0], vec![(0, 0)]),
            (&[1.0], &[], vec![]),
        ] {
            assert_eq!(associate_poses(poses, images, 0.08).pairs, pairs);
        }
        let sparse = associate_poses(&[0.034, 0.2], &video, 0.08);
        assert!((sparse.widest_gap - 0.001).abs() < 1e-12);
        let other_clock = associate_poses(&[5.0, 6.0], &[0.0, 1.0], 0.08);
        assert_eq!((other_clock.pairs.len(), other_clock.nearest_gap), (0, 4.0));
    }
}
