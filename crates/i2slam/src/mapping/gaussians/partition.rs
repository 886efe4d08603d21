//! Rectangles of pixels that one Gaussian stands for: large on plain surfaces, single pixels at texture
//! and edges.
//!
//! A rectangle is taken whole where colour and inverse depth are affine over it,
//!
//! ```text
//! c(u, v) = c₀ + c_u u + c_v v + noise,   1/z(u, v) = w₀ + w_u u + w_v v + noise
//! ```
//!
//! (a plane in space has affine inverse depth); else its halves are looked at. A square is divided along
//! the axis that leaves less in the halves, any other rectangle along its longer one (a k-d tree whose
//! cells are at most twice as long as wide).

use super::picture_noise::PictureNoise;
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
/// Distance of a surface from a plane that does not count, as a share of the longer edge.
const MAX_RELIEF: f32 = 0.25;

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rectangle {
    /// First column and row.
    pub(super) column: usize,
    pub(super) row: usize,
    /// Width and height [px].
    pub(super) edges: [usize; 2],
    /// Inverse depth at the centre, and its derivatives by column and row [1/m, 1/m/px]; the
    /// derivatives are zero where no plane is known.
    pub(super) inverse_depth: [f32; 3],
}

impl Rectangle {
    /// Columns and rows of its pixels.
    pub(super) fn pixels(&self) -> impl Iterator<Item = (usize, usize)> + use<> {
        let Self { column, row, edges: [width, height], .. } = *self;
        (row..row + height).flat_map(move |y| (column..column + width).map(move |x| (x, y)))
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
        let [half_width, half_height] = self.edges.map(|edge| 0.5 * edge as f64);
        camera.unproject(self.column as f64 + half_width, self.row as f64 + half_height, 1.0)
    }
}

/// Affine fit over a rectangle: value at the centre, slopes per pixel, deviation of the residuals.
struct Affine {
    value: f32,
    slope: [f32; 2],
    deviation: f32,
}

/// Divides a picture with depth into rectangles.
pub(super) struct Partition<'a> {
    colour: &'a Image<f32>,
    inverse_depth: Vec<f32>,
    focal: f32,
    noise: PictureNoise,
    depth_noise: f32,
}

impl<'a> Partition<'a> {
    /// Of a picture with its depth [m], 0 where there is none; `focal` in pixels.
    pub(super) fn new(colour: &'a Image<f32>, depth: &Image<f32>, focal: f32) -> Self {
        let inverse_depth =
            depth.data.iter().map(|&z| if z > 0.0 { 1.0 / z } else { 0.0 }).collect();
        let mut partition = Self {
            colour,
            inverse_depth,
            focal,
            noise: PictureNoise::new(colour),
            depth_noise: 0.0,
        };
        partition.depth_noise = partition.plane_noise();
        partition
    }

    /// Rectangles that cover the pixels marked in `wanted`.
    pub(super) fn rectangles(&self, wanted: &[bool]) -> Vec<Rectangle> {
        let mut rectangles = Vec::new();
        for row in (0..self.colour.height).step_by(MAX_SIZE) {
            for column in (0..self.colour.width).step_by(MAX_SIZE) {
                self.divide([column, row], ([MAX_SIZE; 2], None), wanted, &mut rectangles);
            }
        }
        rectangles
    }

    /// Shorter edge of the rectangle that each pixel lies in [px].
    pub(super) fn sizes(&self) -> Vec<u8> {
        let mut sizes = vec![1; self.inverse_depth.len()];
        for rectangle in self.rectangles(&vec![true; sizes.len()]) {
            let [width, height] = rectangle.edges;
            for row in rectangle.row..rectangle.row + height {
                let start = row * self.colour.width + rectangle.column;
                sizes[start..start + width].fill(width.min(height) as u8);
            }
        }
        sizes
    }

    /// Deviation of a channel about a value up to which a rectangle counts as plain.
    pub(super) fn max_detail(&self, channel: usize, value: f32) -> f32 {
        MIN_DETAIL.max(COLOUR_NOISE_FACTOR * self.noise.deviation(channel, value))
    }

    /// Square of the deviations of colour from an affine function over a rectangle, over those up to which it
    /// counts as plain, summed over the channels.
    fn detail(&self, at: [usize; 2], edges: [usize; 2]) -> f32 {
        let of_channel = |c: usize| {
            let Affine { value, deviation, .. } = self.fit(self.colour.plane(c), at, edges);
            (deviation / self.max_detail(c, value)).powi(2)
        };
        (0..3).map(of_channel).sum()
    }

