//! The scale `a` between exposure and travel.

use i2slam_geometry::Real;

/// `a` of eqs. 16 and 17: `a Δt` is the share of the way from one frame's middle to the next
/// that lies inside half an exposure.
///
/// With a steady frame rate `f` the middles are `1/f` apart and half an exposure lasts `Δt/2`,
/// so `a Δt = f Δt / 2` and `a = f/2` for exposures in seconds (supplement). `a Δt` has no
/// unit: it lies between 0 and 1/2 for any camera whose exposures do not overlap.
///
/// Where the true exposures are unknown and frame 0's is called 1, the unit of time is frame 0's
/// exposure `τ` (in s), and `a` absorbs it: `a = f τ / 2`, half the share of the frame interval for
/// which the shutter of frame 0 was open. `f/2` would then put the targets many frames away;
/// start from [`from_open_share`](Self::from_open_share) instead and let `a` be optimised.
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
