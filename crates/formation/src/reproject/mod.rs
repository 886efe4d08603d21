//! Blur at the price of a sharp render: one render and its depth stand for all virtual cameras.
//!
//! The exposure integral (eqs. 5 and 6) takes one render per virtual camera. Here the map is
//! rendered once, at the middle of the exposure, and every virtual camera reads that picture:
//!
//! ```text
//! blurred(p) = Σ_j weight_j · sharp(q_j(p))
//! q(p):  the place in the sharp render of the surface that virtual camera j sees at pixel p
//! ```
//!
//! **Finding q.** With inverse depth `w = 1/z` of the sharp render, a pixel's ray is a straight line
//! `q(w) = q_∞ + e w` (exact for any motion), and `q` is where `w` is the inverse depth that the
//! render has at `q(w)`. On a smooth surface one Newton step from the pixel's own depth solves this
//! for the first and the last virtual camera, and a parabola in time through both and the middle
//! gives all others. In blocks of 4 x 4 pixels near a step in depth whose sides a virtual camera
//! moves apart by more than half a pixel, its rays are walked from near to far instead, and the
//! first surface counts; background that a foreground hides from the sharp render takes the
//! background beside it. Pixels along the edge of a foreground hold a mixture of two depths and go
//! with the foreground. An unknown depth takes the farther of its row's two nearest known ones, or
//! is infinitely far without any. What lies outside the render takes its edge, so that the render
//! may be larger than the picture by a margin of half a blur length.
//!
//! **Reading the render.** It is brought to twice its resolution (see `upsample.rs`); taps are
//! bilinear there.
//!
//! **Backward.** With respect to the sharp render, the exact transpose. With respect to the poses at
//! shutter open and close, the derivative of `q` relative to the middle, times the slope of the
//! render at `q`; a surface point keeps its inverse depth plane. Neglected are the blur's effect on
//! the *map's* depth (of second order), the slope of the surface in blocks that were searched, and
//! how the edge of a foreground moves over what it covers there.
//!
//! **Rolling shutter.** With `readout` (first to last row, in exposures; positive when the top row
//! comes first) row `r` of `H` sees every moment later by `readout ((r + ½)/H - ½)`; the shutter
//! poses are those of the middle row. Each row has virtual cameras of its own, on the motion
//! continued at its speed beyond the exposure, which land by two Newton steps each.
//!
//! **The gauge.** The sharp render stands at [`ShutterPoses::middle`], which moves with both poses.
//! The gradient has two parts that add up: `d_radiance`, for the renderer to pull back to its map
//! and its own pose, which goes to the shutter by `ShutterPoses::pull_back(0.5, d_pose)`; and the
//! [`ShutterTangent`] of the motion relative to the middle from [`Reprojection::pull_back`].

mod backward;
mod band;
mod forward;
mod ray_surface;
mod reference;
mod sampling;
mod surface;
#[cfg(test)]
mod tests;
mod upsample;
mod views;

pub use reference::ReferenceReprojection;

use crate::shutter::{Quadrature, ShutterPoses, ShutterTangent};
use backward::PullBackBand;
use band::{BAND, Band, Scene, lay_bands};
use forward::BlurBand;
use i2slam_compute::simd::Column;
use i2slam_geometry::{Camera, Image};
use pulp::Arch;
use rayon::prelude::*;
use sampling::{LANES, Texel};
use upsample::UpsampleRow;

/// Side of the tiles that [`Reprojection::uncovered`] counts in [px].
pub const TILE: usize = sampling::LANES;

/// Gradients of [`Reprojection::pull_back`] beside that of the sharp render.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ReprojectionGradient {
    /// By start and end pose, through their motion relative to the middle.
    pub shutter: ShutterTangent<f64>,
    /// By the readout [per exposure].
    pub readout: f64,
}

/// Blurs one sharp render by its depth, and pulls cotangents back. Holds what one frame needs
/// between the two, and keeps its allocations from frame to frame. Gives the same bytes for any
/// number of threads of the current `rayon` pool.
#[derive(Clone, Debug, Default)]
pub struct Reprojection {
    scene: Scene,
    /// The sharp render at twice its resolution.
    fine: Vec<Texel>,
    /// Inverse depth at (row, chunk of a row, moving view) [1/m].
    inverse_depths: Vec<Column>,
    bands: Vec<Band>,
    /// See [`Reprojection::uncovered`].
    uncovered: Vec<f32>,
    sums: Vec<[f64; 6]>,
}