    /// Divides a rectangle; `plane` is the slope of the plane that a larger one around it lies on.
    fn divide(
        &self,
        [column, row]: [usize; 2],
        (edges, plane): ([usize; 2], Option<[f32; 2]>),
        wanted: &[bool],
        rectangles: &mut Vec<Rectangle>,
    ) {
        let (width, height) = (self.colour.width, self.colour.height);
        if column >= width || row >= height {
            return;
        }
        let rectangle = |w: f32, slope: Option<[f32; 2]>| {
            let [by_u, by_v] = slope.unwrap_or_default();
            Rectangle { column, row, edges, inverse_depth: [w, by_u, by_v] }
        };
        if edges == [1, 1] {
            let pixel = row * width + column;
            let w = self.inverse_depth[pixel];
            if wanted[pixel] && w > 0.0 {
                rectangles.push(rectangle(w, plane));
            }
            return;
        }
        let (mut slope, mut axis) = (plane, usize::from(edges[1] > edges[0]));
        if column + edges[0] <= width && row + edges[1] <= height {
            let pixels = |f: &dyn Fn(usize) -> bool| {
                (row..row + edges[1]).all(|y| (column..column + edges[0]).all(|x| f(y * width + x)))
            };
            if pixels(&|p| !wanted[p]) {
                return;
            }
            if pixels(&|p| self.inverse_depth[p] > 0.0)
                && let Some((w, own)) = self.plane([column, row], edges, plane)
            {
                // Of the larger rectangle: less noise.
                slope = plane.or(own);
                if pixels(&|p| wanted[p]) && self.is_plain([column, row], edges) {
                    rectangles.push(rectangle(w, slope));
                    return;
                }
            }
            if edges[0] == edges[1] {
                let [across, down] = [0, 1].map(|axis| self.cut_cost([column, row], edges, axis));
                axis = usize::from(down < across);
            }
        }
        let mut half = edges;
        half[axis] /= 2;
        let mut second = [column, row];
        second[axis] += half[axis];
        for at in [[column, row], second] {
            self.divide(at, (half, slope), wanted, rectangles);
        }
    }

    /// Cost of a cut along an axis: squared deviations of colour and inverse depth from affine fits over
    /// both halves, each over its tolerance.
    fn cut_cost(&self, at: [usize; 2], edges: [usize; 2], axis: usize) -> f32 {
        let (mut half, mut second) = (edges, at);
        half[axis] /= 2;
        second[axis] += half[axis];
        let cost = |at| {
            let depth = self.fit(&self.inverse_depth, at, half);
            let relief = self.max_relief(depth.value, edges);
            self.detail(at, half) + (depth.deviation / relief).powi(2)
        };
        cost(at) + cost(second)
    }

    /// Deviation of inverse depth that does not count over a rectangle.
    fn max_relief(&self, inverse_depth: f32, edges: [usize; 2]) -> f32 {
        let edge = edges[0].max(edges[1]) as f32;
        let relief = MAX_RELIEF * edge * inverse_depth / self.focal;
        relief.hypot(DEPTH_NOISE_FACTOR * self.depth_noise)
    }

    /// Inverse depth over a rectangle that is a plane, and its slope where that can be told; two pixels
    /// are compared by the slope of the plane `around`.
    fn plane(
        &self,
        at: [usize; 2],
        edges: [usize; 2],
        around: Option<[f32; 2]>,
    ) -> Option<(f32, Option<[f32; 2]>)> {
        let Affine { value, slope, deviation } = self.fit(&self.inverse_depth, at, edges);
        let is_pair = edges[0] * edges[1] == 2;
        let deviation = match is_pair {
            true => self.pair_deviation(at, usize::from(edges[1] > 1), around.unwrap_or_default()),
            false => deviation,
        };
        let is_plane = deviation <= self.max_relief(value, edges);
        is_plane.then_some((value, (!is_pair).then_some(slope)))
    }

    /// Deviation of two neighbours along an axis from a slope of inverse depth.
    fn pair_deviation(&self, [column, row]: [usize; 2], axis: usize, slope: [f32; 2]) -> f32 {
        let first = row * self.colour.width + column;
        let second = first + [1, self.colour.width][axis];
        let difference = self.inverse_depth[second] - self.inverse_depth[first];
        (difference - slope[axis]).abs() * std::f32::consts::FRAC_1_SQRT_2
    }

    /// Tells if colour is affine over a rectangle: by the mean square over the channels, because
    /// the largest of three is beyond 1.5 deviations in a third of all rectangles of mere noise.
    fn is_plain(&self, at: [usize; 2], edges: [usize; 2]) -> bool {
        self.detail(at, edges) <= 3.0
    }

