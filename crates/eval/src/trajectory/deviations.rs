//! Errors of poses over the deviations that they claim, within short stretches of a path.

use crate::EvalError;
use crate::statistics::percentile;
use i2slam_geometry::{Pose, Rotation, StampedPose, Vec3};

/// Largest offset of the clock of a truth that was recorded apart, and step of the search [s].
const MAX_OFFSET: f64 = 0.02;
const OFFSET_STEP: f64 = 0.002;
/// Distance of the poses whose fourth difference shows the noise of a truth [s].
const NOISE_STEP: f64 = 0.02;
/// Standard deviation of the fourth difference of numbers of unit variance, `√(1 + 16 + 36 + 16 + 1)`.
const FOURTH_DIFFERENCE: f64 = 8.3666;
/// Median length of a normal vector over the root of its three summed, equal variances.
const MEDIAN_LENGTH: f64 = 0.888;
/// Largest time from a pose to the true one before or after it [s].
const MAX_GAP: f64 = 0.05;

/// A pose of an estimate, with its claimed deviations of position [m] and rotation [rad], each the
/// root of three summed variances.
#[derive(Clone, Copy, Debug)]
pub struct ClaimedPose {
    /// Stamp and pose.
    pub pose: StampedPose,
    /// Deviation of the position and of the rotation.
    pub deviation: [f64; 2],
}

/// Medians over the poses of an estimate; position, then rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeviationRatios {
    /// Length of the error [m, rad].
    pub errors: [f64; 2],
    /// Error over deviation, that of the truth included: 0.89 is due where three equal variances
    /// are summed, 0.67 where one of them is far larger.
    pub ratios: [f64; 2],
    /// Deviation of the truth itself [m, rad]: from fourth differences where it has more poses than
    /// the estimate, else zero.
    pub truth: [f64; 2],
    /// Time to be added to the stamps of the estimate [s]; likewise.
    pub offset: f64,
}

/// Compares errors with claimed deviations. The error of a pose is that against the poses within
/// `reach` seconds and `least` poses on either side: after found and true path are brought together
/// there by their mean orientation and position. Positions of the estimate count times `scale`.
///
/// # Errors
///
/// Fewer than three poses with a true one.
pub fn deviation_ratios(
    estimate: &[ClaimedPose],
    truth: &[StampedPose],
    scale: f64,
    (reach, least): (f64, usize),
) -> Result<DeviationRatios, EvalError> {
    let is_recorded_apart = truth.len() > estimate.len() + estimate.len() / 2;
    let errors = |offset: f64| local_errors(estimate, truth, scale, (reach, least), offset);
    let rotation = |offset: f64| errors(offset).iter().map(|e| e.0[1] * e.0[1]).sum::<f64>();
    let steps = (MAX_OFFSET / OFFSET_STEP).round() as i32;
    let offset = match is_recorded_apart {
        true => (-steps..=steps)
            .map(|step| OFFSET_STEP * f64::from(step))
            .min_by(|a, b| rotation(*a).total_cmp(&rotation(*b)))
            .unwrap_or(0.0),
        false => 0.0,
    };
    let noise = if is_recorded_apart { own_deviation(truth) } else { [0.0; 2] };
    let found = errors(offset);
    if found.len() < 3 {
        return Err(EvalError::TooFew {
            what: "poses with a true one",
            found: found.len(),
            needed: 3,
        });
    }
    let all = |of: &dyn Fn(&ErrorAndDeviation, usize) -> f64| {
        [0, 1].map(|i| median(&found.iter().map(|e| of(e, i)).collect::<Vec<_>>()))
    };
    Ok(DeviationRatios {
        errors: all(&|(error, _), i| error[i]),
        ratios: all(&|(error, claimed), i| error[i] / claimed[i].hypot(noise[i])),
        truth: noise,
        offset,
    })
}

/// Length of an error and its deviation; each of position and rotation.
type ErrorAndDeviation = ([f64; 2], [f64; 2]);

/// Errors of every pose with a true one.
fn local_errors(
    estimate: &[ClaimedPose],
    truth: &[StampedPose],
    scale: f64,
    (reach, least): (f64, usize),
    offset: f64,
) -> Vec<ErrorAndDeviation> {
    let true_pose = |claimed: &ClaimedPose| pose_at(truth, claimed.pose.timestamp + offset);
    let pairs: Vec<(&ClaimedPose, Pose<f64>)> =
        estimate.iter().filter_map(|c| Some((c, true_pose(c)?))).collect();
    let error = |place: usize| {
        let stamp = |i: usize| pairs[i].0.pose.timestamp;
        let is_near =
            |i: &usize| i.abs_diff(place) <= least || (stamp(*i) - stamp(place)).abs() <= reach;
        let around: Vec<usize> = (0..pairs.len()).filter(is_near).collect();
        let share = 1.0 / around.len() as f64;
        let mean = |of: &dyn Fn(usize) -> Vec3<f64>| {
            around.iter().fold(Vec3::zero(), |sum, i| sum + of(*i) * share)
        };
        let found = |i: usize| pairs[i].0.pose.world_from_camera;
        let first = pairs[place].1.rotation * found(place).rotation.inverse();
        let turn = |by: Rotation<f64>, i: usize| {
            (by * found(i).rotation * pairs[i].1.rotation.inverse()).log()
        };
        let by = Rotation::exp(mean(&|i| turn(first, i)) * -1.0) * first;
        let off = |i: usize| by.rotate(found(i).translation * scale) - pairs[i].1.translation;
        let position = off(place) - mean(&off);
        let claimed = pairs[place].0.deviation;
        ([position.norm(), turn(by, place).norm()], [scale * claimed[0], claimed[1]])
    };
    (0..pairs.len()).map(error).collect()
}

