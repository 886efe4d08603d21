//! The scene that is re-projected, and its fixed partition into bands of rows.

use super::sampling::Texel;
use super::surface::Surface;
use super::views::Views;
use crate::shutter::{Quadrature, ShutterPoses};
use i2slam_compute::simd::Column;
use i2slam_geometry::{Camera, Image, Pose, Real};

/// The sharp render's surface and the virtual cameras that see it.
#[derive(Clone, Debug)]
pub(super) struct Scene<T = f32> {
    /// Of the sharp render.
    pub(super) camera: Camera<T>,
    /// By how much the render is larger than the picture on every side [px].
    pub(super) margin: usize,
    pub(super) shutter: ShutterPoses<f64>,
    pub(super) views: Views<T>,
    pub(super) surface: Surface<T>,
}

impl<T: Real> Default for Scene<T> {
    fn default() -> Self {
        let (zero, one) = (T::zero(), T::one());
        Self {
            camera: Camera { width: 0, height: 0, fx: one, fy: one, cx: zero, cy: zero },
            margin: 0,
            shutter: ShutterPoses::still(Pose::identity()),
            views: Views::default(),
            surface: Surface::default(),
        }
    }
}

impl<T: Real> Scene<T> {
    /// Sets the virtual cameras of an exposure, for a render that is `width` pixels wide.
    pub(super) fn set_views(
        &mut self,
        camera: &Camera<T>,
        shutter: &ShutterPoses<f64>,
        readout: f64,
        (virtual_cameras, quadrature): (usize, Quadrature),
        width: usize,
    ) {
        self.margin = width.saturating_sub(camera.width) / 2;
        (self.camera, self.shutter) = (camera.widened(self.margin), *shutter);
        let seen_by = (&self.camera, self.margin);
        self.views.update(seen_by, shutter, readout, virtual_cameras, quadrature);
    }

    /// Reads the depth of the render, and prepares the search for the views' surfaces.
    pub(super) fn set_depth(&mut self, depth: &Image<T>) {
        self.surface.update(depth);
        let reach = self.views.reach(&self.camera, self.surface.blocks.nearest());
        self.surface.blocks.prepare_search(reach, self.views.largest_parallax(&self.camera));
    }

    /// Camera of the blurred picture.
    pub(super) fn picture_camera(&self) -> Camera<T> {
        self.camera.cropped(self.margin)
    }
}

/// Six sums, each over the pixels of one lane.
pub(super) type LaneSums = [Column; 6];

/// Rows of the picture per band: whole [tiles](super::TILE).
pub(super) const BAND: usize = 48;

/// Scratch of one band; it keeps its allocation from call to call.
#[derive(Clone, Debug, Default)]
pub(super) struct Band {
    /// First row of the picture; in the sharp render, to which the margin belongs, the band starts
    /// a margin further down.
    pub(super) first_row: usize,
    /// Fine rows that its taps' upper samples lie in, first and last.
    pub(super) fine_first: u32,
    pub(super) fine_last: u32,
    /// Three rows, one per plane.
    pub(super) planar_row: Vec<f32>,
    /// Cotangent of the fine rows, and of the image rows that they come from.
    pub(super) d_fine: Vec<Texel>,
    pub(super) d_sharp: Vec<f32>,
    /// The rows of the image in `d_sharp`, first and one past the last.
    pub(super) sharp_rows: (usize, usize),
    /// Six sums for each moving view of the row at work, and for each view of the whole band.
    pub(super) lane_sums: Vec<LaneSums>,
    pub(super) sums: Vec<[f64; 6]>,
}

impl Band {
    /// Clears the lanes of a row's `views`, the band's `sums` and the cotangent of the fine rows of
    /// an image of `width`.
    #[inline(always)]
    pub(super) fn start_pull_back(&mut self, views: usize, sums: usize, width: usize) {
        self.sums.clear();
        self.sums.resize(sums, [0.0; 6]);
        self.lane_sums.clear();
        self.lane_sums.resize(views, LaneSums::default());
        let fine_rows = (self.fine_last + 2 - self.fine_first) as usize;
        self.d_fine.clear();
        self.d_fine.resize(fine_rows * 2 * width, Texel::zero());
    }

    /// Carries the sums of a row over to those of the band, from number `first` on.
    #[inline(always)]
    pub(super) fn end_row(&mut self, first: usize) {
        for (sums, lane_sums) in self.sums[first..].iter_mut().zip(&mut self.lane_sums) {
            for (sum, lanes) in sums.iter_mut().zip(lane_sums.iter()) {
                *sum += lanes.iter().map(|&v| f64::from(v)).sum::<f64>();
            }
            *lane_sums = LaneSums::default();
        }
    }
}

/// Lays `bands` over a sharp render; the first of them cover the picture.
pub(super) fn lay_bands(bands: &mut Vec<Band>, width: usize, height: usize) {
    bands.resize_with(height.div_ceil(BAND), Band::default);
    for (i, band) in bands.iter_mut().enumerate() {
        band.first_row = i * BAND;
        band.planar_row.resize(3 * width, 0.0);
    }
}
