//! Which colour image goes with which depth image, by time.

use i2slam_geometry::nearest_stamp;

/// The rules of association.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rules {
    /// Partners must be closer in time than this [s].
    pub(crate) tolerance: f64,
    /// Frames must follow the last kept one by more than this [s].
    pub(crate) minimum_gap: f64,
}

/// The associated stream and what was left out of it.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Association {
    /// Places in the colour and in the depth list, in order of time.
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
    rules: Rules,
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

#[cfg(test)]
mod tests {
    use super::*;

    const RULES: Rules = Rules { tolerance: 0.08, minimum_gap: 1.0 / 32.0 };

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
        let all = associate(&stamps, &stamps, None, Rules { minimum_gap: 0.0, ..RULES });
        assert_eq!(all.pairs.len(), 5);
    }

    #[test]
    fn thirty_frames_a_second_all_stay() {
        let stamps: Vec<f64> = (0..80).map(|i| (i as f64 / 30.0 * 1e6).round() / 1e6).collect();
        assert_eq!(associate(&stamps, &stamps, None, RULES).pairs.len(), 80);
    }

    #[test]
    fn frames_outside_the_ground_truth_are_left_out() {
        let stamps = [0.0, 1.0, 2.0];
        let a = associate(&stamps, &stamps, Some(&[0.95, 2.05]), RULES);
        assert_eq!(a.pairs, vec![(1, 1), (2, 2)]);
        assert_eq!(a.without_pose, 1);
    }
}
