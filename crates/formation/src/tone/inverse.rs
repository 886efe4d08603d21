//! The response read backwards: from a picture value to a linear one.

use super::ResponseCurve;
use i2slam_geometry::Real;

impl<T: Real> ResponseCurve<T> {
    /// The smallest linear value in [0, 1] whose picture value is `y`, by binary search: what a
    /// pixel says about radiance when a map is started from a picture.
    ///
    /// `y` outside [0, 1] is clipped to it; NaN stays NaN. Where the curve is level, the left
    /// end of the level part comes back.
    pub fn inverse(&self, channel: usize, y: T) -> T {
        if y.is_nan() {
            return y;
        }
        let y = y.max(T::zero()).min(T::one());
        let (values, positions) = (self.values(channel), self.positions());
        let right = values.partition_point(|&v| v < y).min(values.len() - 1);
        let Some(left) = right.checked_sub(1) else { return T::zero() };
        let share = (y - values[left]) / (values[right] - values[left]);
        positions[left] + (positions[right] - positions[left]) * share.min(T::one())
    }
}
