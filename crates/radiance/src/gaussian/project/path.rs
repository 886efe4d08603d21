//! Path of a footprint's centre while the shutter is open, for one Gaussian of any scalar and for a
//! group of `f32`.
//!
//! The mean is projected exactly at mid-exposure and at both ends of it, `c₀`, `c₋` and `c₊` at
//! `s = 0, ∓½`, and moves along the parabola through the three:
//!
//! ```text
//! c(s) = c₀ + s (v + s h),   v = c₊ - c₋,   h = 2 (c₊ + c₋ - 2 c₀)
//! ```

use super::stages::Parameters;
use crate::gaussian::{RasterSettings, ShutterMotion, View};
use i2slam_compute::simd::{Column, Lanes, Mask, cross, transform};
use i2slam_geometry::{Camera, Mat3, Pose, Real, Tangent, Vec3};
use pulp::Simd;

/// Motion of a footprint's centre: `s (velocity + s curvature)` from its place at mid-exposure.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Path<T> {
    /// `v` \[px per exposure\].
    pub(crate) velocity: [T; 2],
    /// `h` \[px per exposure²\].
    pub(crate) curvature: [T; 2],
}

impl<T: Real> Path<T> {
    /// Offset from the place at mid-exposure \[px\].
    pub(crate) fn shift(&self, s: T) -> [T; 2] {
        [0, 1].map(|k| s * (self.velocity[k] + s * self.curvature[k]))
    }

    /// The derivative of [`shift`](Self::shift) by `s`.
    pub(crate) fn speed(&self, s: T) -> [T; 2] {
        [0, 1].map(|k| self.velocity[k] + T::of(2.0) * s * self.curvature[k])
    }
}

/// The camera at shutter open and close.
pub(crate) struct Ends<T> {
    camera: Camera<T>,
    /// `camera_from_world` rotations and centres in the world.
    poses: [(Mat3<T>, Vec3<T>); 2],
    near: T,
}

impl<T: Real> Ends<T> {
    pub(crate) fn new(camera: Camera<T>, poses: [Pose<T>; 2], near: T) -> Self {
        let poses = poses.map(|pose| (pose.rotation.inverse().matrix(), pose.translation));
        Self { camera, poses, near }
    }

    /// The path of a mean that projects to `centre`, if it is beyond the near plane at both ends.
    pub(crate) fn path(&self, mean: Vec3<T>, centre: [T; 2]) -> Option<Path<T>> {
        let [open, close] = self.points(mean).map(|p| {
            let (u, v) = self.camera.project(p);
            (p.z >= self.near && u.is_finite() && v.is_finite()).then_some([u, v])
        });
        let (open, close) = (open?, close?);
        let two = T::of(2.0);
        Some(Path {
            velocity: [0, 1].map(|k| close[k] - open[k]),
            curvature: [0, 1].map(|k| two * (close[k] - centre[k] + (open[k] - centre[k]))),
        })
    }

    /// The mean in the camera at both ends.
    fn points(&self, mean: Vec3<T>) -> [Vec3<T>; 2] {
        self.poses.each_ref().map(|(rotation, origin)| *rotation * (mean - *origin))
    }

    /// `∂L/∂mean` (but for what comes through `c₀`) and `∂L/∂` of the tangents of both ends'
    /// poses, from `∂L/∂` of the path.
    pub(crate) fn pull_back(&self, mean: Vec3<T>, d_path: &Path<T>) -> (Vec3<T>, [Tangent<T>; 2]) {
        let mut d_mean = Vec3::zero();
        let mut tangents = [Tangent::zero(); 2];
        let points = self.points(mean);
        for (end, sign) in [-T::one(), T::one()].into_iter().enumerate() {
            let (p, (rotation, _)) = (points[end], &self.poses[end]);
            let d = [0, 1].map(|k| sign * d_path.velocity[k] + T::of(2.0) * d_path.curvature[k]);
            let (x, y) = (d[0] * self.camera.fx / p.z, d[1] * self.camera.fy / p.z);
            let d_p = Vec3::new(x, y, -(x * p.x + y * p.y) / p.z);
            d_mean += rotation.transpose() * d_p;
            tangents[end] = Tangent { translation: -d_p, rotation: -p.cross(d_p) };
        }
        (d_mean, tangents)
    }
}

