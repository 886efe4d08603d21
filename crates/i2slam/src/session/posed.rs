//! Keyframes with poses of another source, which are refined together with the map; the frames
//! between them are localised in it at the end.

use super::Session;
use super::error::{SessionError, check_image};
use super::state::SessionState;
use crate::config::{MapKind, ResponseScope};
use crate::keyframes::{EstimatedDepth, PosedKeyframe};
use crate::mapping::{AdjacentFrames, Keyframe};
use crate::objective::Observation;
use crate::reconstruction::FrameEstimate;
use i2slam_formation::{CentreVelocity, FrameTone, ShutterPoses};
use i2slam_geometry::{Image, Pose, Tangent};
use i2slam_odometry::blank_reason;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Instant;

/// Poses as their source gave them, and the change of world.
#[derive(Default)]
pub(super) struct SourcePoses {
    /// From the world of the source to that of the session.
    world_from_source: Option<Pose<f64>>,
    /// Poses of keyframes before refinement, in the world of the session, by frame index.
    keyframes: BTreeMap<usize, Pose<f64>>,
}

impl SourcePoses {
    /// A pose in the world of the session, which is the camera of the first one.
    pub(super) fn place_in_world(&mut self, source_from_camera: Pose<f64>) -> Pose<f64> {
        let world = self.world_from_source.get_or_insert_with(|| source_from_camera.inverse());
        *world * source_from_camera
    }

    /// Replaces the pose that a keyframe came with, in the world of the session.
    pub(super) fn correct(&mut self, index: usize, world_from_camera: Pose<f64>) {
        if let Some(pose) = self.keyframes.get_mut(&index) {
            *pose = world_from_camera;
        }
    }
}

/// A picture with its depth.
pub(super) fn estimated_observation(
    colour: Arc<Image<f32>>,
    EstimatedDepth { depth, variance }: EstimatedDepth,
) -> Observation {
    match variance {
        None => Observation::new(colour, depth),
        Some(variance) => Observation::estimated(colour, depth, variance),
    }
}

impl Session {
    /// Keeps the world that keyframes come in, instead of that of the first one's camera.
    pub(super) fn keep_world(&mut self) {
        self.source.get_or_insert_default().world_from_source = Some(Pose::identity());
    }

    /// A session of the same settings without frames, in the world that keyframes come in.
    pub(super) fn restarted(&self) -> Self {
        let mut session = Self::refining(self.config.clone(), self.camera, self.frame_rate);
        session.keep_world();
        session.is_readout_given = self.is_readout_given;
        session.set_unordered(self.is_unordered);
        session.set_cancellation(self.state.cancellation.clone());
        session.state.scratch = Arc::clone(&self.state.scratch);
        if let Some(valid_mask) = &self.state.valid_mask {
            session.set_valid_mask(Arc::clone(valid_mask));
        }
        session
    }

    /// Adds one keyframe, or a frame between keyframes, and refines map, poses and tone for some
    /// steps. Frames stay in order of their indices; one that is known is replaced with what it
    /// brought into a map of Gaussians.
    ///
    /// # Errors
    ///
    /// A keyframe that does not fit the camera or has no finite pose, and a map that cannot be
    /// started with its settings.
    pub fn add_keyframe(
        &mut self,
        keyframe: PosedKeyframe,
    ) -> Result<&FrameEstimate, SessionError> {
        self.check(&keyframe)?;
        let clock = Instant::now();
        let keyframe_from_source = keyframe.world_from_camera.inverse();
        let relative = |(timestamp, pose)| (timestamp, keyframe_from_source * pose);
        let (before, after) = (keyframe.before.map(relative), keyframe.after.map(relative));
        let adjacent = match self.is_unordered {
            true => AdjacentFrames::of_photograph(keyframe.timestamp, keyframe.exposure_motion),
            false => AdjacentFrames { before, after, ..AdjacentFrames::default() },
        };
        let PosedKeyframe { is_keyframe, fills_depth, .. } = keyframe;
        if self.position_of(keyframe.index).is_ok() {
            self.forget(&BTreeSet::from([keyframe.index]));
        }
        let position = self.state.frames.partition_point(|f| f.index < keyframe.index);
        let (mut estimate, observation) = self.initial_estimate(position, keyframe, adjacent);
        let observation = self.state.scratch.insert(observation);
        let maps = estimate.keyframe;
        estimate.keyframe &= is_keyframe;
        self.insert(position, estimate);
        if position == 1 && !self.is_unordered {
            self.initialize_first_exposure();
        }
        if maps {
            let keyframe = Keyframe::new(position, observation, adjacent);
            self.map_keyframe(Keyframe { fills_depth, ..keyframe })?;
        }
        let estimate = &mut self.state.frames[position];
        estimate.mapping_seconds = clock.elapsed().as_secs_f64();
        Ok(estimate)
    }

