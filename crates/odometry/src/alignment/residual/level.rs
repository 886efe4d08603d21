//! One pyramid level of frame or target, laid out for blocks of samples.

use i2slam_compute::median;
use i2slam_compute::simd::{Lanes, Mask};
use i2slam_geometry::{Camera, Image};
use pulp::Simd;
use std::ops::{Deref, DerefMut, Range};
use std::sync::Arc;

/// Largest relative depth difference of neighbouring pixels on one surface.
const MAX_DEPTH_STEP_RATIO: f32 = 0.05;

/// Samples of one block; a multiple of the widest instruction.
pub(super) const BLOCK: usize = 128;

/// One value for each sample of a block.
#[derive(Clone, Copy)]
#[repr(align(64))]
pub(super) struct BlockValues(pub(super) [f32; BLOCK]);

impl Default for BlockValues {
    fn default() -> Self {
        Self([0.0; BLOCK])
    }
}

impl Deref for BlockValues {
    type Target = [f32];

    #[inline(always)]
    fn deref(&self) -> &[f32] {
        &self.0
    }
}

impl DerefMut for BlockValues {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut [f32] {
        &mut self.0
    }
}

/// Number of vectors of `S` in a block.
#[inline(always)]
pub(super) fn groups<S: Simd>() -> usize {
    BLOCK / S::F32_LANES
}

/// One pyramid level of the observed frame.
pub struct FrameLevel {
    /// Intrinsics at this level, those of the target too.
    pub camera: Camera<f32>,
    /// Picture values, three planes.
    pub colour: Arc<Image<f32>>,
    /// Depth [m]; 0 = no reading.
    pub depth: Arc<Image<f32>>,
    pub(super) samples: DepthSamples,
    pub(super) texels: PackedColour,
}

/// One pyramid level of an alignment target: radiance and depth seen from the target's pose.
pub struct TargetLevel {
    /// Linear radiance, three planes.
    pub radiance: Image<f32>,
    /// Depth divided by opacity [m]; 0 where the target has no surface.
    pub depth: Image<f32>,
    pub(super) surface: InverseDepth,
    pub(super) texels: PackedColour,
    /// Whether the target has depth at all; without, every point in view counts as visible.
    pub(super) has_surface: bool,
    /// Standard deviation of the depth, estimated from its roughness [m at 1 m].
    pub noise: f32,
}

impl TargetLevel {
    /// From linear radiance and depth [m]; either may be an empty picture.
    pub fn new(radiance: Image<f32>, depth: Image<f32>) -> Self {
        let roughness = roughness(&depth);
        Self {
            has_surface: depth.pixels() > 0,
            noise: depth_noise_of(&depth, &roughness),
            surface: InverseDepth::new(&depth, &roughness),
            texels: PackedColour::new(&radiance),
            radiance,
            depth,
        }
    }

    /// Pixels that lie on one surface with those to the right and below: where points can be compared with
    /// the target's depth.
    pub fn surface_pixels(&self) -> usize {
        let last_column = self.surface.width.saturating_sub(1);
        let rows = self.surface.roughness.chunks(self.surface.width.max(1));
        rows.flat_map(|row| row.iter().take(last_column)).filter(|r| **r >= 0.0).count()
    }
}

impl FrameLevel {
    /// With a sample at every `stride`-th pixel.
    pub fn new(
        camera: Camera<f32>,
        colour: impl Into<Arc<Image<f32>>>,
        depth: impl Into<Arc<Image<f32>>>,
        stride: usize,
    ) -> Self {
        let (colour, depth) = (colour.into(), depth.into());
        let samples = DepthSamples::new(&camera, &depth, &roughness(&depth), stride);
        Self { camera, samples, texels: PackedColour::new(&colour), colour, depth }
    }

    /// The samples at every `stride`-th pixel, apart by tiles of the picture, `[columns, rows]` of
    /// them.
    pub fn tiles(&self, stride: usize, [columns, rows]: [usize; 2]) -> Vec<DepthSamples> {
        let roughness = roughness(&self.depth);
        let part = |i: usize, parts: usize, size: usize| i * size / parts..(i + 1) * size / parts;
        let tile = |i: usize| {
            let across = part(i % columns, columns, self.depth.width);
            let down = part(i / columns, rows, self.depth.height);
            DepthSamples::within(&self.camera, (&self.depth, &roughness), stride, across, down)
        };
        (0..columns * rows).map(tile).collect()
    }
}

