//! Keyframes: frames that stay in memory for mapping, and their choice.

use crate::config::MappingConfig;
use crate::objective::{Observation, blur_length};
use crate::reconstruction::FrameEstimate;
use i2slam_formation::{CentreVelocity, ShutterPoses};
use i2slam_geometry::{Camera, Pose, Tangent};
use i2slam_storage::Stored;
use std::sync::Arc;

/// A frame that stays in memory for mapping.
#[derive(Clone, Debug)]
pub(crate) struct Keyframe {
    /// Position among the session's frames.
    pub(crate) frame: usize,
    pub(crate) observation: Stored<Observation>,
    pub(crate) adjacent: AdjacentFrames,
    /// True if the motion during the exposure was found from pictures, and is neither stepped nor aligned
    /// any more: a blurred map would shorten it again.
    pub(crate) has_found_motion: bool,
    /// True if it places Gaussians where it has no depth, too, at inpainted depth.
    pub(crate) fills_depth: bool,
}

impl Keyframe {
    pub(crate) fn new(
        frame: usize,
        observation: Stored<Observation>,
        adjacent: AdjacentFrames,
    ) -> Self {
        Self { frame, observation, adjacent, has_found_motion: false, fills_depth: true }
    }

    /// Motion from start to end of the exposure of this keyframe's estimate, if it was found from pictures.
    pub(crate) fn exposure_motion(&self, estimate: &FrameEstimate) -> Option<Tangent<f64>> {
        match self.has_found_motion {
            true => Some(CentreVelocity::from(estimate.shutter).velocity),
            false => self.adjacent.exposure_motion,
        }
    }
}

/// The pictures of keyframes, read where they are not in memory.
pub(super) fn observations(views: &[Keyframe]) -> Vec<Arc<Observation>> {
    views.iter().map(|view| view.observation.get()).collect()
}

/// Video frames before and after a keyframe where known: time stamp [s], and pose relative to the
/// keyframe (`keyframe_from_other`), which stays when the keyframe moves; of a photograph its motion.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct AdjacentFrames {
    pub(crate) before: Option<(f64, Pose<f64>)>,
    pub(crate) after: Option<(f64, Pose<f64>)>,
    /// Motion from start to end of the exposure, of either sign, found by comparison with other
    /// photographs.
    pub(crate) exposure_motion: Option<Tangent<f64>>,
}

/// Time before a photograph at which its camera was at its place [s]: so long ago that it tells nothing of
/// the motion during the exposure.
const TIME_AT_REST: f64 = 1e6;

impl AdjacentFrames {
    /// Of a photograph, which has no neighbours in time.
    pub(crate) fn of_photograph(timestamp: f64, exposure_motion: Option<Tangent<f64>>) -> Self {
        let before = Some((timestamp - TIME_AT_REST, Pose::identity()));
        Self { before, after: None, exposure_motion }
    }

    /// One known neighbour, before or after `frame`.
    pub(crate) fn from_neighbour(frame: &FrameEstimate, other: &FrameEstimate) -> Self {
        let relative = Some((other.timestamp, frame.middle().inverse() * other.middle()));
        match other.timestamp < frame.timestamp {
            true => Self { before: relative, ..Self::default() },
            false => Self { after: relative, ..Self::default() },
        }
    }

    /// The frame before a keyframe, at its relative pose, with the tone of the keyframe.
    pub(crate) fn previous_frame(&self, keyframe: &FrameEstimate) -> Option<FrameEstimate> {
        let (timestamp, pose) = self.before?;
        let shutter = ShutterPoses::still(keyframe.middle() * pose);
        let posed = FrameEstimate::at_pose(keyframe.index, timestamp, shutter);
        Some(FrameEstimate { tone: keyframe.tone, ..posed })
    }

    /// Frames before and after a keyframe, an unknown one extrapolated at constant velocity.
    pub(crate) fn both(&self, timestamp: f64) -> Option<[(f64, Pose<f64>); 2]> {
        let mirrored = |(stamp, pose): (f64, Pose<f64>)| (2.0 * timestamp - stamp, pose.inverse());
        let before = self.before.or(self.after.map(mirrored))?;
        Some([before, self.after.unwrap_or_else(|| mirrored(before))])
    }

    /// Camera motion at a keyframe of this time stamp, per frame interval of the video.
    pub(crate) fn motion_per_interval(
        &self,
        timestamp: f64,
        frame_rate: f64,
    ) -> Option<Tangent<f64>> {
        let motions = self.both(timestamp)?.map(|(stamp, pose)| {
            let intervals = intervals(frame_rate, timestamp.min(stamp), timestamp.max(stamp));
            Pose::identity().local(pose).scaled((stamp - timestamp).signum() / intervals)
        });
        Some(motions[0].plus(motions[1]).scaled(0.5))
    }
}

