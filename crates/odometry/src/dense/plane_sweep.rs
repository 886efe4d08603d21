//! Plane sweep: costs of inverse depths by zero-mean normalised correlation of windows.

use i2slam_geometry::{Camera, Image, Pose, Vec3};
use rayon::prelude::*;

/// Labels that are compared in parallel, which bounds the planes in memory.
const LABELS_PER_BATCH: usize = 16;

/// A picture in which pixel `(u, v)` at inverse depth `ρ` is at `turn (u, v, 1) + ρ shift`.
struct SweptView<'a> {
    image: &'a Image<f32>,
    turn: [Vec3<f32>; 3],
    shift: Vec3<f32>,
}

/// A keyframe and its neighbours on one pyramid level.
pub(super) struct PlaneSweep<'a> {
    windows: WindowStatistics,
    neighbours: Vec<SweptView<'a>>,
}

/// Matching costs of every pixel and label: `values[pixel * labels + label]`, in [0, 1].
pub(super) struct CostVolume {
    pub(super) values: Vec<f32>,
    pub(super) labels: usize,
}

impl CostVolume {
    /// The costs of a pixel.
    pub(super) fn costs_at(&self, pixel: usize) -> &[f32] {
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
            SweptView { image, turn: turn.map(Vec3::cast), shift: pixels(pose.translation).cast() }
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

    /// Mean cost of the better half of the neighbours that see a pixel: others may be occluded.
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
        neighbour: &SweptView<'_>,
        inverse_depth: &dyn Fn(usize) -> f32,
    ) -> Vec<f32> {
        let (warp_to_keyframe, shown) = neighbour.warp_to_keyframe(inverse_depth);
        let mut costs = self.windows.costs(&warp_to_keyframe);
        costs.iter_mut().zip(shown).filter(|(_, shown)| !shown).for_each(|(cost, _)| *cost = 2.0);
        costs
    }
}

impl SweptView<'_> {
    /// The neighbour's picture warped to the keyframe, and whether it sees each pixel.
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

/// Variance of noise in a window of an 8-bit picture: windows with less contrast match nothing.
const WINDOW_NOISE_VARIANCE: f32 = 5e-5;

/// A picture with mean and deviation of the window around every pixel.
struct WindowStatistics {
    image: Image<f32>,
    means: Vec<f32>,
    /// `1 / √(variance + noise)`.
    sharpness: Vec<f32>,
    half: usize,
}

impl WindowStatistics {
    /// Windows of `2 half + 1` pixels a side.
    fn new(image: Image<f32>, half: usize) -> Self {
        let (width, height) = (image.width, image.height);
        let squares: Vec<f32> = image.data.iter().map(|v| v * v).collect();
        let means = window_means(&image.data, width, height, half);
        let squares = window_means(&squares, width, height, half);
        let sharpness = means.iter().zip(squares).map(|(m, s)| inverse_deviation(*m, s)).collect();
        Self { image, means, sharpness, half }
    }

    /// Costs `1 - correlation` with the windows of another picture, in [0, 1]; 1 for flat ones.
    fn costs(&self, other: &[f32]) -> Vec<f32> {
        let (width, height) = (self.image.width, self.image.height);
        let squares: Vec<f32> = other.iter().map(|v| v * v).collect();
        let products: Vec<f32> = other.iter().zip(&self.image.data).map(|(a, b)| a * b).collect();
        let [means, squares, products] =
            [other, &squares, &products].map(|plane| window_means(plane, width, height, self.half));
        (0..width * height)
            .map(|i| {
                let covariance = products[i] - self.means[i] * means[i];
                let spread = self.sharpness[i] * inverse_deviation(means[i], squares[i]);
                (1.0 - covariance * spread).clamp(0.0, 1.0)
            })
            .collect()
    }
}

fn inverse_deviation(mean: f32, mean_square: f32) -> f32 {
    ((mean_square - mean * mean).max(0.0) + WINDOW_NOISE_VARIANCE).sqrt().recip()
}

/// Window means; the border value is repeated beyond the border.
fn window_means(plane: &[f32], width: usize, height: usize, half: usize) -> Vec<f32> {
    let side = 2 * half + 1;
    let mut rows = vec![0.0; plane.len()];
    for (from, to) in plane.chunks_exact(width).zip(rows.chunks_exact_mut(width)) {
        let padded = |i: usize| from[i.saturating_sub(half).min(width - 1)];
        for (column, sum) in to.iter_mut().enumerate() {
            let inside = column >= half && column + half < width;
            *sum = match inside {
                true => from[column - half..=column + half].iter().sum(),
                false => (column..column + side).map(padded).sum(),
            };
        }
    }
    let scale = 1.0 / (side * side) as f32;
    let mut out = vec![0.0; plane.len()];
    for (row, to) in out.chunks_exact_mut(width).enumerate() {
        for k in row..row + side {
            let from = k.saturating_sub(half).min(height - 1) * width;
            to.iter_mut().zip(&rows[from..from + width]).for_each(|(sum, value)| *sum += value);
        }
        to.iter_mut().for_each(|sum| *sum *= scale);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(of: impl Fn(f32, f32) -> f32) -> Image<f32> {
        Image::from_fn(24, 18, 1, |_, x, y| of(x as f32, y as f32))
    }

    #[test]
    fn gain_and_bias_change_nothing_and_flat_windows_say_nothing() {
        let wave = |x: f32, y: f32| 0.5 + 0.3 * (0.9 * x).sin() * (0.7 * y).cos();
        let windows = WindowStatistics::new(picture(wave), 2);
        let brighter = picture(|x, y| 0.1 + 0.6 * wave(x, y));
        assert!(windows.costs(&brighter.data).iter().all(|c| *c < 0.02));
        let shifted = picture(|x, y| wave(x + 2.0, y));
        assert!(windows.costs(&shifted.data).iter().sum::<f32>() > 0.5 * 24.0 * 18.0);
        assert!(windows.costs(&picture(|_, _| 0.4).data).iter().all(|c| *c > 0.9));
    }

    #[test]
    fn means_repeat_the_border() {
        let plane = picture(|x, _| x);
        let means = window_means(&plane.data, 24, 18, 2);
        assert!((means[0] - 0.6).abs() < 1e-5 && (means[5 * 24 + 10] - 10.0).abs() < 1e-5);
    }
}