impl Reprojection {
    /// The average of what the virtual cameras see.
    ///
    /// `readout` [exposures] is the time in which the rows are read, 0 for a global shutter.
    /// `radiance` (3 planes, linear) and `depth` (1 plane [m], 0 = unknown) are the map seen from
    /// `shutter.middle()` by `camera` with a margin of the same number of pixels on every side
    /// ([`Camera::widened`]; none is fine too); `blurred` is the picture of `camera`.
    ///
    /// # Panics
    /// When `radiance` and `depth` do not have 3 and 1 planes of the same size, or their size is
    /// not that of `camera` with a margin.
    pub fn blur(
        &mut self,
        camera: &Camera<f32>,
        shutter: &ShutterPoses<f64>,
        readout: f64,
        virtual_cameras: usize,
        quadrature: Quadrature,
        radiance: &Image<f32>,
        depth: &Image<f32>,
        blurred: &mut Image<f32>,
    ) {
        let plan = (virtual_cameras, quadrature);
        self.scene.set_views(camera, shutter, readout, plan, radiance.width);
        let Camera { width, height, .. } = self.scene.camera;
        assert_shape(radiance, width, height, 3);
        assert_shape(depth, width, height, 1);
        blurred.reshape(camera.width, camera.height, 3);
        if self.scene.views.count() == 0 || blurred.data.is_empty() {
            radiance.crop_into(self.scene.margin, blurred);
            self.uncovered.clear();
            return;
        }
        self.scene.set_depth(depth);
        lay_bands(&mut self.bands, width, height);
        self.upsample(radiance);
        self.gather(radiance, blurred);
    }

    /// Share (0 to 1) of each tile's pixels and moments that see what a foreground hides from
    /// the sharp render, so that the last [`blur`](Self::blur) had to guess them: tiles of
    /// [`TILE`] pixels, row by row. Pixels beyond the right and lower edge count as seen; empty
    /// where nothing moved.
    pub fn uncovered(&self) -> &[f32] {
        &self.uncovered
    }

    fn upsample(&mut self, radiance: &Image<f32>) {
        let Camera { width, height, .. } = self.scene.camera;
        self.fine.resize(4 * width * height, Texel::zero());
        let planes = [0, 1, 2].map(|c| radiance.plane(c));
        let arch = Arch::new();
        let rows = self.fine.par_chunks_mut(2 * BAND * 2 * width);
        rows.zip(&mut self.bands).for_each(|(rows, band)| {
            let scratch = &mut band.planar_row;
            for (y, out) in (2 * band.first_row..).zip(rows.chunks_exact_mut(2 * width)) {
                arch.dispatch(UpsampleRow { planes, height, y, scratch, out });
            }
        });
    }

    fn gather(&mut self, radiance: &Image<f32>, blurred: &mut Image<f32>) {
        let (width, pixels) = (blurred.width, blurred.pixels());
        let (scene, fine) = (&self.scene, &self.fine);
        let depths_per_row = sampling::chunks(width) * scene.views.count();
        self.inverse_depths.resize(blurred.height * depths_per_row, [0.0; LANES]);
        let (stride, margin) = (scene.camera.width, scene.margin);
        let chunk = BAND * width;
        let (red, rest) = blurred.data.split_at_mut(pixels);
        let (green, blue) = rest.split_at_mut(pixels);
        let planes = red.par_chunks_mut(chunk).zip(green.par_chunks_mut(chunk));
        let planes = planes.zip(blue.par_chunks_mut(chunk));
        let tiles = width.div_ceil(TILE);
        self.uncovered.resize(tiles * blurred.height.div_ceil(TILE), 0.0);
        let bands =
            self.bands.par_iter_mut().zip(self.uncovered.par_chunks_mut(BAND / TILE * tiles));
        let depths = self.inverse_depths.par_chunks_mut(BAND * depths_per_row);
        bands.zip(depths).zip(planes).for_each(|(((band, uncovered), depths), planes)| {
            let ((red, green), blue) = planes;
            let rows = band.first_row + margin..band.first_row + margin + red.len() / width;
            let sharp =
                [0, 1, 2].map(|c| &radiance.plane(c)[rows.start * stride..rows.end * stride]);
            let (blurred, inverse_depths) = ([red, green, blue], depths);
            let task = BlurBand { scene, fine, band, inverse_depths, uncovered, sharp, blurred };
            Arch::new().dispatch(task);
        });
    }