    /// Least-squares affine function over a rectangle; a constant over two pixels.
    fn fit(&self, plane: &[f32], [column, row]: [usize; 2], [width, height]: [usize; 2]) -> Affine {
        let n = (width * height) as f32;
        let middle = [width, height].map(|edge| 0.5 * (edge as f32 - 1.0));
        let [mut sum, mut squares, mut by_u, mut by_v] = [0.0_f32; 4];
        let origin = plane[row * self.colour.width + column];
        for y in 0..height {
            let start = (row + y) * self.colour.width + column;
            let v = y as f32 - middle[1];
            for (x, value) in plane[start..start + width].iter().enumerate() {
                let (u, value) = (x as f32 - middle[0], value - origin);
                sum += value;
                squares += value * value;
                by_u += u * value;
                by_v += v * value;
            }
        }
        // Σ u² over the pixels of a row of w is w (w² - 1) / 12.
        let spread = [width, height].map(|edge| n * ((edge * edge) as f32 - 1.0) / 12.0);
        let (slope, fitted) = match width * height {
            1 | 2 => ([0.0; 2], 1.0),
            _ => ([by_u / spread[0], by_v / spread[1]], 3.0),
        };
        let rest = squares - sum * sum / n - slope[0] * by_u - slope[1] * by_v;
        let freedom = (n - fitted).max(1.0);
        Affine { value: origin + sum / n, slope, deviation: (rest.max(0.0) / freedom).sqrt() }
    }

    /// Median deviation of inverse depth from planes.
    fn plane_noise(&self) -> f32 {
        let (size, plane) = (NOISE_SIZE, &self.inverse_depth);
        let (width, height) = (self.colour.width, self.colour.height);
        let mut deviations = Vec::new();
        for row in (0..(height + 1).saturating_sub(size)).step_by(size) {
            for column in (0..(width + 1).saturating_sub(size)).step_by(size) {
                let is_known = (row..row + size)
                    .all(|y| plane[y * width + column..][..size].iter().all(|&w| w > 0.0));
                if is_known {
                    deviations.push(self.fit(plane, [column, row], [size; 2]).deviation);
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

    fn rectangles(colour: &Image<f32>, depth: &Image<f32>, wanted: &[bool]) -> Vec<Rectangle> {
        Partition::new(colour, depth, FOCAL).rectangles(wanted)
    }

    #[test]
    fn rectangles_cover_what_is_wanted_once() {
        let (colour, mut depth) = scene(0.0);
        depth.data[5 * SIDE + 3] = 0.0;
        let wanted: Vec<bool> = (0..SIDE * SIDE).map(|p| p % 7 != 3).collect();
        let mut covered = vec![0; SIDE * SIDE];
        for rectangle in rectangles(&colour, &depth, &wanted) {
            rectangle.pixels().for_each(|(x, y)| covered[y * SIDE + x] += 1);
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
            let rectangles = rectangles(&colour, &depth, &[true; SIDE * SIDE]);
            for rectangle in &rectangles {
                let due = if rectangle.column < CHEQUERED { MAX_SIZE } else { 1 };
                assert_eq!(rectangle.edges, [due; 2], "noise {noise}: {rectangle:?}");
            }
        }
    }

    /// Stripes of two pixels, of which squares would be two pixels wide.
    #[test]
    fn stripes_have_rectangles_along_them() {
        for (upright, due) in [(true, [2, 4]), (false, [4, 2])] {
            let (mut colour, mut depth) = (Image::new(SIDE, SIDE, 3), Image::new(SIDE, SIDE, 1));
            depth.data.fill(2.0);
            for (i, value) in colour.data.iter_mut().enumerate() {
                let (x, y) = (i % SIDE, i / SIDE % SIDE);
                let is_bright = if upright { x % 4 < 2 } else { y % 4 < 2 };
                *value = if x >= CHEQUERED && is_bright { 0.7 } else { 0.2 };
            }
            for rectangle in rectangles(&colour, &depth, &[true; SIDE * SIDE]) {
                let due = if rectangle.column < CHEQUERED { [MAX_SIZE; 2] } else { due };
                assert_eq!(rectangle.edges, due, "{rectangle:?}");
            }
        }
    }

    /// Two pixels beside an edge of depth are no plane, two along a slope are.
    #[test]
    fn two_pixels_are_compared_by_the_plane_around_them() {
        let (colour, depth) = scene(0.0);
        let partition = Partition::new(&colour, &depth, FOCAL);
        let (above_edge, slope) = ([4, SIDE / 2 - 1], Some([0.004, 0.002]));
        assert!(partition.plane(above_edge, [1, 2], slope).is_none());
        assert!(partition.plane(above_edge, [2, 1], slope).is_some());
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
        let square = rectangles(&colour, &depth, &[true; SIDE * SIDE])[0];
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
