//! The session on keyframes that come with poses: posed pictures go in one by one, a reconstruction
//! comes out. Poses are refined together with the map; the frames between keyframes are found in it
//! at the end.

mod localization;

use super::{MIN_MEAN_BRIGHTNESS, SessionError};
use crate::config::{Config, MapKind, ResponseScope};
use crate::keyframes::PosedKeyframe;
use crate::mapping::{AdjacentFrames, JointMapper, Keyframe, MappingContext};
use crate::objective::Observation;
use crate::reconstruction::{FrameEstimate, Reconstruction};
use crate::warning::Warning;
use i2slam_compute::{CancellationToken, Random};
use i2slam_formation::{CameraResponse, FrameTone, ShutterPoses};
use i2slam_geometry::{Camera, Image, Pose, Tangent};
use i2slam_radiance::hashgrid::SettingsError;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

/// RGB SLAM on keyframes whose poses, and perhaps depths, are known roughly.
///
/// The world is the camera of the first keyframe as it came; every pose is refined, that one too.
pub struct KeyframeSession {
    config: Config,
    camera: Camera<f64>,
    frame_rate: f64,
    mapper: Box<dyn JointMapper>,
    /// From the source's world to that of the session.
    world_from_source: Option<Pose<f64>>,
    /// Poses as they came, in the world of the session, by index.
    input_poses: BTreeMap<usize, Pose<f64>>,
    responses: Vec<CameraResponse<f32>>,
    frames: Vec<FrameEstimate>,
    keyframes: Vec<Keyframe>,
    covered: Option<Arc<Image<bool>>>,
    warnings: Vec<Warning>,
    cancellation: CancellationToken,
    random: Random,
    failure: Option<SettingsError>,
}

impl KeyframeSession {
    /// A session for keyframes of `camera`, taken from a video of `frame_rate` frames per second.
    pub fn new(config: Config, camera: Camera<f64>, frame_rate: f64) -> Self {
        Self {
            mapper: super::posed_mapper(&config, &camera, frame_rate),
            world_from_source: None,
            input_poses: BTreeMap::new(),
            responses: vec![super::response(&config)],
            frames: Vec::new(),
            keyframes: Vec::new(),
            covered: None,
            warnings: unused(&config),
            cancellation: CancellationToken::default(),
            random: Random::new(config.seed),
            failure: None,
            config,
            camera,
            frame_rate,
        }
    }

    /// Restricts the image terms to recorded pixels (see the dataset's `covered`).
    pub fn set_covered(&mut self, covered: Arc<Image<bool>>) {
        self.mapper.set_covered(Arc::clone(&covered));
        self.covered = Some(covered);
    }

    /// Once `cancellation` is cancelled, what remains of a keyframe's mapping is left undone.
    pub fn set_cancellation(&mut self, cancellation: CancellationToken) {
        self.cancellation = cancellation;
    }

    /// Takes in one keyframe and refines map, poses and tone for some steps.
    ///
    /// # Errors
    ///
    /// A keyframe that does not fit the camera or has no finite pose, and a map that cannot be
    /// started with its settings.
    pub fn process(&mut self, keyframe: PosedKeyframe) -> Result<&FrameEstimate, SessionError> {
        self.check(&keyframe)?;
        let clock = Instant::now();
        let from_keyframe = keyframe.world_from_camera.inverse();
        let seen_from = |(timestamp, pose)| (timestamp, from_keyframe * pose);
        let adjacent = AdjacentFrames {
            before: keyframe.before.map(seen_from),
            after: keyframe.after.map(seen_from),
        };
        let (estimate, observation) = self.take_in(keyframe, adjacent);
        let position = self.frames.len();
        let maps = estimate.keyframe;
        self.frames.push(estimate);
        self.split_the_first(position);
        if maps {
            self.keyframes.push(Keyframe { frame: position, observation, adjacent });
            let (mapper, mut context) = self.context();
            if let Err(source) = mapper.add(&mut context) {
                self.failure = Some(source);
                return Err(SessionError::Map { source });
            }
        }
        self.frames[position].mapping_seconds = clock.elapsed().as_secs_f64();
        Ok(&self.frames[position])
    }

    /// Refines everything over all keyframes; `on_step(done, of)` says whether to go on.
    pub fn finish(&mut self, on_step: &mut dyn FnMut(usize, usize) -> bool) {
        if self.keyframes.is_empty() || self.failure.is_some() {
            return;
        }
        let (mapper, mut context) = self.context();
        if let Err(error) = mapper.finish(&mut context, on_step) {
            self.warnings.push(format!("the map is empty: {error}").into());
            self.failure = Some(error);
        }
        self.warnings.extend(self.frames.iter().filter(|f| f.keyframe && !f.tracked).map(|f| {
            let what =
                "not found in the map: its pose is that of the front end, refined with the map";
            Warning::of_frame(f.index, what)
        }));
    }

    /// Keyframes processed so far.
    pub fn frames(&self) -> &[FrameEstimate] {
        &self.frames
    }

    /// Messages since the last call: what was unusual and what was done about it.
    pub fn take_warnings(&mut self) -> Vec<Warning> {
        std::mem::take(&mut self.warnings)
    }

    /// Everything estimated so far.
    pub fn reconstruction(&self) -> Reconstruction {
        Reconstruction {
            config: self.config.clone(),
            camera: self.camera,
            frames: self.frames.clone(),
            map: self.mapper.map(),
            responses: self.responses.clone(),
            rolling_shutter_readout: self.config.input.rolling_shutter_readout,
        }
    }

