//! SSIM (Wang et al. 2004) and its derivative, in four passes over the rows of all planes.
//!
//! With `A1 = 2 μx μy + C1`, `A2 = 2 σxy + C2`, `B1 = μx² + μy² + C1`, `B2 = σx² + σy² + C2`,
//! `S = A1 A2 / (B1 B2)` and window `G`, the pull-back of `G x`, `G x²` and `G xy` is
//! `G(∂S/∂μx) + 2 x G(∂S/∂σx²) + y G(∂S/∂σxy)`, where `∂S/∂μx` includes its way through
//! `σx² = G x² - μx²` and `σxy = G xy - μx μy`.

use super::window::{Window, filter};
use i2slam_geometry::{Image, Real};
use pulp::Arch;
use rayon::prelude::*;

/// SSIM's constants for pictures in `[0, 1]` (Wang et al. 2004).
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// Rows that one task takes at least.
const ROWS: usize = 8;

/// The observed picture's window means, which every step needs: `μy` and `G y²`, planes as in the
/// picture.
#[derive(Clone, Debug)]
pub(crate) struct SsimReference<T = f32> {
    mean: Vec<T>,
    second: Vec<T>,
}

impl<T: Real> SsimReference<T> {
    pub(crate) fn new(observed: &Image<T>) -> Self {
        // Every keyframe keeps its own, so that they take no more room than they need.
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

/// Buffers between the passes; they keep their allocation from step to step.
#[derive(Clone, Debug, Default)]
pub(crate) struct Similarity<T = f32> {
    /// Filtered along rows.
    along: [Vec<T>; 3],
    /// Filtered down columns: `G x`, `G x²` and `G xy`, then `∂S` by each.
    full: [Vec<T>; 3],
    /// `Σ S` of each row.
    sums: Vec<f64>,
}

/// What the passes share.
struct Pass<'a, T> {
    picture: &'a Image<T>,
    observed: &'a Image<T>,
    reference: &'a SsimReference<T>,
    window: Window<T>,
    arch: Arch,
}

impl<T: Real> Similarity<T> {
    /// `Σ S(x, y)` over pixels and channels; adds `scale · ∂Σ/∂x` to `gradient`.
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
        self.similarity(&pass);
        self.derivatives_along(&pass);
        self.derivative(&pass, scale, gradient);
        self.sums.iter().sum()
    }

    /// `x`, `x²` and `x y` filtered along rows; `full` holds the products meanwhile.
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
                    pass.window.along(x, mean);
                    pass.window.along(squares, second);
                    pass.window.along(products, cross);
                });
            },
        );
    }

    /// The rest of the filter, `S`, and its derivatives by the three filtered planes.
    fn similarity(&mut self, pass: &Pass<'_, T>) {
        let (width, along) = (pass.picture.width, &self.along);
        rows(&mut self.full, width).zip(&mut self.sums).enumerate().for_each(
            |(row, (mut full, sum))| {
                pass.arch.dispatch(|| {
                    pass.down(along, row, &mut full);
                    *sum = pass.similarity_of_row(row, full);
                });
            },
        );
    }

    /// The derivatives filtered along rows.
    fn derivatives_along(&mut self, pass: &Pass<'_, T>) {
        let (width, full) = (pass.picture.width, &self.full);
        rows(&mut self.along, width).enumerate().for_each(|(row, along)| {
            pass.arch.dispatch(|| {
                for (full, along) in full.iter().zip(along) {
                    pass.window.along(pass.row(full, row), along);
                }
            });
        });
    }

    /// The rest of that filter, added to the gradient.
    fn derivative(&mut self, pass: &Pass<'_, T>, scale: T, gradient: &mut [T]) {
        let (width, along, two) = (pass.picture.width, &self.along, T::of(2.0));
        let gradient = gradient.par_chunks_mut(width);
        rows(&mut self.full, width).zip(gradient).enumerate().for_each(
            |(row, (mut full, gradient))| {
                pass.arch.dispatch(|| {
                    pass.down(along, row, &mut full);
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
    let [a, b, c] = planes.each_mut().map(|p| p.par_chunks_mut(width).with_min_len(ROWS));
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
    fn down(&self, along: &[Vec<T>; 3], row: usize, out: &mut [&mut [T]; 3]) {
        let (pixels, height) = (self.picture.pixels(), self.picture.height);
        let plane = row / height * pixels..(row / height + 1) * pixels;
        for (along, out) in along.iter().zip(out) {
            self.window.down(&along[plane.clone()], row % height, out);
        }
    }

    /// `Σ S` of a row; turns the filtered moments into derivatives.
    #[inline(always)]
    fn similarity_of_row(&self, row: usize, full: [&mut [T]; 3]) -> f64 {
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
