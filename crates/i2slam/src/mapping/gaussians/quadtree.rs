//! Squares of pixels that one Gaussian stands for: large on plain surfaces, single pixels at texture
//! and edges.
//!
//! A square of `s` pixels is taken whole where colour and inverse depth are affine over it,
//!
//! ```text
//! c(u, v) = c₀ + c_u u + c_v v + noise,   1/z(u, v) = w₀ + w_u u + w_v v + noise
//! ```
//!
//! (a plane in space has affine inverse depth); else its four quarters are looked at.

use i2slam_compute::median;
use i2slam_geometry::{Camera, Image, Vec3};

/// Edge of the largest square [px].
pub(super) const MAX_SIZE: usize = 8;
/// Edge of the squares over which the noise of depth is read off [px].
const NOISE_SIZE: usize = 8;
/// Deviations from an affine patch that count as noise, in standard deviations: of colour, and of
/// inverse depth.
const COLOUR_NOISE_FACTOR: f32 = 1.5;
const DEPTH_NOISE_FACTOR: f32 = 2.0;
/// Picture deviation below which detail does not count: 40 dB.
const MIN_DETAIL: f32 = 0.01;
/// Distance of a surface from a plane that does not count, as a share of the square's edge.
const MAX_RELIEF: f32 = 0.25;
/// Ratio of the median of the absolute value of a normal variable to its standard deviation.
const MEDIAN_OVER_DEVIATION: f32 = 0.674_5;

/// A square of pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Square {
    /// First column and row.
    pub(super) column: usize,
    pub(super) row: usize,
    /// Edge [px].
    pub(super) size: usize,
    /// Inverse depth at the centre, and its derivatives by column and row [1/m, 1/m/px]; the
    /// derivatives are zero where no plane is known.
    pub(super) inverse_depth: [f32; 3],
}

impl Square {
    /// Columns and rows of its pixels.
    pub(super) fn pixels(&self) -> impl Iterator<Item = (usize, usize)> + use<> {
        let Self { column, row, size, .. } = *self;
        (row..row + size).flat_map(move |y| (column..column + size).map(move |x| (x, y)))
    }

    /// Its centre on the surface, in the camera [m].
    pub(super) fn centre(&self, camera: &Camera<f64>) -> Vec3<f64> {
        self.ray(camera) * f64::from(1.0 / self.inverse_depth[0])
    }

    /// Derivatives of the surface point by column and row, in the camera [m/px]: with the ray `d` of
    /// a pixel and inverse depth `w`, `X = d / w`.
    pub(super) fn tangents(&self, camera: &Camera<f64>) -> [Vec3<f64>; 2] {
        let [w, by_u, by_v] = self.inverse_depth.map(f64::from);
        let ray = self.ray(camera);
        [
            Vec3::new(1.0 / (camera.fx * w), 0.0, 0.0) - ray * (by_u / (w * w)),
            Vec3::new(0.0, 1.0 / (camera.fy * w), 0.0) - ray * (by_v / (w * w)),
        ]
    }

    /// Ray of its centre, of depth 1.
    fn ray(&self, camera: &Camera<f64>) -> Vec3<f64> {
        let half = 0.5 * self.size as f64;
        camera.unproject(self.column as f64 + half, self.row as f64 + half, 1.0)
    }
}

/// Affine fit over a square: value at the centre, slopes per pixel, deviation of the residuals.
struct Affine {
    value: f32,
    slope: [f32; 2],
    deviation: f32,
}

/// Divides a picture with depth into squares.
pub(super) struct Quadtree<'a> {
    colour: &'a Image<f32>,
    inverse_depth: Vec<f32>,
    focal: f32,
    max_detail: f32,
    depth_noise: f32,
}

impl<'a> Quadtree<'a> {
    /// Of a picture with its depth [m], 0 where there is none; `focal` in pixels.
    pub(super) fn new(colour: &'a Image<f32>, depth: &Image<f32>, focal: f32) -> Self {
        let inverse_depth =
            depth.data.iter().map(|&z| if z > 0.0 { 1.0 / z } else { 0.0 }).collect();
        let mut tree = Self { colour, inverse_depth, focal, max_detail: 0.0, depth_noise: 0.0 };
        let colour_noise = (0..3).map(|c| tree.pixel_noise(colour.plane(c))).sum::<f32>() / 3.0;
        tree.max_detail = MIN_DETAIL.max(COLOUR_NOISE_FACTOR * colour_noise);
        tree.depth_noise = tree.plane_noise();
        tree
    }

