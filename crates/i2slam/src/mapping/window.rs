//! Keyframes that a mapping step is taken on.

use super::keyframe::Keyframe;
use crate::reconstruction::FrameEstimate;
use i2slam_compute::Random;
use i2slam_geometry::{Camera, Image, Vec3};

/// Pixels of the current frame that are looked up in every keyframe (SplaTAM).
const PROBES: usize = 1600;
/// Border of a keyframe that does not count, as a share of its width (SplaTAM: 20 px of 640).
const BORDER: f64 = 20.0 / 640.0;

/// The current frame, the last keyframe before it (in mid-sequence where there is none, the first after
/// it), and others that see part of the frame (SplaTAM's rule).
pub(super) fn overlapping_window(
    keyframes: &[Keyframe],
    current: &Keyframe,
    frames: &[FrameEstimate],
    camera: &Camera<f64>,
    size: usize,
    random: &mut Random,
) -> Vec<Keyframe> {
    let mut window = vec![current.clone()];
    let mut others: Vec<&Keyframe> =
        keyframes.iter().filter(|k| k.frame != current.frame).collect();
    if others.is_empty() {
        return window;
    }
    let last = others.partition_point(|k| k.frame < current.frame).saturating_sub(1);
    let last = others.remove(last);
    if size > 1 {
        window.push(last.clone());
    }
    let points = random_points(current, frames, camera, random);
    let mut overlapping: Vec<&Keyframe> =
        others.into_iter().filter(|k| sees_any(&frames[k.frame], camera, &points)).collect();
    random.shuffle(&mut overlapping);
    window.extend(overlapping.into_iter().take(size.saturating_sub(2)).cloned());
    window
}

/// The current frame if there is one, the last keyframe, and others drawn from all, `size` in all.
pub(super) fn recent_window(
    keyframes: &[Keyframe],
    current: Option<&Keyframe>,
    size: usize,
    random: &mut Random,
) -> Vec<Keyframe> {
    let mut window: Vec<Keyframe> = current.into_iter().cloned().collect();
    let is_current = |k: &Keyframe| current.is_some_and(|current| k.frame == current.frame);
    let mut others: Vec<&Keyframe> = keyframes.iter().filter(|k| !is_current(k)).collect();
    if window.len() < size {
        window.extend(others.pop().cloned());
    }
    random.shuffle(&mut others);
    let missing = size.saturating_sub(window.len());
    window.extend(others.into_iter().take(missing).cloned());
    window
}

/// `size` keyframes drawn from all.
pub(super) fn random_window(
    keyframes: &[Keyframe],
    size: usize,
    random: &mut Random,
) -> Vec<Keyframe> {
    let mut order: Vec<&Keyframe> = keyframes.iter().collect();
    random.shuffle(&mut order);
    order.into_iter().take(size).cloned().collect()
}

/// `count` recorded pixels of an image of `size` pixels, drawn with replacement.
pub(super) fn random_pixels(
    size: usize,
    count: usize,
    valid_mask: Option<&Image<bool>>,
    random: &mut Random,
) -> Vec<usize> {
    let recorded = |pixel: &usize| valid_mask.is_none_or(|valid_mask| valid_mask.data[*pixel]);
    (0..count).map(|_| random.below(size)).filter(recorded).collect()
}

/// Random surface points of the current frame, in the world.
fn random_points(
    current: &Keyframe,
    frames: &[FrameEstimate],
    camera: &Camera<f64>,
    random: &mut Random,
) -> Vec<Vec3<f64>> {
    let observation = current.observation.get();
    let depth = &observation.depth.data;
    let valid: Vec<usize> = (0..depth.len()).filter(|&i| depth[i] > 0.0).collect();
    if valid.is_empty() {
        return Vec::new();
    }
    let pose = frames[current.frame].middle();
    (0..PROBES)
        .map(|_| {
            let pixel = valid[random.below(valid.len())];
            let (u, v) = Camera::<f64>::pixel_centre(pixel % camera.width, pixel / camera.width);
            pose * camera.unproject(u, v, f64::from(depth[pixel]))
        })
        .collect()
}

fn sees_any(frame: &FrameEstimate, camera: &Camera<f64>, points: &[Vec3<f64>]) -> bool {
    let camera_from_world = frame.middle().inverse();
    let border = BORDER * camera.width as f64;
    points.iter().any(|&point_in_world| {
        let point = camera_from_world * point_in_world;
        point.z > 0.0 && {
            let (u, v) = camera.project(point);
            camera.contains(u, v, border)
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mapping::AdjacentFrames;
    use crate::objective::Observation;
    use i2slam_formation::ShutterPoses;
    use i2slam_geometry::Pose;
    use i2slam_storage::ScratchStore;

    /// In mid-sequence the neighbour of a frame is the keyframe before it.
    #[test]
    fn a_window_has_the_keyframe_before_its_frame() {
        let camera = Camera { width: 8, height: 8, fx: 8.0, fy: 8.0, cx: 4.0, cy: 4.0 };
        let blank = Observation::new(Image::new(8, 8, 3), Image::new(8, 8, 1));
        let observation = ScratchStore::in_memory().insert(blank);
        let adjacent = AdjacentFrames::default();
        let keyframe = |frame| Keyframe::new(frame, observation.clone(), adjacent);
        let still = ShutterPoses::still(Pose::identity());
        let frames: Vec<FrameEstimate> =
            (0..6).map(|index| FrameEstimate::at_pose(index, 0.0, still)).collect();
        let window = |known: &[usize], current: usize| -> Vec<usize> {
            let known: Vec<Keyframe> = known.iter().copied().map(keyframe).collect();
            let (current, mut random) = (keyframe(current), Random::new(1));
            let window = overlapping_window(&known, &current, &frames, &camera, 2, &mut random);
            window.iter().map(|keyframe| keyframe.frame).collect()
        };
        assert_eq!(window(&[0, 2, 4, 5], 5), [5, 4]);
        assert_eq!(window(&[0, 2, 4, 5], 3), [3, 2]);
        assert_eq!(window(&[0, 2, 4, 5], 2), [2, 0]);
        assert_eq!(window(&[0, 2, 4, 5], 0), [0, 2]);
        assert_eq!(window(&[], 0), [0]);
    }
}
