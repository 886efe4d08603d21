//! Plane sweep: matching costs of a keyframe with its neighbours at given inverse depths.

use super::window_correlation::WindowStatistics;
use i2slam_geometry::{Camera, Image, Pose, Vec3};
use rayon::prelude::*;

/// Labels that are compared in parallel, which bounds the planes in memory.
const LABELS_PER_BATCH: usize = 16;

/// A neighbour's picture: a pixel `(u, v)` of the keyframe at inverse depth `ρ` projects to `turn
/// (u, v, 1) + ρ shift`, in homogeneous pixels.
struct Neighbour<'a> {
    image: &'a Image<f32>,
    turn: [Vec3<f32>; 3],
    shift: Vec3<f32>,
}

/// A keyframe and its neighbours on one pyramid level.
pub(super) struct PlaneSweep<'a> {
    windows: WindowStatistics,
    neighbours: Vec<Neighbour<'a>>,
}

/// Matching costs of every pixel and label: `values[pixel * labels + label]`, in [0, 1].
pub(super) struct CostVolume {
    pub(super) values: Vec<f32>,
    pub(super) labels: usize,
}

impl CostVolume {
    /// The costs of a pixel.
    pub(super) fn of(&self, pixel: usize) -> &[f32] {
        &self.values[pixel * self.labels..(pixel + 1) * self.labels]
    }
}

impl<'a> PlaneSweep<'a> {
    /// `others`: brightness, and `other_from_keyframe`. All have the intrinsics of `camera`.
    pub(super) fn new(
        camera: &Camera<f64>,
        keyframe: &Image<f32>,
        half_window: usize,
        others: &[(&'a Image<f32>, Pose<f64>)],
    ) -> Self {
        let neighbour = |(image, pose): &(&'a Image<f32>, Pose<f64>)| {
            let pixels = |p: Vec3<f64>| {
                Vec3::new(camera.fx * p.x + camera.cx * p.z, camera.fy * p.y + camera.cy * p.z, p.z)
            };
            let column = |u: f64, v: f64| pixels(pose.rotation.rotate(camera.unproject(u, v, 1.0)));
            let origin = column(0.0, 0.0);
            let turn = [column(1.0, 0.0) - origin, column(0.0, 1.0) - origin, origin];
            Neighbour { image, turn: turn.map(Vec3::cast), shift: pixels(pose.translation).cast() }
        };
        Self {
            windows: WindowStatistics::new(keyframe.clone(), half_window),
            neighbours: others.iter().map(neighbour).collect(),
        }
    }

    /// Costs at `inverse_depth(pixel) + offset` for each of the offsets.
    pub(super) fn costs(
        &self,
        inverse_depth: impl Fn(usize) -> f32 + Sync,
        offsets: &[f32],
    ) -> CostVolume {
        let labels = offsets.len();
        let mut values = vec![0.0; labels * self.windows.image.data.len()];
        for (begin, some) in (0..).step_by(LABELS_PER_BATCH).zip(offsets.chunks(LABELS_PER_BATCH)) {
            let plane =
                |offset: &f32| self.mean_plane_costs(&|pixel| inverse_depth(pixel) + offset);
            let planes: Vec<Vec<f32>> = some.par_iter().map(plane).collect();
            values.par_chunks_exact_mut(labels).enumerate().for_each(|(pixel, costs)| {
                let costs = costs[begin..].iter_mut().zip(&planes);
                costs.for_each(|(cost, plane)| *cost = plane[pixel]);
            });
        }
        CostVolume { values, labels }
    }

    /// Mean cost of the better half of the neighbours that see a pixel; in the others it may be
    /// occluded.
    fn mean_plane_costs(&self, inverse_depth: &dyn Fn(usize) -> f32) -> Vec<f32> {
        let pixels = self.windows.image.data.len();
        let each: Vec<Vec<f32>> =
            self.neighbours.iter().map(|n| self.neighbour_costs(n, inverse_depth)).collect();
        let mut sorted = Vec::with_capacity(each.len());
        (0..pixels)
            .map(|i| {
                sorted.clear();
                sorted.extend(each.iter().map(|costs| costs[i]).filter(|cost| *cost <= 1.0));
                sorted.sort_unstable_by(f32::total_cmp);
                let half = sorted.len().div_ceil(2);
                if half == 0 { 1.0 } else { sorted[..half].iter().sum::<f32>() / half as f32 }
            })
            .collect()
    }

    /// Costs of one neighbour; above 1 where it does not see the pixel.
    fn neighbour_costs(
        &self,
        neighbour: &Neighbour<'_>,
        inverse_depth: &dyn Fn(usize) -> f32,
    ) -> Vec<f32> {
        let (warp_to_keyframe, shown) = neighbour.warp_to_keyframe(inverse_depth);
        let mut costs = self.windows.costs(&warp_to_keyframe);
        costs.iter_mut().zip(shown).filter(|(_, shown)| !shown).for_each(|(cost, _)| *cost = 2.0);
        costs
    }
}

impl Neighbour<'_> {
    /// The neighbour's picture warped to the keyframe, its border repeated, and whether it sees the
    /// pixel.
    fn warp_to_keyframe(&self, inverse_depth: &dyn Fn(usize) -> f32) -> (Vec<f32>, Vec<bool>) {
        let (width, height) = (self.image.width, self.image.height);
        let (right, low) = ((width - 1) as f32 - 1e-3, (height - 1) as f32 - 1e-3);
        let [by_u, by_v, origin] = self.turn;
        let mut values = Vec::with_capacity(width * height);
        let mut shown = Vec::with_capacity(width * height);
        for row in 0..height {
            let start = origin + by_v * (row as f32 + 0.5);
            for column in 0..width {
                let rho = inverse_depth(row * width + column);
                let q = start + by_u * (column as f32 + 0.5) + self.shift * rho;
                let scale = 1.0 / q.z.max(1e-6);
                let (x, y) = (q.x * scale - 0.5, q.y * scale - 0.5);
                shown.push(q.z > 1e-6 && x >= 0.0 && y >= 0.0 && x <= right && y <= low);
                let (x, y) = (x.clamp(0.0, right), y.clamp(0.0, low));
                let (left, top) = (x as usize, y as usize);
                let (dx, dy) = (x - left as f32, y - top as f32);
                let at = top * width + left;
                let pixel = &self.image.data;
                let upper = pixel[at] + (pixel[at + 1] - pixel[at]) * dx;
                let below = at + width;
                let lower = pixel[below] + (pixel[below + 1] - pixel[below]) * dx;
                values.push(upper + (lower - upper) * dy);
            }
        }
        (values, shown)
    }
}
