//! Association by time: colour with depth images, poses with images.

use super::DroppedFrames;
use crate::text::counted;
use crate::{DepthPairing, OpenOptions};
use i2slam_geometry::nearest_stamp;

/// Limits of the association of colour with depth.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AssociationRules {
    pub(crate) pairing: DepthPairing,
    /// Partners must be closer in time than this [s].
    pub(crate) tolerance: f64,
    /// Frames must follow the last kept one by more than this [s].
    pub(crate) minimum_gap: f64,
}

impl AssociationRules {
    pub(crate) fn of(options: &OpenOptions) -> Self {
        Self {
            pairing: options.depth_pairing,
            tolerance: options.association_tolerance,
            minimum_gap: options.minimum_gap,
        }
    }
}

/// The associated stream, and counts of what was dropped from it.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Association {
    /// Indices of colour images and of their depth images, in order of time.
    pub(crate) pairs: Vec<(usize, Option<usize>)>,
    /// Colour images dropped because no depth image is in time.
    pub(crate) without_depth: usize,
    /// Colour images without a ground-truth pose in time.
    pub(crate) without_pose: usize,
    /// Pairs that follow the last kept one too closely.
    pub(crate) too_close: usize,
    /// The smallest distance in time between a colour and a depth image [s].
    pub(crate) nearest_gap: f64,
}

impl Association {
    /// Number of frames with depth.
    pub(crate) fn with_depth(&self) -> usize {
        self.pairs.iter().filter(|(_, depth)| depth.is_some()).count()
    }

    /// Counts of the colour images that are not in the associated stream.
    pub(super) fn dropped(&self) -> DroppedFrames {
        DroppedFrames {
            without_depth: self.without_depth,
            without_pose: self.without_pose,
            too_close: self.too_close,
        }
    }
}

/// Chooses the colour images that are frames, and gives them depth images. Colour without a pose in
/// time (where `poses` are given) is dropped, then colour too close to the last kept, as in SplaTAM's
/// TUM loader. `depth` is `None` for a sequence without depth. All stamps sorted [s].
pub(crate) fn associate(
    colour: &[f64],
    depth: Option<&[f64]>,
    poses: Option<&[f64]>,
    rules: AssociationRules,
) -> Association {
    let mut result = Association { nearest_gap: f64::INFINITY, ..Association::default() };
    let drops_without_depth = rules.pairing == DepthPairing::Nearest;
    let mut last_kept = f64::NEG_INFINITY;
    for (i, &stamp) in colour.iter().enumerate() {
        let nearest = depth.and_then(|depth| nearest_stamp(depth, stamp, f64::INFINITY));
        let gap = depth.zip(nearest).map_or(f64::INFINITY, |(depth, j)| (depth[j] - stamp).abs());
        result.nearest_gap = result.nearest_gap.min(gap);
        let in_time = nearest.filter(|_| gap < rules.tolerance);
        let has_pose = poses.is_none_or(|poses| {
            nearest_stamp(poses, stamp, rules.tolerance)
                .is_some_and(|k| (poses[k] - stamp).abs() < rules.tolerance)
        });
        if drops_without_depth && depth.is_some() && in_time.is_none() {
            result.without_depth += 1;
        } else if !has_pose {
            result.without_pose += 1;
        } else if stamp - last_kept <= rules.minimum_gap {
            result.too_close += 1;
        } else {
            last_kept = stamp;
            result.pairs.push((i, in_time));
        }
    }
    if let (DepthPairing::OneToOne, Some(depth)) = (rules.pairing, depth) {
        pair_one_to_one(&mut result.pairs, colour, depth, rules.tolerance);
    }
    result
}

/// Gives every depth image to the one frame with which it is mutually nearest in time, and takes it
/// from the others.
fn pair_one_to_one(
    frames: &mut [(usize, Option<usize>)],
    colour: &[f64],
    depth: &[f64],
    tolerance: f64,
) {
    let stamps: Vec<f64> = frames.iter().map(|(i, _)| colour[*i]).collect();
    frames.iter_mut().for_each(|(_, depth)| *depth = None);
    for (frame, j) in pair_mutually_nearest(&stamps, depth, tolerance).pairs {
        frames[frame].1 = Some(j);
    }
}

/// Pairs of stamps in two lists.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct MutualPairs {
    /// Indices into the first and into the second list, in order of time.
    pub(crate) pairs: Vec<(usize, usize)>,
    /// Smallest distance in time between stamps of the two lists [s].
    pub(crate) nearest_gap: f64,
    /// Largest distance in time within a pair [s].
    pub(crate) widest_gap: f64,
}

