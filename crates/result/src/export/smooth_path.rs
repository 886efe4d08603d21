//! A camera path without the tremor of a hand.

use i2slam::geometry::{Pose, Rotation, Vec3};

/// Deviation of the smoothing kernel [s]: a hand trembles at 5 Hz and more, a step takes half a second.
const SMOOTHING: f64 = 0.25;
/// Least deviation of the kernel in intervals between poses.
const MIN_INTERVALS: f64 = 2.0;
/// Deviations of the kernel beyond which a pose does not count.
const REACH: f64 = 4.0;

/// Poses at even times, `rate` per second from the first time to the last; times [s] rise.
///
/// Each is a line fitted to the poses around its time with a Gaussian kernel (local linear regression,
/// Cleveland 1979), which unlike a mean does not lag at the ends: positions directly, rotations by their
/// logarithms from the nearest one.
pub(super) fn smooth_path(times: &[f64], poses: &[Pose<f64>], rate: f64) -> Vec<Pose<f64>> {
    let (Some(first), Some(last)) = (times.first(), times.last()) else { return Vec::new() };
    let interval = (last - first) / times.len().saturating_sub(1).max(1) as f64;
    let deviation = SMOOTHING.max(MIN_INTERVALS * interval);
    let count = ((last - first) * rate + 1e-6).floor() as usize + 1;
    let at = |i: usize| smoothed(times, poses, first + i as f64 / rate, deviation);
    (0..count).map(at).collect()
}

fn smoothed(times: &[f64], poses: &[Pose<f64>], time: f64, deviation: f64) -> Pose<f64> {
    let after = times.partition_point(|t| *t < time).min(times.len() - 1);
    let before = after.saturating_sub(1);
    let nearest = if time - times[before] < times[after] - time { before } else { after };
    let gap = (times[nearest] - time).abs();
    let (from, to) = (
        times.partition_point(|t| *t < time - gap - REACH * deviation),
        times.partition_point(|t| *t <= time + gap + REACH * deviation),
    );
    let reference = poses[nearest].rotation;
    let mut line = Line::default();
    for i in from..to {
        let offset = times[i] - time;
        // Relative to the nearest pose, which counts fully even within a gap.
        let weight = (0.5 * (gap * gap - offset * offset) / (deviation * deviation)).exp();
        let turn = (reference.inverse() * poses[i].rotation).log();
        line.add(weight, offset, [poses[i].translation, turn]);
    }
    let [position, turn] = line.at_zero();
    Pose::new((reference * Rotation::exp(turn)).normalized(), position)
}

/// Sums of a weighted line through two vectors.
#[derive(Default)]
struct Line {
    weight: f64,
    first: f64,
    second: f64,
    values: [Vec3<f64>; 2],
    moments: [Vec3<f64>; 2],
}

impl Line {
    fn add(&mut self, weight: f64, offset: f64, values: [Vec3<f64>; 2]) {
        self.weight += weight;
        self.first += weight * offset;
        self.second += weight * offset * offset;
        for (i, value) in values.into_iter().enumerate() {
            self.values[i] += value * weight;
            self.moments[i] += value * (weight * offset);
        }
    }

    /// The values of the line at offset 0; the mean where all offsets are the same.
    fn at_zero(&self) -> [Vec3<f64>; 2] {
        let determinant = self.weight * self.second - self.first * self.first;
        let is_line = determinant > 1e-9 * self.weight * self.second;
        std::array::from_fn(|i| match is_line {
            true => {
                (self.values[i] * self.second - self.moments[i] * self.first) * determinant.recip()
            }
            false => self.values[i] * self.weight.recip(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Steady motion, with a tremor of this size.
    fn path(tremor: f64) -> (Vec<f64>, Vec<Pose<f64>>) {
        let times: Vec<f64> = (0..90).map(|i| 100.0 + f64::from(i) / 30.0).collect();
        let pose = |t: &f64| {
            let shake = tremor * (2.0 * std::f64::consts::PI * 7.0 * t).sin();
            let rotation = Rotation::exp(Vec3::new(shake, 0.3 * (t - 100.0), 0.0));
            Pose::new(rotation, Vec3::new(0.5 * (t - 100.0), shake, 0.0))
        };
        let poses = times.iter().map(pose).collect();
        (times, poses)
    }

    #[test]
    fn steady_motion_stays_and_tremor_goes() {
        let (times, steady) = path(0.0);
        let kept = smooth_path(&times, &steady, 30.0);
        assert_eq!(kept.len(), steady.len());
        for (a, b) in kept.iter().zip(&steady) {
            assert!((a.translation - b.translation).norm() < 1e-6);
            assert!((a.rotation.inverse() * b.rotation).log().norm() < 1e-6);
        }
        let (times, shaken) = path(0.02);
        for (a, b) in smooth_path(&times, &shaken, 30.0).iter().zip(&steady) {
            assert!((a.translation - b.translation).norm() < 0.006);
            assert!((a.rotation.inverse() * b.rotation).log().norm() < 0.006);
        }
    }

    #[test]
    fn gaps_and_single_poses_are_bridged() {
        let (mut times, mut poses) = path(0.0);
        times.drain(20..70);
        poses.drain(20..70);
        let smooth = smooth_path(&times, &poses, 60.0);
        assert_eq!(smooth.len(), 179);
        let steps = smooth.windows(2).map(|w| (w[1].translation - w[0].translation).norm());
        assert!(
            steps.clone().all(|step| step.is_finite() && step < 0.2),
            "{:?}",
            steps.max_by(f64::total_cmp)
        );
        assert_eq!(smooth_path(&times[..1], &poses[..1], 30.0).len(), 1);
        assert!(smooth_path(&[], &[], 30.0).is_empty());
    }
}
