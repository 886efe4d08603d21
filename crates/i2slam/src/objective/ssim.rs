//! SSIM (Wang et al. 2004) as a loss with its derivative, in four passes over the rows of all
//! planes. `i2slam-eval` has an SSIM of its own: the judge shares no code with the system.
//!
//! With `A1 = 2 μx μy + C1`, `A2 = 2 σxy + C2`, `B1 = μx² + μy² + C1`, `B2 = σx² + σy² + C2`, `S =
//! A1 A2 / (B1 B2)` and window `G`, the pull-back of `G x`, `G x²` and `G xy` is `G(∂S/∂μx) + 2 x
//! G(∂S/∂σx²) + y G(∂S/∂σxy)`, where `∂S/∂μx` includes its way through `σx² = G x² - μx²` and `σxy
//! = G xy - μx μy`.

use i2slam_geometry::{Image, Real};
use pulp::Arch;
use rayon::prelude::*;

/// SSIM's constants for pictures in `[0, 1]` (Wang et al. 2004).
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// Least number of rows of a parallel task.
const MIN_TASK_ROWS: usize = 8;

/// Width of the window, and its radius [px].
const TAPS: usize = 11;
const RADIUS: usize = TAPS / 2;

/// The Gaussian window of SSIM along one axis; pictures are continued with zeros.
#[derive(Clone, Copy)]
struct Window<T>([T; TAPS]);

impl<T: Real> Window<T> {
    /// Normalised weights, σ = 1.5 (Wang et al. 2004).
    fn new() -> Self {
        let raw: [f64; TAPS] = std::array::from_fn(|i| {
            let d = i as f64 - RADIUS as f64;
            (-d * d / (2.0 * 1.5 * 1.5)).exp()
        });
        let sum: f64 = raw.iter().sum();
        Self(raw.map(|w| T::of(w / sum)))
    }

    /// Filters one row.
    #[inline(always)]
    fn filter_row(&self, row: &[T], out: &mut [T]) {
        let width = row.len();
        let inner = RADIUS.min(width)..width.saturating_sub(RADIUS).max(RADIUS.min(width));
        // Every pixel that has a whole window, by all taps at once.
        if !inner.is_empty() {
            let shifted = std::array::from_fn(|k| &row[k..]);
            self.blend(shifted, &mut out[inner.clone()]);
        }
        for i in (0..inner.start).chain(inner.end..width) {
            let first = i.saturating_sub(RADIUS);
            let taps = &self.0[first + RADIUS - i..];
            out[i] = T::zero();
            for (&w, &v) in taps.iter().zip(&row[first..(i + RADIUS + 1).min(width)]) {
                out[i] += w * v;
            }
        }
    }

    /// Filters the columns of a plane, for row `y`.
    #[inline(always)]
    fn filter_columns(&self, plane: &[T], y: usize, out: &mut [T]) {
        let width = out.len();
        if y >= RADIUS && (y + RADIUS + 1) * width <= plane.len() {
            let rows = std::array::from_fn(|k| &plane[(y + k - RADIUS) * width..]);
            return self.blend(rows, out);
        }
        out.fill(T::zero());
        for (k, &w) in self.0.iter().enumerate() {
            let Some(source) = (y + k).checked_sub(RADIUS) else { continue };
            let Some(row) = plane.get(source * width..(source + 1) * width) else { break };
            for (out, &v) in out.iter_mut().zip(row) {
                *out += w * v;
            }
        }
    }

    /// `out = Σ_k w_k rows_k`, in the order of the taps.
    #[inline(always)]
    fn blend(&self, rows: [&[T]; TAPS], out: &mut [T]) {
        let [r0, r1, r2, r3, r4, r5, r6, r7, r8, r9, r10] = rows.map(|row| &row[..out.len()]);
        let w = self.0;
        // Written out, as a loop over the taps is not turned into vectors.
        for (i, out) in out.iter_mut().enumerate() {
            let sum = w[0] * r0[i] + w[1] * r1[i] + w[2] * r2[i] + w[3] * r3[i] + w[4] * r4[i];
            let sum = sum + w[5] * r5[i] + w[6] * r6[i] + w[7] * r7[i] + w[8] * r8[i];
            *out = sum + w[9] * r9[i] + w[10] * r10[i];
        }
    }
}

/// A plane of `width` columns filtered by the window. The filter is its own adjoint.
fn filter<T: Real>(plane: &[T], width: usize) -> Vec<T> {
    let window = Window::new();
    let (mut rows, mut out) = (vec![T::zero(); plane.len()], vec![T::zero(); plane.len()]);
    for (input, row) in plane.chunks_exact(width).zip(rows.chunks_exact_mut(width)) {
        window.filter_row(input, row);
    }
    for (y, out) in out.chunks_exact_mut(width).enumerate() {
        window.filter_columns(&rows, y, out);
    }
    out
}

