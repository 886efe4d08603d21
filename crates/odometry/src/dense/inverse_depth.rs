//! Inverse depth of one keyframe: a coarse plane sweep with semi-global aggregation, refined twice.

use super::plane_sweep::{CostVolume, MatchingWindow, PlaneSweep};
use super::semi_global::aggregate_costs;
use crate::track::pyramid::Pyramid;
use i2slam_compute::{CancellationToken, median};
use i2slam_geometry::{Camera, Image, Pose, Vec3};
use rayon::prelude::*;

/// Half the side of a window, at full size and at half size [px].
const HALF_WINDOWS: [usize; 2] = [2, 1];
/// Pixels whose noise a filtered cost averages: between the 25 of a window, beside edges of the picture, and
/// the 80 of window and filter where it is plain; with it errors are 0.55 to 0.95 of the deviation in the median.
const COST_SUPPORT: f32 = 49.0;
/// Distance from a depth edge [px] within which costs are often of the other surface.
pub(super) const EDGE_REACH: usize = 3;
/// Variance added to that of a window of a picture in [0, 1]: less contrast lowers its correlation.
const WINDOW_NOISE_VARIANCE: f32 = 1e-5;
/// Pixels of a half-size picture from which on the first sweep is in half size: thin things are lost
/// in smaller ones.
const MIN_COARSE_PIXELS: usize = 160 * 120;
/// Largest motion of a neighbour's picture from one plane of the first sweep to the next [px].
const PLANE_STEP: f64 = 1.0;
/// Smallest and largest number of planes.
const PLANE_COUNT_RANGE: (usize, usize) = (24, 128);
/// Labels to either side of each refinement, and their distance in steps of the sweep.
const REFINEMENTS: [(usize, f32); 2] = [(4, 0.5), (3, 0.25)];
/// Largest step between coarse pixels across which inverse depth is interpolated, over its value.
const MAX_UPSAMPLED_STEP: f32 = 0.1;
/// Mean cost that noise alone leaves.
pub(super) const MIN_COST: f32 = 0.01;
/// Cost above which a match has no value.
pub(super) const MAX_COST: f32 = 0.6;

/// Largest relative standard deviation of a known inverse depth.
const MAX_RELATIVE_DEVIATION: f32 = 0.1;

/// Inverse depth, 0 where unknown, with its variance for every pixel.
#[derive(Clone, Debug)]
pub(super) struct InverseDepthEstimate {
    pub(super) inverse_depth: Image<f32>,
    pub(super) variance: Image<f32>,
}

impl InverseDepthEstimate {
    /// True where the deviation is small enough for a depth.
    pub(super) fn is_known(&self, pixel: usize) -> bool {
        let (rho, variance) = (self.inverse_depth.data[pixel], self.variance.data[pixel]);
        rho > 0.0 && variance.sqrt() <= MAX_RELATIVE_DEVIATION * rho
    }

    /// Makes pixels unknown.
    pub(super) fn remove(&mut self, pixels: &[bool]) {
        let all = self.inverse_depth.data.iter_mut().zip(&mut self.variance.data).zip(pixels);
        all.filter(|(_, is_removed)| **is_removed)
            .for_each(|((rho, v), _)| (*rho, *v) = (0.0, 0.0));
    }
}

/// Another keyframe: pyramid and `other_from_keyframe`.
pub(super) type NeighbourView<'a> = (&'a Pyramid, Pose<f64>);

