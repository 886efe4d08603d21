//! Localisation of the frames between keyframes in the finished map.

use super::{KeyframeSession, SessionError};
use crate::keyframes::PosedKeyframe;
use crate::reconstruction::FrameEstimate;
use i2slam_formation::ShutterPoses;
use i2slam_geometry::Pose;

impl KeyframeSession {
    /// Whether the `number`-th keyframe, from 0, is held out from the map (`mapping.hold_out`), to
    /// be [localised](Self::locate) after [`finish`](Self::finish).
    pub fn holds_out(&self, number: usize) -> bool {
        self.config.mapping.holds_out(number)
    }

    /// Localises a frame that is no keyframe, after [`finish`](Self::finish): its picture alone
    /// refines its pose, which starts relative to the nearest keyframe as in the source, and
    /// estimates its motion during exposure and its tone. Nothing else changes. Frames best come in
    /// order.
    ///
    /// # Errors
    ///
    /// A frame that does not fit the camera or has no finite pose.
    pub fn locate(&mut self, frame: PosedKeyframe) -> Result<&FrameEstimate, SessionError> {
        self.check(&frame)?;
        let PosedKeyframe { index, timestamp, colour, world_from_camera, .. } = frame;
        let place = match self.position_of(index) {
            Ok(known) => return Ok(&self.state.frames[known]),
            Err(place) => place,
        };
        let mut estimate = self.unrefined_estimate(place, index, timestamp, world_from_camera);
        let previous = place.checked_sub(1).map(|i| self.state.frames[i].clone());
        let (mapper, context) = self.mapping();
        let found = mapper.locate(&context, (&mut estimate, &colour), previous.as_ref());
        estimate.tracked = found;
        if !found {
            let text = "not found in the map: its pose is that of the front end";
            self.state.warn(index, text);
        }
        self.insert(place, estimate);
        Ok(&self.state.frames[place])
    }

    /// Inserts a frame at its input pose relative to the nearest keyframe, unrefined; false if
    /// present or not finite. For sessions that end before all frames are localised.
    pub fn insert_unrefined(
        &mut self,
        index: usize,
        timestamp: f64,
        world_from_camera: Pose<f64>,
    ) -> bool {
        let Err(place) = self.position_of(index) else { return false };
        if !timestamp.is_finite() || !world_from_camera.is_finite() {
            return false;
        }
        self.world_from_source.get_or_insert_with(|| world_from_camera.inverse());
        let estimate = self.unrefined_estimate(place, index, timestamp, world_from_camera);
        self.insert(place, estimate);
        true
    }

    /// Position of a frame by its index, or where it is to be inserted.
    fn position_of(&self, index: usize) -> Result<usize, usize> {
        self.state.frames.binary_search_by_key(&index, |f| f.index)
    }

    /// A held-out frame at its input pose relative to the nearest keyframe, with the tone of the
    /// frame before its `place`, or else after it.
    fn unrefined_estimate(
        &self,
        place: usize,
        index: usize,
        timestamp: f64,
        world_from_camera: Pose<f64>,
    ) -> FrameEstimate {
        let pose = self.pose_near_keyframe(timestamp, world_from_camera);
        let mut estimate = FrameEstimate::at_pose(index, timestamp, ShutterPoses::still(pose));
        estimate.held_out = true;
        if let Some(near) = self.state.frames.get(place.saturating_sub(1)) {
            (estimate.tone, estimate.response) = (near.tone, near.response);
            estimate.gaussians = near.gaussians;
        }
        estimate
    }

    fn insert(&mut self, place: usize, estimate: FrameEstimate) {
        self.state.frames.insert(place, estimate);
        let later = self.state.keyframes.iter_mut().filter(|k| k.frame >= place);
        later.for_each(|k| k.frame += 1);
    }

    /// Pose of a frame that keeps its input pose relative to the keyframe nearest in time.
    fn pose_near_keyframe(&self, timestamp: f64, world_from_camera: Pose<f64>) -> Pose<f64> {
        let source = self.world_from_source.unwrap_or_else(Pose::identity);
        let input = source * world_from_camera;
        let distance = |f: &&FrameEstimate| (f.timestamp - timestamp).abs();
        let keyframes = self.state.frames.iter().filter(|f| f.keyframe);
        let nearest = keyframes.min_by(|a, b| distance(a).total_cmp(&distance(b)));
        match nearest.and_then(|near| Some((near, self.input_poses.get(&near.index)?))) {
            Some((near, near_input)) => near.middle() * (near_input.inverse() * input),
            None => input,
        }
    }
}
