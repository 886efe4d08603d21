//! A camera path through given views.

use i2slam::geometry::{Pose, Rotation, StampedPose, Vec3};

/// Poses at even times, `rate` per second from the first view to the last; times of `views` rise.
///
/// Between two views the path is the cubic of Hermite with the slopes of Catmull and Rom, those between the views
/// before and after (at an end to the next one): of positions, and of rotations by their logarithms from the view
/// before. It passes through the views without a jump in velocity of positions, which
/// [`interpolate_pose`](i2slam::geometry::interpolate_pose), made for poses close together, has at each.
pub(super) fn path_through(views: &[StampedPose], rate: f64) -> Vec<Pose<f64>> {
    let (Some(first), Some(last)) = (views.first(), views.last()) else { return Vec::new() };
    let count = ((last.timestamp - first.timestamp) * rate + 1e-6).floor() as usize + 1;
    (0..count).map(|i| pose_at(views, first.timestamp + i as f64 / rate)).collect()
}

fn pose_at(views: &[StampedPose], time: f64) -> Pose<f64> {
    let after = views.partition_point(|view| view.timestamp <= time).min(views.len() - 1);
    let before = after.saturating_sub(1);
    let [t0, t1] = [before, after].map(|i| views[i].timestamp);
    let span = t1 - t0;
    if span <= 0.0 {
        return views[after].world_from_camera;
    }
    let reference = views[before].world_from_camera.rotation;
    // Position, and rotation from the view before.
    let value = |i: usize| {
        let Pose { rotation, translation } = views[i].world_from_camera;
        [translation, (reference.inverse() * rotation).log()]
    };
    let slope = |i: usize| {
        let (from, to) = (i.saturating_sub(1), (i + 1).min(views.len() - 1));
        let time = views[to].timestamp - views[from].timestamp;
        let (start, end) = (value(from), value(to));
        [0, 1].map(|k| (end[k] - start[k]) * time.recip())
    };
    let s = ((time - t0) / span).clamp(0.0, 1.0);
    let (p0, p1, m0, m1) = (value(before), value(after), slope(before), slope(after));
    let [translation, turn]: [Vec3<f64>; 2] = [0, 1].map(|k| {
        p0[k] * (1.0 + s * s * (2.0 * s - 3.0))
            + p1[k] * (s * s * (3.0 - 2.0 * s))
            + m0[k] * (span * s * (1.0 - s) * (1.0 - s))
            + m1[k] * (span * s * s * (s - 1.0))
    });
    Pose::new((reference * Rotation::exp(turn)).normalized(), translation)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view(timestamp: f64, turn: f64, x: f64) -> StampedPose {
        let rotation = Rotation::exp(Vec3::new(0.1, turn, 0.0));
        StampedPose {
            timestamp,
            world_from_camera: Pose::new(rotation, Vec3::new(x, 0.0, 2.0 * x)),
        }
    }

    #[test]
    fn the_path_meets_its_views_and_is_straight_between_even_ones() {
        let views: Vec<_> =
            (0..4).map(|i| view(5.0 + f64::from(i), 0.4 * f64::from(i), f64::from(i))).collect();
        let path = path_through(&views, 10.0);
        assert_eq!(path.len(), 31);
        for (i, view) in views.iter().enumerate() {
            let off = path[10 * i].local(view.world_from_camera).to_array();
            assert!(off.iter().all(|v| v.abs() < 1e-9), "{off:?}");
        }
        for (i, pose) in path.iter().enumerate() {
            let off = pose.translation - Vec3::new(1.0, 0.0, 2.0) * (0.1 * i as f64);
            assert!(off.norm() < 1e-9, "{i}: {off:?}");
        }
    }

    #[test]
    fn speed_does_not_jump_at_a_view() {
        let views =
            [view(0.0, 0.0, 0.0), view(1.0, 0.5, 1.0), view(3.0, -0.2, 1.5), view(3.5, 0.0, 0.0)];
        let path = path_through(&views, 10_000.0);
        for at in [10_000, 30_000] {
            let step = |i: usize| path[i].translation - path[i - 1].translation;
            assert!((step(at + 1) - step(at)).norm() < 1e-6, "{:?} {:?}", step(at), step(at + 1));
        }
        assert_eq!(path_through(&[], 30.0).len(), 0);
        assert_eq!(path_through(&views[..1], 30.0).len(), 1);
    }
}
