//! Inverse depth of photographs: a plane for every pixel, by PatchMatch (Bleyer et al. 2011, Schönberger et
//! al. 2016).
//!
//! Photographs are taken so far apart that a surface is foreshortened differently in each, and windows of one
//! inverse depth do not match. That of a plane is affine in the picture,
//!
//! ```text
//! ρ(u, v) = ρ₀ + ρ_u (u - u₀) + ρ_v (v - v₀),
//! ```
//!
//! so that a window is seen in another view, where pixel `(u, v)` at `ρ` is at `turn (u, v, 1) + ρ shift`, by
//! a homography. Pixels take over planes of others, near and far, and disturbed ones, whose cost is less:
//! one minus the correlation of windows, weighted by distance and brightness, the mean of the better half of
//! the views.

use super::inverse_depth::{InverseDepthEstimate, MAX_COST, MIN_COST, NeighbourView};
use super::plane_sweep::{SweptView, UNSEEN};
use i2slam_compute::{CancellationToken, Random};
use i2slam_geometry::{Camera, Image, Vec3};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// Half the side of a window, and the distance of its samples [px].
const HALF_WINDOW: isize = 5;
const SAMPLE_STEP: usize = 2;
/// Samples of a window.
const SAMPLES: usize = (2 * HALF_WINDOW as usize / SAMPLE_STEP + 1).pow(2);
/// Variance added to that of a window: less contrast lowers its correlation.
const WINDOW_NOISE_VARIANCE: f32 = 5e-5;
/// Difference of brightness at which the weight of a sample falls to 0.6.
const BRIGHTNESS_DEVIATION: f32 = 0.2;
/// Rounds in which planes are taken over and disturbed, at all pixels.
const ROUNDS: usize = 4;
/// Places that planes are taken over from [px], all of the other colour of a chequerboard.
const PROPAGATED: [[isize; 2]; 8] =
    [[1, 0], [-1, 0], [0, 1], [0, -1], [5, 0], [-5, 0], [0, 5], [0, -5]];
/// Largest tangent of the angle between a surface's normal and the ray.
const MAX_TILT: f32 = 4.0;
/// Motion in the views over which the sharpness of a minimum is measured [px].
const MINIMUM_REACH: f32 = 0.7;
/// Views that are compared, at most.
pub(super) const MAX_VIEWS: usize = 8;
/// Distance of a cost by half of the views from the least so far, beyond which the others are not asked.
const FAR_ABOVE: f32 = 0.5;
/// First disturbance of an inverse depth, relative, and of a tangent; both halve from round to round.
const DISTURBANCE: [f32; 2] = [0.05, 0.5];

/// Numbers of views, best first.
type Order = [usize; MAX_VIEWS];

/// Inverse depth of a pixel and its change to the next column and row.
#[derive(Clone, Copy, Debug)]
struct Plane {
    inverse_depth: f32,
    slope: [f32; 2],
}

impl Plane {
    /// The plane as a pixel sees it that lies at `offset` from that of `self` [px].
    fn moved(self, [columns, rows]: [isize; 2]) -> Self {
        let [by_u, by_v] = self.slope;
        let inverse_depth = self.inverse_depth + by_u * columns as f32 + by_v * rows as f32;
        Self { inverse_depth, ..self }
    }
}

/// A keyframe, the views it is compared with, and what planes are allowed.
pub(super) struct PatchMatch<'a> {
    keyframe: &'a Image<f32>,
    views: Vec<SweptView<'a>>,
    bounds: [f32; 2],
    /// Focal length [px].
    focal: f32,
}

/// The window around a pixel: places relative to it, weights, and values less their mean.
struct Window {
    weights: [f32; PADDED],
    values: [f32; PADDED],
    inverse_deviation: f32,
}

impl Window {
    #[inline(always)]
    fn new(keyframe: &Image<f32>, [column, row]: [usize; 2]) -> Self {
        let inside = |at: usize, by: isize, size: usize| {
            at.saturating_add_signed(by).min(size.saturating_sub(1))
        };
        let centre = keyframe.at(0, column, row);
        let (mut weights, mut values) = ([0.0; PADDED], [0.0; PADDED]);
        for (i, [x, y]) in places().enumerate() {
            let value =
                keyframe.at(0, inside(column, x, keyframe.width), inside(row, y, keyframe.height));
            let distance = (x * x + y * y) as f32 / (2 * HALF_WINDOW * HALF_WINDOW) as f32;
            let contrast = ((value - centre) / BRIGHTNESS_DEVIATION).powi(2) / 2.0;
            (weights[i], values[i]) = ((-distance - contrast).exp(), value);
        }
        let total: f32 = weights.iter().sum();
        weights.iter_mut().for_each(|weight| *weight /= total);
        let mean: f32 = weights.iter().zip(&values).map(|(w, v)| w * v).sum();
        values.iter_mut().for_each(|value| *value -= mean);
        let variance: f32 = weights.iter().zip(&values).map(|(w, v)| w * v * v).sum();
        let inverse_deviation = (variance + WINDOW_NOISE_VARIANCE).sqrt().recip();
        Self { weights, values, inverse_deviation }
    }
}

