//! Plane sweep: costs of inverse depths by zero-mean normalised correlation of windows.

use super::cost_filter::CostFilter;
use i2slam_geometry::{Camera, Image, Pose, Vec3};
use pulp::Arch;
use rayon::prelude::*;

/// Labels that are compared in parallel, which bounds the planes in memory.
const LABELS_PER_BATCH: usize = 16;

/// A picture in which pixel `(u, v)` at inverse depth `ρ` is at `turn (u, v, 1) + ρ shift`.
pub(super) struct SweptView<'a> {
    pub(super) image: &'a Image<f32>,
    /// Columns of `turn`.
    pub(super) turn: [Vec3<f32>; 3],
    pub(super) shift: Vec3<f32>,
}

/// Windows that are compared.
#[derive(Clone, Copy)]
pub(super) struct MatchingWindow {
    /// Half the side [px].
    pub(super) half: usize,
    /// Variance added to that of a window: less contrast lowers its correlation.
    pub(super) noise_variance: f32,
}

/// A keyframe and its neighbours on one pyramid level.
pub(super) struct PlaneSweep<'a> {
    windows: WindowStatistics<'a>,
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
        keyframe: &'a Image<f32>,
        window: MatchingWindow,
        others: &[(&'a Image<f32>, Pose<f64>)],
    ) -> Self {
        Self {
            windows: WindowStatistics::new(keyframe, window),
            neighbours: others.iter().map(|(o, pose)| SweptView::new(camera, o, pose)).collect(),
        }
    }

    /// Filtered costs at `inverse_depth + offset` for each of the offsets; one inverse depth per pixel.
    pub(super) fn costs(&self, inverse_depth: &[f32], offsets: &[f32]) -> CostVolume {
        let (labels, arch) = (offsets.len(), Arch::new());
        let filter = CostFilter::new(self.windows.image);
        let mut values = vec![0.0; labels * self.windows.image.data.len()];
        for (begin, some) in (0..).step_by(LABELS_PER_BATCH).zip(offsets.chunks(LABELS_PER_BATCH)) {
            let plane =
                |offset: &f32| self.mean_plane_costs(arch, &filter, (inverse_depth, *offset));
            let planes: Vec<Vec<f32>> = some.par_iter().map(plane).collect();
            values.par_chunks_exact_mut(labels).enumerate().for_each(|(pixel, costs)| {
                let costs = costs[begin..].iter_mut().zip(&planes);
                costs.for_each(|(cost, plane)| *cost = plane[pixel]);
            });
        }
        CostVolume { values, labels }
    }

    /// Costs of each neighbour at one inverse depth per pixel; above 1 where it does not see a pixel.
    pub(super) fn neighbour_costs(&self, inverse_depth: &[f32]) -> Vec<Vec<f32>> {
        let (mut scratch, arch) = (Scratch::default(), Arch::new());
        let each = self.neighbours.iter();
        each.map(|n| self.plane_costs(arch, n, (inverse_depth, 0.0), &mut scratch)).collect()
    }

    /// Costs of a neighbour, [`UNSEEN`] where it does not see a pixel.
    fn plane_costs(
        &self,
        arch: Arch,
        neighbour: &SweptView<'_>,
        (inverse_depth, offset): (&[f32], f32),
        scratch: &mut Scratch,
    ) -> Vec<f32> {
        let mut costs = vec![0.0; inverse_depth.len()];
        arch.dispatch(|| {
            neighbour.warp_to_keyframe(inverse_depth, offset, scratch);
            self.windows.write_costs(scratch, &mut costs);
        });
        costs
    }

    /// Mean cost of the better half of the neighbours that see a pixel, as others may be occluded; then
    /// filtered.
    fn mean_plane_costs(
        &self,
        arch: Arch,
        filter: &CostFilter<'_>,
        (inverse_depth, offset): (&[f32], f32),
    ) -> Vec<f32> {
        let mut scratch = Scratch::default();
        let mut cost = |neighbour: &SweptView<'_>| {
            self.plane_costs(arch, neighbour, (inverse_depth, offset), &mut scratch)
        };
        let each: Vec<Vec<f32>> = self.neighbours.iter().map(&mut cost).collect();
        let mut mean = vec![0.0; inverse_depth.len()];
        arch.dispatch(|| {
            write_means_of_better_half(&each, &mut mean);
            filter.apply(&mut mean);
        });
        mean
    }
}

