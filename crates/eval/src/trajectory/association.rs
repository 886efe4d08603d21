//! Association of estimated with true poses by time.

use crate::EvalError;
use i2slam_geometry::{StampedPose, nearest_stamp};

/// The usual largest time difference of a pair [s] (the TUM RGB-D benchmark's own tools).
pub const DEFAULT_TOLERANCE: f64 = 0.02;

/// A pair of poses taken at (nearly) the same time, as indices into the two trajectories.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Association {
    /// Index into the estimate.
    pub estimate: usize,
    /// Index into the truth.
    pub truth: usize,
}

/// Pairs in order of time, at most `tolerance` seconds apart, each pose in at most one pair.
///
/// As evo does, every pose of the trajectory with fewer poses (the estimate, if both have as
/// many) takes the nearest stamp of the other, the earlier of two that are equally near. Where
/// two of them take the same stamp, evo counts it twice; here the nearer one keeps it and the
/// other is left out. Neither trajectory need be sorted.
pub fn associate(
    estimate: &[StampedPose],
    truth: &[StampedPose],
    tolerance: f64,
) -> Result<Vec<Association>, EvalError> {
    if tolerance.is_nan() || tolerance < 0.0 {
        return Err(EvalError::InvalidTolerance { tolerance });
    }
    let estimate = sort_stamps(estimate, "the stamps of the estimate")?;
    let truth = sort_stamps(truth, "the stamps of the truth")?;
    let pair = |estimate, truth| Association { estimate, truth };
    Ok(if estimate.stamps.len() <= truth.stamps.len() {
        unique_pairs(&estimate, &truth, tolerance).map(|(e, t)| pair(e, t)).collect()
    } else {
        unique_pairs(&truth, &estimate, tolerance).map(|(t, e)| pair(e, t)).collect()
    })
}

/// Number of frames, given by their stamps [s], that have a true pose within `tolerance` [s] and no
/// estimated one. Errors do not count such frames: a path that leaves out what is hard looks better
/// than it is.
pub fn count_frames_without_pose(
    frames: &[f64],
    estimate: &[StampedPose],
    truth: &[StampedPose],
    tolerance: f64,
) -> Result<usize, EvalError> {
    let estimate = sort_stamps(estimate, "the stamps of the estimate")?;
    let truth = sort_stamps(truth, "the stamps of the truth")?;
    let mut is_missing: Vec<bool> = frames
        .iter()
        .map(|stamp| nearest_stamp(&truth.stamps, *stamp, tolerance).is_some())
        .collect();
    for stamp in estimate.stamps {
        if let Some(frame) = nearest_stamp(frames, stamp, tolerance) {
            is_missing[frame] = false;
        }
    }
    Ok(is_missing.into_iter().filter(|missing| *missing).count())
}

/// Associates poses; an error unless there are `needed` pairs and all poses are finite.
pub(super) fn finite_pairs(
    estimate: &[StampedPose],
    truth: &[StampedPose],
    tolerance: f64,
    needed: usize,
) -> Result<Vec<Association>, EvalError> {
    let pairs = associate(estimate, truth, tolerance)?;
    if pairs.is_empty() && !estimate.is_empty() && !truth.is_empty() {
        let (estimate, truth) = (span(estimate), span(truth));
        return Err(EvalError::NoOverlap { estimate, truth, tolerance });
    }
    if pairs.len() < needed {
        return Err(EvalError::TooFew { what: "pairs of poses", found: pairs.len(), needed });
    }
    for (poses, what) in [(estimate, "the estimated poses"), (truth, "the true poses")] {
        if !poses.iter().all(|p| p.world_from_camera.is_finite()) {
            return Err(EvalError::NotFinite { what });
        }
    }
    Ok(pairs)
}

/// First and last stamp.
fn span(poses: &[StampedPose]) -> [f64; 2] {
    let stamps = || poses.iter().map(|p| p.timestamp);
    [stamps().fold(f64::INFINITY, f64::min), stamps().fold(f64::NEG_INFINITY, f64::max)]
}