/// A number in `[-1, 1)`.
#[inline(always)]
fn signed(random: &mut Random) -> f32 {
    2.0 * random.uniform() as f32 - 1.0
}

/// Sums that are added up at the same time.
const LANES: usize = 8;
/// Length of lists of samples; those beyond [`SAMPLES`] have no weight.
const PADDED: usize = SAMPLES.next_multiple_of(LANES);
/// Columns and rows of the samples of a window, relative to its pixel.
const OFFSETS: [[f32; PADDED]; 2] = {
    let (mut offsets, mut i) = ([[0.0; PADDED]; 2], 0);
    let side = 2 * HALF_WINDOW as usize / SAMPLE_STEP + 1;
    while i < SAMPLES {
        offsets[0][i] = (i % side * SAMPLE_STEP) as f32 - HALF_WINDOW as f32;
        offsets[1][i] = (i / side * SAMPLE_STEP) as f32 - HALF_WINDOW as f32;
        i += 1;
    }
    offsets
};

/// Places of the samples of a window, relative to its pixel.
fn places() -> impl Iterator<Item = [isize; 2]> {
    let line = || (-HALF_WINDOW..=HALF_WINDOW).step_by(SAMPLE_STEP);
    line().flat_map(move |y| line().map(move |x| [x, y]))
}