/// Rounds of narrowing the rows, and with them the times, at which a footprint is seen.
const ROUNDS: usize = 3;

/// Camera motion shared by all paths of one picture.
pub(crate) struct MotionFrame {
    camera: Camera<f32>,
    ends: [End; 2],
    near: f32,
    /// From the first moment to the last.
    moments: [f32; 2],
    readout: f32,
}

/// The camera at one end of the exposure.
struct End {
    camera_from_world: [[f32; 3]; 3],
    world_from_camera: [[f32; 3]; 3],
    /// The camera's centre in the world.
    origin: [f32; 3],
}

impl End {
    /// The mean in the camera.
    #[inline(always)]
    fn point<S: Simd>(&self, mean: [Lanes<S>; 3]) -> [Lanes<S>; 3] {
        let [x, y, z] = mean;
        let [ox, oy, oz] = self.origin;
        let offset = [x - x.constant(ox), y - y.constant(oy), z - z.constant(oz)];
        transform(&self.camera_from_world, offset)
    }
}

/// The path of a group's centres.
pub(crate) struct LanePath<S: Simd> {
    pub(crate) velocity: [Lanes<S>; 2],
    pub(crate) curvature: [Lanes<S>; 2],
    /// True where the means are beyond the near plane at both ends.
    pub(crate) accepted: Mask<S>,
}

impl MotionFrame {
    pub(crate) fn new(view: &View<f32>, motion: &ShutterMotion, settings: &RasterSettings) -> Self {
        let ends = motion.ends(view.world_from_camera).map(|pose| {
            let camera_from_world = pose.rotation.inverse().matrix();
            End {
                camera_from_world: camera_from_world.rows,
                world_from_camera: camera_from_world.transpose().rows,
                origin: pose.translation.to_array(),
            }
        });
        let times = motion.counted().into_iter().map(|moment| moment.time);
        let both = |[a, b]: [f32; 2], t: f32| [a.min(t), b.max(t)];
        let moments = times.map(|t| [t, t]).reduce(|a, [t, _]| both(a, t)).unwrap_or_default();
        Self {
            camera: view.camera,
            ends,
            near: settings.near,
            moments,
            readout: motion.counted_readout(),
        }
    }

    #[inline(always)]
    pub(crate) fn path<S: Simd>(
        &self,
        simd: S,
        parameters: &Parameters,
        centre: [Lanes<S>; 2],
    ) -> LanePath<S> {
        let mean = Lanes::load_all(simd, &parameters.mean);
        let (open, close) = (self.ends[0].point(mean), self.ends[1].point(mean));
        let (from, to) = (self.project(open), self.project(close));
        let beyond = |p: [Lanes<S>; 3]| p[2].within(self.near, f32::MAX);
        let mut accepted = beyond(open) & beyond(close);
        let (mut velocity, mut curvature) = (centre, centre);
        for k in 0..2 {
            velocity[k] = to[k] - from[k];
            curvature[k] = ((to[k] - centre[k]) + (from[k] - centre[k])).scale(2.0);
            let finite = (velocity[k] + curvature[k]).scale(0.0).within(0.0, 0.0);
            accepted = accepted & finite;
        }
        LanePath { velocity, curvature, accepted }
    }

    #[inline(always)]
    fn project<S: Simd>(&self, p: [Lanes<S>; 3]) -> [Lanes<S>; 2] {
        let (inverse_depth, camera) = (p[2].recip(), &self.camera);
        let (x, y) = (p[0] * inverse_depth, p[1] * inverse_depth);
        [x.scale(camera.fx) + x.constant(camera.cx), y.scale(camera.fy) + y.constant(camera.cy)]
    }

    /// Smallest and largest shift of the centres, per axis, over the moments of all rows that see
    /// them. Rows bound the times and times the rows: a few rounds narrow both down.
    #[inline(always)]
    pub(crate) fn sweep<S: Simd>(
        &self,
        path: &LanePath<S>,
        centre_y: Lanes<S>,
        extent_y: Lanes<S>,
    ) -> [[Lanes<S>; 2]; 2] {
        let height = self.camera.height as f32;
        let mut rows = [centre_y.constant(0.0), centre_y.constant(height)];
        let mut times = self.times(rows);
        if self.readout != 0.0 {
            for _ in 0..ROUNDS {
                let [low, high] = shifts(path, 1, times);
                let first = (centre_y + low - extent_y).clamp_min(0.0).clamp_max(height);
                let end = (centre_y + high + extent_y).clamp_min(0.0).clamp_max(height);
                rows = [first.max(rows[0]), end.min(rows[1])];
                times = self.times(rows);
            }
        }
        [shifts(path, 0, times), shifts(path, 1, times)]
    }

