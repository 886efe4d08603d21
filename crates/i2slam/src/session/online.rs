//! The online system: frames go in one by one, a reconstruction comes out.

use super::backend::Backend;
use super::frame_tracker::FrameTracker;
use super::{MIN_MEAN_BRIGHTNESS, SessionError};
use crate::config::{Config, ResponseScope};
use crate::mapping::Tracker;
use crate::objective::Observation;
use crate::reconstruction::{FrameEstimate, Reconstruction};
use crate::tracking::{SequenceReadout, TrackingResult};
use crate::warning::Warning;
use i2slam_compute::CancellationToken;
use i2slam_dataset::Frame;
use i2slam_formation::TrajectoryScale;
use i2slam_geometry::{Camera, Image};
use std::sync::Arc;

/// RGB-D SLAM on one sequence.
pub struct Session {
    config: Config,
    camera: Camera<f64>,
    frame_rate: f64,
    scale: TrajectoryScale<f64>,
    readout: SequenceReadout,
    backend: Backend,
    /// A copy of the map, for tracking beside mapping.
    snapshot: Option<Box<dyn Tracker>>,
}

impl Session {
    /// A session for frames of `camera` at `frame_rate` frames per second.
    pub fn new(config: Config, camera: Camera<f64>, frame_rate: f64) -> Self {
        Self {
            scale: TrajectoryScale::from_frame_rate(frame_rate),
            readout: SequenceReadout::new(&config.input),
            backend: Backend::new(&config, &camera),
            snapshot: None,
            config,
            camera,
            frame_rate,
        }
    }

    /// Restricts the image terms to recorded pixels (see the dataset's `covered`).
    pub fn set_covered(&mut self, covered: Arc<Image<bool>>) {
        self.backend.mapper.set_covered(Arc::clone(&covered));
        self.backend.covered = Some(covered);
    }

    /// Once `cancellation` is cancelled, what remains of a frame's mapping, and of its tracking by first-order
    /// steps, is left undone.
    pub fn set_cancellation(&mut self, cancellation: CancellationToken) {
        self.backend.cancellation = cancellation;
    }

    /// Tracks one frame, then maps with it; with `mapping.beside_tracking`, the frame before is
    /// mapped while this one is tracked.
    pub fn process(&mut self, frame: &Frame) -> Result<&FrameEstimate, SessionError> {
        self.check_size(frame)?;
        let observation =
            Arc::new(Observation::new(Arc::clone(&frame.colour), Arc::clone(&frame.depth)));
        let usable = self.usable(frame.index, &observation);
        let mut estimate = self.track(frame, &observation, usable);
        let position = self.backend.frames.len();
        estimate.held_out = self.holds_out(position);
        let maps = usable && estimate.tracked && !estimate.held_out;
        self.backend.frames.push(estimate);
        self.tell_of_an_emptied_map(frame.index);
        if maps {
            self.backend.hand_over(&self.config, &self.camera, observation);
        }
        if !self.config.mapping.beside_tracking {
            self.backend.work(&self.config, &self.camera);
        }
        match self.backend.mapper.failure() {
            Some(source) => Err(SessionError::Map { source }),
            None => Ok(&self.backend.frames[position]),
        }
    }

    /// Gaussians can all be pruned; a field, once begun, stays.
    fn tell_of_an_emptied_map(&mut self, index: usize) {
        let Backend { mapper, keyframes, warnings, .. } = &mut self.backend;
        if mapper.is_empty() && mapper.failure().is_none() && !keyframes.is_empty() {
            let what = "the map was empty (all Gaussians pruned) and starts again";
            warnings.push(Warning::of_frame(index, what));
        }
    }

    /// Whether a frame is kept from the map; the one that starts it never is.
    fn holds_out(&self, position: usize) -> bool {
        self.config.mapping.holds_out(position) && !self.backend.mapper.is_empty()
    }