impl<'a> PatchMatch<'a> {
    /// `bounds` of the inverse depth.
    pub(super) fn new(
        camera: &Camera<f64>,
        keyframe: &'a Image<f32>,
        others: &[NeighbourView<'a>],
        bounds: [f64; 2],
    ) -> Self {
        let view =
            |(pyramid, pose): &NeighbourView<'a>| SweptView::new(camera, pyramid.finest(), pose);
        let views = others.iter().take(MAX_VIEWS).map(view).collect();
        let bounds = bounds.map(|rho| rho as f32);
        Self { keyframe, views, bounds, focal: camera.fx as f32 }
    }

    /// Improves the inverse depths of `start`, which may be wrong anywhere; `None` if cancelled.
    pub(super) fn refine(
        &self,
        start: &Image<f32>,
        cancellation: &CancellationToken,
    ) -> Option<InverseDepthEstimate> {
        let (count, arch) = (start.data.len(), Arch::new());
        let initial = (0..count).into_par_iter().map(|pixel| {
            let plane = self.initial_plane(start, self.place(pixel));
            (plane, self.full_cost(&self.window(pixel), plane, pixel))
        });
        let mut planes: Vec<(Plane, f32)> = initial.collect();
        for round in 0..ROUNDS {
            for colour in 0..2 {
                if cancellation.is_cancelled() {
                    return None;
                }
                let known = &planes;
                let update = |pixel: usize| {
                    let [column, row] = self.place(pixel);
                    match (column + row) % 2 == colour {
                        true => arch.dispatch(Update { all: self, known, pixel, round }),
                        false => known[pixel],
                    }
                };
                planes = (0..count).into_par_iter().map(update).collect();
            }
        }
        Some(self.estimate(&planes))
    }

    fn place(&self, pixel: usize) -> [usize; 2] {
        [pixel % self.keyframe.width, pixel / self.keyframe.width]
    }

    fn window(&self, pixel: usize) -> Window {
        Window::new(self.keyframe, self.place(pixel))
    }

    /// Plane through the inverse depths around a pixel where they are of one surface, else facing the camera.
    fn initial_plane(&self, start: &Image<f32>, [column, row]: [usize; 2]) -> Plane {
        const REACH: usize = 2;
        let (width, height) = (start.width, start.height);
        let inverse_depth = start.at(0, column, row).clamp(self.bounds[0], self.bounds[1]);
        let slope = |before: f32, after: f32, distance: usize| {
            let slope = (after - before) / distance.max(1) as f32;
            let largest = MAX_TILT * inverse_depth / self.focal;
            if slope.abs() < largest { slope } else { 0.0 }
        };
        let columns = [column.saturating_sub(REACH), (column + REACH).min(width - 1)];
        let rows = [row.saturating_sub(REACH), (row + REACH).min(height - 1)];
        let along = columns.map(|x| start.at(0, x, row));
        let down = rows.map(|y| start.at(0, column, y));
        let slope = [
            slope(along[0], along[1], columns[1] - columns[0]),
            slope(down[0], down[1], rows[1] - rows[0]),
        ];
        Plane { inverse_depth, slope }
    }

    /// The best of a pixel's plane, those of others, and disturbed ones.
    #[inline(always)]
    fn improved(&self, known: &[(Plane, f32)], pixel: usize, round: usize) -> (Plane, f32) {
        let [column, row] = self.place(pixel);
        let window = self.window(pixel);
        let best = known[pixel];
        let order = self.views_in_order(&window, best.0, pixel);
        let mut search = Search { window: &window, order: &order, pixel, best };
        for [x, y] in PROPAGATED {
            let place = [column.wrapping_add_signed(x), row.wrapping_add_signed(y)];
            if place[0] < self.keyframe.width && place[1] < self.keyframe.height {
                let other = known[place[1] * self.keyframe.width + place[0]].0;
                search.consider(self, other.moved([-x, -y]));
            }
        }
        let mut random = Random::new((round * known.len() + pixel) as u64);
        let [least, most] = self.bounds;
        let anywhere = least + (most - least) * random.uniform() as f32;
        search.consider(self, self.tilted(anywhere, search.best.0, &mut random, MAX_TILT));
        let [of_depth, of_tilt] = DISTURBANCE.map(|size| size * 0.5_f32.powi(round as i32));
        for tilt in [0.0, of_tilt] {
            let best = search.best.0;
            let rho = best.inverse_depth * (1.0 + of_depth * signed(&mut random));
            search.consider(self, self.tilted(rho, best, &mut random, tilt));
        }
        let best = search.best.0;
        search.consider(self, self.tilted(best.inverse_depth, best, &mut random, of_tilt));
        search.best
    }

    /// A plane at an inverse depth whose tangents differ from those of `plane` by up to `most`.
    #[inline(always)]
    fn tilted(&self, rho: f32, plane: Plane, random: &mut Random, most: f32) -> Plane {
        let unit = plane.inverse_depth / self.focal;
        let slope = plane.slope.map(|slope| {
            let tangent = slope / unit + most * signed(random);
            tangent.clamp(-MAX_TILT, MAX_TILT) * rho / self.focal
        });
        Plane { inverse_depth: rho, slope }
    }

    #[inline(always)]
    fn is_allowed(&self, plane: Plane) -> bool {
        let rho = plane.inverse_depth;
        let steepest = plane.slope.iter().fold(0.0_f32, |most, slope| most.max(slope.abs()));
        (self.bounds[0]..=self.bounds[1]).contains(&rho) && steepest <= MAX_TILT * rho / self.focal
    }

    /// The views in order of the costs of a plane.
    #[inline(always)]
    fn views_in_order(&self, window: &Window, plane: Plane, pixel: usize) -> Order {
        let mut order: Order = std::array::from_fn(|view| view);
        let mut costs = [UNSEEN; MAX_VIEWS];
        for (cost, view) in costs.iter_mut().zip(&self.views) {
            *cost = view_cost(window, plane, self.place(pixel), view);
        }
        order.sort_unstable_by(|a, b| costs[*a].total_cmp(&costs[*b]).then(a.cmp(b)));
        order
    }

    /// Cost of a plane: the mean of the better half of the views that see the pixel; 1 where none does, and
    /// where the first half of `order` shows that it is far above `limit`.
    #[inline(always)]
    fn cost(
        &self,
        window: &Window,
        (plane, order, limit): (Plane, &Order, f32),
        pixel: usize,
    ) -> f32 {
        let (mut costs, mut seen, mut sum) = ([UNSEEN; MAX_VIEWS], 0, 0.0);
        let count = self.views.len();
        for (number, view) in order.iter().filter_map(|view| self.views.get(*view)).enumerate() {
            let cost = view_cost(window, plane, self.place(pixel), view);
            sum += cost;
            if 2 * (number + 1) == count && 2.0 * sum > (limit + FAR_ABOVE) * count as f32 {
                return 1.0;
            }
            if cost <= 1.0 {
                let place = costs[..seen].partition_point(|other| *other <= cost);
                costs.copy_within(place..seen, place + 1);
                costs[place] = cost;
                seen += 1;
            }
        }
        let half = seen.div_ceil(2);
        if half == 0 { 1.0 } else { costs[..half].iter().sum::<f32>() / half as f32 }
    }

    /// Cost of a plane, however large.
    fn full_cost(&self, window: &Window, plane: Plane, pixel: usize) -> f32 {
        let order = std::array::from_fn(|view| view);
        self.cost(window, (plane, &order, f32::INFINITY), pixel)
    }

    /// Inverse depths of the planes; their variance is that of [a sweep](super::inverse_depth), by the
    /// sharpness of the minimum.
    fn estimate(&self, planes: &[(Plane, f32)]) -> InverseDepthEstimate {
        let of_pixel = |(pixel, (plane, here)): (usize, &(Plane, f32))| {
            let step = self.step(*plane, self.place(pixel));
            let window = self.window(pixel);
            let [before, after] = [-step, step].map(|change| {
                let plane = Plane { inverse_depth: plane.inverse_depth + change, ..*plane };
                self.full_cost(&window, plane, pixel)
            });
            let curvature = (before - 2.0 * here + after) / step.powi(2);
            let variance = 2.0 * here.max(MIN_COST) / (SAMPLES as f32 * curvature);
            let is_known = *here <= MAX_COST && curvature > 0.0 && variance.is_finite();
            if is_known { (plane.inverse_depth, variance) } else { (0.0, 0.0) }
        };
        let (inverse_depth, variance) = planes.par_iter().enumerate().map(of_pixel).unzip();
        let image = |data| Image { data, ..*self.keyframe };
        InverseDepthEstimate { inverse_depth: image(inverse_depth), variance: image(variance) }
    }

    /// Change of inverse depth that moves the pixel by [`MINIMUM_REACH`] in the mean over the views.
    fn step(&self, plane: Plane, place: [usize; 2]) -> f32 {
        let small = 0.01 * plane.inverse_depth;
        let moved = |view: &SweptView<'_>| {
            let at = |rho: f32| project(view.centre(place, rho));
            let [from, to] = [at(plane.inverse_depth), at(plane.inverse_depth + small)];
            (to[0] - from[0]).hypot(to[1] - from[1])
        };
        let mean = self.views.iter().map(moved).sum::<f32>() / self.views.len().max(1) as f32;
        small * MINIMUM_REACH / mean.max(1e-3)
    }
}