/// Window means of the observed picture, computed once for all steps: `μy` and `G y²`, planes as in
/// the picture.
#[derive(Clone, Debug)]
pub(crate) struct SsimReference<T = f32> {
    mean: Vec<T>,
    second: Vec<T>,
}

impl<T: Real> SsimReference<T> {
    pub(crate) fn new(observed: &Image<T>) -> Self {
        // Exact capacity, because every keyframe keeps them.
        let room = || Vec::with_capacity(observed.data.len());
        let mut means = Self { mean: room(), second: room() };
        for plane in (0..observed.channels).map(|c| observed.plane(c)) {
            let square: Vec<T> = plane.iter().map(|&v| v * v).collect();
            means.mean.extend(filter(plane, observed.width));
            means.second.extend(filter(&square, observed.width));
        }
        means
    }
}

/// Evaluates SSIM; owns the buffers between the passes.
#[derive(Clone, Debug, Default)]
pub(crate) struct Ssim<T = f32> {
    /// Filtered along rows.
    along: [Vec<T>; 3],
    /// Filtered down columns: `G x`, `G x²` and `G xy`, then `∂S` by each.
    full: [Vec<T>; 3],
    /// `Σ S` of each row.
    sums: Vec<f64>,
}

/// Inputs of the passes.
struct Pass<'a, T> {
    picture: &'a Image<T>,
    observed: &'a Image<T>,
    reference: &'a SsimReference<T>,
    window: Window<T>,
    arch: Arch,
}

impl<T: Real> Ssim<T> {
    /// Returns `Σ S(x, y)` over pixels and channels, and adds `scale · ∂Σ/∂x` to `gradient`.
    pub(super) fn pull_back(
        &mut self,
        picture: &Image<T>,
        observed: &Image<T>,
        reference: &SsimReference<T>,
        scale: T,
        gradient: &mut [T],
    ) -> f64 {
        let length = picture.data.len();
        if length == 0 {
            return 0.0;
        }
        self.along.iter_mut().chain(&mut self.full).for_each(|p| p.resize(length, T::zero()));
        self.sums.resize(length / picture.width, 0.0);
        let (window, arch) = (Window::new(), Arch::new());
        let pass = Pass { picture, observed, reference, window, arch };
        self.moments_along(&pass);
        self.ssim_and_derivatives(&pass);
        self.derivatives_along(&pass);
        self.derivatives_down(&pass, scale, gradient);
        self.sums.iter().sum()
    }

    /// Filters `x`, `x²` and `x y` along rows; `full` holds the products.
    fn moments_along(&mut self, pass: &Pass<'_, T>) {
        let width = pass.picture.width;
        rows(&mut self.along, width).zip(rows(&mut self.full, width)).enumerate().for_each(
            |(row, ([mean, second, cross], [_, squares, products]))| {
                pass.arch.dispatch(|| {
                    let (x, y) =
                        (pass.row(&pass.picture.data, row), pass.row(&pass.observed.data, row));
                    for i in 0..width {
                        squares[i] = x[i] * x[i];
                        products[i] = x[i] * y[i];
                    }
                    pass.window.filter_row(x, mean);
                    pass.window.filter_row(squares, second);
                    pass.window.filter_row(products, cross);
                });
            },
        );
    }

    /// Filters down columns, and computes `S` and its derivatives by the three filtered planes.
    fn ssim_and_derivatives(&mut self, pass: &Pass<'_, T>) {
        let (width, along) = (pass.picture.width, &self.along);
        rows(&mut self.full, width).zip(&mut self.sums).enumerate().for_each(
            |(row, (mut full, sum))| {
                pass.arch.dispatch(|| {
                    pass.filter_columns(along, row, &mut full);
                    *sum = pass.ssim_of_row(row, full);
                });
            },
        );
    }

    /// Filters the derivatives along rows.
    fn derivatives_along(&mut self, pass: &Pass<'_, T>) {
        let (width, full) = (pass.picture.width, &self.full);
        rows(&mut self.along, width).enumerate().for_each(|(row, along)| {
            pass.arch.dispatch(|| {
                for (full, along) in full.iter().zip(along) {
                    pass.window.filter_row(pass.row(full, row), along);
                }
            });
        });
    }