/// Distance of each pixel's depth from a plane through its neighbours in the row or the column, the
/// larger of the two [m]. Large at edges and beside holes; 0 where there is no depth.
pub(super) fn roughness(depth: &Image<f32>) -> Image<f32> {
    let (width, height) = (depth.width, depth.height);
    let inverse: Vec<f32> =
        depth.data.iter().map(|&d| if d > 0.0 { 1.0 / d } else { 0.0 }).collect();
    Image::from_fn(width, height, 1, |_, column, row| {
        let i = row * width + column;
        let bend = |a: usize, b: usize| (inverse[a] + inverse[b] - 2.0 * inverse[i]).abs();
        let inside = |at: usize, size: usize| at > 0 && at + 1 < size;
        let along = if inside(column, width) { bend(i - 1, i + 1) } else { 0.0 };
        let across = if inside(row, height) { bend(i - width, i + width) } else { 0.0 };
        along.max(across) * depth.data[i] * depth.data[i]
    })
}

/// Growth of depth noise with distance: with the square of the depth beyond 1 m.
pub(in super::super) fn depth_spread(z: f32) -> f32 {
    z * z.max(1.0)
}

/// Standard deviation of depth noise [m at 1 m], see [`depth_spread`].
pub(in super::super) fn depth_noise(depth: &Image<f32>) -> f32 {
    depth_noise_of(depth, &roughness(depth))
}

/// The second difference of independent noise has `√6` times its standard deviation, and the median
/// of the larger of two such has about that size; most of a picture is no edge.
fn depth_noise_of(depth: &Image<f32>, roughness: &Image<f32>) -> f32 {
    let pixels = depth.data.iter().zip(&roughness.data).step_by(5);
    let mut all: Vec<f32> =
        pixels.filter(|(d, _)| **d > 0.0).map(|(d, r)| r / depth_spread(*d)).collect();
    median(&mut all).map_or(f32::INFINITY, |roughness| roughness / 6.0_f32.sqrt())
}

/// Whether four depths [m] of neighbouring pixels are readings of one surface.
pub fn is_one_surface(depths: [f32; 4]) -> bool {
    let least = depths.iter().copied().fold(f32::INFINITY, f32::min);
    let most = depths.iter().copied().fold(0.0, f32::max);
    least > 0.0 && most - least < MAX_DEPTH_STEP_RATIO * least
}

/// The points of pixels with depth, in raster order; the last block is padded with depth 0.
pub struct DepthSamples {
    pub(super) blocks: Vec<SampleBlock>,
    /// Number of pixels with depth.
    pub(super) count: usize,
}

/// [`BLOCK`] samples.
#[derive(Default)]
pub(super) struct SampleBlock {
    /// The point in the camera that took the depth picture.
    pub(super) point: [BlockValues; 3],
    pub(super) roughness: BlockValues,
}

impl DepthSamples {
    /// Samples every `stride`-th column and row.
    pub(super) fn new(
        camera: &Camera<f32>,
        depth: &Image<f32>,
        roughness: &Image<f32>,
        stride: usize,
    ) -> Self {
        let (across, down) = (0..depth.width, 0..depth.height);
        Self::within(camera, (depth, roughness), stride, across, down)
    }

    /// Those within ranges of columns and rows.
    fn within(
        camera: &Camera<f32>,
        (depth, roughness): (&Image<f32>, &Image<f32>),
        stride: usize,
        across: Range<usize>,
        down: Range<usize>,
    ) -> Self {
        let mut samples = Self { blocks: Vec::new(), count: 0 };
        let first = |range: &Range<usize>| range.start.next_multiple_of(stride);
        for row in (first(&down)..down.end).step_by(stride) {
            for column in (first(&across)..across.end).step_by(stride) {
                let z = depth.at(0, column, row);
                if z > 0.0 {
                    let (u, v) = Camera::<f32>::pixel_centre(column, row);
                    let point = camera.unproject(u, v, z);
                    samples.push(point.to_array(), roughness.at(0, column, row));
                }
            }
        }
        samples
    }

