//! The frames between keyframes: found in the finished map.

use super::{KeyframedSession, SessionError};
use crate::keyframes::PosedKeyframe;
use crate::reconstruction::FrameEstimate;
use i2slam_formation::ShutterPoses;
use i2slam_geometry::Pose;

impl KeyframedSession {
    /// Whether the keyframe that comes `number`-th, from 0, is kept from the map (`mapping.hold_out`):
    /// it is one to [`locate`](Self::locate) after [`finish`](Self::finish).
    pub fn holds_out(&self, number: usize) -> bool {
        self.config.mapping.holds_out(number)
    }

    /// Takes in a frame that is no keyframe, after [`finish`](Self::finish): its pose starts where its
    /// source puts it beside the nearest keyframe, and is refined, with the motion over its exposure
    /// and its gains, by its picture alone. Nothing else changes. Frames best come in order.
    ///
    /// # Errors
    ///
    /// A frame that does not fit the camera or has no finite pose.
    pub fn locate(&mut self, frame: PosedKeyframe) -> Result<&FrameEstimate, SessionError> {
        self.check(&frame)?;
        let place = self.frames.partition_point(|f| f.index < frame.index);
        if self.frames.get(place).is_some_and(|f| f.index == frame.index) {
            return Ok(&self.frames[place]);
        }
        let expected = self.beside_keyframe(&frame);
        let before = place.checked_sub(1).map(|i| self.frames[i].clone());
        let near = before.as_ref().or(self.frames.get(place));
        let mut estimate =
            FrameEstimate::posed(frame.index, frame.timestamp, ShutterPoses::still(expected));
        if let Some(near) = near {
            (estimate.tone, estimate.response) = (near.tone, near.response);
            estimate.gaussians = near.gaussians;
        }
        let (mapper, story) = self.story();
        let found = mapper.locate(&story, (&mut estimate, &frame.colour), before.as_ref());
        (estimate.tracked, estimate.held_out) = (found, true);
        if !found {
            let index = frame.index;
            self.warnings.push(format!(
                "frame {index}: not found in the map: its pose is that of the front end"
            ));
        }
        self.frames.insert(place, estimate);
        self.keyframes.iter_mut().filter(|k| k.frame >= place).for_each(|k| k.frame += 1);
        Ok(&self.frames[place])
    }

    /// Where a frame is if it has kept its place beside the keyframe that is nearest in time.
    fn beside_keyframe(&self, frame: &PosedKeyframe) -> Pose<f64> {
        let source = self.world_from_source.unwrap_or_else(Pose::identity);
        let came = source * frame.world_from_camera;
        let off = |f: &&FrameEstimate| (f.timestamp - frame.timestamp).abs();
        let keyframes = self.frames.iter().filter(|f| f.keyframe);
        let nearest = keyframes.min_by(|a, b| off(a).total_cmp(&off(b)));
        match nearest.and_then(|near| Some((near, self.came.get(&near.index)?))) {
            Some((near, its)) => near.middle() * (its.inverse() * came),
            None => came,
        }
    }
}
