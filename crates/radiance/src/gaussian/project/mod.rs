//! Projection of Gaussians to footprints in the image, forward and backward.

use i2slam_geometry::{Camera, Real};
use std::f32::consts::LN_2;

mod cpu_backward;
mod cpu_forward;
mod path;
pub(crate) mod reference;
mod stages;

pub(crate) use cpu_backward::{Footprints, PoseSums};
pub(crate) use cpu_forward::{Projection, project};
pub(crate) use path::{MotionFrame, Path};
pub(crate) use stages::Frame;

/// The range of `x/z` and `y/z` in which the Jacobian of the projection is taken at the mean, 0.3
/// of half the field of view beyond the image; outside it is taken at the border.
#[derive(Clone, Copy, Debug)]
pub(crate) struct JacobianRange<T> {
    pub(crate) low: [T; 2],
    pub(crate) high: [T; 2],
}

impl<T: Real> JacobianRange<T> {
    pub(crate) fn of(camera: &Camera<T>) -> Self {
        let (width, height) = (T::of(camera.width as f64), T::of(camera.height as f64));
        let margin = T::of(0.15);
        Self {
            low: [
                (-camera.cx - margin * width) / camera.fx,
                (-camera.cy - margin * height) / camera.fy,
            ],
            high: [
                (width - camera.cx + margin * width) / camera.fx,
                (height - camera.cy + margin * height) / camera.fy,
            ],
        }
    }
}

/// Gaussians that are projected together; fixed, so that sums do not depend on the threads.
pub(crate) const CHUNK: usize = 256;

/// A footprint, ready for rasterising: one cache line.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(64))]
pub(crate) struct Splat {
    /// Centre \[px\].
    pub(crate) centre: [f32; 2],
    /// `[a, b, c]` of `log₂ α = log2_opacity + a dx² + b dx dy + c dy²`, all of `\[px⁻²\]`.
    pub(crate) exponent: [f32; 3],
    /// `log₂` of the opacity.
    pub(crate) log2_opacity: f32,
    /// Linear radiance.
    pub(crate) radiance: [f32; 3],
    /// Depth of the mean \[m\].
    pub(crate) depth: f32,
    /// Change of depth by column and row \[m/px\].
    pub(crate) depth_slope: [f32; 2],
    /// `log₂` of the opacity over `alpha_min`: what the exponent may fall by within the extent.
    pub(crate) reach: f32,
    /// Tiles that the extent's box touches: first column, first row, end column, end row.
    pub(crate) tiles: [u16; 4],
    /// Position of the first of this splat's tiles among those of its chunk.
    pub(crate) first_tile: u32,
}

impl Splat {
    /// `Σ₂⁻¹ d`: with it `∂α/∂centre = α Σ₂⁻¹ d` for the offset `d` of a pixel.
    #[inline(always)]
    pub(crate) fn gradient(&self, d: [f32; 2]) -> [f32; 2] {
        let ([a, b, c], [x, y]) = (self.exponent, d);
        [-LN_2 * (2.0 * a * x + b * y), -LN_2 * (b * x + 2.0 * c * y)]
    }

    /// `Σ₂ d`.
    #[inline(always)]
    pub(crate) fn covariance_product(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        let [a, b, c] = self.exponent;
        let factor = -2.0 / (LN_2 * (4.0 * a * c - b * b));
        [factor * (c * x - 0.5 * b * y), factor * (a * y - 0.5 * b * x)]
    }

    /// Number of tiles that the extent's box touches.
    pub(crate) fn tile_count(&self) -> u32 {
        let [x0, y0, x1, y1] = self.tiles.map(u32::from);
        (x1 - x0) * (y1 - y0)
    }
}

/// Visible Gaussians of a chunk.
#[derive(Default)]
pub(crate) struct Chunk {
    /// Sort items of the Gaussians that touch a tile.
    pub(crate) visible: Vec<u64>,
    /// Number of tiles they touch.
    pub(crate) tile_count: u32,
}