    /// The transpose of the last [`blur`](Self::blur): from `d_blurred = ∂loss/∂blurred`, writes
    /// `d_radiance = ∂loss/∂radiance` and returns the gradient of the readout, and of the shutter
    /// poses through the motion relative to the middle (see the module on what to add to it).
    ///
    /// # Panics
    /// When `d_blurred` has another shape than the last blurred picture.
    pub fn pull_back(
        &mut self,
        d_blurred: &Image<f32>,
        d_radiance: &mut Image<f32>,
    ) -> ReprojectionGradient {
        let Scene { camera, margin, views, .. } = &self.scene;
        let frame = self.scene.picture_camera();
        assert_shape(d_blurred, frame.width, frame.height, 3);
        d_radiance.reshape(camera.width, camera.height, 3);
        if views.count() == 0 || d_blurred.data.is_empty() {
            d_blurred.embed_into(*margin, d_radiance);
            return ReprojectionGradient::default();
        }
        self.scatter(d_blurred);
        self.merge(d_blurred, d_radiance);
        let Scene { views, shutter, .. } = &self.scene;
        self.sums.clear();
        self.sums.resize(views.sums(0, frame.height).1, [0.0; 6]);
        for band in &self.bands[..frame.height.div_ceil(BAND)] {
            let first = views.sums(band.first_row, frame.height).0;
            for (total, sum) in self.sums[first..].iter_mut().zip(&band.sums) {
                total.iter_mut().zip(sum).for_each(|(total, s)| *total += s);
            }
        }
        views.pull_back(shutter, &self.sums)
    }

    fn scatter(&mut self, d_blurred: &Image<f32>) {
        let width = d_blurred.width;
        let (scene, fine) = (&self.scene, &self.fine);
        let depths_per_row = sampling::chunks(width) * scene.views.count();
        let depths = self.inverse_depths.par_chunks(BAND * depths_per_row);
        self.bands.par_iter_mut().zip(depths).for_each(|(band, depths)| {
            let from = band.first_row * width;
            let pixels = depths.len() / depths_per_row * width;
            let d_blurred = [0, 1, 2].map(|c| &d_blurred.plane(c)[from..from + pixels]);
            let task = PullBackBand { scene, fine, band, inverse_depths: depths, d_blurred };
            Arch::new().dispatch(task);
        });
    }

    /// Sums the bands' cotangents, in the order of the bands.
    fn merge(&self, d_blurred: &Image<f32>, d_radiance: &mut Image<f32>) {
        let Scene { camera: Camera { width, height, .. }, margin, views, .. } = &self.scene;
        let (width, height, margin, still) = (*width, *height, *margin, views.still_weight);
        let bands = &self.bands[..d_blurred.height.div_ceil(BAND)];
        let rows = d_radiance.data.par_chunks_mut(width);
        rows.enumerate().with_min_len(BAND).for_each(|(i, to)| {
            let (plane, y) = (i / height, i % height);
            to.fill(0.0);
            if let Some(y) = y.checked_sub(margin).filter(|&y| y < d_blurred.height) {
                let from = (plane * d_blurred.height + y) * d_blurred.width;
                let from = &d_blurred.data[from..from + d_blurred.width];
                to[margin..].iter_mut().zip(from).for_each(|(to, d)| *to = still * d);
            }
            for band in bands {
                let (first, end) = band.sharp_rows;
                if (first..end).contains(&y) {
                    let from = (plane * (end - first) + y - first) * width;
                    let d_sharp = &band.d_sharp[from..from + width];
                    to.iter_mut().zip(d_sharp).for_each(|(to, d)| *to += d);
                }
            }
        });
    }
}

fn assert_shape<T>(image: &Image<T>, width: usize, height: usize, channels: usize) {
    let actual = (image.width, image.height, image.channels, image.data.len());
    assert_eq!(actual, (width, height, channels, width * height * channels), "image shape");
}