    /// Maps a keyframe; in Gaussians it is localised first, which initialises its motion during
    /// exposure and its tone. A field that grows is too soft for that.
    fn map_keyframe(&mut self, keyframe: Keyframe) -> Result<(), SessionError> {
        let position = keyframe.frame;
        if self.config.map.kind == MapKind::Gaussian && !self.mapper.is_empty() {
            let mut estimate = self.state.frames[position].clone();
            let observation = keyframe.observation.get();
            let previous = keyframe.adjacent.previous_frame(&estimate);
            let (mapper, tracker, context) = self.mapping();
            let frame = (&mut estimate, &observation.colour);
            let others = &context.frames[..position];
            let known = (previous.as_ref(), keyframe.adjacent.exposure_motion);
            tracker.localize(mapper, &context, frame, known, others);
            self.state.frames[position] = estimate;
        }
        if self.state.frames[position].keyframe {
            let keyframes = &mut self.state.keyframes;
            let place = keyframes.partition_point(|k| k.frame < position);
            keyframes.insert(place, keyframe.clone());
        }
        self.map(&keyframe)?;
        self.state.frames[position].gaussians = self.mapper.gaussians();
        Ok(())
    }

    fn check(&self, keyframe: &PosedKeyframe) -> Result<(), SessionError> {
        let index = keyframe.index;
        let depth = keyframe.depth.as_ref();
        let images = [
            (("colour", 3), Some(&*keyframe.colour)),
            (("depth", 1), depth.map(|d| &d.depth)),
            (("depth variance", 1), depth.and_then(|d| d.variance.as_ref())),
        ];
        for (kind, image) in images {
            image.map_or(Ok(()), |image| check_image(index, kind, image, &self.camera))?;
        }
        if !keyframe.timestamp.is_finite() {
            return Err(SessionError::Stamp { index });
        }
        match keyframe.world_from_camera.is_finite() {
            true => Ok(()),
            false => Err(SessionError::Pose { index }),
        }
    }

    /// Estimate and observation of a keyframe before refinement, with the tone of the frame before
    /// its position.
    fn initial_estimate(
        &mut self,
        position: usize,
        keyframe: PosedKeyframe,
        adjacent: AdjacentFrames,
    ) -> (FrameEstimate, Observation) {
        let PosedKeyframe { index, timestamp, colour, world_from_camera, depth, .. } = keyframe;
        let source = self.source.get_or_insert_default();
        let world_from_camera = source.place_in_world(world_from_camera);
        source.keyframes.insert(index, world_from_camera);
        let blank = blank_reason(&colour);
        if let Some(reason) = blank {
            self.state.warn(index, format!("{reason}: it is not mapped"));
        }
        let observation = match depth {
            None => {
                let no_depth = Image::new(self.camera.width, self.camera.height, 1);
                Observation::new(colour, no_depth)
            }
            Some(estimated) => estimated_observation(colour, estimated),
        };
        let response = self.response_at(position);
        let previous = self.state.frames[..position].last().filter(|_| !self.is_unordered);
        let mut estimate = FrameEstimate {
            tone: previous.map_or_else(FrameTone::default, |f| f.tone),
            response,
            keyframe: blank.is_none(),
            tracked: blank.is_none(),
            ..FrameEstimate::at_pose(index, timestamp, ShutterPoses::still(world_from_camera))
        };
        let known = adjacent.motion_per_interval(timestamp, self.frame_rate);
        let from_previous = || {
            let adjacent = AdjacentFrames::from_neighbour(&estimate, previous?);
            adjacent.motion_per_interval(timestamp, self.frame_rate)
        };
        let is_blurred = self.config.formation.blur;
        if let Some(velocity) = adjacent.exposure_motion.filter(|_| is_blurred) {
            estimate.shutter = CentreVelocity { centre: world_from_camera, velocity }.into();
        } else if let Some(motion) = known.or_else(from_previous) {
            estimate.shutter = self.initial_shutter(&estimate, motion);
        }
        (estimate, observation)
    }

    /// Index of the response of a keyframe to be added at a position: the sequence's, or its own, a
    /// copy of that of the frame before.
    fn response_at(&mut self, position: usize) -> usize {
        let SessionState { frames, responses, .. } = &mut self.state;
        if frames.is_empty() || self.config.formation.response_scope == ResponseScope::Sequence {
            return responses.len() - 1;
        }
        let previous = frames[..position].last().map_or(0, |frame| frame.response);
        responses.push(responses[previous].clone());
        responses.len() - 1
    }

