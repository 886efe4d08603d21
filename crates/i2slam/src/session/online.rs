//! RGB-D session: every frame is tracked, then mapped.

use super::backend::Backend;
use super::error::{SessionError, check_image};
use crate::config::{Config, MappingConfig, ResponseScope};
use crate::mapping::{Keyframe, Tracker};
use crate::objective::Observation;
use crate::reconstruction::{FrameEstimate, Reconstruction};
use crate::tracking::{SequenceReadout, TrackingContext, TrackingResult, predict_pose};
use crate::warning::Warning;
use i2slam_compute::CancellationToken;
use i2slam_dataset::Frame;
use i2slam_formation::{CameraResponse, FrameTone, ShutterPoses, TrajectoryScale};
use i2slam_geometry::{Camera, Image};
use i2slam_odometry::blank_reason;
use std::sync::Arc;
use std::time::Instant;

/// RGB-D SLAM on one sequence.
pub struct Session {
    config: Config,
    camera: Camera<f64>,
    frame_rate: f64,
    scale: TrajectoryScale<f64>,
    readout: SequenceReadout,
    backend: Backend,
    /// Copies of map and estimates, which mapping may change while a frame is tracked.
    snapshot: Option<Box<dyn Tracker>>,
    frames_before: Vec<FrameEstimate>,
    /// Whether a frame without a depth picture was warned of.
    is_missing_depth_told: bool,
}

impl Session {
    /// A session for frames of `camera` at `frame_rate` frames per second.
    pub fn new(config: Config, camera: Camera<f64>, frame_rate: f64) -> Self {
        Self {
            scale: TrajectoryScale::from_frame_rate(frame_rate),
            readout: SequenceReadout::new(&config.input),
            backend: Backend::new(&config, &camera),
            snapshot: None,
            frames_before: Vec::new(),
            is_missing_depth_told: false,
            config,
            camera,
            frame_rate,
        }
    }

    /// Restricts the image terms to recorded pixels, a mask such as `Sequence::valid_mask`.
    pub fn set_valid_mask(&mut self, valid_mask: Arc<Image<bool>>) {
        self.backend.mapper.set_valid_mask(Arc::clone(&valid_mask));
        self.backend.state.valid_mask = Some(valid_mask);
    }

    /// Sets the token whose cancellation ends mapping and first-order tracking of a frame early.
    pub fn set_cancellation(&mut self, cancellation: CancellationToken) {
        self.backend.state.cancellation = cancellation;
    }

    /// Tracks one frame, then maps with it. With `mapping.beside_tracking`, the frame before is
    /// mapped while this one is tracked.
    ///
    /// # Errors
    ///
    /// A frame that does not fit the camera, and a map that cannot be started with its settings.
    pub fn process(&mut self, frame: &Frame) -> Result<&FrameEstimate, SessionError> {
        check_image(frame.index, ("colour", 3), &frame.colour, &self.camera)?;
        let depth = match &frame.depth {
            Some(depth) => Arc::clone(&depth.image),
            None => Arc::new(Image::new(self.camera.width, self.camera.height, 1)),
        };
        check_image(frame.index, ("depth", 1), &depth, &self.camera)?;
        let observation = Arc::new(Observation::new(Arc::clone(&frame.colour), depth));
        let usable = self.is_usable(frame, &observation);
        let (mut estimate, starts_map) = self.track(frame, &observation, usable);
        let position = self.backend.state.frames.len();
        estimate.held_out = self.holds_out(position);
        let maps = usable && (estimate.tracked || starts_map) && !estimate.held_out;
        self.backend.state.frames.push(estimate);
        self.warn_if_map_emptied(frame.index);
        if maps {
            self.backend.enqueue(&self.config, &self.camera, observation);
        }
        if !self.config.mapping.beside_tracking {
            self.backend.map_pending(&self.config, &self.camera);
        }
        match self.backend.mapper.failure() {
            Some(source) => Err(SessionError::Map { source }),
            None => Ok(&self.backend.state.frames[position]),
        }
    }