    fn push(&mut self, point: [f32; 3], roughness: f32) {
        let lane = self.count % BLOCK;
        if lane == 0 {
            self.blocks.push(SampleBlock::default());
        }
        if let Some(block) = self.blocks.last_mut() {
            block.point.iter_mut().zip(point).for_each(|(row, value)| row.0[lane] = value);
            block.roughness.0[lane] = roughness;
        }
        self.count += 1;
    }
}

/// Bilinear taps of a block: upper left pixels, and fractions to the right and down.
pub(super) struct BilinearTaps {
    index: [u32; BLOCK],
    right: BlockValues,
    down: BlockValues,
}

impl Default for BilinearTaps {
    fn default() -> Self {
        Self { index: [0; BLOCK], right: BlockValues::default(), down: BlockValues::default() }
    }
}

impl BilinearTaps {
    /// Stores the image positions `(u, v)` of a group; returns the mask of those between the
    /// outermost pixel centres, the others are stored as 0.
    #[inline(always)]
    pub(super) fn store_positions<S: Simd>(
        &mut self,
        simd: S,
        group: usize,
        (u, v): (Lanes<S>, Lanes<S>),
        camera: &Camera<f32>,
    ) -> Mask<S> {
        let number = |value| Lanes::splat(simd, value);
        let (x, y) = (u - number(0.5), v - number(0.5));
        let most = |size: usize| number(size.saturating_sub(1) as f32);
        let inside = number(0.0).le(x)
            & number(0.0).le(y)
            & x.lt(most(camera.width))
            & y.lt(most(camera.height));
        inside.keep(x).store_group(&mut self.right, group);
        inside.keep(y).store_group(&mut self.down, group);
        inside
    }

    /// Splits the stored positions into pixels and fractions.
    #[inline(always)]
    pub(super) fn split(&mut self, camera: &Camera<f32>) {
        let width = camera.width as u32;
        for i in 0..BLOCK {
            let (column, row) = (self.right.0[i] as u32, self.down.0[i] as u32);
            self.index[i] = row * width + column;
            self.right.0[i] -= column as f32;
            self.down.0[i] -= row as f32;
        }
    }

    /// Value and derivatives by `u` and `v` from the values of the four pixels.
    #[inline(always)]
    pub(super) fn interpolate<S: Simd>(
        &self,
        simd: S,
        group: usize,
        corners: &[BlockValues; 4],
    ) -> [Lanes<S>; 3] {
        let [a, b, c, d] = [0, 1, 2, 3].map(|i| Lanes::load_group(simd, &corners[i], group));
        let (right, down) = (
            Lanes::load_group(simd, &self.right, group),
            Lanes::load_group(simd, &self.down, group),
        );
        let (top, bottom) = ((b - a).mul_add(right, a), (d - c).mul_add(right, c));
        let by_u = ((d - c) - (b - a)).mul_add(down, b - a);
        [(bottom - top).mul_add(down, top), by_u, bottom - top]
    }
}

/// A depth picture prepared for interpolation: inverse depth is linear over the image of a plane,
/// so that a floor seen at a grazing angle has no bias.
pub(super) struct InverseDepth {
    width: usize,
    /// Inverse depth of each pixel [1/m]; 0 where there is none.
    inverse: Vec<f32>,
    /// The largest roughness of the four pixels from each on to the right and down; negative where
    /// they do not lie on one surface.
    roughness: Vec<f32>,
}

impl InverseDepth {
    fn new(depth: &Image<f32>, roughness: &Image<f32>) -> Self {
        let (width, pixels) = (depth.width, depth.pixels());
        // Beyond the last pixel, so that taps of empty lanes may be read from pixel 0.
        let padded = pixels + width + 2;
        let mut surface = Self { width, inverse: vec![0.0; padded], roughness: vec![-1.0; padded] };
        for (inverse, &d) in surface.inverse.iter_mut().zip(&depth.data) {
            *inverse = if d > 0.0 { 1.0 / d } else { 0.0 };
        }
        for i in 0..pixels.saturating_sub(width + 1) {
            let of = |data: &[f32]| [data[i], data[i + 1], data[i + width], data[i + width + 1]];
            if is_one_surface(of(&depth.data)) {
                surface.roughness[i] = of(&roughness.data).into_iter().fold(0.0, f32::max);
            }
        }
        surface
    }