    /// Refines the map over all keyframes; `on_step(done, of)` says whether to go on.
    pub fn finish(&mut self, on_step: &mut dyn FnMut(usize, usize) -> bool) {
        self.backend.finish(&self.config, &self.camera, on_step);
    }

    /// Frames processed so far.
    pub fn frames(&self) -> &[FrameEstimate] {
        &self.backend.frames
    }

    /// Messages since the last call: what was unusual and what was done about it.
    pub fn take_warnings(&mut self) -> Vec<Warning> {
        std::mem::take(&mut self.backend.warnings)
    }

    /// Everything estimated so far.
    pub fn reconstruction(&self) -> Reconstruction {
        Reconstruction {
            config: self.config.clone(),
            camera: self.camera,
            frames: self.backend.frames.clone(),
            map: self.backend.mapper.map(),
            responses: self.backend.responses.clone(),
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
        } else if mean < MIN_MEAN_BRIGHTNESS {
            "its picture is black"
        } else {
            return true;
        };
        let what = format!("{reason}: its pose is predicted, not measured");
        self.backend.warnings.push(Warning::of_frame(index, what));
        false
    }

    fn track(&mut self, frame: &Frame, observation: &Observation, usable: bool) -> FrameEstimate {
        let (mut estimate, result) = match self.config.mapping.beside_tracking {
            true => self.look_beside_mapping(frame, observation, usable),
            false => self.look(frame, observation, usable),
        };
        if let Some(result) = result {
            self.scale = result.scale;
            if let Some(measured) = result.measured_readout {
                self.readout.add(measured, 1.0 / self.frame_rate);
            }
            let per_frame = self.config.formation.response_scope == ResponseScope::Frame;
            if let (true, Some(response)) = (per_frame, result.response) {
                self.backend.responses.push(response);
                estimate.response = self.backend.responses.len() - 1;
            }
            if !estimate.tracked {
                let what = "tracking lost: its pose is predicted and it is not mapped";
                self.backend.warnings.push(Warning::of_frame(frame.index, what));
            }
        } else {
            estimate.tracked = usable && self.backend.mapper.is_empty();
        }
        estimate
    }

    /// Looks for a frame in the map.
    fn look(
        &mut self,
        frame: &Frame,
        observation: &Observation,
        usable: bool,
    ) -> (FrameEstimate, Option<TrackingResult>) {
        let Backend { mapper, frames, keyframes, responses, cancellation, .. } = &mut self.backend;
        let last = responses.len() - 1;
        let look = FrameTracker {
            config: &self.config,
            camera: &self.camera,
            frame_rate: self.frame_rate,
            scale: self.scale,
            readout: self.readout,
            frames,
            keyframes,
            response: (last, &responses[last]),
            cancellation,
        };
        let tracker = if usable { mapper.tracker() } else { None };
        look.at(tracker, frame, observation)
    }

    /// Looks for a frame in the map as it was before the last frame came, and takes that one in at
    /// the same time.
    fn look_beside_mapping(
        &mut self,
        frame: &Frame,
        observation: &Observation,
        usable: bool,
    ) -> (FrameEstimate, Option<TrackingResult>) {
        let (config, camera, backend) = (&self.config, &self.camera, &mut self.backend);
        if self.snapshot.is_none() {
            backend.work(config, camera);
            self.snapshot = backend.snapshot(camera, None);
        }
        let last = backend.responses.len() - 1;
        let look = FrameTracker {
            config,
            camera,
            frame_rate: self.frame_rate,
            scale: self.scale,
            readout: self.readout,
            frames: &backend.frames.clone(),
            keyframes: &backend.keyframes.clone(),
            response: (last, &backend.responses[last].clone()),
            cancellation: &backend.cancellation.clone(),
        };
        let mut snapshot = self.snapshot.take();
        let tracker = snapshot.as_deref_mut().filter(|_| usable);
        let (seen, ()) =
            rayon::join(|| look.at(tracker, frame, observation), || backend.work(config, camera));
        self.snapshot = backend.snapshot(camera, snapshot);
        seen
    }
}
