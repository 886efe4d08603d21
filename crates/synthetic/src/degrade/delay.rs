//! Depth of another moment than its stamp says.

use super::refuse;
use crate::error::SyntheticError;
use i2slam_dataset::Sequence;
use i2slam_geometry::{Camera, Image, Pose, Trajectory, interpolate_pose, nearest_stamp};
use std::sync::Arc;

/// Times that are nearer than this are the same [s]: lists are written in microseconds.
const SAME_TIME: f64 = 2e-6;
/// Most fixed-point steps for one pixel.
const STEPS: usize = 12;
/// A step of depth below this share of it ends the search.
const CONVERGED: f64 = 1e-5;
/// Largest distance between a pixel and where its depth lands [px].
const LANDED: f64 = 0.5;
/// Neighbours whose depth differs by more than this share are not averaged.
const EDGE: f32 = 0.05;

/// Depth pictures of a sequence at any moment: with true poses the nearest picture in time, carried
/// to the moment by the camera's true motion between; else the nearest picture as it is.
pub(super) struct DepthAtTime {
    /// Stamps of depth [s], with their frames; in order of time.
    stamps: Vec<f64>,
    frames: Vec<usize>,
    /// Empty if no poses are known.
    poses: Trajectory,
}

impl DepthAtTime {
    pub(super) fn new(sequence: &Sequence, delay: f64) -> Result<Self, SyntheticError> {
        let entries = sequence.entries.iter().enumerate();
        let mut known: Vec<(f64, usize)> =
            entries.filter_map(|(i, entry)| Some((entry.depth.as_ref()?.timestamp, i))).collect();
        known.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (stamps, frames): (Vec<f64>, Vec<usize>) = known.into_iter().unzip();
        let mut poses = sequence.true_trajectory()?;
        poses.dedup_by_key(|pose| pose.timestamp);
        if poses.len() < 2 {
            poses.clear();
        }
        let all = Self { stamps, frames, poses };
        let moved = |&stamp: &f64| all.nearest(stamp) != all.nearest(stamp - delay);
        if all.poses.is_empty() && delay != 0.0 && !all.stamps.iter().any(moved) {
            let expected = "at least half the time between two depth pictures: the sequence has no \
                            true poses by which depth could be carried over less";
            return refuse("delay of depth", format!("{} ms", delay * 1e3), expected);
        }
        Ok(all)
    }

    fn nearest(&self, time: f64) -> usize {
        nearest_stamp(&self.stamps, time, f64::INFINITY).unwrap_or_default()
    }

    /// Depth at a time [s].
    pub(super) fn load(
        &self,
        sequence: &Sequence,
        time: f64,
    ) -> Result<Arc<Image<f32>>, SyntheticError> {
        let nearest = self.nearest(time);
        let depth = self.frames.get(nearest).map(|&frame| sequence.load(frame)).transpose()?;
        let Some(depth) = depth.and_then(|frame| frame.depth) else { return Ok(Arc::default()) };
        let depth = depth.image;
        if self.poses.is_empty() || (self.stamps[nearest] - time).abs() < SAME_TIME {
            return Ok(depth);
        }
        let at = |time: f64| interpolate_pose(&self.poses, time).unwrap_or_else(Pose::identity);
        let (then, now) = (at(self.stamps[nearest]), at(time));
        Ok(Arc::new(warp(&depth, &sequence.camera, then.inverse() * now)))
    }
}

/// Depth seen by another camera: for every pixel the depth z at which its ray meets the surface of
/// the source, by fixed-point iteration; 0 where it meets none. Of several the nearest counts.
fn warp(depth: &Image<f32>, camera: &Camera<f64>, source_from_target: Pose<f64>) -> Image<f32> {
    let target_from_source = source_from_target.inverse();
    let mut out = Image::new(depth.width, depth.height, 1);
    for row in 0..depth.height {
        for column in 0..depth.width {
            let (u, v) = Camera::<f64>::pixel_centre(column, row);
            let ray = camera.unproject(u, v, 1.0);
            let meet = |start: f32| -> Option<f64> {
                let mut z = f64::from(start);
                for _ in 0..STEPS {
                    let point = source_from_target * (ray * z);
                    let (x, y) = (point.z > 1e-6).then(|| camera.project(point))?;
                    let found = camera.unproject(x, y, surface_depth(depth, x, y)?);
                    let landed = target_from_source * found;
                    let step = (landed.z - z).abs();
                    z = landed.z;
                    if z <= 1e-6 {
                        return None;
                    }
                    if step < CONVERGED * z {
                        let (x, y) = camera.project(landed);
                        return ((x - u).hypot(y - v) < LANDED).then_some(z);
                    }
                }
                None
            };
            // Neighbours' results reach surfaces that the same pixel of the source does not show.
            let left = column.checked_sub(1).map_or(0.0, |x| out.at(0, x, row));
            let above = row.checked_sub(1).map_or(0.0, |y| out.at(0, column, y));
            let starts = [depth.at(0, column, row), left, above];
            let met = starts.into_iter().filter(|&z| z > 0.0).filter_map(meet);
            out.data[row * depth.width + column] = met.min_by(f64::total_cmp).unwrap_or(0.0) as f32;
        }
    }
    out
}