/// Place of a point in a picture, from the centre of its first pixel [px].
#[inline(always)]
fn project(point: Vec3<f32>) -> [f32; 2] {
    let scale = 1.0 / point.z.max(1e-6);
    [point.x * scale - 0.5, point.y * scale - 0.5]
}

/// A pixel that is to be improved, with the vector instructions of the machine.
struct Update<'a> {
    all: &'a PatchMatch<'a>,
    known: &'a [(Plane, f32)],
    pixel: usize,
    round: usize,
}

impl WithSimd for Update<'_> {
    type Output = (Plane, f32);

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Self::Output {
        self.all.improved(self.known, self.pixel, self.round)
    }
}

/// Search for the best plane of a pixel.
struct Search<'a> {
    window: &'a Window,
    order: &'a Order,
    pixel: usize,
    /// With its cost.
    best: (Plane, f32),
}

impl Search<'_> {
    #[inline(always)]
    fn consider(&mut self, all: &PatchMatch<'_>, plane: Plane) {
        if all.is_allowed(plane) {
            let cost = all.cost(self.window, (plane, self.order, self.best.1), self.pixel);
            if cost < self.best.1 {
                self.best = (plane, cost);
            }
        }
    }
}

/// One minus the correlation of a window with a view, [`UNSEEN`] where that does not see the pixel.
#[inline(always)]
fn view_cost(window: &Window, plane: Plane, place: [usize; 2], view: &SweptView<'_>) -> f32 {
    let centre = view.centre(place, plane.inverse_depth);
    let [to_right, down] = [0, 1].map(|axis| view.turn[axis] + view.shift * plane.slope[axis]);
    let image = view.image;
    let [right, low] = [image.width, image.height].map(|size| (size - 1) as f32 - 1e-3);
    let [x, y] = project(centre);
    if !(centre.z > 1e-6 && (0.0..=right).contains(&x) && (0.0..=low).contains(&y)) {
        return UNSEEN;
    }
    let (mut columns, mut rows) = ([0.0; PADDED], [0.0; PADDED]);
    for i in 0..PADDED {
        let (x, y) = (OFFSETS[0][i], OFFSETS[1][i]);
        let [x, y] = project(centre + to_right * x + down * y);
        (columns[i], rows[i]) = (x.max(0.0).min(right), y.max(0.0).min(low));
    }
    let mut values = [0.0; PADDED];
    for i in 0..SAMPLES {
        let (left, top) = (columns[i] as usize, rows[i] as usize);
        let (dx, dy) = (columns[i] - left as f32, rows[i] - top as f32);
        let square = &image.data[top * image.width + left..][..image.width + 2];
        let [a, b] = [square[0], square[1]];
        let [c, d] = [square[image.width], square[image.width + 1]];
        let (upper, lower) = (a + (b - a) * dx, c + (d - c) * dx);
        values[i] = upper + (lower - upper) * dy;
    }
    let (mut sum, mut squares, mut product) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
    for block in (0..PADDED).step_by(LANES) {
        for lane in 0..LANES {
            let i = block + lane;
            let weighted = window.weights[i] * values[i];
            sum[lane] += weighted;
            squares[lane] += weighted * values[i];
            product[lane] += weighted * window.values[i];
        }
    }
    let [sum, squares, product] = [sum, squares, product].map(|lanes| lanes.iter().sum::<f32>());
    let variance: f32 = (squares - sum * sum).max(0.0) + WINDOW_NOISE_VARIANCE;
    (1.0 - product * window.inverse_deviation / variance.sqrt()).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_geometry::{Pose, Rotation};

    const CAMERA: Camera<f64> =
        Camera { width: 48, height: 40, fx: 60.0, fy: 60.0, cx: 24.0, cy: 20.0 };
    /// Inverse depth of a steep plane in the middle of the first picture, and its change by column.
    const PLANE: [f64; 2] = [0.5, 0.012];

    /// Brightness of a point of the plane.
    fn texture(point: Vec3<f64>) -> f32 {
        let wave = |a: f64, b: f64, phase: f64| (a * point.x + b * point.y + phase).sin();
        (0.5 + 0.15 * (wave(14.0, 5.0, 0.3) + wave(-6.0, 17.0, 1.0) + wave(23.0, -9.0, 2.0))) as f32
    }

    /// The plane as a camera sees it.
    fn picture(world_from_camera: Pose<f64>) -> Image<f32> {
        // Its inverse depth is n . ray in the first camera: n . X = 1.
        let normal = Vec3::new(PLANE[1] * CAMERA.fx, 0.0, PLANE[0]);
        let inverse = world_from_camera.inverse();
        let centre = world_from_camera.translation;
        Image::from_fn(CAMERA.width, CAMERA.height, 1, |_, column, row| {
            let (u, v) = Camera::<f64>::pixel_centre(column, row);
            let ray: Vec3<f64> = inverse.rotation.inverse().rotate(CAMERA.unproject(u, v, 1.0));
            let distance = (1.0 - normal.dot(centre)) / normal.dot(ray);
            texture(centre + ray * distance)
        })
    }

    /// Largest error of the inverse depths away from the border, relative, from a start that is wrong.
    fn error(views: &[SweptView<'_>], keyframe: &Image<f32>) -> f64 {
        let views =
            views.iter().map(|v| SweptView { image: v.image, turn: v.turn, shift: v.shift });
        let bounds = [0.15, 1.2];
        let all = PatchMatch { keyframe, views: views.collect(), bounds, focal: 60.0 };
        let mut start = Image::new(CAMERA.width, CAMERA.height, 1);
        start.data.fill(0.9);
        let found = all.refine(&start, &CancellationToken::default()).expect("not cancelled");
        let mut errors = Vec::new();
        for row in 8..CAMERA.height - 8 {
            for column in 12..CAMERA.width - 12 {
                let due = PLANE[0] + PLANE[1] * (column as f64 + 0.5 - CAMERA.cx);
                let rho = f64::from(found.inverse_depth.at(0, column, row));
                errors.push((rho / due - 1.0).abs());
            }
        }
        errors.sort_by(f64::total_cmp);
        errors[errors.len() * 9 / 10]
    }

    #[test]
    fn a_steep_plane_is_found_from_far_apart() {
        let keyframe = picture(Pose::identity());
        let pose = |x: f64, turn: f64| {
            Pose::new(Rotation::exp(Vec3::new(0.0, turn, 0.0)), Vec3::new(x, 0.1 * x, 0.0))
        };
        let poses = [pose(0.5, -0.25), pose(-0.5, 0.25), pose(0.3, -0.15)];
        let pictures = poses.map(picture);
        let view = |(image, pose): (_, &Pose<f64>)| SweptView::new(&CAMERA, image, &pose.inverse());
        let views: Vec<SweptView<'_>> = pictures.iter().zip(&poses).map(view).collect();
        let error = error(&views, &keyframe);
        assert!(error < 0.01, "{error}");
    }
}