/// Estimates the inverse depth of a keyframe between two bounds; `None` if cancelled.
pub(super) fn estimate_inverse_depth(
    camera: &Camera<f64>,
    keyframe: &Pyramid,
    others: &[NeighbourView<'_>],
    [least, most]: [f64; 2],
    cancellation: &CancellationToken,
) -> Option<InverseDepthEstimate> {
    let goes_on = || (!cancellation.is_cancelled()).then_some(());
    goes_on()?;
    let fine = keyframe.finest();
    let level = usize::from(
        keyframe.levels.get(1).is_some_and(|half| half.data.len() >= MIN_COARSE_PIXELS),
    );
    let coarse = &keyframe.levels[level];
    let coarse_camera = at_level(camera, coarse, level);
    let plane_count = plane_count(&coarse_camera, others, [least, most]);
    let step = ((most - least) / (plane_count - 1) as f64) as f32;
    let sweep = plane_sweep_at(&coarse_camera, keyframe, others, level, window_at(level));
    let offsets: Vec<f32> = (0..plane_count).map(|k| step * k as f32).collect();
    let volume = sweep.costs(&vec![least as f32; coarse.data.len()], &offsets);
    goes_on()?;
    let smooth = aggregate_costs(&volume, coarse);
    let mut first = Image::new(coarse.width, coarse.height, 1);
    for (pixel, rho) in first.data.iter_mut().enumerate() {
        *rho = least as f32 + step * subpixel_minimum(smooth.costs_at(pixel)).0;
    }
    let mut found = upsample(&median_filter(&first), fine.width, fine.height);
    let sweep = plane_sweep_at(camera, keyframe, others, 0, window_at(0));
    let mut variance = Image::new(fine.width, fine.height, 1);
    for (reach, share) in REFINEMENTS {
        let distance = share * step;
        let offsets: Vec<f32> =
            (0..=2 * reach).map(|k| (k as f32 - reach as f32) * distance).collect();
        goes_on()?;
        let base = median_filter(&found);
        let volume = sweep.costs(&base.data, &offsets);
        let smooth = aggregate_costs(&volume, fine);
        for pixel in 0..base.data.len() {
            let (place, label) = subpixel_minimum(smooth.costs_at(pixel));
            found.data[pixel] = base.data[pixel] + (place - reach as f32) * distance;
            variance.data[pixel] = minimum_variance(&volume, pixel, label) * distance * distance;
        }
    }
    let mut variance = median_filter(&variance);
    for (rho, v) in found.data.iter_mut().zip(&mut variance.data) {
        if !(*rho > 0.0 && v.is_finite()) {
            (*rho, *v) = (0.0, 0.0);
        }
    }
    Some(InverseDepthEstimate { inverse_depth: found, variance })
}

fn at_level(camera: &Camera<f64>, picture: &Image<f32>, level: usize) -> Camera<f64> {
    let scale = 0.5_f64.powi(level as i32);
    Camera {
        width: picture.width,
        height: picture.height,
        fx: camera.fx * scale,
        fy: camera.fy * scale,
        cx: camera.cx * scale,
        cy: camera.cy * scale,
    }
}

fn window_at(level: usize) -> MatchingWindow {
    MatchingWindow { half: HALF_WINDOWS[level], noise_variance: WINDOW_NOISE_VARIANCE }
}

/// The sweep of a keyframe on a level of its pyramid, where it has the intrinsics of `camera`.
pub(super) fn plane_sweep_at<'a>(
    camera: &Camera<f64>,
    keyframe: &'a Pyramid,
    others: &[NeighbourView<'a>],
    level: usize,
    window: MatchingWindow,
) -> PlaneSweep<'a> {
    let others: Vec<(&Image<f32>, Pose<f64>)> =
        others.iter().map(|(pyramid, pose)| (&pyramid.levels[level], *pose)).collect();
    PlaneSweep::new(camera, &keyframe.levels[level], window, &others)
}

