//! Readout, and offset and delay of depth, that a frame was mapped with, against those found later.

use i2slam_odometry::Reconstruction;

/// Displacement of the rows at the border of a frame beyond which it is mapped anew, and of its depth
/// [px]: motion during the exposure is refined with the map, depth is not.
const MAX_ROW_DISPLACEMENT: f64 = 1.0;
const MAX_DEPTH_DISPLACEMENT: f64 = 0.25;

/// Registration of rows and depth at one time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Registration {
    /// Readout of the rolling shutter [s].
    readout: f64,
    /// Offset of depth pictures [px].
    shift: [f64; 2],
    /// Delay of depth pictures [s].
    delay: f64,
}

impl Registration {
    /// As known with a path in pictures of the mapped size.
    pub(super) fn of(path: &Reconstruction) -> Self {
        let (shift, delay) =
            path.depth_model.as_ref().map_or(([0.0; 2], 0.0), |model| (model.shift, model.delay));
        Self { readout: path.rolling_shutter_readout, shift, delay }
    }

    /// As known with a later path, apart from the offset: dense depth takes it over with a keyframe.
    pub(super) fn between_keyframes(&self, path: &Reconstruction) -> Self {
        Self { shift: self.shift, ..Self::of(path) }
    }

    /// True if rows or depth of a picture that moves at `speed` [px/s] are elsewhere now.
    pub(super) fn is_outdated(&self, now: &Self, speed: f64) -> bool {
        let by_shift = (now.shift[0] - self.shift[0]).hypot(now.shift[1] - self.shift[1]);
        let by_delay = speed * (now.delay - self.delay).abs();
        // The rows at the border are exposed half a readout from the middle one.
        let by_rows = 0.5 * speed * (now.readout - self.readout).abs();
        by_shift + by_delay > MAX_DEPTH_DISPLACEMENT || by_rows > MAX_ROW_DISPLACEMENT
    }
}

/// Speed of the picture of a scene at `depth`, by the motion between the frames around one [px/s]; 0
/// where it is not known.
pub(super) fn image_speed(path: &Reconstruction, frame: usize, depth: f64) -> f64 {
    let (before, after) = (frame.saturating_sub(1), (frame + 1).min(path.poses.len() - 1));
    let (Some(first), Some(last)) = (path.poses[before], path.poses[after]) else { return 0.0 };
    let time = path.timestamps[after] - path.timestamps[before];
    let motion = first.local(last);
    let angle = motion.rotation.norm() + motion.translation.norm() / depth;
    if time > 0.0 { path.camera.fx * angle / time } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_a_quarter_of_a_pixel_off_and_rows_one_off_are_outdated() {
        let was = Registration { readout: 0.02, shift: [1.0, -1.0], delay: 0.01 };
        let is_outdated = |now: Registration, speed: f64| was.is_outdated(&now, speed);
        assert!(!is_outdated(was, 1e4));
        let shift = |x: f64| Registration { shift: [1.0 + x, -1.0], ..was };
        assert!(!is_outdated(shift(0.24), 0.0) && is_outdated(shift(0.26), 0.0));
        // 100 px/s for 2 and 3 ms.
        let delay = |later: f64| Registration { delay: 0.01 + later, ..was };
        assert!(!is_outdated(delay(0.002), 100.0) && is_outdated(delay(-0.003), 100.0));
        // 100 px/s for half of 18 and 22 ms.
        let readout = |longer: f64| Registration { readout: 0.02 + longer, ..was };
        assert!(!is_outdated(readout(0.018), 100.0) && is_outdated(readout(0.022), 100.0));
    }
}
