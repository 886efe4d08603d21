//! A camera that moves while its shutter is open.
//!
//! Times `s` count in exposures from the middle of the exposure of the picture's middle row. The
//! camera is at `world_from_camera.retract(velocity · s)`, and row `r` of `height` sees moment
//! `s_j` at
//!
//! ```text
//! s = s_j + readout ((r + ½) / height - ½)
//! ```

use i2slam_geometry::{Pose, Real, Rotation, Tangent, right_jacobian};

/// One sample of the exposure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment<T = f32> {
    /// Time from the middle of the exposure \[exposures\], from -½ (open) to ½ (close).
    pub time: T,
    /// Share of the exposure, relative to the sum; a moment with none is left out.
    pub weight: T,
}

/// Camera motion while the shutter is open, and the times at which rows are read.
#[derive(Clone, Debug, PartialEq)]
pub struct ShutterMotion<T = f32> {
    /// Motion over the exposure in the frame of the camera at mid-exposure
    /// \[m, rad per exposure\]: the pose at `s` is `world_from_camera.retract(velocity · s)`.
    pub velocity: Tangent<T>,
    /// Time from the top to the bottom edge \[exposures\]: positive when the top row comes first.
    pub readout: T,
    /// Samples of the exposure. Without any the picture is black.
    pub moments: Vec<Moment<T>>,
}

/// `∂L/∂` of a view and its [`ShutterMotion`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionGradient<T = f64> {
    /// `∂L/∂ξ` for the pose at mid-exposure, `world_from_camera.retract(ξ)`.
    pub pose: Tangent<T>,
    /// `∂L/∂velocity`.
    pub velocity: Tangent<T>,
    /// `∂L/∂readout`.
    pub readout: T,
}

impl<T: Real> ShutterMotion<T> {
    /// A camera that stands still: one moment in the middle of the exposure.
    pub fn still() -> Self {
        let moments = vec![Moment { time: T::zero(), weight: T::one() }];
        Self { velocity: Tangent::zero(), readout: T::zero(), moments }
    }

    /// A global shutter sampled in the middles of `count` equal parts of the exposure.
    pub fn global(velocity: Tangent<T>, count: usize) -> Self {
        let n = count as f64;
        let time = |j: usize| T::of((j as f64 + 0.5) / n - 0.5);
        let moments = (0..count).map(|j| Moment { time: time(j), weight: T::of(1.0 / n) });
        Self { velocity, readout: T::zero(), moments: moments.collect() }
    }

    /// The moments with positive weight, normalised to a sum of 1.
    pub(crate) fn counted(&self) -> Vec<Moment<T>> {
        let counts = |m: &&Moment<T>| {
            let finite = m.time.is_finite() && m.weight.is_finite() && self.readout.is_finite();
            finite && m.weight > T::zero()
        };
        let sum: T = self.moments.iter().filter(counts).map(|m| m.weight).sum();
        let scaled = |m: &Moment<T>| Moment { time: m.time, weight: m.weight / sum };
        self.moments.iter().filter(counts).map(scaled).collect()
    }

    /// The readout, or zero if it is not finite (and then no moment counts).
    pub(crate) fn counted_readout(&self) -> T {
        if self.readout.is_finite() { self.readout } else { T::zero() }
    }

    /// Delay of a row relative to the middle one \[exposures\].
    pub(crate) fn row_time(&self, row: usize, height: usize) -> T {
        self.readout * row_place(row, height)
    }

    /// The poses at shutter open and close, where `s = ∓½`.
    pub(crate) fn ends(&self, world_from_camera: Pose<T>) -> [Pose<T>; 2] {
        END_TIMES.map(|s| world_from_camera.retract(self.velocity.scaled(T::of(s))))
    }

    /// Converts to another scalar type.
    pub fn cast<U: Real>(&self) -> ShutterMotion<U> {
        let of = |v: T| U::of(v.to_f64());
        let moment = |m: &Moment<T>| Moment { time: of(m.time), weight: of(m.weight) };
        ShutterMotion {
            velocity: self.velocity.cast(),
            readout: of(self.readout),
            moments: self.moments.iter().map(moment).collect(),
        }
    }
}

/// `s` at shutter open and close.
const END_TIMES: [f64; 2] = [-0.5, 0.5];

/// Place of a row between the top edge (-½) and the bottom edge (½).
pub(crate) fn row_place<T: Real>(row: usize, height: usize) -> T {
    T::of(row as f64 + 0.5) / T::of(height as f64) - T::of(0.5)
}

impl<T: Real> MotionGradient<T> {
    /// From `∂L/∂` of the pose at mid-exposure with the ends held, of the poses at both ends, and
    /// of the readout.
    ///
    /// With `velocity = (ν, ω)` and `E = Exp(s ω)`, tangents `(ρ_c, φ_c)` of the pose at
    /// mid-exposure and changes `δν, δω` move the pose at `s` by
    ///
    /// ```text
    /// ρ = Eᵀ (ρ_c - s ν × φ_c + s δν)
    /// φ = Eᵀ φ_c + s J_r(s ω) δω
    /// ```
    ///
    /// and this is the transpose.
    pub(crate) fn new(
        motion: &ShutterMotion<T>,
        pose: Tangent<T>,
        ends: [Tangent<T>; 2],
        readout: T,
    ) -> Self {
        let mut sum = Self { pose, velocity: Tangent::zero(), readout };
        for (s, end) in END_TIMES.map(T::of).into_iter().zip(ends) {
            let turn = motion.velocity.rotation * s;
            let rotation = Rotation::exp(turn);
            let position = rotation.rotate(end.translation);
            let lever = motion.velocity.translation.cross(position) * s;
            sum.pose = sum.pose.plus(Tangent {
                translation: position,
                rotation: lever + rotation.rotate(end.rotation),
            });
            sum.velocity = sum.velocity.plus(Tangent {
                translation: position * s,
                rotation: right_jacobian(turn).transpose() * end.rotation * s,
            });
        }
        sum
    }
}