/// Pairs stamps of two lists that are mutual nearest neighbours in time, less than `tolerance` [s]
/// apart. Both lists sorted [s].
pub(crate) fn pair_mutually_nearest(first: &[f64], second: &[f64], tolerance: f64) -> MutualPairs {
    let mut found = MutualPairs { nearest_gap: f64::INFINITY, ..MutualPairs::default() };
    for (i, &stamp) in first.iter().enumerate() {
        let Some(j) = nearest_stamp(second, stamp, f64::INFINITY) else { break };
        let gap = (second[j] - stamp).abs();
        found.nearest_gap = found.nearest_gap.min(gap);
        let back = nearest_stamp(first, second[j], f64::INFINITY);
        if gap < tolerance && back == Some(i) {
            found.widest_gap = found.widest_gap.max(gap);
            found.pairs.push((i, j));
        }
    }
    found
}

/// Warnings about colour images that are not in the associated stream, and why.
pub(super) fn time_warnings(dropped: &DroppedFrames, rules: AssociationRules) -> Vec<String> {
    let AssociationRules { tolerance, minimum_gap, .. } = rules;
    let all = [
        (dropped.without_depth, "colour image", format!("no depth image within {tolerance} s")),
        (dropped.without_pose, "frame", format!("no ground-truth pose within {tolerance} s")),
        (
            dropped.too_close,
            "frame",
            match minimum_gap {
                0.0 => "of the same time stamp as the frame before".to_owned(),
                _ => format!(
                    "no more than {minimum_gap} s after the frame before (minimum_gap; 0 keeps all)"
                ),
            },
        ),
    ];
    let some = all.into_iter().filter(|(count, ..)| *count > 0);
    some.map(|(count, word, why)| format!("{} left out: {why}", counted(count, word))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULES: AssociationRules = AssociationRules {
        pairing: DepthPairing::Nearest,
        tolerance: 0.08,
        minimum_gap: 1.0 / 32.0,
    };

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
            let a = associate(colour, Some(depth), poses, rules);
            let pairs: Vec<_> = pairs.into_iter().map(|(i, j)| (i, Some(j))).collect();
            assert_eq!(a.pairs, pairs);
            assert_eq!([a.without_depth, a.without_pose, a.too_close], dropped);
        }
        assert!((associate(&one, Some(&two), None, RULES).nearest_gap - 0.01).abs() < 1e-12);
        let stamps: Vec<f64> = (0..80).map(|i| (i as f64 / 30.0 * 1e6).round() / 1e6).collect();
        assert_eq!(associate(&stamps, Some(&stamps), None, RULES).pairs.len(), 80);
    }

    #[test]
    fn one_to_one_keeps_all_colour_and_uses_a_depth_image_once() {
        let rules = AssociationRules { pairing: DepthPairing::OneToOne, minimum_gap: 0.0, ..RULES };
        let colour: Vec<f64> = (0..9).map(|i| f64::from(i) / 30.0).collect();
        // Depth at a fourth of the rate, between colour images; the last one out of reach.
        let depth = [0.04, 0.17, 0.4];
        let found = associate(&colour, Some(&depth), None, rules);
        let mut due: Vec<(usize, Option<usize>)> = (0..9).map(|i| (i, None)).collect();
        (due[1].1, due[5].1) = (Some(0), Some(1));
        assert_eq!(found.pairs, due);
        assert_eq!((found.with_depth(), found.without_depth), (2, 0));
        // Every colour image in reach takes the nearest by the other rule.
        let nearest = AssociationRules { pairing: DepthPairing::Nearest, ..rules };
        assert_eq!(associate(&colour, Some(&depth), None, nearest).with_depth(), 8);
        // The frames are those of colour alone, and depth goes to the kept one of two close frames.
        let alone = associate(&colour, None, None, rules);
        assert_eq!(alone.pairs, (0..9).map(|i| (i, None)).collect::<Vec<_>>());
        let thinned = AssociationRules { minimum_gap: 0.05, ..rules };
        let found = associate(&colour, Some(&[0.03, 0.07]), None, thinned);
        assert_eq!(&found.pairs[..3], &[(0, Some(0)), (2, Some(1)), (4, None)]);
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
            assert_eq!(pair_mutually_nearest(poses, images, 0.08).pairs, pairs);
        }
        let sparse = pair_mutually_nearest(&[0.034, 0.2], &video, 0.08);
        assert!((sparse.widest_gap - 0.001).abs() < 1e-12);
        let other_clock = pair_mutually_nearest(&[5.0, 6.0], &[0.0, 1.0], 0.08);
        assert_eq!((other_clock.pairs.len(), other_clock.nearest_gap), (0, 4.0));
    }
}
