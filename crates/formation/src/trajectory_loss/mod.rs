//! The exposure lies on the trajectory (eqs. 15 to 17).
//!
//! With `T^i` the middle of frame `i`'s exposure, `Δt^i` its length and `a` a scale:
//!
//! ```text
//! L_t = ‖t(t_e^{i-1}) - Lerp(t^{i-1}, t^i, a Δt^{i-1})‖² + ‖t(t_s^i) - Lerp(t^{i-1}, t^i, 1 - a Δt^i)‖²
//! L_R = the same with Slerp                                              L = L_t + L_R   (m² + rad²)
//! ```
//!
//! The paper writes the rotation part as a difference of rotation vectors. Here it is the
//! squared length of the rotation vector of the *relative* rotation, `‖Log(R_target⁻¹ R)‖²`: the
//! squared angle between the two, which is a metric on rotations. A difference of two rotation
//! vectors depends on the choice of the world frame and jumps where one passes half a turn; for
//! nearby rotations around a common axis the two agree.

use crate::shutter::{ShutterPoses, ShutterTangent};
use i2slam_geometry::{Pose, Real, Tangent};

#[cfg(test)]
mod tests;

/// Two consecutive frames, `i-1` and `i`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrajectoryPair<T> {
    /// Shutter poses of frame `i-1`.
    pub previous: ShutterPoses<T>,
    /// Shutter poses of frame `i`.
    pub current: ShutterPoses<T>,
    /// `Δt^{i-1}`, in any unit of time that all frames share.
    pub exposure_previous: T,
    /// `Δt^i`, in the same unit.
    pub exposure_current: T,
    /// `a`, one for the sequence.
    pub scale: TrajectoryScale<T>,
}

/// The two parts of the loss, eqs. 16 and 17.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct TrajectoryLoss<T> {
    /// Squared distances (m²).
    pub translation: T,
    /// Squared angles (rad²).
    pub rotation: T,
}

/// Gradient of [`TrajectoryLoss::total`].
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct TrajectoryGradient<T> {
    /// With respect to the shutter poses of frame `i-1`.
    pub previous: ShutterTangent<T>,
    /// With respect to the shutter poses of frame `i`.
    pub current: ShutterTangent<T>,
    /// With respect to ln `Δt^{i-1}`: adds to `log_exposure` where the two are one parameter.
    pub log_exposure_previous: T,
    /// With respect to ln `Δt^i`.
    pub log_exposure_current: T,
    /// With respect to `a`.
    pub scale: T,
}

impl<T: Real> TrajectoryLoss<T> {
    /// Both parts together (eq. 15).
    pub fn total(&self) -> T {
        self.translation + self.rotation
    }
}

impl<T: Real> TrajectoryPair<T> {
    /// The loss and its gradient with respect to everything in it.
    pub fn loss_and_gradient(&self) -> (TrajectoryLoss<T>, TrajectoryGradient<T>) {
        let path = ShutterPoses { start: self.previous.middle(), end: self.current.middle() };
        let reach_previous = self.scale.a * self.exposure_previous;
        let reach_current = self.scale.a * self.exposure_current;
        let close = residual(&path, reach_previous, self.previous.end);
        let open = residual(&path, T::one() - reach_current, self.current.start);

        let d_path = close.d_path.plus(open.d_path);
        let d_previous = self.previous.pull_back(T::of(0.5), d_path.start);
        let d_current = self.current.pull_back(T::of(0.5), d_path.end);
        let gradient = TrajectoryGradient {
            previous: ShutterTangent { end: d_previous.end.plus(close.d_pose), ..d_previous },
            current: ShutterTangent { start: d_current.start.plus(open.d_pose), ..d_current },
            log_exposure_previous: close.d_u * reach_previous,
            log_exposure_current: -open.d_u * reach_current,
            scale: close.d_u * self.exposure_previous - open.d_u * self.exposure_current,
        };
        let loss = TrajectoryLoss {
            translation: close.loss.translation + open.loss.translation,
            rotation: close.loss.rotation + open.loss.rotation,
        };
        (loss, gradient)
    }
}

/// One pose against its place on the path.
struct Residual<T> {
    loss: TrajectoryLoss<T>,
    /// Cotangent of the pose.
    d_pose: Tangent<T>,
    /// Cotangents of the two ends of the path.
    d_path: ShutterTangent<T>,
    /// Derivative with respect to the place on the path.
    d_u: T,
}

/// With `r = Log(R_target⁻¹ R)`, perturbing `R` moves `r` by `J_r⁻¹(r) φ` and perturbing the
/// target by `-J_l⁻¹(r) φ`; both Jacobians keep `r` itself, so the cotangents are `±2 r`.
fn residual<T: Real>(path: &ShutterPoses<T>, u: T, pose: Pose<T>) -> Residual<T> {
    let two = T::of(2.0);
    let target = path.at(u);
    let apart = pose.translation - target.translation;
    let turned = (target.rotation.inverse() * pose.rotation).log();

    let d_pose = Tangent {
        translation: pose.rotation.inverse().rotate(apart) * two,
        rotation: turned * two,
    };
    let d_target = Tangent {
        translation: target.rotation.inverse().rotate(apart) * -two,
        rotation: turned * -two,
    };
    // Along the path the target moves by t_1 - t_0 in the world and turns by ω in its own frame.
    let step = path.end.translation - path.start.translation;
    let omega = (path.start.rotation.inverse() * path.end.rotation).log();
    Residual {
        loss: TrajectoryLoss { translation: apart.norm_squared(), rotation: turned.norm_squared() },
        d_pose,
        d_path: path.pull_back(u, d_target),
        d_u: -two * apart.dot(step) + d_target.rotation.dot(omega),
    }
}

/// `a` of eqs. 16 and 17: `a Δt` is the share of the way from one frame's middle to the next that
/// lies inside half an exposure, 0 to 1/2 where exposures do not overlap.
///
/// With a frame rate `f`, `a = f/2` for exposures in seconds (supplement). Where the true exposures
/// are unknown and frame 0's is called 1, `a` is half the share of the frame interval for which its
/// shutter was open.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrajectoryScale<T> {
    /// 1 / (twice the frame interval), in the unit of the exposures.
    pub a: T,
}

impl<T: Real> TrajectoryScale<T> {
    /// `a = f/2`, for exposures in seconds and `frames_per_second` (1/s).
    pub fn from_frame_rate(frames_per_second: T) -> Self {
        Self { a: frames_per_second * T::of(0.5) }
    }

    /// `a = share/2`, for exposures in units of an exposure that keeps the shutter open for
    /// `share` of the frame interval (0 to 1): 1/2 is a film camera's usual shutter.
    pub fn from_open_share(share: T) -> Self {
        Self { a: share * T::of(0.5) }
    }
}
