//! The frames between keyframes: found in the finished map.

use super::{KeyframeSession, SessionError};
use crate::keyframes::PosedKeyframe;
use crate::reconstruction::FrameEstimate;
use crate::warning::Warning;
use i2slam_formation::ShutterPoses;
use i2slam_geometry::Pose;

impl KeyframeSession {
    /// Whether the keyframe that comes `number`-th, from 0, is kept from the map
    /// (`mapping.hold_out`): it is one to [`locate`](Self::locate) after [`finish`](Self::finish).
    pub fn holds_out(&self, number: usize) -> bool {
        self.config.mapping.holds_out(number)
    }

    /// Takes in a frame that is no keyframe, after [`finish`](Self::finish): its pose starts where
    /// its source puts it beside the nearest keyframe, and is refined, with the motion over its
    /// exposure and its gains, by its picture alone. Nothing else changes. Frames best come in
    /// order.
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
        let expected = self.beside_keyframe(frame.timestamp, frame.world_from_camera);
        let before = place.checked_sub(1).map(|i| self.frames[i].clone());
        let near = before.as_ref().or(self.frames.get(place));
        let mut estimate =
            FrameEstimate::posed(frame.index, frame.timestamp, ShutterPoses::still(expected));
        if let Some(near) = near {
            (estimate.tone, estimate.response) = (near.tone, near.response);
            estimate.gaussians = near.gaussians;
        }
        let (mapper, context) = self.context();
        let found = mapper.locate(&context, (&mut estimate, &frame.colour), before.as_ref());
        (estimate.tracked, estimate.held_out) = (found, true);
        if !found {
            let what = "not found in the map: its pose is that of the front end";
            self.warnings.push(Warning::of_frame(frame.index, what));
        }
        self.insert(place, estimate);
        Ok(&self.frames[place])
    }

    /// Takes in a frame of which nothing but the pose that its source found is known, at its place
    /// beside the nearest keyframe, where a session ends before it came to look for it. A frame
    /// that is there already stays as it is. Returns whether it was taken in.
    pub fn place(&mut self, index: usize, timestamp: f64, world_from_camera: Pose<f64>) -> bool {
        let place = self.frames.partition_point(|f| f.index < index);
        let is_known = self.frames.get(place).is_some_and(|f| f.index == index);
        if is_known || !timestamp.is_finite() || !world_from_camera.is_finite() {
            return false;
        }
        self.world_from_source.get_or_insert_with(|| world_from_camera.inverse());
        let at = self.beside_keyframe(timestamp, world_from_camera);
        let posed = FrameEstimate::posed(index, timestamp, ShutterPoses::still(at));
        let near = place.checked_sub(1).or((!self.frames.is_empty()).then_some(0));
        let (tone, response, gaussians) = near.map_or_else(
            || (posed.tone, posed.response, 0),
            |i| (self.frames[i].tone, self.frames[i].response, self.frames[i].gaussians),
        );
        self.insert(place, FrameEstimate { tone, response, gaussians, held_out: true, ..posed });
        true
    }

    fn insert(&mut self, place: usize, estimate: FrameEstimate) {
        self.frames.insert(place, estimate);
        self.keyframes.iter_mut().filter(|k| k.frame >= place).for_each(|k| k.frame += 1);
    }

    /// Where a frame is if it has kept its place beside the keyframe that is nearest in time.
    fn beside_keyframe(&self, timestamp: f64, world_from_camera: Pose<f64>) -> Pose<f64> {
        let source = self.world_from_source.unwrap_or_else(Pose::identity);
        let came = source * world_from_camera;
        let off = |f: &&FrameEstimate| (f.timestamp - timestamp).abs();
        let keyframes = self.frames.iter().filter(|f| f.keyframe);
        let nearest = keyframes.min_by(|a, b| off(a).total_cmp(&off(b)));
        match nearest.and_then(|near| Some((near, self.input_poses.get(&near.index)?))) {
            Some((near, its)) => near.middle() * (its.inverse() * came),
            None => came,
        }
    }
}