/// Number of frame intervals of the video between two time stamps [s], at least 1.
pub(crate) fn intervals(frame_rate: f64, earlier: f64, later: f64) -> f64 {
    let intervals = (later - earlier) * frame_rate;
    if intervals.is_finite() { intervals.max(1.0) } else { 1.0 }
}

/// Whether the last of `frames` becomes a keyframe, `last` being the one before.
///
/// With `keyframe_motion` zero, every `keyframe_interval`-th frame does (SplaTAM). Otherwise a
/// keyframe is due when that many frames have passed and the picture has moved, overlap lost and
/// parallax gained, by `keyframe_motion` of its width. A due keyframe waits, at most half an
/// interval, for a frame of the sharper half of those since the last keyframe.
pub(crate) fn is_keyframe(
    mapping: &MappingConfig,
    camera: &Camera<f64>,
    frames: &[FrameEstimate],
    last: usize,
    observation: &Observation,
) -> bool {
    let position = frames.len() - 1;
    if mapping.keyframe_motion <= 0.0 {
        return frames.len().is_multiple_of(mapping.keyframe_interval);
    }
    let passed = position - last;
    if passed < mapping.keyframe_interval {
        return false;
    }
    let between = ShutterPoses { start: frames[last].middle(), end: frames[position].middle() };
    let motion = blur_length(camera, &between, &observation.depth);
    if motion < f64::from(mapping.keyframe_motion) * camera.width as f64 {
        return false;
    }
    2 * passed >= 3 * mapping.keyframe_interval || is_sharp(&frames[last + 1..])
}

/// Whether the last of `frames` is among the sharper half of those that were tracked.
fn is_sharp(frames: &[FrameEstimate]) -> bool {
    let blur = frames.last().map_or(0.0, |f| f.blur_length);
    let tracked = frames.iter().filter(|f| f.tracked);
    let sharper = tracked.clone().filter(|f| f.blur_length < blur).count();
    2 * sharper < tracked.count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use i2slam_geometry::{Image, Rotation, Vec3};

    const CAMERA: Camera<f64> =
        Camera { width: 100, height: 80, fx: 100.0, fy: 100.0, cx: 50.0, cy: 40.0 };

    /// A frame rotated by `pixels` from the first, with a blur of `blur` pixels.
    fn frame(index: usize, pixels: f64, blur: f64) -> FrameEstimate {
        let turn = Rotation::exp(Vec3::new(0.0, pixels / 100.0, 0.0));
        FrameEstimate {
            blur_length: blur,
            ..FrameEstimate::at_pose(
                index,
                index as f64,
                ShutterPoses::still(Pose::new(turn, Vec3::zero())),
            )
        }
    }

    fn keyframes(interval: usize, motion: f32, path: &[(f64, f64)]) -> Vec<usize> {
        let mut mapping = Config::default().mapping;
        (mapping.keyframe_interval, mapping.keyframe_motion) = (interval, motion);
        let mut depth = Image::new(100, 80, 1);
        depth.data.fill(2.0);
        let observation = Observation::new(Image::new(100, 80, 3), depth);
        let (mut frames, mut chosen) = (Vec::new(), vec![0]);
        for (index, &(pixels, blur)) in path.iter().enumerate() {
            frames.push(frame(index, pixels, blur));
            let last = chosen[chosen.len() - 1];
            if index > 0 && is_keyframe(&mapping, &CAMERA, &frames, last, &observation) {
                chosen.push(index);
            }
        }
        chosen
    }

    #[test]
    fn a_still_camera_adds_no_keyframes() {
        assert_eq!(keyframes(2, 0.05, &[(0.0, 0.0); 12]), [0]);
        assert_eq!(keyframes(3, 0.0, &[(0.0, 0.0); 8]), [0, 2, 5]);
    }

    #[test]
    fn a_due_keyframe_waits_for_a_sharp_frame() {
        let path = |blurs: &[f64]| -> Vec<(f64, f64)> {
            blurs.iter().enumerate().map(|(i, &b)| (4.0 * i as f64, b)).collect()
        };
        assert_eq!(keyframes(4, 0.05, &path(&[0.0, 1.0, 2.0, 7.0, 8.0, 0.5, 3.0])), [0, 5]);
        assert_eq!(keyframes(4, 0.05, &path(&[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0])), [0, 6]);
    }

    #[test]
    fn intervals_are_counted_and_at_least_one() {
        assert_eq!(intervals(20.0, 0.0, 0.2), 4.0);
        assert_eq!(intervals(20.0, 0.2, 0.0), 1.0);
    }
}