    /// Squares that cover the pixels marked in `wanted`.
    pub(super) fn squares(&self, wanted: &[bool]) -> Vec<Square> {
        let mut squares = Vec::new();
        for row in (0..self.colour.height).step_by(MAX_SIZE) {
            for column in (0..self.colour.width).step_by(MAX_SIZE) {
                self.divide([column, row], (MAX_SIZE, None), wanted, &mut squares);
            }
        }
        squares
    }

    /// Edge of the square that each pixel lies in [px].
    pub(super) fn sizes(&self) -> Vec<u8> {
        let mut sizes = vec![1; self.inverse_depth.len()];
        for square in self.squares(&vec![true; sizes.len()]) {
            for row in square.row..square.row + square.size {
                let start = row * self.colour.width + square.column;
                sizes[start..start + square.size].fill(square.size as u8);
            }
        }
        sizes
    }

    /// Picture deviation up to which a square counts as plain.
    pub(super) fn max_detail(&self) -> f32 {
        self.max_detail
    }

    /// Divides a square; `plane` is the slope of the plane that a larger one around it lies on.
    fn divide(
        &self,
        [column, row]: [usize; 2],
        (size, plane): (usize, Option<[f32; 2]>),
        wanted: &[bool],
        squares: &mut Vec<Square>,
    ) {
        let (width, height) = (self.colour.width, self.colour.height);
        if column >= width || row >= height {
            return;
        }
        let square = |w: f32, slope: Option<[f32; 2]>| {
            let [by_u, by_v] = slope.unwrap_or_default();
            Square { column, row, size, inverse_depth: [w, by_u, by_v] }
        };
        if size == 1 {
            let pixel = row * width + column;
            let w = self.inverse_depth[pixel];
            if wanted[pixel] && w > 0.0 {
                squares.push(square(w, plane));
            }
            return;
        }
        let mut slope = plane;
        if column + size <= width && row + size <= height {
            let pixels = |f: &dyn Fn(usize) -> bool| {
                (row..row + size).all(|y| (column..column + size).all(|x| f(y * width + x)))
            };
            if pixels(&|p| !wanted[p]) {
                return;
            }
            if pixels(&|p| self.inverse_depth[p] > 0.0)
                && let Some((w, own)) = self.plane([column, row], size)
            {
                // Of the larger square: less noise.
                slope = plane.or(Some(own));
                if pixels(&|p| wanted[p]) && self.is_plain([column, row], size) {
                    squares.push(square(w, slope));
                    return;
                }
            }
        }
        let half = size / 2;
        for (x, y) in [(0, 0), (half, 0), (0, half), (half, half)] {
            self.divide([column + x, row + y], (half, slope), wanted, squares);
        }
    }

    /// Inverse depth and its slope over a square that is a plane.
    fn plane(&self, at: [usize; 2], size: usize) -> Option<(f32, [f32; 2])> {
        let Affine { value, slope, deviation } = self.fit(&self.inverse_depth, at, size);
        let relief = MAX_RELIEF * size as f32 * value / self.focal;
        let is_plane = deviation <= relief.hypot(DEPTH_NOISE_FACTOR * self.depth_noise);
        is_plane.then_some((value, slope))
    }

    /// Whether colour is affine over a square.
    fn is_plain(&self, at: [usize; 2], size: usize) -> bool {
        (0..3).all(|c| self.fit(self.colour.plane(c), at, size).deviation <= self.max_detail)
    }

    /// Least-squares affine function over a square of two pixels or more.
    fn fit(&self, plane: &[f32], [column, row]: [usize; 2], size: usize) -> Affine {
        let (n, middle) = ((size * size) as f32, 0.5 * (size as f32 - 1.0));
        let [mut sum, mut squares, mut by_u, mut by_v, mut spread] = [0.0_f32; 5];
        let origin = plane[row * self.colour.width + column];
        for y in 0..size {
            let start = (row + y) * self.colour.width + column;
            let v = y as f32 - middle;
            for (x, value) in plane[start..start + size].iter().enumerate() {
                let (u, value) = (x as f32 - middle, value - origin);
                sum += value;
                squares += value * value;
                by_u += u * value;
                by_v += v * value;
                spread += u * u;
            }
        }
        let slope = [by_u / spread, by_v / spread];
        let rest = squares - sum * sum / n - slope[0] * by_u - slope[1] * by_v;
        let freedom = (n - 3.0).max(1.0);
        Affine { value: origin + sum / n, slope, deviation: (rest.max(0.0) / freedom).sqrt() }
    }

    /// Standard deviation of what is not affine over squares of two pixels, by its median.
    fn pixel_noise(&self, plane: &[f32]) -> f32 {
        self.median_deviation(plane, 2, |_| true) / MEDIAN_OVER_DEVIATION
    }