    /// Inverse depths of the four pixels of each tap, and their roughness.
    #[inline(always)]
    pub(super) fn gather(
        &self,
        taps: &BilinearTaps,
        corners: &mut [BlockValues; 4],
        roughness: &mut BlockValues,
    ) {
        for i in 0..BLOCK {
            let index = taps.index[i] as usize;
            let (top, bottom) = (&self.inverse[index..][..2], &self.inverse[index + self.width..]);
            (corners[0].0[i], corners[1].0[i]) = (top[0], top[1]);
            (corners[2].0[i], corners[3].0[i]) = (bottom[0], bottom[1]);
            roughness.0[i] = self.roughness[index];
        }
    }
}

/// A picture of three channels with the channels of a pixel side by side.
pub(super) struct PackedColour {
    width: usize,
    data: Vec<[f32; 4]>,
}

impl PackedColour {
    fn new(image: &Image<f32>) -> Self {
        let (width, pixels) = (image.width, image.pixels());
        let mut data = vec![[0.0; 4]; pixels + width + 2];
        for channel in 0..image.channels.min(3) {
            for (texel, &value) in data.iter_mut().zip(image.plane(channel)) {
                texel[channel] = value;
            }
        }
        Self { width, data }
    }

    /// Interpolates each channel: value and derivatives by `u` and `v`.
    #[inline(always)]
    pub(super) fn sample(&self, taps: &BilinearTaps, out: &mut [[BlockValues; 3]; 3]) {
        for i in 0..BLOCK {
            let index = taps.index[i] as usize;
            let (right, down) = (taps.right.0[i], taps.down.0[i]);
            let (top, bottom) = (&self.data[index..][..2], &self.data[index + self.width..][..2]);
            let (a, b, c, d) = (top[0], top[1], bottom[0], bottom[1]);
            let (mut value, mut by_u, mut by_v) = ([0.0; 4], [0.0; 4], [0.0; 4]);
            for k in 0..4 {
                let (across, below) = (b[k] - a[k], d[k] - c[k]);
                let (upper, lower) = (a[k] + across * right, c[k] + below * right);
                by_v[k] = lower - upper;
                by_u[k] = across + (below - across) * down;
                value[k] = upper + by_v[k] * down;
            }
            for k in 0..3 {
                out[k][0].0[i] = value[k];
                out[k][1].0[i] = by_u[k];
                out[k][2].0[i] = by_v[k];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn holes_and_edges_are_no_surface() {
        let surface = |depth| TargetLevel::new(Image::default(), depth).surface_pixels();
        let depth = |column, row| match (column, row) {
            (2, 1) => 0.0,
            (6.., _) => 2.0,
            _ => 1.0,
        };
        let wall = Image::from_fn(9, 5, 1, |_, _, _| 1.0);
        let with_hole_and_edge = Image::from_fn(9, 5, 1, |_, column, row| depth(column, row));
        assert_eq!(surface(wall), 8 * 4);
        assert_eq!(surface(with_hole_and_edge), 8 * 4 - 4 - 4);
    }

    #[test]
    fn depth_noise_is_separated_from_edges_and_slopes() {
        let mut random = i2slam_compute::Random::new(3);
        let sigma = 0.004;
        let mut plane = Image::from_fn(60, 40, 1, |_, column, row| {
            let edge = if column < 30 { 0.3 } else { 0.0 };
            1.0 / (0.8 + edge + 0.004 * row as f32)
        });
        let clean = TargetLevel::new(Image::default(), plane.clone()).noise;
        plane
            .data
            .iter_mut()
            .for_each(|d| *d += sigma * (12.0_f64.sqrt() * (random.uniform() - 0.5)) as f32);
        let noisy = TargetLevel::new(Image::default(), plane).noise;
        assert!(clean < 1e-5 && (0.7..1.4).contains(&(noisy / sigma)), "{clean} {noisy}");
    }
}