    /// Final optimisation over all keyframes; stops when `on_step(done, total)` returns false.
    pub fn finish(&mut self, on_step: &mut dyn FnMut(usize, usize) -> bool) {
        self.backend.finish(&self.config, &self.camera, on_step);
    }

    /// Frames processed so far.
    pub fn frames(&self) -> &[FrameEstimate] {
        &self.backend.state.frames
    }

    /// Settings of mapping.
    pub(crate) fn mapping(&self) -> &MappingConfig {
        &self.config.mapping
    }

    /// Whether the readout of a rolling shutter was to be found, and no frame has measured it.
    pub(crate) fn is_readout_missing(&self) -> bool {
        self.readout.optimised && !self.readout.is_measured()
    }

    /// Takes the warnings since the last call.
    pub fn take_warnings(&mut self) -> Vec<Warning> {
        std::mem::take(&mut self.backend.state.warnings)
    }

    /// A copy of everything estimated so far.
    pub fn reconstruction(&self) -> Reconstruction {
        let Backend { mapper, state, .. } = &self.backend;
        state.reconstruction(&self.config, &self.camera, mapper.map(), self.readout.seconds)
    }

    /// Warns of a map whose Gaussians were all pruned. A field, once started, stays.
    fn warn_if_map_emptied(&mut self, index: usize) {
        let Backend { mapper, state, .. } = &mut self.backend;
        if mapper.is_empty() && mapper.failure().is_none() && !state.keyframes.is_empty() {
            state.warn(index, "the map was empty (all Gaussians pruned) and starts again");
        }
    }

    /// Whether a frame is held out from the map; the one that starts it never is.
    fn holds_out(&self, position: usize) -> bool {
        self.config.mapping.holds_out(position) && !self.backend.mapper.is_empty()
    }

    /// Whether a frame can be tracked and mapped; warns if not.
    fn is_usable(&mut self, frame: &Frame, observation: &Observation) -> bool {
        let reason = if frame.depth.is_none() {
            self.warn_of_missing_depth(frame.index);
            return false;
        } else if observation.valid_depths() == 0 {
            "it has no depth"
        } else if let Some(reason) = blank_reason(&observation.colour) {
            reason
        } else {
            return true;
        };
        let text = format!("{reason}: its pose is predicted, not measured");
        self.backend.state.warn(frame.index, text);
        false
    }

    /// Warns of the first frame without a depth picture.
    fn warn_of_missing_depth(&mut self, index: usize) {
        if !std::mem::replace(&mut self.is_missing_depth_told, true) {
            let text = "it has no depth picture of its own: the poses of such frames are \
                        predicted, not measured";
            self.backend.state.warn(index, text);
        }
    }

    /// Estimate of a frame, and whether the map starts with it. Such a frame counts as tracked only
    /// where it starts the path, too: later its pose is predicted.
    fn track(
        &mut self,
        frame: &Frame,
        observation: &Observation,
        usable: bool,
    ) -> (FrameEstimate, bool) {
        let (mut estimate, result) = self.track_on_map(frame, observation, usable);
        let Some(result) = result else {
            let starts_map = usable && self.backend.mapper.is_empty();
            estimate.tracked = starts_map && !self.frames().iter().any(|f| f.tracked);
            return (estimate, starts_map);
        };
        self.scale = result.scale;
        if let Some(measured) = result.measured_readout {
            self.readout.add(measured, 1.0 / self.frame_rate);
        }
        let state = &mut self.backend.state;
        let per_frame = self.config.formation.response_scope == ResponseScope::Frame;
        if let (true, Some(response)) = (per_frame, result.response) {
            state.responses.push(response);
            estimate.response = state.responses.len() - 1;
        }
        if !estimate.tracked {
            state.warn(frame.index, "tracking lost: its pose is predicted and it is not mapped");
        }
        (estimate, false)
    }