    /// First and last time at which rows are exposed.
    #[inline(always)]
    fn times<S: Simd>(&self, [first, end]: [Lanes<S>; 2]) -> [Lanes<S>; 2] {
        let scale = self.readout / self.camera.height as f32;
        let half = first.constant(0.5 * self.readout);
        let (a, b) = (first.scale(scale) - half, end.scale(scale) - half);
        let [low, high] = self.moments;
        [a.min(b) + a.constant(low), a.max(b) + a.constant(high)]
    }

    /// Gradients of the means and of both ends' poses from those of the paths.
    #[inline(always)]
    pub(crate) fn pull_back<S: Simd>(
        &self,
        simd: S,
        parameters: &Parameters,
        d_velocity: [Lanes<S>; 2],
        d_curvature: [Lanes<S>; 2],
    ) -> PathCotangents<S> {
        let mean = Lanes::load_all(simd, &parameters.mean);
        let (camera, zero) = (&self.camera, mean[0].constant(0.0));
        let mut result = PathCotangents { mean: [zero; 3], ends: [[zero; 6]; 2] };
        for end in 0..2 {
            let p = self.ends[end].point(mean);
            let sign = [-1.0, 1.0][end];
            let d_x = d_velocity[0].scale(sign) + d_curvature[0].scale(2.0);
            let d_y = d_velocity[1].scale(sign) + d_curvature[1].scale(2.0);
            let inverse_depth = p[2].recip();
            let x = d_x.scale(camera.fx) * inverse_depth;
            let y = d_y.scale(camera.fy) * inverse_depth;
            let d_p = [x, y, -((x * p[0] + y * p[1]) * inverse_depth)];
            let (moment, world) =
                (cross(p, d_p), transform(&self.ends[end].world_from_camera, d_p));
            for k in 0..3 {
                result.mean[k] += world[k];
                result.ends[end][k] = -d_p[k];
                result.ends[end][3 + k] = -moment[k];
            }
        }
        result
    }
}

/// Smallest and largest `s (v + s h)` on one axis for times in a range, at most that far.
#[inline(always)]
fn shifts<S: Simd>(path: &LanePath<S>, axis: usize, [first, last]: [Lanes<S>; 2]) -> [Lanes<S>; 2] {
    let (v, h) = (path.velocity[axis], path.curvature[axis]);
    let (a, b) = (v * first, v * last);
    let bend = h * (first * first).max(last * last);
    [a.min(b) + bend.clamp_max(0.0), a.max(b) + bend.clamp_min(0.0)]
}

/// `∂L/∂` of what a path depends on.
pub(crate) struct PathCotangents<S: Simd> {
    /// Of the mean in the world, but for what comes through the centre at mid-exposure.
    pub(crate) mean: [Lanes<S>; 3],
    /// Of `(ρ, φ)` of the poses at both ends.
    pub(crate) ends: [[Lanes<S>; 6]; 2],
}

/// The paths of a group, to write and to read one by one.
#[derive(Default)]
pub(crate) struct PathColumns {
    pub(crate) velocity: [Column; 2],
    pub(crate) curvature: [Column; 2],
}

impl PathColumns {
    #[inline(always)]
    pub(crate) fn store<S: Simd>(&mut self, path: &LanePath<S>) {
        for k in 0..2 {
            path.velocity[k].store(&mut self.velocity[k]);
            path.curvature[k].store(&mut self.curvature[k]);
        }
    }

    #[inline(always)]
    pub(crate) fn path(&self, place: usize) -> Path<f32> {
        let ([vx, vy], [hx, hy]) = (&self.velocity, &self.curvature);
        Path { velocity: [vx[place], vy[place]], curvature: [hx[place], hy[place]] }
    }
}