/// Depth at a position between pixel centres: inverse depth interpolated on a surface, the nearest
/// pixel's depth beside an edge or a hole; `None` without a reading.
fn surface_depth(depth: &Image<f32>, u: f64, v: f64) -> Option<f64> {
    let tap = depth.tap(u as f32, v as f32)?;
    let nearest = Some(depth.at(0, u as usize, v as usize)).filter(|&z| z > 0.0)?;
    let around = tap.values(depth.plane(0));
    let is_surface = around.iter().all(|&z| (z - nearest).abs() < EDGE * nearest);
    let interpolated = || tap.interpolate(around.map(f32::recip)).0.recip();
    Some(f64::from(if is_surface { interpolated() } else { nearest }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_geometry::{Rotation, Vec3};

    const CAMERA: Camera<f64> =
        Camera { width: 80, height: 60, fx: 70.0, fy: 70.0, cx: 40.0, cy: 30.0 };

    /// Depth of the plane `normal · p = distance` of the world from a pose, 0 behind it.
    fn plane(world_from_camera: Pose<f64>, normal: Vec3<f64>, distance: f64) -> Image<f32> {
        Image::from_fn(80, 60, 1, |_, column, row| {
            let (u, v) = Camera::<f64>::pixel_centre(column, row);
            let ray = world_from_camera.rotation.rotate(CAMERA.unproject(u, v, 1.0));
            let z = (distance - normal.dot(world_from_camera.translation)) / normal.dot(ray);
            z.max(0.0) as f32
        })
    }

    #[test]
    fn depth_is_carried_by_the_motion_of_the_camera() {
        let normal = Vec3::new(0.3, -0.2, 1.0);
        let then = Pose::new(Rotation::identity(), Vec3::zero());
        let turned = Rotation::exp(Vec3::new(0.03, -0.05, 0.02));
        let now = Pose::new(turned, Vec3::new(0.04, -0.02, 0.06));
        let (source, due) = (plane(then, normal, 2.0), plane(now, normal, 2.0));
        let found = warp(&source, &CAMERA, then.inverse() * now);
        let (mut seen, mut largest) = (0, 0.0_f32);
        for (&z, &true_z) in found.data.iter().zip(&due.data).filter(|(z, _)| **z > 0.0) {
            seen += 1;
            largest = largest.max((z - true_z).abs());
        }
        assert!(seen > 4100 && seen < 4800, "{seen} of 4800");
        assert!(largest < 2e-3, "{largest}");
        let unmoved = source.data.iter().zip(&due.data).map(|(a, b)| (a - b).abs());
        assert!(unmoved.fold(0.0, f32::max) > 0.1, "the motion shows in depth");
    }

    #[test]
    fn what_the_source_hides_has_no_reading() {
        // A near wall left of the middle; the camera moves left and sees behind its edge.
        let source = Image::from_fn(80, 60, 1, |_, column, _| if column < 40 { 1.0 } else { 2.0 });
        let moved = Pose::new(Rotation::identity(), Vec3::new(0.2, 0.0, 0.0));
        let found = warp(&source, &CAMERA, moved);
        // The edge at 40 moves by 14 px at 1 m, by 7 px at 2 m.
        assert_eq!([10, 24, 34, 60].map(|column| found.at(0, column, 30)), [1.0, 1.0, 2.0, 2.0]);
        assert_eq!(found.at(0, 29, 30), 0.0, "uncovered");
    }
}
