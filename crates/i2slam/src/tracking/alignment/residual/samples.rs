//! Frame and model laid out for blocks of samples: what one sample needs lies together.

use super::block::{BLOCK, Row};
use i2slam_compute::simd::{Lanes, Mask};
use i2slam_geometry::{Camera, Image};
use pulp::Simd;

/// The pixels with depth, in raster order; the last block ends with samples of depth 0.
pub(in super::super) struct Samples {
    pub(super) blocks: Vec<SampleBlock>,
    /// Number of pixels with depth.
    pub(super) count: usize,
}

pub(super) struct SampleBlock {
    /// The point in the camera that took the depth picture.
    pub(super) point: [Row; 3],
    pub(super) relief: Row,
}

impl Samples {
    /// Of every `stride`-th pixel and row.
    pub(in super::super) fn new(
        camera: &Camera<f32>,
        depth: &Image<f32>,
        relief: &Image<f32>,
        stride: usize,
    ) -> Self {
        let mut samples = Self { blocks: Vec::new(), count: 0 };
        for row in (0..depth.height).step_by(stride) {
            for column in (0..depth.width).step_by(stride) {
                let z = depth.at(0, column, row);
                if z > 0.0 {
                    let (u, v) = Camera::<f32>::pixel_centre(column, row);
                    let point = camera.unproject(u, v, z);
                    samples.push(point.to_array(), relief.at(0, column, row));
                }
            }
        }
        samples
    }

    fn push(&mut self, point: [f32; 3], relief: f32) {
        let lane = self.count % BLOCK;
        if lane == 0 {
            self.blocks.push(SampleBlock { point: [Row::ZERO; 3], relief: Row::ZERO });
        }
        if let Some(block) = self.blocks.last_mut() {
            block.point.iter_mut().zip(point).for_each(|(row, value)| row.0[lane] = value);
            block.relief.0[lane] = relief;
        }
        self.count += 1;
    }
}

/// Upper left pixels of bilinear taps and the fractions to the right and down.
pub(super) struct Taps {
    index: [u32; BLOCK],
    right: Row,
    down: Row,
}

impl Taps {
    pub(super) const EMPTY: Self = Self { index: [0; BLOCK], right: Row::ZERO, down: Row::ZERO };

    /// Notes the image position `(u, v)` of a group; where it lies inside of the pixel centres.
    #[inline(always)]
    pub(super) fn place<S: Simd>(
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

    /// Splits the noted positions into pixels and fractions.
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
        corners: &[Row; 4],
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

/// A depth picture as a surface between pixels.
pub(in super::super) struct Surface {
    width: usize,
    /// Inverse depth of each pixel; 0 where there is none.
    inverse: Vec<f32>,
    /// The largest relief of the four pixels from each on to the right and down; negative where
    /// they do not lie on one surface.
    relief: Vec<f32>,
}

impl Surface {
    /// `one_surface` tells whether four depths belong together.
    pub(in super::super) fn new(
        depth: &Image<f32>,
        relief: &Image<f32>,
        one_surface: impl Fn([f32; 4]) -> bool,
    ) -> Self {
        let (width, pixels) = (depth.width, depth.pixels());
        // Beyond the last pixel, so that taps of empty lanes may be read from pixel 0.
        let padded = pixels + width + 2;
        let mut surface = Self { width, inverse: vec![0.0; padded], relief: vec![-1.0; padded] };
        for (inverse, &d) in surface.inverse.iter_mut().zip(&depth.data) {
            *inverse = if d > 0.0 { 1.0 / d } else { 0.0 };
        }
        for i in 0..pixels.saturating_sub(width + 1) {
            let of = |data: &[f32]| [data[i], data[i + 1], data[i + width], data[i + width + 1]];
            if one_surface(of(&depth.data)) {
                surface.relief[i] = of(&relief.data).into_iter().fold(0.0, f32::max);
            }
        }
        surface
    }

    /// Inverse depths of the four pixels of each tap and their relief.
    #[inline(always)]
    pub(super) fn gather(&self, taps: &Taps, corners: &mut [Row; 4], relief: &mut Row) {
        for i in 0..BLOCK {
            let index = taps.index[i] as usize;
            let (top, bottom) = (&self.inverse[index..][..2], &self.inverse[index + self.width..]);
            (corners[0].0[i], corners[1].0[i]) = (top[0], top[1]);
            (corners[2].0[i], corners[3].0[i]) = (bottom[0], bottom[1]);
            relief.0[i] = self.relief[index];
        }
    }
}

/// A picture of three channels, pixel by pixel.
pub(in super::super) struct Texels {
    width: usize,
    data: Vec<[f32; 4]>,
}

impl Texels {
    /// Empty for an empty picture.
    pub(in super::super) fn new(image: &Image<f32>) -> Self {
        let (width, pixels) = (image.width, image.pixels());
        let mut data = vec![[0.0; 4]; pixels + width + 2];
        for channel in 0..image.channels.min(3) {
            for (texel, &value) in data.iter_mut().zip(image.plane(channel)) {
                texel[channel] = value;
            }
        }
        Self { width, data }
    }

    /// Per channel: value and derivatives by `u` and `v`.
    #[inline(always)]
    pub(super) fn sample(&self, taps: &Taps, out: &mut [[Row; 3]; 3]) {
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