/// The true pose at a time, between the two around it; `None` where they are far.
fn pose_at(truth: &[StampedPose], time: f64) -> Option<Pose<f64>> {
    let next = truth.partition_point(|pose| pose.timestamp < time).min(truth.len().checked_sub(1)?);
    let (before, after) = (&truth[next.saturating_sub(1)], &truth[next]);
    let is_near = |pose: &StampedPose| (pose.timestamp - time).abs() <= MAX_GAP;
    let span = after.timestamp - before.timestamp;
    if (after.timestamp - time).abs() < 1e-6 || span <= 0.0 {
        return is_near(after).then_some(after.world_from_camera);
    }
    let share = ((time - before.timestamp) / span).clamp(0.0, 1.0);
    (is_near(before) && is_near(after))
        .then(|| before.world_from_camera.interpolate(after.world_from_camera, share))
}

/// Deviation of recorded poses from their fourth differences, which smooth motion hardly has.
fn own_deviation(truth: &[StampedPose]) -> [f64; 2] {
    const WEIGHTS: [f64; 5] = [1.0, -4.0, 6.0, -4.0, 1.0];
    let difference = |middle: &StampedPose| {
        let at = |k: usize| pose_at(truth, middle.timestamp + NOISE_STEP * (k as f64 - 2.0));
        let poses: Option<Vec<Pose<f64>>> = (0..5).map(at).collect();
        let mut sums = [Vec3::zero(); 2];
        for (pose, weight) in poses?.iter().zip(WEIGHTS) {
            let by = middle.world_from_camera.local(*pose);
            sums[0] += by.translation * weight;
            sums[1] += by.rotation * weight;
        }
        Some(sums.map(Vec3::norm))
    };
    let all: Vec<[f64; 2]> = truth.iter().filter_map(difference).collect();
    [0, 1].map(|i| {
        let lengths: Vec<f64> = all.iter().map(|v| v[i]).collect();
        if lengths.is_empty() {
            0.0
        } else {
            median(&lengths) / (MEDIAN_LENGTH * FOURTH_DIFFERENCE)
        }
    })
}

/// The median; infinite of no numbers.
fn median(values: &[f64]) -> f64 {
    percentile(values, 50.0).unwrap_or(f64::INFINITY)
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_geometry::Tangent;

    fn random(seed: u64) -> f64 {
        let mut z = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn normal(seed: u64) -> f64 {
        (0..12).map(|k| random(12 * seed + k)).sum::<f64>() - 6.0
    }

    fn path(time: f64) -> Pose<f64> {
        let turn = Vec3::new(0.2 * time, 0.3 * (12.0 * time).sin(), 0.1 * time);
        Pose::new(Rotation::exp(turn), Vec3::new(time, (3.0 * time).sin(), 0.2 * time))
    }

    /// Poses every `interval` with noise of these deviations per coordinate.
    fn recorded(count: usize, interval: f64, seed: u64, noise: [f64; 2]) -> Vec<StampedPose> {
        let pose = |i: usize| {
            let n = |k: u64| normal(seed + 6 * i as u64 + k);
            let by: [f64; 6] = std::array::from_fn(|k| noise[k / 3] * n(k as u64));
            let timestamp = interval * i as f64;
            let world_from_camera = path(timestamp).retract(Tangent::from_array(by));
            StampedPose { timestamp, world_from_camera }
        };
        (0..count).map(pose).collect()
    }

    /// Errors of a path in another world and scale are what its noise makes them, and half as long
    /// claims are found out; noise of the truth, and an offset of its clock, are no errors.
    #[test]
    fn errors_are_compared_with_claims() {
        let noise = [0.002, 0.001];
        let world = Pose::new(Rotation::exp(Vec3::new(0.4, -2.0, 1.0)), Vec3::new(3.0, 1.0, -2.0));
        let claimed = |pose: &StampedPose| {
            let mut pose = *pose;
            pose.world_from_camera = world * pose.world_from_camera;
            pose.world_from_camera.translation = pose.world_from_camera.translation * 0.5;
            let root = 3.0_f64.sqrt();
            ClaimedPose { pose, deviation: [0.5 * root * noise[0], root * noise[1]] }
        };
        let estimate: Vec<ClaimedPose> =
            recorded(120, 1.0 / 30.0, 1, noise).iter().map(claimed).collect();
        let exact = recorded(120, 1.0 / 30.0, 0, [0.0; 2]);
        let reach = (0.25, 2);
        let found = deviation_ratios(&estimate, &exact, 2.0, reach).expect("enough");
        assert!(found.ratios.iter().all(|r| (0.75..1.0).contains(r)), "{found:?}");
        assert_eq!((found.offset, found.truth), (0.0, [0.0; 2]));
        let halved: Vec<ClaimedPose> = estimate
            .iter()
            .map(|c| ClaimedPose { deviation: c.deviation.map(|d| 0.5 * d), ..*c })
            .collect();
        let found = deviation_ratios(&halved, &exact, 2.0, reach).expect("enough");
        assert!(found.ratios.iter().all(|r| (1.5..2.0).contains(r)), "{found:?}");
        let mut noisy = recorded(420, 0.01, 77, [0.004, 0.003]);
        noisy.iter_mut().for_each(|pose| pose.timestamp += 0.008);
        let found = deviation_ratios(&estimate, &noisy, 2.0, reach).expect("enough");
        assert!((found.offset - 0.008).abs() < 0.003, "{found:?}");
        assert!((found.truth[1] / (3.0_f64.sqrt() * 0.003) - 1.0).abs() < 0.3, "{found:?}");
        assert!(found.ratios.iter().all(|r| (0.65..1.1).contains(r)), "{found:?}");
        assert!(deviation_ratios(&estimate[..2], &exact, 2.0, reach).is_err());
    }
}
