//! The online system: frames go in one by one, a reconstruction comes out.

mod map;
mod start;

pub(crate) use start::raster_settings;

use crate::config::{Config, ResponseScope};
use crate::mapping::{Keyframe, MapOptimizer, SceneScale};
use crate::objective::{FrameObjective, Observation, blur_length};
use crate::reconstruction::{Convergence, FrameEstimate, Losses, Reconstruction};
use crate::tracking::{SequenceReadout, TrackingContext, TrackingResult, predict, track};
use i2slam_compute::Random;
use i2slam_dataset::Frame;
use i2slam_formation::{CameraResponse, FrameTone, ShutterPoses, TrajectoryScale};
use i2slam_geometry::{Camera, Image, Tangent};
use i2slam_radiance::gaussian::GaussianMap;
use std::sync::Arc;
use std::time::Instant;

/// Mean picture value under which a frame says nothing about the map's radiance.
const BLACK: f32 = 0.004;

/// What can go wrong while a frame is processed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SessionError {
    /// The frame does not fit the camera of the session.
    #[error(
        "frame {index}: its {what} is {actual:?} pixels, expected {expected:?}: all frames of a \
         sequence must have one size"
    )]
    Size {
        /// Position in the associated stream.
        index: usize,
        /// Colour or depth.
        what: &'static str,
        /// Width and height of the frame.
        actual: (usize, usize),
        /// Width and height of the camera.
        expected: (usize, usize),
    },
}

/// RGB-D SLAM on one sequence.
pub struct Session {
    config: Config,
    camera: Camera<f64>,
    frame_rate: f64,
    map: GaussianMap,
    responses: Vec<CameraResponse<f32>>,
    scale: TrajectoryScale<f64>,
    readout: SequenceReadout,
    scene: SceneScale,
    frames: Vec<FrameEstimate>,
    keyframes: Vec<Keyframe>,
    objective: FrameObjective,
    optimizer: MapOptimizer,
    covered: Option<Arc<Image<bool>>>,
    full: bool,
    random: Random,
    warnings: Vec<String>,
}

impl Session {
    /// A session for frames of `camera` at `frame_rate` frames per second.
    pub fn new(config: Config, camera: Camera<f64>, frame_rate: f64) -> Self {
        let objective = FrameObjective::new(camera.cast(), start::raster_settings(&config));
        Self {
            map: start::empty_map(&config),
            responses: vec![start::response(&config)],
            scale: TrajectoryScale::from_frame_rate(frame_rate),
            readout: SequenceReadout::new(&config.input),
            scene: SceneScale { radius: f32::INFINITY },
            frames: Vec::new(),
            keyframes: Vec::new(),
            optimizer: MapOptimizer::new(),
            covered: None,
            full: false,
            random: Random::new(config.seed),
            warnings: Vec::new(),
            objective,
            config,
            camera,
            frame_rate,
        }
    }

    /// Restricts the image terms to recorded pixels (see the dataset's `covered`).
    pub fn set_covered(&mut self, covered: Arc<Image<bool>>) {
        self.objective.set_covered(Arc::clone(&covered));
        self.covered = Some(covered);
    }

    /// Tracks one frame, then maps with it.
    pub fn process(&mut self, frame: &Frame) -> Result<&FrameEstimate, SessionError> {
        self.check_size(frame)?;
        let observation = Arc::new(Observation::new(frame.colour.clone(), frame.depth.clone()));
        let usable = self.usable(frame.index, &observation);
        let clock = Instant::now();
        let estimate = self.track(frame, &observation, usable);
        self.frames.push(estimate);
        let position = self.frames.len() - 1;
        self.frames[position].tracking_seconds = clock.elapsed().as_secs_f64();
        if self.map.is_empty() && !self.keyframes.is_empty() {
            self.warnings.push(format!(
                "frame {}: the map was empty (all Gaussians pruned) and starts again",
                frame.index
            ));
        }
        let clock = Instant::now();
        self.frames[position].held_out = self.holds_out(position);
        let frame = &self.frames[position];
        if usable && frame.tracked && !frame.held_out {
            self.map_frame(position, observation);
        }
        let estimate = &mut self.frames[position];
        estimate.mapping_seconds = clock.elapsed().as_secs_f64();
        estimate.gaussians = self.map.len();
        Ok(&self.frames[position])
    }

    /// Whether a frame is kept from the map; the one that starts it never is.
    fn holds_out(&self, position: usize) -> bool {
        let every = self.config.mapping.hold_out;
        every > 0 && position > 0 && position.is_multiple_of(every) && !self.map.is_empty()
    }

    /// Refines the map over all keyframes; `on_step(done, of)` says whether to go on.
    pub fn finish(&mut self, on_step: &mut dyn FnMut(usize, usize) -> bool) {
        let steps = self.config.mapping.final_iterations;
        if self.keyframes.is_empty() {
            return;
        }
        let mut order: Vec<usize> = Vec::new();
        for step in 0..steps {
            if order.is_empty() {
                order = (0..self.keyframes.len()).collect();
                self.random.shuffle(&mut order);
            }
            let Some(next) = order.pop() else { break };
            let keyframe = self.keyframes[next].clone();
            self.map_step(&keyframe);
            if !on_step(step + 1, steps) {
                break;
            }
        }
        self.prune();
    }

