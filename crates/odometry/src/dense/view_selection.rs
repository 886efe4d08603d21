//! Selection of the keyframes that a keyframe is matched with.

use super::patch_match::MAX_VIEWS;
use i2slam_geometry::{Camera, Pose};

/// Best parallax [rad]: less is imprecise, more shows other surfaces.
const BEST_PARALLAX: f64 = 0.1;
/// Limits of the views that a keyframe is matched with, and compared with for consistency.
#[derive(Clone, Copy)]
pub(super) struct ViewLimits {
    /// Their number, at most.
    count: usize,
    /// Smallest ratio of the picture that both see.
    overlap: f64,
}

/// Those of keyframes of a film.
pub(super) const KEYFRAMES: ViewLimits = ViewLimits { count: 5, overlap: 0.5 };
/// Those of photographs: less is seen by two, and more of it from elsewhere.
pub(super) const PHOTOGRAPHS: ViewLimits = ViewLimits { count: MAX_VIEWS, overlap: 0.3 };

/// The most useful of `others` for a keyframe whose median depth is `depth`, best first.
pub(super) fn select_views(
    camera: &Camera<f64>,
    keyframe: Pose<f64>,
    others: &[(usize, Pose<f64>)],
    depth: f64,
    limits: ViewLimits,
) -> Vec<usize> {
    let worth = |pose: &Pose<f64>| {
        let parallax = (pose.translation - keyframe.translation).norm() / depth;
        let overlap = overlap_ratio(camera, keyframe, *pose, depth);
        let ratio = parallax / BEST_PARALLAX;
        (overlap >= limits.overlap).then(|| overlap * ratio.min(ratio.recip()).max(0.0))
    };
    let mut worths: Vec<(f64, usize)> =
        others.iter().filter_map(|(index, pose)| Some((worth(pose)?, *index))).collect();
    worths.retain(|(worth, _)| *worth > 0.0);
    worths.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    worths.truncate(limits.count);
    worths.into_iter().map(|(_, index)| index).collect()
}

/// Ratio of a picture at one depth that another camera sees.
pub(crate) fn overlap_ratio(
    camera: &Camera<f64>,
    from: Pose<f64>,
    to: Pose<f64>,
    depth: f64,
) -> f64 {
    let to_from = to.inverse() * from;
    let mut seen = 0;
    for i in 0..64 {
        let u = (f64::from(i % 8) + 0.5) / 8.0 * camera.width as f64;
        let v = (f64::from(i / 8) + 0.5) / 8.0 * camera.height as f64;
        let point = to_from * camera.unproject(u, v, depth);
        let (u, v) = camera.project(point);
        seen += i32::from(point.z > 0.0 && camera.contains(u, v, 0.0));
    }
    f64::from(seen) / 64.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_geometry::{Rotation, Vec3};

    #[test]
    fn parallax_is_wanted_and_overlap_needed() {
        let camera = Camera { width: 160, height: 120, fx: 130.0, fy: 130.0, cx: 80.0, cy: 60.0 };
        let at = |x: f64, turn: f64| {
            Pose::new(Rotation::exp(Vec3::new(0.0, turn, 0.0)), Vec3::new(x, 0.0, 0.0))
        };
        let others = [
            (1, at(0.02, 0.0)),
            (2, at(0.25, 0.0)),
            (3, at(0.25, 1.5)),
            (4, at(0.2, 0.0)),
            (5, at(0.0, 0.0)),
        ];
        let three = ViewLimits { count: 3, overlap: 0.5 };
        assert_eq!(select_views(&camera, at(0.0, 0.0), &others, 2.0, three), [4, 2, 1]);
    }
}
