//! Session on keyframes with roughly known poses, which are refined together with the map; the
//! frames between them are localised in it at the end.

use super::error::{SessionError, check_image};
use super::state::SessionState;
use crate::config::{Config, MapKind, ResponseScope};
use crate::keyframes::PosedKeyframe;
use crate::mapping::{
    AdjacentFrames, JointFieldMapper, JointGaussianMapper, JointMapper, Keyframe, MappingContext,
};
use crate::objective::Observation;
use crate::reconstruction::{FrameEstimate, Reconstruction};
use crate::warning::Warning;
use i2slam_compute::CancellationToken;
use i2slam_formation::{FrameTone, ShutterPoses};
use i2slam_geometry::{Camera, Image, Pose, Tangent};
use i2slam_odometry::blank_reason;
use i2slam_radiance::hashgrid::SettingsError;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

/// RGB SLAM on keyframes whose poses, and perhaps depths, are roughly known.
///
/// The world is the camera of the first keyframe at its input pose; every pose is refined, that one
/// too.
pub struct KeyframeSession {
    config: Config,
    camera: Camera<f64>,
    frame_rate: f64,
    mapper: Box<dyn JointMapper>,
    state: SessionState,
    /// From the world of the keyframe source to that of the session.
    world_from_source: Option<Pose<f64>>,
    /// Poses before refinement, in the world of the session, by frame index.
    input_poses: BTreeMap<usize, Pose<f64>>,
    failure: Option<SettingsError>,
}

impl KeyframeSession {
    /// A session for keyframes of `camera`, taken from a video of `frame_rate` frames per second.
    pub fn new(config: Config, camera: Camera<f64>, frame_rate: f64) -> Self {
        let mapper: Box<dyn JointMapper> = match config.map.kind {
            MapKind::Gaussian => Box::new(JointGaussianMapper::new(&config, &camera, frame_rate)),
            MapKind::HashGrid => Box::new(JointFieldMapper::new(&camera, frame_rate)),
        };
        let mut state = SessionState::new(&config);
        state.warnings.extend(unused_setting(&config));
        Self {
            mapper,
            state,
            world_from_source: None,
            input_poses: BTreeMap::new(),
            failure: None,
            config,
            camera,
            frame_rate,
        }
    }

    /// Restricts the image terms to recorded pixels, a mask such as `Sequence::valid_mask`.
    pub fn set_valid_mask(&mut self, valid_mask: Arc<Image<bool>>) {
        self.mapper.set_valid_mask(Arc::clone(&valid_mask));
        self.state.valid_mask = Some(valid_mask);
    }

    /// Sets the token whose cancellation ends mapping of a keyframe early.
    pub fn set_cancellation(&mut self, cancellation: CancellationToken) {
        self.state.cancellation = cancellation;
    }

    /// Adds one keyframe, and refines map, poses and tone for some steps.
    ///
    /// # Errors
    ///
    /// A keyframe that does not fit the camera or has no finite pose, and a map that cannot be
    /// started with its settings.
    pub fn process(&mut self, keyframe: PosedKeyframe) -> Result<&FrameEstimate, SessionError> {
        self.check(&keyframe)?;
        let clock = Instant::now();
        let keyframe_from_source = keyframe.world_from_camera.inverse();
        let relative = |(timestamp, pose)| (timestamp, keyframe_from_source * pose);
        let (before, after) = (keyframe.before.map(relative), keyframe.after.map(relative));
        let adjacent = AdjacentFrames { before, after };
        let (estimate, observation) = self.initial_estimate(keyframe, adjacent);
        let position = self.state.frames.len();
        let maps = estimate.keyframe;
        self.state.frames.push(estimate);
        if position == 1 {
            self.initialize_first_exposure();
        }
        if maps {
            self.state.keyframes.push(Keyframe { frame: position, observation, adjacent });
            let (mapper, mut context) = self.mapping();
            if let Err(source) = mapper.add(&mut context) {
                self.failure = Some(source);
                return Err(SessionError::Map { source });
            }
        }
        let estimate = &mut self.state.frames[position];
        estimate.mapping_seconds = clock.elapsed().as_secs_f64();
        Ok(estimate)
    }