/// Buffers of the costs of one neighbour.
#[derive(Default)]
struct Scratch {
    /// The neighbour's picture warped to the keyframe, and whether it sees each pixel.
    warped: Vec<f32>,
    shown: Vec<bool>,
    /// Places in the neighbour's picture of a row of pixels [px].
    x: Vec<f32>,
    y: Vec<f32>,
    products: Vec<f32>,
    /// Window sums along rows.
    rows: Vec<f32>,
    /// Window means of the warped picture, its square, and its product with the keyframe.
    means: [Vec<f32>; 3],
}

/// Pixels that are sorted together.
const BLOCK: usize = 64;

/// Cost of a neighbour that does not see the pixel: above all others.
pub(super) const UNSEEN: f32 = 2.0;

/// Writes the mean over the better half of the costs of each pixel, 1 where no neighbour sees it.
#[inline(always)]
fn write_means_of_better_half(each: &[Vec<f32>], mean: &mut [f32]) {
    let mut sorted = vec![[UNSEEN; BLOCK]; each.len()];
    for (block, mean) in mean.chunks_mut(BLOCK).enumerate() {
        let mut seen = [0.0; BLOCK];
        for (costs, sorted) in each.iter().zip(&mut sorted) {
            let costs = &costs[block * BLOCK..][..mean.len()];
            for i in 0..costs.len() {
                let is_seen = costs[i] <= 1.0;
                sorted[i] = if is_seen { costs[i] } else { UNSEEN };
                seen[i] += if is_seen { 1.0 } else { 0.0 };
            }
        }
        for last in 1..sorted.len() {
            for k in (0..last).rev() {
                let (lower, upper) = sorted.split_at_mut(k + 1);
                sort_pairs(&mut lower[k], &mut upper[0]);
            }
        }
        for i in 0..mean.len() {
            let half = (0.5_f32 * seen[i]).ceil();
            let mut sum = 0.0;
            for k in 0..sorted.len() {
                sum += if (k as f32) < half { sorted[k][i] } else { 0.0 };
            }
            mean[i] = if half > 0.0 { sum / half } else { 1.0 };
        }
    }
}

/// Puts the smaller of two numbers at each place into the first list.
#[inline(always)]
fn sort_pairs(lower: &mut [f32; BLOCK], upper: &mut [f32; BLOCK]) {
    for i in 0..BLOCK {
        let (a, b) = (lower[i], upper[i]);
        lower[i] = if a < b { a } else { b };
        upper[i] = if a < b { b } else { a };
    }
}

impl<'a> SweptView<'a> {
    /// A picture with `other_from_keyframe`; both have the intrinsics of `camera`.
    pub(super) fn new(camera: &Camera<f64>, image: &'a Image<f32>, pose: &Pose<f64>) -> Self {
        let pixels = |p: Vec3<f64>| {
            Vec3::new(camera.fx * p.x + camera.cx * p.z, camera.fy * p.y + camera.cy * p.z, p.z)
        };
        let column = |u: f64, v: f64| pixels(pose.rotation.rotate(camera.unproject(u, v, 1.0)));
        let origin = column(0.0, 0.0);
        let turn = [column(1.0, 0.0) - origin, column(0.0, 1.0) - origin, origin];
        Self { image, turn: turn.map(Vec3::cast), shift: pixels(pose.translation).cast() }
    }

