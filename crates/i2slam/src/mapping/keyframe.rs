//! Which frames stay in memory for mapping.

use crate::config::MappingConfig;
use crate::objective::{Observation, blur_length};
use crate::reconstruction::FrameEstimate;
use i2slam_formation::ShutterPoses;
use i2slam_geometry::Camera;
use std::sync::Arc;

/// A frame that stays in memory for mapping.
#[derive(Clone, Debug)]
pub(crate) struct Keyframe {
    /// Position among the session's frames.
    pub(crate) frame: usize,
    pub(crate) observation: Arc<Observation>,
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
    use i2slam_geometry::{Image, Pose, Rotation, Vec3};

    const CAMERA: Camera<f64> =
        Camera { width: 100, height: 80, fx: 100.0, fy: 100.0, cx: 50.0, cy: 40.0 };

    /// A frame turned by `pixels` from the first, with a blur of `blur` pixels.
    fn frame(index: usize, pixels: f64, blur: f64) -> FrameEstimate {
        let turn = Rotation::exp(Vec3::new(0.0, pixels / 100.0, 0.0));
        FrameEstimate {
            blur_length: blur,
            ..FrameEstimate::posed(
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
    fn a_camera_that_stands_still_adds_none() {
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
}
