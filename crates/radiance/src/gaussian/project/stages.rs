//! Quantities between parameters and footprints of a group of Gaussians, for both directions.

use super::JacobianRange;
use crate::gaussian::{ColourActivation, GaussianMap, RasterSettings, Shape, View};
use i2slam_compute::simd::{Column, Lanes, MAX_LANES, combine, dot, transform};
use i2slam_geometry::Camera;
use pulp::Simd;

/// Camera, map and settings shared by all Gaussians of one picture.
pub(crate) struct Frame {
    pub(crate) activation: ColourActivation,
    pub(crate) shape: Shape,
    pub(crate) camera: Camera<f32>,
    /// `W`, and its transpose.
    pub(crate) camera_from_world: [[f32; 3]; 3],
    pub(crate) world_from_camera: [[f32; 3]; 3],
    /// The camera's centre in the world.
    pub(crate) origin: [f32; 3],
    range: JacobianRange<f32>,
    pub(crate) settings: RasterSettings,
    pub(crate) log2_alpha_min: f32,
}

/// The parameters of a group that shape its footprints.
#[derive(Default)]
pub(crate) struct Parameters {
    pub(crate) mean: [Column; 3],
    pub(crate) log_scale: [Column; 3],
    pub(crate) rotation: [Column; 4],
    pub(crate) opacity_logit: Column,
}

impl Parameters {
    /// Puts the Gaussian at `index` of the map at `place` of the group.
    #[inline(always)]
    pub(crate) fn set(&mut self, place: usize, map: &GaussianMap, index: usize) {
        let place = place % MAX_LANES;
        put(&mut self.mean, place, &map.means[index]);
        put(&mut self.log_scale, place, &map.log_scales[index]);
        if map.shape == Shape::Anisotropic {
            put(&mut self.rotation, place, &map.rotations[index]);
        }
        self.opacity_logit[place] = map.opacity_logits[index];
    }
}

/// Puts the numbers of one Gaussian at its place in the columns.
#[inline(always)]
pub(crate) fn put<const N: usize>(columns: &mut [Column; N], place: usize, values: &[f32; N]) {
    for k in 0..N {
        columns[k][place] = values[k];
    }
}

/// The Jacobian of the projection, `[[x[0], 0, x[1]], [0, y[0], y[1]]]`.
pub(crate) struct Jacobian<S: Simd> {
    pub(crate) x: [Lanes<S>; 2],
    pub(crate) y: [Lanes<S>; 2],
}

/// Quantities between the parameters and the footprint.
pub(crate) struct Stages<S: Simd> {
    /// Mean in the camera frame.
    pub(crate) p: [Lanes<S>; 3],
    /// `1 / z`.
    pub(crate) inverse_depth: Lanes<S>,
    /// `x/z` and `y/z`, and the same within the range of the Jacobian.
    pub(crate) ratio: [Lanes<S>; 2],
    pub(crate) clamped: [Lanes<S>; 2],
    pub(crate) jacobian: Jacobian<S>,
    /// Standard deviations; isotropic uses the first.
    pub(crate) scale: [Lanes<S>; 3],
    pub(crate) axes: Option<Axes<S>>,
}

/// Rotation and axes of anisotropic Gaussians.
pub(crate) struct Axes<S: Simd> {
    /// Unit quaternion w, x, y, z, and one over the length of the stored one.
    pub(crate) unit: [Lanes<S>; 4],
    pub(crate) inverse_norm: Lanes<S>,
    /// Rows of `A = W R S`: the covariance in the camera frame is `A Aᵀ`.
    pub(crate) rows: [[Lanes<S>; 3]; 3],
}

impl Frame {
    pub(crate) fn new(map: &GaussianMap, view: &View<f32>, settings: &RasterSettings) -> Self {
        let camera_from_world = view.world_from_camera.rotation.inverse().matrix();
        Self {
            activation: map.activation,
            shape: map.shape,
            camera: view.camera,
            camera_from_world: camera_from_world.rows,
            world_from_camera: camera_from_world.transpose().rows,
            origin: view.world_from_camera.translation.to_array(),
            range: JacobianRange::of(&view.camera),
            settings: *settings,
            log2_alpha_min: settings.alpha_min.log2(),
        }
    }

    /// A vector of the world in the camera's axes.
    pub(crate) fn to_camera(&self, v: [f32; 3]) -> [f32; 3] {
        self.camera_from_world.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
    }

    /// The border of the Jacobian's range on one axis.
    #[inline(always)]
    pub(crate) fn range(&self, axis: usize) -> [f32; 2] {
        [self.range.low[axis], self.range.high[axis]]
    }

