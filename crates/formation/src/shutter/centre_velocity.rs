//! The exposure as its centre pose and a velocity (paper, appendix, RGBD-SLAM), which converge at
//! very different speeds and have a learning rate each.

use super::{ShutterPoses, ShutterTangent};
use i2slam_geometry::{Mat3, Pose, Real, Rotation, Tangent, Vec3, right_jacobian};

/// Centre of the exposure and the motion over it.
///
/// `start = centre ⊞ (-v/2)`, `end = centre ⊞ (+v/2)`. The conversions to and from
/// [`ShutterPoses`] are exact inverses for less than half a turn, and the middle of
/// Slerp and Lerp is the centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CentreVelocity<T> {
    /// `world_from_camera` halfway through the exposure.
    pub centre: Pose<T>,
    /// Motion from open to close, in the centre's frame [m, rad per exposure].
    pub velocity: Tangent<T>,
}

impl<T: Real> CentreVelocity<T> {
    /// A start for a new frame: centred at `centre`, moving as the camera did since `previous`,
    /// for `share` of that way while the shutter is open (the paper starts from 1/10).
    pub fn along(previous: Pose<T>, centre: Pose<T>, share: T) -> Self {
        let motion = Tangent {
            translation: centre.local(previous).translation * -T::one(),
            rotation: previous.local(centre).rotation,
        };
        Self { centre, velocity: motion.scaled(share) }
    }

    /// Moves the centre by a tangent in its own frame and adds to the velocity.
    pub fn retract(&self, centre: Tangent<T>, velocity: Tangent<T>) -> Self {
        Self { centre: self.centre.retract(centre), velocity: self.velocity.plus(velocity) }
    }

    /// Pulls cotangents of the shutter poses back: `(centre cotangent, velocity cotangent)`.
    ///
    /// With `v = (ν, ω)`, `s = ±1/2` and `E = Exp(s ω)`, tangents `(ρ_c, φ_c)` of the centre and
    /// changes `δν, δω` of the velocity move an end by
    ///
    /// ```text
    /// ρ = Eᵀ (ρ_c - s ν × φ_c + s δν)
    /// φ = Eᵀ φ_c + s J_r(s ω) δω
    /// ```
    ///
    /// and this is the transpose, summed over both ends.
    pub fn pull_back(&self, d_shutter: ShutterTangent<T>) -> (Tangent<T>, Tangent<T>) {
        let half = T::of(0.5);
        let (centre_s, velocity_s) = self.pull_back_end(-half, d_shutter.start);
        let (centre_e, velocity_e) = self.pull_back_end(half, d_shutter.end);
        (centre_s.plus(centre_e), velocity_s.plus(velocity_e))
    }

    fn pull_back_end(&self, s: T, d_end: Tangent<T>) -> (Tangent<T>, Tangent<T>) {
        let turn: Vec3<T> = self.velocity.rotation * s;
        let rotation = Rotation::exp(turn);
        let d_position = rotation.rotate(d_end.translation);
        let d_centre = Tangent {
            translation: d_position,
            rotation: self.velocity.translation.cross(d_position) * s
                + rotation.rotate(d_end.rotation),
        };
        let d_velocity = Tangent {
            translation: d_position * s,
            rotation: right_jacobian(turn).transpose() * d_end.rotation * s,
        };
        (d_centre, d_velocity)
    }

    /// Pulls cotangents of centre and velocity back onto the shutter poses that they were made
    /// of: the inverse of [`pull_back`](Self::pull_back).
    ///
    /// With `p_± = E_± d_±.ρ` and `a_± = E_± d_±.φ` for close (+) and open (-), `pull_back` says
    ///
    /// ```text
    /// p_+ + p_- = d_centre.ρ                 ½ (p_+ - p_-) = d_velocity.ρ
    /// a_+ + a_- = d_centre.φ - ν × d_velocity.ρ
    /// J_lᵀ a_+ - J_rᵀ a_- = 2 d_velocity.φ   at ω / 2
    /// ```
    pub fn pull_back_to_shutter(
        &self,
        d_centre: Tangent<T>,
        d_velocity: Tangent<T>,
    ) -> ShutterTangent<T> {
        let half = T::of(0.5);
        let turn: Vec3<T> = self.velocity.rotation * half;
        let rotation = Rotation::exp(turn);
        let (left, right) = (right_jacobian(turn * -T::one()), right_jacobian(turn));
        let (left, right) = (left.transpose(), right.transpose());
        let both = d_centre.rotation - self.velocity.translation.cross(d_velocity.translation);
        let close = solve(&sum(&left, &right), d_velocity.rotation * T::of(2.0) + right * both);
        let open = both - close;
        let middle = d_centre.translation * half;
        ShutterTangent {
            start: Tangent {
                translation: rotation.rotate(middle - d_velocity.translation),
                rotation: rotation.rotate(open),
            },
            end: Tangent {
                translation: rotation.inverse().rotate(middle + d_velocity.translation),
                rotation: rotation.inverse().rotate(close),
            },
        }
    }
}

fn sum<T: Real>(a: &Mat3<T>, b: &Mat3<T>) -> Mat3<T> {
    let row = |i: usize| std::array::from_fn(|j| a.rows[i][j] + b.rows[i][j]);
    Mat3 { rows: [row(0), row(1), row(2)] }
}

/// `m⁻¹ v` by Cramer's rule.
fn solve<T: Real>(m: &Mat3<T>, v: Vec3<T>) -> Vec3<T> {
    let columns = m.transpose().rows.map(Vec3::from_array);
    let [a, b, c] = columns;
    let determinant = a.dot(b.cross(c));
    Vec3::new(v.dot(b.cross(c)), a.dot(v.cross(c)), a.dot(b.cross(v))) * (T::one() / determinant)
}

impl<T: Real> From<CentreVelocity<T>> for ShutterPoses<T> {
    fn from(motion: CentreVelocity<T>) -> Self {
        let half = motion.velocity.scaled(T::of(0.5));
        Self {
            start: motion.centre.retract(half.scaled(-T::one())),
            end: motion.centre.retract(half),
        }
    }
}

impl<T: Real> From<ShutterPoses<T>> for CentreVelocity<T> {
    fn from(shutter: ShutterPoses<T>) -> Self {
        let centre = shutter.middle();
        let moved = shutter.end.translation - shutter.start.translation;
        let velocity = Tangent {
            translation: centre.rotation.inverse().rotate(moved),
            rotation: (shutter.start.rotation.inverse() * shutter.end.rotation).log(),
        };
        Self { centre, velocity }
    }
}