    /// Filters the derivatives down columns and adds them to the gradient.
    fn derivatives_down(&mut self, pass: &Pass<'_, T>, scale: T, gradient: &mut [T]) {
        let (width, along, two) = (pass.picture.width, &self.along, T::of(2.0));
        let gradient = gradient.par_chunks_mut(width);
        rows(&mut self.full, width).zip(gradient).enumerate().for_each(
            |(row, (mut full, gradient))| {
                pass.arch.dispatch(|| {
                    pass.filter_columns(along, row, &mut full);
                    let (x, y) =
                        (pass.row(&pass.picture.data, row), pass.row(&pass.observed.data, row));
                    let [mean, second, cross] = full;
                    for i in 0..width {
                        gradient[i] += scale * (mean[i] + two * x[i] * second[i] + y[i] * cross[i]);
                    }
                });
            },
        );
    }
}

/// The rows of three stacks of planes, side by side.
fn rows<T: Real>(
    planes: &mut [Vec<T>; 3],
    width: usize,
) -> impl IndexedParallelIterator<Item = [&mut [T]; 3]> {
    let [a, b, c] = planes.each_mut().map(|p| p.par_chunks_mut(width).with_min_len(MIN_TASK_ROWS));
    a.zip(b).zip(c).map(|((a, b), c)| [a, b, c])
}

impl<T: Real> Pass<'_, T> {
    /// A row of a stack of planes, counted from the first row of the first plane.
    #[inline(always)]
    fn row<'b>(&self, planes: &'b [T], row: usize) -> &'b [T] {
        &planes[row * self.picture.width..(row + 1) * self.picture.width]
    }

    /// Filters a row of three stacks of planes down their columns.
    #[inline(always)]
    fn filter_columns(&self, along: &[Vec<T>; 3], row: usize, out: &mut [&mut [T]; 3]) {
        let (pixels, height) = (self.picture.pixels(), self.picture.height);
        let plane = row / height * pixels..(row / height + 1) * pixels;
        for (along, out) in along.iter().zip(out) {
            self.window.filter_columns(&along[plane.clone()], row % height, out);
        }
    }

    /// `Σ S` of a row; turns the filtered moments into derivatives.
    #[inline(always)]
    fn ssim_of_row(&self, row: usize, full: [&mut [T]; 3]) -> f64 {
        let (c1, c2, two) = (T::of(C1), T::of(C2), T::of(2.0));
        let mean_y = self.row(&self.reference.mean, row);
        let second_y = self.row(&self.reference.second, row);
        let [by_mean, by_second, by_cross] = full;
        let mut sum = 0.0;
        for i in 0..mean_y.len() {
            let (mx, my) = (by_mean[i], mean_y[i]);
            let a1 = two * mx * my + c1;
            let a2 = two * (by_cross[i] - mx * my) + c2;
            let b1 = mx * mx + my * my + c1;
            let b2 = by_second[i] - mx * mx + second_y[i] - my * my + c2;
            let s = a1 * a2 / (b1 * b2);
            sum += s.to_f64();
            by_second[i] = -s / b2;
            by_cross[i] = two * a1 / (b1 * b2);
            by_mean[i] = two * (my * a2 / (b1 * b2) - mx * s / b1)
                - two * mx * by_second[i]
                - my * by_cross[i];
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_window_keeps_a_constant_inside_the_border() {
        let out = filter(&[2.0_f32; 30 * 20], 30);
        assert!((out[10 * 30 + 15] - 2.0).abs() < 1e-5);
        assert!(out[0] < 1.0);
    }

    #[test]
    fn the_filter_is_the_sum_over_its_window() {
        for (width, height) in [(24, 13), (11, 11), (7, 30), (1, 1), (5, 4)] {
            let plane = i2slam_check::noise(3, width * height);
            let window = Window::<f64>::new().0;
            let due = |x: usize, y: usize| {
                let mut sum = 0.0;
                for (j, i) in (0..TAPS).flat_map(|j| (0..TAPS).map(move |i| (j, i))) {
                    let (column, row) =
                        ((x + i).wrapping_sub(RADIUS), (y + j).wrapping_sub(RADIUS));
                    if column < width && row < height {
                        sum += window[i] * window[j] * plane[row * width + column];
                    }
                }
                sum
            };
            for (at, found) in filter(&plane, width).into_iter().enumerate() {
                let due = due(at % width, at / width);
                assert!((found - due).abs() < 1e-12, "{width}x{height}, {at}: {found} {due}");
            }
        }
    }

    #[test]
    fn the_filter_is_its_own_adjoint() {
        for width in [24, 3] {
            let (a, b) = (i2slam_check::noise(1, width * 17), i2slam_check::noise(2, width * 17));
            let dot = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
            assert!((dot(&filter(&a, width), &b) - dot(&a, &filter(&b, width))).abs() < 1e-12);
        }
    }
}