    #[inline(always)]
    pub(crate) fn stages<S: Simd, const ANISOTROPIC: bool>(
        &self,
        simd: S,
        parameters: &Parameters,
    ) -> Stages<S> {
        let [x, y, z] = Lanes::load_all(simd, &parameters.mean);
        let [ox, oy, oz] = self.origin;
        let offset = [x - x.constant(ox), y - y.constant(oy), z - z.constant(oz)];
        let p = transform(&self.camera_from_world, offset);
        let inverse_depth = p[2].recip();
        let ratio = [p[0] * inverse_depth, p[1] * inverse_depth];
        let ([xl, xh], [yl, yh]) = (self.range(0), self.range(1));
        let clamped = [ratio[0].clamp_min(xl).clamp_max(xh), ratio[1].clamp_min(yl).clamp_max(yh)];
        let focal = [inverse_depth.scale(self.camera.fx), inverse_depth.scale(self.camera.fy)];
        let jacobian = Jacobian {
            x: [focal[0], -(focal[0] * clamped[0])],
            y: [focal[1], -(focal[1] * clamped[1])],
        };
        let [s0, s1, s2] = Lanes::load_all(simd, &parameters.log_scale);
        let (scale, axes) = if ANISOTROPIC {
            let scale = [s0.exp(), s1.exp(), s2.exp()];
            let quaternion = Lanes::load_all(simd, &parameters.rotation);
            (scale, Some(self.axes(quaternion, scale)))
        } else {
            ([s0.exp(); 3], None)
        };
        Stages { p, inverse_depth, ratio, clamped, jacobian, scale, axes }
    }

    /// Projected means [px].
    #[inline(always)]
    pub(crate) fn centre<S: Simd>(&self, stages: &Stages<S>) -> [Lanes<S>; 2] {
        let ([x, y], camera) = (stages.ratio, &self.camera);
        [x.scale(camera.fx) + x.constant(camera.cx), y.scale(camera.fy) + y.constant(camera.cy)]
    }

    #[inline(always)]
    fn axes<S: Simd>(&self, quaternion: [Lanes<S>; 4], scale: [Lanes<S>; 3]) -> Axes<S> {
        let [w, x, y, z] = quaternion;
        let inverse_norm = (w * w + x * x + y * y + z * z).sqrt().recip();
        let (w, x) = (w * inverse_norm, x * inverse_norm);
        let (y, z) = (y * inverse_norm, z * inverse_norm);
        let (one, two) = (w.constant(1.0), w.constant(2.0));
        // Columns of R.
        let r0 = [one - two * (y * y + z * z), two * (x * y + w * z), two * (x * z - w * y)];
        let r1 = [two * (x * y - w * z), one - two * (x * x + z * z), two * (y * z + w * x)];
        let r2 = [two * (x * z + w * y), two * (y * z - w * x), one - two * (x * x + y * y)];
        let a0 = transform(&self.camera_from_world, r0);
        let a1 = transform(&self.camera_from_world, r1);
        let a2 = transform(&self.camera_from_world, r2);
        let [s0, s1, s2] = scale;
        let rows = [
            [a0[0] * s0, a1[0] * s1, a2[0] * s2],
            [a0[1] * s0, a1[1] * s1, a2[1] * s2],
            [a0[2] * s0, a1[2] * s1, a2[2] * s2],
        ];
        Axes { unit: [w, x, y, z], inverse_norm, rows }
    }
}

impl<S: Simd> Stages<S> {
    /// `Σ₂ = J V Jᵀ + screen_variance I` as `[xx, xy, yy]`.
    #[inline(always)]
    pub(crate) fn covariance(&self, screen_variance: f32) -> [Lanes<S>; 3] {
        let (j, low_pass) = (&self.jacobian, self.p[2].constant(screen_variance));
        if let Some(axes) = &self.axes {
            let [bx, by] = self.screen_axes(axes);
            return [dot(bx, bx) + low_pass, dot(bx, by), dot(by, by) + low_pass];
        }
        let variance = self.scale[0] * self.scale[0];
        [
            variance * (j.x[0] * j.x[0] + j.x[1] * j.x[1]) + low_pass,
            variance * (j.x[1] * j.y[1]),
            variance * (j.y[0] * j.y[0] + j.y[1] * j.y[1]) + low_pass,
        ]
    }

    /// `c = J V e_z = B a_z`, the covariance of pixel and depth.
    #[inline(always)]
    pub(crate) fn depth_covariance(&self, axes: &Axes<S>) -> [Lanes<S>; 2] {
        self.screen_axes(axes).map(|row| dot(row, axes.rows[2]))
    }

    /// Rows of `B = J A`.
    #[inline(always)]
    pub(crate) fn screen_axes(&self, axes: &Axes<S>) -> [[Lanes<S>; 3]; 2] {
        let j = &self.jacobian;
        [
            combine(j.x[0], axes.rows[0], j.x[1], axes.rows[2]),
            combine(j.y[0], axes.rows[1], j.y[1], axes.rows[2]),
        ]
    }
}

/// `K d` of the symmetric matrix `K = [[a, b], [b, c]]`.
#[inline(always)]
pub(crate) fn symmetric_product<S: Simd>(
    [a, b, c]: [Lanes<S>; 3],
    [x, y]: [Lanes<S>; 2],
) -> [Lanes<S>; 2] {
    [a * x + b * y, b * x + c * y]
}
