//! The path of a footprint's centre while the shutter is open, as in the equations.
//!
//! The mean is projected exactly at mid-exposure and at both ends of it, `c₀`, `c₋` and `c₊` at
//! `s = 0, ∓½`, and moves along the parabola through the three:
//!
//! ```text
//! c(s) = c₀ + s (v + s h),   v = c₊ - c₋,   h = 2 (c₊ + c₋ - 2 c₀)
//! ```

use i2slam_geometry::{Camera, Mat3, Pose, Real, Tangent, Vec3};

/// Where a footprint's centre moves: `s (velocity + s curvature)` from where it is at
/// mid-exposure.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Path<T> {
    /// `v` \[px per exposure\].
    pub(crate) velocity: [T; 2],
    /// `h` \[px per exposure²\].
    pub(crate) curvature: [T; 2],
}

impl<T: Real> Path<T> {
    /// How far the centre is from where it is at mid-exposure \[px\].
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

    /// The path of a mean whose projection at mid-exposure is `centre`, if it is beyond the near
    /// plane at both ends.
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

    /// `∂L/∂c₀` from `∂L/∂` of the path.
    pub(crate) fn centre_cotangent(d_path: &Path<T>) -> [T; 2] {
        d_path.curvature.map(|d| T::of(-4.0) * d)
    }
}