    /// Final optimisation of map and keyframes; stops when `on_step(done, total)` returns false.
    pub fn finish(&mut self, on_step: &mut dyn FnMut(usize, usize) -> bool) {
        if self.state.keyframes.is_empty() || self.failure.is_some() {
            return;
        }
        let (mapper, mut context) = self.mapping();
        if let Err(error) = mapper.finish(&mut context, on_step) {
            self.state.warnings.push(format!("the map is empty: {error}").into());
            self.failure = Some(error);
        }
        let SessionState { frames, warnings, .. } = &mut self.state;
        warnings.extend(frames.iter().filter(|f| f.keyframe && !f.tracked).map(|f| {
            let text =
                "not found in the map: its pose is that of the front end, refined with the map";
            Warning::of_frame(f.index, text)
        }));
    }

    /// Frames so far, in order of their index.
    pub fn frames(&self) -> &[FrameEstimate] {
        &self.state.frames
    }

    /// Takes the warnings since the last call.
    pub fn take_warnings(&mut self) -> Vec<Warning> {
        std::mem::take(&mut self.state.warnings)
    }

    /// A copy of everything estimated so far.
    pub fn reconstruction(&self) -> Reconstruction {
        let readout = self.config.input.rolling_shutter_readout;
        self.state.reconstruction(&self.config, &self.camera, self.mapper.map(), readout)
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

    /// Estimate and observation of a keyframe before refinement.
    fn initial_estimate(
        &mut self,
        keyframe: PosedKeyframe,
        adjacent: AdjacentFrames,
    ) -> (FrameEstimate, Arc<Observation>) {
        let PosedKeyframe { index, timestamp, colour, world_from_camera, depth, .. } = keyframe;
        let source = *self.world_from_source.get_or_insert_with(|| world_from_camera.inverse());
        let world_from_camera = source * world_from_camera;
        self.input_poses.insert(index, world_from_camera);
        let blank = blank_reason(&colour);
        if let Some(reason) = blank {
            self.state.warn(index, format!("{reason}: it is not mapped"));
        }
        let observation = match depth {
            None => {
                let no_depth = Image::new(self.camera.width, self.camera.height, 1);
                Observation::new(colour, no_depth)
            }
            Some(estimated) => match estimated.variance {
                None => Observation::new(colour, estimated.depth),
                Some(variance) => Observation::estimated(colour, estimated.depth, variance),
            },
        };
        let response = self.next_response();
        let last = self.state.frames.last();
        let mut estimate = FrameEstimate {
            tone: last.map_or_else(FrameTone::default, |f| f.tone),
            response,
            keyframe: blank.is_none(),
            ..FrameEstimate::at_pose(index, timestamp, ShutterPoses::still(world_from_camera))
        };
        let known = adjacent.motion_per_interval(timestamp, self.frame_rate);
        let from_last = || {
            let adjacent = AdjacentFrames::from_neighbour(&estimate, last?);
            adjacent.motion_per_interval(timestamp, self.frame_rate)
        };
        if let Some(motion) = known.or_else(from_last) {
            estimate.shutter = self.initial_shutter(&estimate, motion);
        }
        (estimate, Arc::new(observation))
    }

    /// Index of the next keyframe's response: the sequence's, or its own, a copy of the last.
    fn next_response(&mut self) -> usize {
        let SessionState { frames, responses, .. } = &mut self.state;
        let last = responses.len() - 1;
        if frames.is_empty() || self.config.formation.response_scope == ResponseScope::Sequence {
            return last;
        }
        responses.push(responses[last].clone());
        last + 1
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

    fn mapping(&mut self) -> (&mut dyn JointMapper, MappingContext<'_>) {
        let keyframes = self.state.keyframes.len();
        let context = self.state.mapping_context(&self.config, &self.camera, keyframes);
        (self.mapper.as_mut(), context)
    }

    /// Whether the `number`-th keyframe, from 0, is held out (`mapping.hold_out`).
    pub fn holds_out(&self, number: usize) -> bool {
        self.config.mapping.holds_out(number)
    }

    /// Localises a frame that is no keyframe, after [`finish`](Self::finish), best in order: its
    /// picture refines its pose, which starts relative to the nearest keyframe as in the source,
    /// and estimates its motion during exposure and its tone. Nothing else changes.
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

    /// A held-out frame relative to the nearest keyframe, with the tone of the one before `place`.
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

/// Warns of a changed setting that has no effect in this kind of session.
fn unused_setting(config: &Config) -> Option<Warning> {
    let preset = Config::preset(&config.preset).ok()?.formation.quadrature;
    let is_field = config.map.kind == MapKind::HashGrid;
    (is_field && preset != config.formation.quadrature).then(|| {
        "`formation.quadrature` has no effect here: the moments of the exposure are drawn at \
         random within equal parts of it"
            .into()
    })
}

#[cfg(test)]
mod tests;
