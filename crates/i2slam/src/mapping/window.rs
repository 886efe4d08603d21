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
    let depth = &current.observation.depth.data;
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