    /// Initialises the first exposure's motion from the second frame, if it has none.
    fn initialize_first_exposure(&mut self) {
        let [first, second] = &self.state.frames[..] else { return };
        if first.shutter.start != first.shutter.end {
            return;
        }
        let adjacent = AdjacentFrames::from_neighbour(first, second);
        if let Some(motion) = adjacent.motion_per_interval(first.timestamp, self.frame_rate) {
            self.state.frames[0].shutter = self.initial_shutter(first, motion);
        }
    }

    /// Exposure around a frame's pose, from the motion in a frame interval.
    fn initial_shutter(&self, frame: &FrameEstimate, motion: Tangent<f64>) -> ShutterPoses<f64> {
        if !self.config.formation.blur {
            return ShutterPoses::still(frame.middle());
        }
        let motion = motion.scaled(f64::from(self.config.parameters.keyframed.initial_split));
        ShutterPoses {
            start: frame.middle().retract(motion.scaled(-0.5)),
            end: frame.middle().retract(motion.scaled(0.5)),
        }
    }

    /// Localises a frame that is no keyframe, after [`finish`](Self::finish), best in order: its
    /// picture refines its pose, which starts relative to the nearest keyframe as in the source,
    /// and estimates its motion during exposure and its tone. Nothing else changes. A frame that was
    /// mapped when it came is localised again, in the finished map.
    ///
    /// # Errors
    ///
    /// A frame that does not fit the camera or has no finite pose.
    pub fn localize(&mut self, frame: PosedKeyframe) -> Result<&FrameEstimate, SessionError> {
        self.check(&frame)?;
        let PosedKeyframe { index, timestamp, colour, world_from_camera, exposure_motion, .. } =
            frame;
        let (is_present, place) = match self.position_of(index) {
            Ok(known) => (true, known),
            Err(place) => (false, place),
        };
        if is_present && (self.state.frames[place].keyframe || self.state.frames[place].held_out) {
            return Ok(&self.state.frames[place]);
        }
        let mut estimate = match is_present {
            true => self.state.frames[place].clone(),
            false => self.unrefined_estimate(place, index, timestamp, world_from_camera),
        };
        let previous = place.checked_sub(1).filter(|_| !self.is_unordered);
        let previous = previous.map(|i| self.state.frames[i].clone());
        let (mapper, tracker, context) = self.mapping();
        let frame = (&mut estimate, &colour);
        let known = (previous.as_ref(), exposure_motion);
        let is_found = tracker.localize(mapper, &context, frame, known, context.frames);
        estimate.refined |= is_found;
        if !is_found {
            let text = "not found in the map: its pose is that of the front end";
            self.state.warn(index, text);
        }
        match is_present {
            true => self.state.frames[place] = estimate,
            false => self.insert(place, estimate),
        }
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
        self.source.get_or_insert_default().place_in_world(world_from_camera);
        let estimate = self.unrefined_estimate(place, index, timestamp, world_from_camera);
        self.insert(place, estimate);
        true
    }

    /// Position of a frame by its index, or where it is to be inserted.
    fn position_of(&self, index: usize) -> Result<usize, usize> {
        self.state.frames.binary_search_by_key(&index, |f| f.index)
    }

    /// A frame that is not mapped, relative to the nearest keyframe, with the tone of the one before
    /// `place`. It counts as held out; where frames are named that are, only as one of these.
    fn unrefined_estimate(
        &self,
        place: usize,
        index: usize,
        timestamp: f64,
        world_from_camera: Pose<f64>,
    ) -> FrameEstimate {
        let pose = self.pose_near_keyframe(timestamp, world_from_camera);
        let mut estimate = FrameEstimate::at_pose(index, timestamp, ShutterPoses::still(pose));
        let named = &self.config.mapping.hold_out_frames;
        estimate.refined = false;
        estimate.held_out = named.is_empty() || named.contains(&index);
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
        let world_from_source = self.source.as_ref().and_then(|source| source.world_from_source);
        let input = world_from_source.unwrap_or_else(Pose::identity) * world_from_camera;
        let distance = |f: &&FrameEstimate| (f.timestamp - timestamp).abs();
        let keyframes = self.state.frames.iter().filter(|f| f.keyframe);
        let nearest = keyframes.min_by(|a, b| distance(a).total_cmp(&distance(b)));
        match nearest
            .and_then(|near| Some((near, self.source.as_ref()?.keyframes.get(&near.index)?)))
        {
            Some((near, near_input)) => near.middle() * (near_input.inverse() * input),
            None => input,
        }
    }
}