    /// A pixel's point at an inverse depth, in homogeneous pixels of the view.
    pub(super) fn centre(&self, [column, row]: [usize; 2], inverse_depth: f32) -> Vec3<f32> {
        let [by_u, by_v, origin] = self.turn;
        let (u, v) = (column as f32 + 0.5, row as f32 + 0.5);
        origin + by_u * u + by_v * v + self.shift * inverse_depth
    }
    /// Writes the neighbour's picture warped to the keyframe, and whether it sees each pixel.
    #[inline(always)]
    fn warp_to_keyframe(&self, inverse_depth: &[f32], offset: f32, scratch: &mut Scratch) {
        let (width, height) = (self.image.width, self.image.height);
        let (right, low) = ((width - 1) as f32 - 1e-3, (height - 1) as f32 - 1e-3);
        let [by_u, by_v, origin] = self.turn;
        let Scratch { warped, shown, x, y, .. } = scratch;
        warped.resize(width * height, 0.0);
        shown.resize(width * height, false);
        x.resize(width, 0.0);
        y.resize(width, 0.0);
        for row in 0..height {
            let start = origin + by_v * (row as f32 + 0.5);
            let pixels = row * width..(row + 1) * width;
            let (depths, shown) = (&inverse_depth[pixels.clone()], &mut shown[pixels.clone()]);
            for column in 0..width {
                let rho = depths[column] + offset;
                let q = start + by_u * (column as f32 + 0.5) + self.shift * rho;
                let scale = 1.0 / q.z.max(1e-6);
                let (u, v) = (q.x * scale - 0.5, q.y * scale - 0.5);
                shown[column] = (q.z > 1e-6) & (u >= 0.0) & (v >= 0.0) & (u <= right) & (v <= low);
                (x[column], y[column]) = (u.clamp(0.0, right), v.clamp(0.0, low));
            }
            let (pixel, warped) = (&self.image.data, &mut warped[pixels]);
            for column in 0..width {
                let (left, top) = (x[column] as usize, y[column] as usize);
                let (dx, dy) = (x[column] - left as f32, y[column] - top as f32);
                let at = top * width + left;
                let upper = pixel[at] + (pixel[at + 1] - pixel[at]) * dx;
                let below = at + width;
                let lower = pixel[below] + (pixel[below + 1] - pixel[below]) * dx;
                warped[column] = upper + (lower - upper) * dy;
            }
        }
    }
}

/// A picture with mean and deviation of the window around every pixel.
struct WindowStatistics<'a> {
    image: &'a Image<f32>,
    means: Vec<f32>,
    /// `1 / √(variance + noise)`.
    sharpness: Vec<f32>,
    window: MatchingWindow,
}

impl<'a> WindowStatistics<'a> {
    fn new(image: &'a Image<f32>, window: MatchingWindow) -> Self {
        let (size, mut rows) = ((image.width, image.height), Vec::new());
        let squares: Vec<f32> = image.data.iter().map(|v| v * v).collect();
        let (mut means, mut mean_squares) = (Vec::new(), Vec::new());
        write_window_means(&image.data, size, window.half, &mut rows, &mut means);
        write_window_means(&squares, size, window.half, &mut rows, &mut mean_squares);
        let inverse_deviation =
            |(mean, square): (&f32, &f32)| window.inverse_deviation(*mean, *square);
        let sharpness = means.iter().zip(&mean_squares).map(inverse_deviation).collect();
        Self { image, means, sharpness, window }
    }

    /// Writes costs `1 - correlation` with the windows of a warped picture, in [0, 1]; 1 for flat
    /// ones, [`UNSEEN`] where it is not shown.
    #[inline(always)]
    fn write_costs(&self, scratch: &mut Scratch, costs: &mut [f32]) {
        let (size, count) = ((self.image.width, self.image.height), costs.len());
        let window = self.window;
        let Scratch { warped, shown, products, rows, means: [means, squares, crosses], .. } =
            scratch;
        products.resize(count, 0.0);
        write_window_means(warped, size, self.window.half, rows, means);
        for i in 0..count {
            products[i] = warped[i] * warped[i];
        }
        write_window_means(products, size, self.window.half, rows, squares);
        for i in 0..count {
            products[i] = warped[i] * self.image.data[i];
        }
        write_window_means(products, size, self.window.half, rows, crosses);
        let (means, squares, crosses) = (&means[..count], &squares[..count], &crosses[..count]);
        let (own, sharpness, shown) =
            (&self.means[..count], &self.sharpness[..count], &shown[..count]);
        for i in 0..count {
            let covariance = crosses[i] - own[i] * means[i];
            let spread = sharpness[i] * window.inverse_deviation(means[i], squares[i]);
            let cost = (1.0 - covariance * spread).clamp(0.0, 1.0);
            costs[i] = if shown[i] { cost } else { UNSEEN };
        }
    }
}