/// Time stamps in ascending order with their original indices.
struct SortedStamps {
    stamps: Vec<f64>,
    source: Vec<usize>,
}

fn sort_stamps(poses: &[StampedPose], what: &'static str) -> Result<SortedStamps, EvalError> {
    if poses.iter().any(|p| !p.timestamp.is_finite()) {
        return Err(EvalError::NotFinite { what });
    }
    let mut source: Vec<usize> = (0..poses.len()).collect();
    source.sort_by(|&a, &b| poses[a].timestamp.total_cmp(&poses[b].timestamp));
    Ok(SortedStamps { stamps: source.iter().map(|&i| poses[i].timestamp).collect(), source })
}

/// Pairs `(few, many)` of source indices, in order of time.
fn unique_pairs(
    few: &SortedStamps,
    many: &SortedStamps,
    tolerance: f64,
) -> impl Iterator<Item = (usize, usize)> {
    let mut taken: Vec<Option<usize>> = vec![None; many.stamps.len()];
    for (i, &stamp) in few.stamps.iter().enumerate() {
        let Some(j) = nearest_stamp(&many.stamps, stamp, tolerance) else { continue };
        let gap = |i: usize| (few.stamps[i] - many.stamps[j]).abs();
        if taken[j].is_none_or(|held| gap(i) < gap(held)) {
            taken[j] = Some(i);
        }
    }
    taken.into_iter().enumerate().filter_map(|(j, i)| Some((few.source[i?], many.source[j])))
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_geometry::Pose;

    fn at(stamps: &[f64]) -> Vec<StampedPose> {
        let pose = |&timestamp| StampedPose { timestamp, world_from_camera: Pose::identity() };
        stamps.iter().map(pose).collect()
    }

    fn pairs(estimate: &[f64], truth: &[f64]) -> Vec<(usize, usize)> {
        let found = associate(&at(estimate), &at(truth), DEFAULT_TOLERANCE).unwrap();
        found.iter().map(|p| (p.estimate, p.truth)).collect()
    }

    #[test]
    fn pairs_by_hand() {
        assert_eq!(pairs(&[0.0, 0.1, 0.5], &[0.009, 0.05, 0.095, 0.2]), [(0, 0), (1, 2)]);
        // The nearer of two keeps a stamp.
        assert_eq!(pairs(&[0.095, 0.101], &[0.0, 0.1, 0.2]), [(1, 1)]);
        assert_eq!(pairs(&[0.0, 0.095, 0.101], &[0.1, 0.2]), [(2, 0)]);
        assert_eq!(pairs(&[0.3, 0.1], &[0.2, 0.3, 0.1]), [(1, 2), (0, 1)]);
        assert_eq!(pairs(&[], &[1.0]), []);
        assert_eq!(pairs(&[5.0], &[1.0]), []);
    }

    #[test]
    fn frames_without_a_pose_count_where_there_is_a_truth() {
        let frames: Vec<f64> = (0..10).map(|i| f64::from(i) / 30.0).collect();
        let truth: Vec<f64> = (0..25).map(|i| 0.001 + f64::from(i) / 100.0).collect();
        let count = |estimate: &[f64]| {
            count_frames_without_pose(&frames, &at(estimate), &at(&truth), DEFAULT_TOLERANCE)
        };
        // The last two frames have no truth.
        assert_eq!(count(&frames), Ok(0));
        assert_eq!(count(&frames[..8]), Ok(0));
        assert_eq!(count(&[]), Ok(8));
        // Stamps that another program rounded, and one pose twice.
        assert_eq!(count(&[0.033, 0.0334, 0.267]), Ok(7));
    }

    #[test]
    fn poison_is_refused() {
        let bad = associate(&at(&[f64::NAN]), &at(&[0.0]), 0.1);
        assert!(matches!(bad, Err(EvalError::NotFinite { .. })));
        for tolerance in [-1.0, f64::NAN] {
            let bad = associate(&at(&[0.0]), &at(&[0.0]), tolerance);
            assert!(matches!(bad, Err(EvalError::InvalidTolerance { .. })));
        }
    }
}
