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
//! **Finding q.** With inverse depth `w = 1/z` of the sharp render, a pixel's ray is a straight
//! line `q(w) = q_∞ + e w` (exact for any motion), and `q` is where `w` is the inverse depth that
//! the render has at `q(w)`. Where the surface is smooth one Newton step from the pixel's own depth
//! solves this for the first and the last virtual camera, and a parabola in time through both and
//! the middle gives all others. In blocks of 4 x 4 pixels near a step in depth whose sides a
//! virtual camera moves apart by more than half a pixel, its rays are walked from near to far
//! instead, and the first surface counts: a foreground covers what is behind it. Background that
//! the foreground hides from the sharp render takes the background beside the foreground. Along the
//! edge of a foreground a render holds a mixture of two depths; such pixels go with the foreground.
//! An unknown depth takes the farther of its row's two nearest known ones; without any it is
//! infinitely far, where only rotation matters. What lies outside the render takes its edge: to
//! keep the border of a picture as good as its middle, the render may be larger than the picture by
//! a margin of half a blur length all around, see [`Reprojection::blur`].
//!
//! **Reading the render.** Once per frame it is brought to twice its resolution (see
//! `upsample.rs`); taps are bilinear there.
//!
//! **Backward.** With respect to the sharp render, the exact transpose. With respect to the poses
//! at shutter open and close, the derivative of `q` relative to the middle, times the slope of
//! the render at `q`. Depth is held fixed as an image: a surface point keeps its inverse depth
//! plane (exact for the first and the last virtual camera on a flat surface; for those between, to
//! the accuracy of the parabola). Neglected are: what the blur does to the *map's* depth (of second
//! order: it scales the blur's length by the relative change of depth); the slope of the surface in
//! blocks that were searched; and how the edge of a foreground moves over what it covers there.
//!
//! **Rolling shutter.** With `readout` (first to last row, in exposures; positive when the top row
//! comes first) row `r` of `H` sees every moment later by `readout ((r + ½)/H - ½)`, and the
//! shutter poses are those of the middle row. Each row then has virtual cameras of its own, on the
//! motion continued at its speed beyond the exposure, and each of them lands by itself (two Newton
//! steps).
//!
//! **The gauge.** The sharp render stands at [`ShutterPoses::middle`], which moves with both poses.
//! The gradient therefore comes in two parts that add up: `d_radiance`, for the renderer to pull
//! back to its map and to its own pose, which goes to the shutter by
//! `ShutterPoses::pull_back(0.5, d_pose)`; and the [`ShutterTangent`] of the motion relative to
//! the middle, which is what [`Reprojection::pull_back`] returns.

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
use i2slam_geometry::{Camera, Image, Pose};
use pulp::Arch;
use rayon::prelude::*;
use sampling::LANES;
use sampling::Texel;
use surface::Surface;
use upsample::UpsampleRow;
use views::Views;

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
#[derive(Clone, Debug)]
pub struct Reprojection {
    /// Of the sharp render.
    camera: Camera<f32>,
    /// By how much the render is larger than the picture on every side [px].
    margin: usize,
    shutter: ShutterPoses<f64>,
    views: Views<f32>,
    surface: Surface<f32>,
    /// The sharp render at twice its resolution.
    fine: Vec<Texel>,
    /// Inverse depth at (row, chunk of a row, moving view) [1/m].
    inverse_depths: Vec<Column>,
    bands: Vec<Band>,
    /// See [`Reprojection::uncovered`].
    uncovered: Vec<f32>,
    sums: Vec<[f64; 6]>,
}