    fn check(&self, keyframe: &PosedKeyframe) -> Result<(), SessionError> {
        let index = keyframe.index;
        let expected = (self.camera.width, self.camera.height);
        let estimated = keyframe.depth.as_ref();
        let pictures = [
            ("colour", 3, Some(&*keyframe.colour)),
            ("depth", 1, estimated.map(|d| &d.depth)),
            ("depth variance", 1, estimated.and_then(|d| d.variance.as_ref())),
        ];
        for (what, channels, image) in pictures {
            let Some(image) = image else { continue };
            let actual = (image.width, image.height);
            if actual != expected {
                return Err(SessionError::Size { index, what, actual, expected });
            }
            let (values, found) = (image.data.len(), image.channels);
            if found != channels || values != channels * image.pixels() {
                let expected = channels;
                return Err(SessionError::Channels {
                    index,
                    what,
                    values,
                    channels: found,
                    expected,
                });
            }
        }
        if !keyframe.timestamp.is_finite() {
            return Err(SessionError::Stamp { index });
        }
        match keyframe.world_from_camera.is_finite() {
            true => Ok(()),
            false => Err(SessionError::Pose { index }),
        }
    }

    /// What is known of a keyframe before it is refined.
    fn take_in(
        &mut self,
        keyframe: PosedKeyframe,
        adjacent: AdjacentFrames,
    ) -> (FrameEstimate, Arc<Observation>) {
        let PosedKeyframe { index, timestamp, colour, world_from_camera, depth, .. } = keyframe;
        let source = *self.world_from_source.get_or_insert_with(|| world_from_camera.inverse());
        self.input_poses.insert(index, source * world_from_camera);
        let values = colour.data.len().max(1) as f32;
        let seen = colour.data.iter().sum::<f32>() / values >= MIN_MEAN_BRIGHTNESS;
        if !seen {
            self.warnings.push(Warning::of_frame(index, "its picture is black: it is not mapped"));
        }
        let empty = || Image::new(self.camera.width, self.camera.height, 1);
        let observation = match depth {
            None => Observation::new(colour, empty()),
            Some(estimated) => match estimated.variance {
                None => Observation::new(colour, estimated.depth),
                Some(variance) => Observation::estimated(colour, estimated.depth, variance),
            },
        };
        let world_from_camera = source * world_from_camera;
        let mut estimate = FrameEstimate {
            tone: self.frames.last().map_or_else(FrameTone::default, |f| f.tone),
            response: self.response(),
            keyframe: seen,
            ..FrameEstimate::posed(index, timestamp, ShutterPoses::still(world_from_camera))
        };
        let known = adjacent.motion_per_interval(timestamp, self.frame_rate);
        let from_last = || {
            AdjacentFrames::from_neighbour(&estimate, self.frames.last()?)
                .motion_per_interval(timestamp, self.frame_rate)
        };
        if let Some(motion) = known.or_else(from_last) {
            estimate.shutter = self.split(&estimate, motion);
        }
        (estimate, Arc::new(observation))
    }

    /// The response of the next keyframe: the sequence's, or one of its own that starts from that
    /// of the last.
    fn response(&mut self) -> usize {
        let last = self.responses.len() - 1;
        if self.frames.is_empty() || self.config.formation.response_scope == ResponseScope::Sequence
        {
            return last;
        }
        self.responses.push(self.responses[last].clone());
        last + 1
    }

    /// The motion of the first exposure, known once there is a second, unless its source knew it.
    fn split_the_first(&mut self, position: usize) {
        let [first, second] = &self.frames[..] else { return };
        if position != 1 || first.shutter.start != first.shutter.end {
            return;
        }
        let motion = AdjacentFrames::from_neighbour(first, second)
            .motion_per_interval(first.timestamp, self.frame_rate);
        if let Some(motion) = motion {
            self.frames[0].shutter = self.split(first, motion);
        }
    }

    /// Start and end pose of an exposure, `motion` being that of a frame interval.
    fn split(&self, at: &FrameEstimate, motion: Tangent<f64>) -> ShutterPoses<f64> {
        if !self.config.formation.blur {
            return ShutterPoses::still(at.middle());
        }
        spread(at.middle(), motion.scaled(f64::from(self.config.keyframed.initial_split)))
    }

    fn context(&mut self) -> (&mut dyn JointMapper, MappingContext<'_>) {
        let context = MappingContext {
            config: &self.config,
            camera: &self.camera,
            frames: &mut self.frames,
            keyframes: &self.keyframes,
            responses: &mut self.responses,
            covered: self.covered.as_deref(),
            random: &mut self.random,
            warnings: &mut self.warnings,
            cancellation: &self.cancellation,
        };
        (self.mapper.as_mut(), context)
    }
}

/// What was asked for and has no part in this session.
fn unused(config: &Config) -> Vec<Warning> {
    let preset = Config::preset(&config.preset).map(|preset| preset.formation.quadrature);
    let drawn = config.map.kind == MapKind::HashGrid;
    if drawn && preset.is_ok_and(|quadrature| quadrature != config.formation.quadrature) {
        let told = "`formation.quadrature` says nothing here: the moments of the exposure are \
                    drawn at random within equal parts of it";
        return vec![told.into()];
    }
    Vec::new()
}

/// Poses half of `motion` before and behind a pose.
fn spread(middle: Pose<f64>, motion: Tangent<f64>) -> ShutterPoses<f64> {
    ShutterPoses {
        start: middle.retract(motion.scaled(-0.5)),
        end: middle.retract(motion.scaled(0.5)),
    }
}

#[cfg(test)]
mod gaussian_tests;
#[cfg(test)]
mod tests;