    /// Tracks a frame against the map, or with `mapping.beside_tracking` against a snapshot of it,
    /// and maps the frame before meanwhile.
    fn track_on_map(
        &mut self,
        frame: &Frame,
        observation: &Observation,
        usable: bool,
    ) -> (FrameEstimate, Option<TrackingResult>) {
        let (config, camera, backend) = (&self.config, &self.camera, &mut self.backend);
        let beside = config.mapping.beside_tracking;
        if beside && self.snapshot.is_none() {
            backend.map_pending(config, camera);
            self.snapshot = backend.snapshot(None);
        }
        self.frames_before.clone_from(&backend.state.frames);
        let last = backend.state.responses.len() - 1;
        let keyframe = backend.state.keyframes.last().cloned();
        let frame_tracker = FrameTracker {
            config,
            camera,
            frame_rate: self.frame_rate,
            scale: self.scale,
            readout: self.readout,
            frames: &self.frames_before,
            keyframe: keyframe.as_ref(),
            response: (last, &backend.state.responses[last].clone()),
            cancellation: &backend.state.cancellation.clone(),
        };
        if !beside {
            let tracker = if usable { backend.mapper.tracker() } else { None };
            return frame_tracker.track(tracker, frame, observation);
        }
        let mut snapshot = self.snapshot.take();
        let tracker = snapshot.as_deref_mut().filter(|_| usable);
        let (tracked, ()) = rayon::join(
            || frame_tracker.track(tracker, frame, observation),
            || backend.map_pending(config, camera),
        );
        self.snapshot = backend.snapshot(snapshot);
        tracked
    }
}

/// The parts of a session that tracking reads; mapping may change the rest meanwhile.
struct FrameTracker<'a> {
    config: &'a Config,
    camera: &'a Camera<f64>,
    frame_rate: f64,
    scale: TrajectoryScale<f64>,
    readout: SequenceReadout,
    /// All frames before.
    frames: &'a [FrameEstimate],
    keyframe: Option<&'a Keyframe>,
    /// Index and value of the last response.
    response: (usize, &'a CameraResponse<f32>),
    cancellation: &'a CancellationToken,
}

impl FrameTracker<'_> {
    /// Estimate and tracking result of a frame; without a `tracker` its pose is predicted.
    fn track(
        &self,
        tracker: Option<&mut dyn Tracker>,
        frame: &Frame,
        observation: &Observation,
    ) -> (FrameEstimate, Option<TrackingResult>) {
        let clock = Instant::now();
        let context = self.context(frame);
        let predicted = ShutterPoses::still(predict_pose(&context));
        let mut estimate = FrameEstimate {
            tone: self.frames.last().map_or_else(FrameTone::default, |f| f.tone),
            response: self.response.0,
            tracked: false,
            gaussians: self.frames.last().map_or(0, |f| f.gaussians),
            ..FrameEstimate::at_pose(frame.index, frame.timestamp, predicted)
        };
        let result = tracker.map(|tracker| {
            let response = self.config.formation.tone.then_some(self.response.1);
            tracker.track(&context, observation, response, self.scale)
        });
        if let Some(result) = &result {
            result.write_to(&mut estimate, self.camera, &observation.depth);
            estimate.depth_offset = result.depth_offset;
            estimate.tracked = result.tracked;
        }
        estimate.tracking_seconds = clock.elapsed().as_secs_f64();
        (estimate, result)
    }

    fn context(&self, frame: &Frame) -> TrackingContext<'_> {
        let (input, frames) = (&self.config.input, self.frames);
        let depth_timestamp = match &frame.depth {
            Some(depth) if input.depth_stamps => depth.timestamp + input.depth_delay,
            _ => frame.timestamp,
        };
        TrackingContext {
            config: self.config,
            camera: self.camera,
            frame_rate: self.frame_rate,
            readout: self.readout,
            timestamps: (frame.timestamp, depth_timestamp),
            frames,
            previous: frames.last(),
            before_previous: frames.len().checked_sub(2).map(|i| &frames[i]),
            expected: None,
            keyframe: self.keyframe.map(|k| (&*k.observation, frames[k.frame].depth_pose())),
            cancellation: self.cancellation,
        }
    }
}