impl Default for Reprojection {
    fn default() -> Self {
        Self {
            camera: Camera { width: 0, height: 0, fx: 1.0, fy: 1.0, cx: 0.0, cy: 0.0 },
            margin: 0,
            shutter: ShutterPoses::still(Pose::identity()),
            views: Views::default(),
            surface: Surface::default(),
            fine: Vec::new(),
            inverse_depths: Vec::new(),
            bands: Vec::new(),
            uncovered: Vec::new(),
            sums: Vec::new(),
        }
    }
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
        self.margin = radiance.width.saturating_sub(camera.width) / 2;
        (self.camera, self.shutter) = (camera.widened(self.margin), *shutter);
        assert_shape(radiance, self.camera.width, self.camera.height, 3);
        assert_shape(depth, self.camera.width, self.camera.height, 1);
        shape(blurred, camera.width, camera.height);
        let camera = &self.camera;
        let seen_by = (camera, self.margin);
        self.views.update(seen_by, shutter, readout, virtual_cameras, quadrature);
        if self.views.count() == 0 || blurred.data.is_empty() {
            radiance.crop_into(self.margin, blurred);
            self.uncovered.clear();
            return;
        }
        self.surface.update(depth);
        let reach = self.views.reach(camera, self.surface.blocks.nearest());
        self.surface.blocks.prepare_search(reach, self.views.largest_parallax(camera));
        lay_bands(&mut self.bands, camera.width, camera.height);
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
        let (width, height) = (self.camera.width, self.camera.height);
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
        let count = self.views.count();
        let depths_per_row = sampling::chunks(width) * count;
        self.inverse_depths.resize(blurred.height * depths_per_row, [0.0; LANES]);
        let (stride, margin) = (self.camera.width, self.margin);
        let scene = Scene {
            camera: &self.camera,
            width,
            margin,
            views: &self.views,
            surface: &self.surface,
            fine: &self.fine,
        };
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
            let (blurred, scene) = ([red, green, blue], &scene);
            let inverse_depths = depths;
            let task = BlurBand { scene, band, inverse_depths, uncovered, sharp, blurred };
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
        let frame = self.camera.cropped(self.margin);
        assert_shape(d_blurred, frame.width, frame.height, 3);
        shape(d_radiance, self.camera.width, self.camera.height);
        if self.views.count() == 0 || d_blurred.data.is_empty() {
            d_blurred.embed_into(self.margin, d_radiance);
            return ReprojectionGradient::default();
        }
        self.scatter(d_blurred);
        self.merge(d_blurred, d_radiance);
        self.sums.clear();
        self.sums.resize(self.views.sums(0, frame.height).1, [0.0; 6]);
        for band in &self.bands[..frame.height.div_ceil(BAND)] {
            let first = self.views.sums(band.first_row, frame.height).0;
            for (total, sum) in self.sums[first..].iter_mut().zip(&band.sums) {
                total.iter_mut().zip(sum).for_each(|(total, s)| *total += s);
            }
        }
        self.views.pull_back(&self.shutter, &self.sums)
    }

    fn scatter(&mut self, d_blurred: &Image<f32>) {
        let width = d_blurred.width;
        let scene = Scene {
            camera: &self.camera,
            width,
            margin: self.margin,
            views: &self.views,
            surface: &self.surface,
            fine: &self.fine,
        };
        let depths_per_row = sampling::chunks(width) * self.views.count();
        let depths = self.inverse_depths.par_chunks(BAND * depths_per_row);
        self.bands.par_iter_mut().zip(depths).for_each(|(band, depths)| {
            let from = band.first_row * width;
            let pixels = depths.len() / depths_per_row * width;
            let d_blurred = [0, 1, 2].map(|c| &d_blurred.plane(c)[from..from + pixels]);
            let scene = &scene;
            let task = PullBackBand { scene, band, inverse_depths: depths, d_blurred };
            Arch::new().dispatch(task);
        });
    }

    /// Sums the bands' cotangents, in the order of the bands.
    fn merge(&self, d_blurred: &Image<f32>, d_radiance: &mut Image<f32>) {
        let (width, height) = (self.camera.width, self.camera.height);
        let (still, margin) = (self.views.still_weight, self.margin);
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

fn shape(image: &mut Image<f32>, width: usize, height: usize) {
    if (image.width, image.height, image.channels) != (width, height, 3) {
        image.reset(width, height, 3);
    }
}