    /// Median deviation of inverse depth from planes.
    fn plane_noise(&self) -> f32 {
        self.median_deviation(&self.inverse_depth, NOISE_SIZE, |w| w > 0.0)
    }

    fn median_deviation(&self, plane: &[f32], size: usize, known: impl Fn(f32) -> bool) -> f32 {
        let (width, height) = (self.colour.width, self.colour.height);
        let mut deviations = Vec::new();
        for row in (0..(height + 1).saturating_sub(size)).step_by(size) {
            for column in (0..(width + 1).saturating_sub(size)).step_by(size) {
                let all = (row..row + size)
                    .all(|y| plane[y * width + column..][..size].iter().all(|&w| known(w)));
                if all {
                    deviations.push(self.fit(plane, [column, row], size).deviation);
                }
            }
        }
        median(&mut deviations).unwrap_or(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 32;
    const FOCAL: f32 = 40.0;

    /// First column of what is chequered.
    const CHEQUERED: usize = 24;

    /// A slanted wall of an even gradient; on its right chequered, and nearer in its lower half.
    fn scene(noise: f32) -> (Image<f32>, Image<f32>) {
        let mut colour = Image::new(SIDE, SIDE, 3);
        let mut depth = Image::new(SIDE, SIDE, 1);
        let random = i2slam_check::noise(5, 3 * SIDE * SIDE);
        for pixel in 0..SIDE * SIDE {
            let (x, y) = (pixel % SIDE, pixel / SIDE);
            let chequered = if x >= CHEQUERED && (x + y) % 2 == 0 { 0.3 } else { 0.0 };
            for c in 0..3 {
                let grain = noise * random[c * SIDE * SIDE + pixel] as f32;
                colour.plane_mut(c)[pixel] = 0.2 + 0.005 * x as f32 + chequered + grain;
            }
            let near = if y >= SIDE / 2 { 2.0 } else { 1.0 };
            depth.data[pixel] = 1.0 / (near * (0.3 + 0.004 * x as f32 + 0.002 * y as f32));
        }
        (colour, depth)
    }

    fn squares(colour: &Image<f32>, depth: &Image<f32>, wanted: &[bool]) -> Vec<Square> {
        Quadtree::new(colour, depth, FOCAL).squares(wanted)
    }

    #[test]
    fn squares_cover_what_is_wanted_once() {
        let (colour, mut depth) = scene(0.0);
        depth.data[5 * SIDE + 3] = 0.0;
        let wanted: Vec<bool> = (0..SIDE * SIDE).map(|p| p % 7 != 3).collect();
        let mut covered = vec![0; SIDE * SIDE];
        for square in squares(&colour, &depth, &wanted) {
            square.pixels().for_each(|(x, y)| covered[y * SIDE + x] += 1);
        }
        for pixel in 0..SIDE * SIDE {
            let due = usize::from(wanted[pixel] && depth.data[pixel] > 0.0);
            assert_eq!(covered[pixel], due, "pixel {pixel}");
        }
    }

    #[test]
    fn plain_walls_have_large_squares_and_texture_single_pixels() {
        for noise in [0.0, 0.003] {
            let (colour, depth) = scene(noise);
            let squares = squares(&colour, &depth, &[true; SIDE * SIDE]);
            for square in &squares {
                let due = if square.column < CHEQUERED { MAX_SIZE } else { 1 };
                assert_eq!(square.size, due, "noise {noise}: {square:?}");
            }
        }
    }

    #[test]
    fn the_plane_of_a_square_is_that_of_the_wall() {
        let (colour, depth) = scene(0.0);
        let camera = Camera {
            width: SIDE,
            height: SIDE,
            fx: f64::from(FOCAL),
            fy: f64::from(FOCAL),
            cx: 16.0,
            cy: 16.0,
        };
        let square = squares(&colour, &depth, &[true; SIDE * SIDE])[0];
        let inverse_depth = |u: f64, v: f64| 0.3 + 0.004 * (u - 0.5) + 0.002 * (v - 0.5);
        let point = |u: f64, v: f64| camera.unproject(u, v, 1.0 / inverse_depth(u, v));
        assert!((square.centre(&camera) - point(4.0, 4.0)).norm() < 1e-5);
        let step = 1e-4;
        let [by_u, by_v] = square.tangents(&camera);
        let along = (point(4.0 + step, 4.0) - point(4.0 - step, 4.0)) * (0.5 / step);
        let down = (point(4.0, 4.0 + step) - point(4.0, 4.0 - step)) * (0.5 / step);
        assert!((by_u - along).norm() < 1e-4 && (by_v - down).norm() < 1e-4);
    }
}
