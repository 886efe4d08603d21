//! The two poses that bound an exposure, and the virtual cameras between them.

use i2slam_geometry::{
    Pose, Real, Rotation, Tangent, Vec3, right_jacobian, right_jacobian_inverse,
};
use serde::{Deserialize, Serialize};

/// The camera at shutter open and at shutter close, both `world_from_camera`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShutterPoses<T> {
    /// `T(t_s)`: when the shutter opens.
    pub start: Pose<T>,
    /// `T(t_e)`: when the shutter closes.
    pub end: Pose<T>,
}

/// Samples of the exposure integral.
///
/// A point that moves by `b` pixels is smeared with variance `b²/12`. `N` samples of equal weight
/// have variance `b²/12 · (N + 1) / (N - 1)` with [`Endpoints`](Self::Endpoints) (five cameras
/// draw a streak 22 % too wide) and `b²/12 · (1 - 1/N²)` with [`Midpoints`](Self::Midpoints) (2 %
/// too narrow), so the same pictures are explained by different poses at shutter open and close.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Quadrature {
    /// From shutter open to shutter close, both included: u = (j - 1) / (N - 1) (eq. 6).
    Endpoints,
    /// In the middle of N equal parts of the exposure, u = (j - 1/2) / N: the streak keeps its
    /// true width.
    Midpoints,
    /// Simpson's rule, both ends included, for an odd `N` of at least 3
    /// ([`Midpoints`](Self::Midpoints) otherwise): `u` as for [`Endpoints`](Self::Endpoints),
    /// weights 1, 4, 2, 4, …, 1. The streak has its exact variance, and of three cameras that in
    /// the middle has two thirds of the light. Chosen by the method, not named in files.
    #[serde(skip)]
    Simpson,
}

impl Quadrature {
    /// Moment and share of the `j`th of `count` cameras.
    fn sample(self, j: usize, count: usize) -> (f64, f64) {
        let (place, even) = (j as f64, 1.0 / count as f64);
        let last = count as f64 - 1.0;
        match self {
            _ if count == 1 => (0.5, 1.0),
            Self::Endpoints => (place / last, even),
            Self::Simpson if count % 2 == 1 => {
                let times = if j == 0 || j + 1 == count { 1.0 } else { 2.0 + 2.0 * (place % 2.0) };
                (place / last, times / (3.0 * last))
            }
            Self::Simpson | Self::Midpoints => ((place + 0.5) / count as f64, even),
        }
    }
}

/// One sample of the exposure integral (eq. 6).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VirtualCamera<T> {
    /// Moment of the exposure: 0 = open, 1 = close.
    pub u: T,
    /// Share of the exposure; the shares of one frame sum to 1.
    pub weight: T,
    /// Pose at that moment.
    pub world_from_camera: Pose<T>,
}

impl<T: Real> ShutterPoses<T> {
    /// A camera that does not move during the exposure.
    pub fn still(world_from_camera: Pose<T>) -> Self {
        Self { start: world_from_camera, end: world_from_camera }
    }

    /// The pose at `u` (0 = open, 1 = close; outside, the motion is continued), eq. 7.
    pub fn at(&self, u: T) -> Pose<T> {
        self.start.interpolate(self.end, u)
    }

    /// The pose halfway through the exposure.
    pub fn middle(&self) -> Pose<T> {
        self.at(T::of(0.5))
    }

    /// Moves the exposure rigidly to another mid-exposure pose.
    #[must_use]
    pub fn with_middle(&self, middle: Pose<T>) -> Self {
        let moved = middle * self.middle().inverse();
        Self { start: moved * self.start, end: moved * self.end }
    }

    /// `count` poses of equal weight, spread over the exposure by `quadrature`. One camera (or
    /// none asked for) stands in the middle.
    pub fn virtual_cameras(&self, count: usize, quadrature: Quadrature) -> Vec<VirtualCamera<T>> {
        self.each_virtual_camera(count, quadrature).collect()
    }