/// Number of planes by [`PLANE_STEP`], within [`PLANE_COUNT_RANGE`].
fn plane_count(
    camera: &Camera<f64>,
    others: &[NeighbourView<'_>],
    [least, most]: [f64; 2],
) -> usize {
    let at = |pose: &Pose<f64>, u: f64, v: f64, rho: f64| {
        let ray: Vec3<f64> = camera.unproject(u, v, 1.0);
        let (x, y) = camera.project(pose.rotation.rotate(ray) + pose.translation * rho);
        [x, y]
    };
    let (w, h) = (camera.width as f64, camera.height as f64);
    let mut longest = 0.0_f64;
    for (_, pose) in others {
        for (u, v) in [(0.25, 0.25), (0.75, 0.25), (0.5, 0.5), (0.25, 0.75), (0.75, 0.75)] {
            let ends = [least, most].map(|rho| at(pose, u * w, v * h, rho));
            let length = (ends[0][0] - ends[1][0]).hypot(ends[0][1] - ends[1][1]);
            longest = longest.max(if length.is_finite() { length } else { 0.0 });
        }
    }
    ((longest / PLANE_STEP) as usize + 1).clamp(PLANE_COUNT_RANGE.0, PLANE_COUNT_RANGE.1)
}

/// Minimum of the costs by a parabola [labels], and the label of least cost.
fn subpixel_minimum(costs: &[f32]) -> (f32, usize) {
    let mut label = 0;
    for (k, cost) in costs.iter().enumerate() {
        if *cost < costs[label] {
            label = k;
        }
    }
    if label == 0 || label + 1 >= costs.len() {
        return (label as f32, label);
    }
    let [before, here, after] = [costs[label - 1], costs[label], costs[label + 1]];
    let curvature = before - 2.0 * here + after;
    let shift = if curvature > 1e-9 { 0.5 * (before - after) / curvature } else { 0.0 };
    (label as f32 + shift.clamp(-0.5, 0.5), label)
}

/// Variance of the minimum [labels²]; infinite without one.
///
/// For means over `N` pixels that differ by noise σ the cost is `C + c x²/2` with `C = N σ²/(2
/// |I|²)` and `c = Σ(∂I)²/|I|²`, so that the variance of the minimum, `σ²/Σ(∂I)²`, is `2 C/(N c)`.
fn minimum_variance(volume: &CostVolume, pixel: usize, label: usize) -> f32 {
    let costs = volume.costs_at(pixel);
    let label = label.clamp(2, costs.len() - 3);
    let here = costs[label];
    let curvature = (costs[label - 2] - 2.0 * here + costs[label + 2]) / 4.0;
    if here > MAX_COST || curvature <= 1e-6 {
        return f32::INFINITY;
    }
    2.0 * here.max(MIN_COST) / (COST_SUPPORT * curvature)
}

/// Median filter of 3 x 3 pixels.
fn median_filter(image: &Image<f32>) -> Image<f32> {
    let mut out = image.clone();
    let (last, end) = (image.width.saturating_sub(1), image.height.saturating_sub(1));
    let rows = out.data.par_chunks_mut(image.width.max(1)).enumerate();
    rows.filter(|(row, _)| (1..end).contains(row)).for_each(|(row, out)| {
        for column in 1..last {
            let mut around: [f32; 9] =
                std::array::from_fn(|k| image.at(0, column + k % 3 - 1, row + k / 3 - 1));
            if let Some(middle) = median(&mut around) {
                out[column] = middle;
            }
        }
    });
    out
}

/// Enlarges a coarse image, linearly where it is smooth.
fn upsample(image: &Image<f32>, width: usize, height: usize) -> Image<f32> {
    let mut out = Image::new(width, height, 1);
    let place = |i: usize, from: usize, to: usize| {
        ((i as f32 + 0.5) * from as f32 / to as f32).clamp(0.5, from as f32 - 0.501)
    };
    for row in 0..height {
        for column in 0..width {
            let (u, v) = (place(column, image.width, width), place(row, image.height, height));
            let nearest = image.at(0, u as usize, v as usize);
            let between = image.tap(u, v).map(|tap| (tap.values(&image.data), tap));
            out.data[row * width + column] = match between {
                Some((values, tap)) if is_smooth(&values) => tap.interpolate(values).0,
                _ => nearest,
            };
        }
    }
    out
}

/// Whether estimates of neighbouring coarse pixels differ so little that those in between lie on a
/// line; measured depths are told apart by half of it ([`crate::alignment::is_one_surface`]).
fn is_smooth(values: &[f32; 4]) -> bool {
    let least = values.iter().copied().fold(f32::INFINITY, f32::min);
    let most = values.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    most - least < MAX_UPSAMPLED_STEP * least.abs()
}