impl MatchingWindow {
    #[inline(always)]
    fn inverse_deviation(self, mean: f32, mean_square: f32) -> f32 {
        ((mean_square - mean * mean).max(0.0) + self.noise_variance).sqrt().recip()
    }
}

/// Writes window means; the border value is repeated beyond the border.
#[inline(always)]
pub(super) fn write_window_means(
    plane: &[f32],
    (width, height): (usize, usize),
    half: usize,
    rows: &mut Vec<f32>,
    out: &mut Vec<f32>,
) {
    let side = 2 * half + 1;
    let mut padded = vec![0.0; width + 2 * half];
    rows.resize(plane.len(), 0.0);
    for (from, to) in plane.chunks_exact(width).zip(rows.chunks_exact_mut(width)) {
        padded[..half].fill(from[0]);
        padded[half..half + width].copy_from_slice(from);
        padded[half + width..].fill(from[width - 1]);
        to.fill(0.0);
        for k in 0..side {
            let from = &padded[k..k + width];
            for i in 0..width {
                to[i] += from[i];
            }
        }
    }
    let scale = 1.0 / (side * side) as f32;
    out.resize(plane.len(), 0.0);
    for (row, to) in out.chunks_exact_mut(width).enumerate() {
        to.fill(0.0);
        for k in row..row + side {
            let from = &rows[k.saturating_sub(half).min(height - 1) * width..][..width];
            for i in 0..width {
                to[i] += from[i];
            }
        }
        for i in 0..width {
            to[i] *= scale;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_geometry::Tangent;

    fn picture(of: impl Fn(f32, f32) -> f32) -> Image<f32> {
        Image::from_fn(24, 18, 1, |_, x, y| of(x as f32, y as f32))
    }

    fn wave(x: f32, y: f32) -> f32 {
        0.5 + 0.3 * (0.9 * x).sin() * (0.7 * y).cos()
    }

    const WINDOW: MatchingWindow = MatchingWindow { half: 2, noise_variance: 5e-5 };

    fn costs(windows: &WindowStatistics<'_>, other: &Image<f32>) -> Vec<f32> {
        let shown = vec![true; other.data.len()];
        let mut scratch = Scratch { warped: other.data.clone(), shown, ..Scratch::default() };
        let mut costs = vec![0.0; other.data.len()];
        windows.write_costs(&mut scratch, &mut costs);
        costs
    }

    #[test]
    fn gain_and_bias_change_nothing_and_flat_windows_say_nothing() {
        let keyframe = picture(wave);
        let windows = WindowStatistics::new(&keyframe, WINDOW);
        let brighter = picture(|x, y| 0.1 + 0.6 * wave(x, y));
        assert!(costs(&windows, &brighter).iter().all(|c| *c < 0.02));
        let shifted = picture(|x, y| wave(x + 2.0, y));
        assert!(costs(&windows, &shifted).iter().sum::<f32>() > 0.5 * 24.0 * 18.0);
        assert!(costs(&windows, &picture(|_, _| 0.4)).iter().all(|c| *c > 0.9));
    }

    #[test]
    fn means_repeat_the_border() {
        let (plane, mut rows, mut means) = (picture(|x, _| x), Vec::new(), Vec::new());
        write_window_means(&plane.data, (24, 18), 2, &mut rows, &mut means);
        assert!((means[0] - 0.6).abs() < 1e-5 && (means[5 * 24 + 10] - 10.0).abs() < 1e-5);
    }

    const CAMERA: Camera<f64> =
        Camera { width: 24, height: 18, fx: 20.0, fy: 21.0, cx: 11.5, cy: 9.5 };

    /// Cost of one neighbour at a pixel, window pixel by window pixel; `None` where it is not seen.
    fn plain_cost(
        keyframe: &Image<f32>,
        (other, pose): (&Image<f32>, &Pose<f64>),
        rho: impl Fn(usize, usize) -> f64,
        (column, row): (usize, usize),
    ) -> Option<f64> {
        let place = |x: usize, y: usize| {
            let (u, v) = Camera::<f64>::pixel_centre(x, y);
            let ray: Vec3<f64> = CAMERA.unproject(u, v, 1.0);
            CAMERA.project(pose.rotation.rotate(ray) + pose.translation * rho(x, y))
        };
        let is_seen = |(u, v): (f64, f64)| {
            (0.5..=23.5 - 1e-3).contains(&u) && (0.5..=17.5 - 1e-3).contains(&v)
        };
        is_seen(place(column, row)).then_some(())?;
        let (mut sums, half) = ([0.0; 5], 2);
        for j in 0..2 * half + 1 {
            for i in 0..2 * half + 1 {
                let x = (column + i).saturating_sub(half).min(23);
                let y = (row + j).saturating_sub(half).min(17);
                let (u, v) = place(x, y);
                let (u, v) = ((u - 0.5).clamp(0.0, 22.999), (v - 0.5).clamp(0.0, 16.999));
                let (dx, dy) = (u.fract(), v.fract());
                let at =
                    |i: usize, j: usize| f64::from(other.at(0, u as usize + i, v as usize + j));
                let upper = at(0, 0) + (at(1, 0) - at(0, 0)) * dx;
                let lower = at(0, 1) + (at(1, 1) - at(0, 1)) * dx;
                let (a, b) = (upper + (lower - upper) * dy, f64::from(keyframe.at(0, x, y)));
                let terms = [a, b, a * a, b * b, a * b];
                sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term / 25.0);
            }
        }
        let [a, b, aa, bb, ab] = sums;
        let noise = f64::from(WINDOW.noise_variance);
        let spread = ((aa - a * a + noise) * (bb - b * b + noise)).sqrt();
        Some((1.0 - (ab - a * b) / spread).clamp(0.0, 1.0))
    }

    #[test]
    fn costs_are_filtered_means_of_the_better_half_of_the_neighbours() {
        let keyframe = picture(wave);
        let others: Vec<Image<f32>> = (0..5)
            .map(|k| picture(|x, y| wave(x + 0.8 * k as f32, 1.05 * y) + 0.02 * (x * y).sin()))
            .collect();
        let step = |k: f64| Tangent::from_array([0.3 * k, -0.2, 0.1 * k, 0.01, 0.02 * k, -0.03]);
        let poses: Vec<Pose<f64>> =
            (-2..3).map(|k| Pose::identity().retract(step(f64::from(k)))).collect();
        let views: Vec<(&Image<f32>, Pose<f64>)> = others.iter().zip(poses.clone()).collect();
        let base: Vec<f32> = (0..24 * 18).map(|i| 0.3 + 0.001 * (i % 24) as f32).collect();
        let offsets: Vec<f32> = (0..LABELS_PER_BATCH + 3).map(|k| 0.05 * k as f32).collect();
        let volume = PlaneSweep::new(&CAMERA, &keyframe, WINDOW, &views).costs(&base, &offsets);
        let mut unseen = 0;
        for label in [0, 7, offsets.len() - 1] {
            let rho = |x: usize, y: usize| f64::from(base[y * 24 + x] + offsets[label]);
            let mut mean_cost = |pixel: usize| {
                let cost = |view| plain_cost(&keyframe, view, rho, (pixel % 24, pixel / 24));
                let mut each: Vec<f64> = others.iter().zip(&poses).filter_map(cost).collect();
                unseen += 5 - each.len();
                each.sort_by(f64::total_cmp);
                each.truncate(each.len().div_ceil(2));
                let sum: f64 = each.iter().sum();
                if each.is_empty() { 1.0 } else { (sum / each.len() as f64) as f32 }
            };
            let mut due: Vec<f32> = (0..24 * 18).map(&mut mean_cost).collect();
            CostFilter::new(&keyframe).apply(&mut due);
            for (pixel, due) in due.iter().enumerate() {
                let found = volume.costs_at(pixel)[label];
                assert!((found - due).abs() < 1e-3, "pixel {pixel}, label {label}: {found} {due}");
            }
        }
        assert!(unseen > 100);
    }
}