    /// Frames processed so far.
    pub fn frames(&self) -> &[FrameEstimate] {
        &self.frames
    }

    /// Messages since the last call: what was unusual and what was done about it.
    pub fn take_warnings(&mut self) -> Vec<String> {
        std::mem::take(&mut self.warnings)
    }

    /// Everything estimated so far.
    pub fn reconstruction(&self) -> Reconstruction {
        Reconstruction {
            config: self.config.clone(),
            camera: self.camera,
            frames: self.frames.clone(),
            map: self.map.clone(),
            responses: self.responses.clone(),
            rolling_shutter_readout: self.readout.seconds,
        }
    }

    fn check_size(&self, frame: &Frame) -> Result<(), SessionError> {
        let expected = (self.camera.width, self.camera.height);
        for (what, image) in [("colour", &frame.colour), ("depth", &frame.depth)] {
            let actual = (image.width, image.height);
            if actual != expected {
                return Err(SessionError::Size { index: frame.index, what, actual, expected });
            }
        }
        Ok(())
    }

    /// Whether a frame can be tracked and mapped; a warning says why not.
    fn usable(&mut self, index: usize, observation: &Observation) -> bool {
        let mean = observation.colour.data.iter().sum::<f32>()
            / observation.colour.data.len().max(1) as f32;
        let reason = if observation.valid_depths() == 0 {
            "it has no depth"
        } else if mean < BLACK {
            "its picture is black"
        } else {
            return true;
        };
        self.warnings.push(format!("frame {index}: {reason}: its pose is predicted, not measured"));
        false
    }

    fn track(&mut self, frame: &Frame, observation: &Observation, usable: bool) -> FrameEstimate {
        let per_frame = self.config.formation.response_scope == ResponseScope::Frame;
        let last_response = self.responses.len() - 1;
        let context = context(
            &self.config,
            &self.camera,
            self.frame_rate,
            self.readout,
            &self.frames,
            &self.keyframes,
            frame,
        );
        let mut estimate = FrameEstimate {
            index: frame.index,
            timestamp: frame.timestamp,
            shutter: ShutterPoses::still(predict(&context)),
            readout: 0.0,
            depth_lead: Tangent::zero(),
            tone: self.frames.last().map_or_else(FrameTone::default, |f| f.tone),
            response: last_response,
            keyframe: false,
            held_out: false,
            tracked: self.map.is_empty() && usable,
            losses: Losses::default(),
            convergence: Convergence::default(),
            blur_length: 0.0,
            tracking_seconds: 0.0,
            mapping_seconds: 0.0,
            gaussians: self.map.len(),
        };
        if self.map.is_empty() || !usable {
            return estimate;
        }
        let result = track(
            &context,
            &mut self.objective,
            &self.map,
            observation,
            self.config.formation.tone.then(|| &self.responses[last_response]),
            self.scale,
        );
        self.accept(&mut estimate, result, per_frame);
        estimate.blur_length = blur_length(&self.camera, &estimate.shutter, &observation.depth);
        if !estimate.tracked {
            self.warnings.push(format!(
                "frame {}: tracking lost: its pose is predicted and it is not mapped",
                frame.index
            ));
        }
        estimate
    }

    fn accept(&mut self, estimate: &mut FrameEstimate, result: TrackingResult, per_frame: bool) {
        estimate.shutter = result.shutter;
        estimate.readout = result.readout;
        estimate.depth_lead = result.depth_lead;
        estimate.tone = result.tone;
        estimate.losses = result.losses;
        estimate.convergence = result.convergence;
        estimate.tracked = result.tracked;
        self.scale = result.scale;
        if let Some(measured) = result.measured_readout {
            self.readout.add(measured, 1.0 / self.frame_rate);
        }
        if let (true, Some(response)) = (per_frame, result.response) {
            self.responses.push(response);
            estimate.response = self.responses.len() - 1;
        }
    }
}

/// What tracking may know of a session; the rest of it stays free to be changed.
fn context<'a>(
    config: &'a Config,
    camera: &'a Camera<f64>,
    frame_rate: f64,
    readout: SequenceReadout,
    frames: &'a [FrameEstimate],
    keyframes: &'a [Keyframe],
    frame: &Frame,
) -> TrackingContext<'a> {
    let input = &config.input;
    let depth_timestamp = match input.depth_stamps {
        true => frame.depth_timestamp + input.depth_delay,
        false => frame.timestamp,
    };
    TrackingContext {
        tracking: &config.tracking,
        formation: &config.formation,
        camera,
        frame_rate,
        readout,
        timestamps: (frame.timestamp, depth_timestamp),
        frames,
        previous: frames.last(),
        before_previous: frames.len().checked_sub(2).map(|i| &frames[i]),
        keyframe: keyframes.last().map(|k| (&*k.observation, frames[k.frame].depth_pose())),
    }
}