    /// [`virtual_cameras`](Self::virtual_cameras) one by one, without a list of them.
    pub fn each_virtual_camera(
        &self,
        count: usize,
        quadrature: Quadrature,
    ) -> impl DoubleEndedIterator<Item = VirtualCamera<T>> + ExactSizeIterator + use<T> {
        let (shutter, count) = (*self, count.max(1));
        (0..count).map(move |j| {
            let (u, weight) = quadrature.sample(j, count);
            let (u, weight) = (T::of(u), T::of(weight));
            VirtualCamera { u, weight, world_from_camera: shutter.at(u) }
        })
    }

    /// Pulls the cotangent of the pose at `u` back onto the two shutter poses.
    ///
    /// With `ω = Log(R_s⁻¹ R_e)`, tangents `(ρ, φ)` of the ends move the pose between them by
    ///
    /// ```text
    /// ρ_v = R(u)ᵀ [(1 - u) R_s ρ_s + u R_e ρ_e]
    /// φ_v = Exp(-u ω) φ_s + u J_r(u ω) [J_r⁻¹(ω) φ_e - J_l⁻¹(ω) φ_s]
    /// ```
    ///
    /// and this is the transpose. All tangents are right perturbations of `world_from_camera`.
    /// Holds for rotations of less than half a turn during the exposure.
    pub fn pull_back(&self, u: T, d_pose: Tangent<T>) -> ShutterTangent<T> {
        let omega = (self.start.rotation.inverse() * self.end.rotation).log();
        let d_position = self.at(u).rotation.rotate(d_pose.translation);
        let (d_start, d_end) = pull_back_slerp(omega, u, d_pose.rotation);
        ShutterTangent {
            start: Tangent {
                translation: self.start.rotation.inverse().rotate(d_position) * (T::one() - u),
                rotation: d_start,
            },
            end: Tangent {
                translation: self.end.rotation.inverse().rotate(d_position) * u,
                rotation: d_end,
            },
        }
    }

    /// Both poses moved by a tangent, each in its own frame.
    pub fn retract(&self, tangent: &ShutterTangent<T>) -> Self {
        Self { start: self.start.retract(tangent.start), end: self.end.retract(tangent.end) }
    }

    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        self.start.is_finite() && self.end.is_finite()
    }
}

/// The transpose of `φ_v(φ_s, φ_e)` above: cotangents of the rotations at open and close.
fn pull_back_slerp<T: Real>(omega: Vec3<T>, u: T, d_phi: Vec3<T>) -> (Vec3<T>, Vec3<T>) {
    let turn = omega * u;
    let d_omega = right_jacobian(turn).transpose() * d_phi * u;
    let carried = Rotation::exp(turn).rotate(d_phi);
    let d_start = carried - right_jacobian_inverse(-omega).transpose() * d_omega;
    let d_end = right_jacobian_inverse(omega).transpose() * d_omega;
    (d_start, d_end)
}

/// A tangent (or a cotangent, the gradient with respect to it) of both shutter poses.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct ShutterTangent<T> {
    /// At shutter open, in the camera frame of that moment [m, rad].
    pub start: Tangent<T>,
    /// At shutter close, in the camera frame of that moment [m, rad].
    pub end: Tangent<T>,
}

impl<T: Real> ShutterTangent<T> {
    /// The zero tangent.
    pub fn zero() -> Self {
        Self { start: Tangent::zero(), end: Tangent::zero() }
    }

    /// The sum of two tangents at the same poses.
    pub fn plus(self, other: Self) -> Self {
        Self { start: self.start.plus(other.start), end: self.end.plus(other.end) }
    }

    /// Every number multiplied by `s`.
    pub fn scaled(self, s: T) -> Self {
        Self { start: self.start.scaled(s), end: self.end.scaled(s) }
    }

    /// As `[start ρ, start φ, end ρ, end φ]`, three numbers each.
    pub fn to_array(self) -> [T; 12] {
        let (start, end) = (self.start.to_array(), self.end.to_array());
        std::array::from_fn(|i| if i < 6 { start[i] } else { end[i - 6] })
    }

    /// From `[start ρ, start φ, end ρ, end φ]`, three numbers each.
    pub fn from_array(a: [T; 12]) -> Self {
        Self {
            start: Tangent::from_array(std::array::from_fn(|i| a[i])),
            end: Tangent::from_array(std::array::from_fn(|i| a[i + 6])),
        }
    }
}
