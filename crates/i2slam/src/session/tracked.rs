//! Frames with depth, tracked against the map and then mapped; their poses stay.

use super::Session;
use super::error::{SessionError, check_image};
use super::state::SessionState;
use crate::config::ResponseScope;
use crate::mapping::{AdjacentFrames, Keyframe, LensVignetting, is_keyframe};
use crate::objective::Observation;
use crate::reconstruction::FrameEstimate;
use crate::tracking::{TrackingContext, TrackingResult, predict_pose};
use i2slam_dataset::Frame;
use i2slam_formation::{FrameTone, ShutterPoses};
use i2slam_geometry::Image;
use i2slam_odometry::blank_reason;
use std::sync::Arc;
use std::time::Instant;

impl Session {
    /// Tracks one frame against the map, then maps with it.
    ///
    /// # Errors
    ///
    /// A frame that does not fit the camera, and a map that cannot be started with its settings.
    pub fn track(&mut self, frame: &Frame) -> Result<&FrameEstimate, SessionError> {
        check_image(frame.index, ("colour", 3), &frame.colour, &self.camera)?;
        let depth = match &frame.depth {
            Some(depth) => Arc::clone(&depth.image),
            None => Arc::new(Image::new(self.camera.width, self.camera.height, 1)),
        };
        check_image(frame.index, ("depth", 1), &depth, &self.camera)?;
        let observation = Observation::new(Arc::clone(&frame.colour), depth);
        let usable = self.is_usable(frame, &observation);
        let (mut estimate, starts_map) = self.tracked_estimate(frame, &observation, usable);
        let position = self.state.frames.len();
        // The frame that starts the map is never held out.
        estimate.held_out = self.holds_out(position, frame.index) && !self.mapper.is_empty();
        let maps = usable && (estimate.tracked || starts_map) && !estimate.held_out;
        self.state.frames.push(estimate);
        self.warn_if_map_emptied(frame.index);
        if maps {
            self.map_tracked(observation)?;
        }
        Ok(&self.state.frames[position])
    }

    /// Maps the last frame, and decides whether it becomes a keyframe.
    fn map_tracked(&mut self, observation: Observation) -> Result<(), SessionError> {
        let clock = Instant::now();
        let starts_map = self.mapper.is_empty();
        let SessionState { frames, keyframes, scratch, .. } = &mut self.state;
        let position = frames.len() - 1;
        let last = keyframes.last().map(|k| k.frame);
        frames[position].keyframe = starts_map
            || last.is_none_or(|last| {
                is_keyframe(&self.config.mapping, &self.camera, frames, last, &observation)
            });
        let observation = scratch.insert(observation);
        let current = Keyframe::new(position, observation, AdjacentFrames::default());
        if frames[position].keyframe {
            keyframes.push(current.clone());
        }
        if starts_map || (position + 1).is_multiple_of(self.config.mapping.interval) {
            self.map(&current)?;
        }
        let estimate = &mut self.state.frames[position];
        if starts_map && self.mapper.is_empty() {
            // Nothing was measured with a map that did not outlive its first frame.
            estimate.tracked = false;
        }
        estimate.mapping_seconds = clock.elapsed().as_secs_f64();
        estimate.gaussians = self.mapper.gaussians();
        Ok(())
    }

    /// Warns of a map whose Gaussians were all pruned. A field, once started, stays.
    fn warn_if_map_emptied(&mut self, index: usize) {
        let had_keyframes = !self.state.keyframes.is_empty();
        if self.mapper.is_empty() && self.failure.is_none() && had_keyframes {
            self.state.warn(index, "the map was empty (all Gaussians pruned) and starts again");
        }
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
        self.state.warn(frame.index, text);
        false
    }

    /// Warns of the first frame without a depth picture.
    fn warn_of_missing_depth(&mut self, index: usize) {
        if !std::mem::replace(&mut self.is_missing_depth_told, true) {
            let text = "it has no depth picture of its own: the poses of such frames are \
                        predicted, not measured";
            self.state.warn(index, text);
        }
    }

    /// Estimate of a frame, and whether the map starts with it. Such a frame counts as tracked only
    /// where it starts the path, too: later its pose is predicted.
    fn tracked_estimate(
        &mut self,
        frame: &Frame,
        observation: &Observation,
        usable: bool,
    ) -> (FrameEstimate, bool) {
        let (mut estimate, result) = self.track_on_map(frame, observation, usable);
        let Some(result) = result else {
            let starts_map = usable && self.mapper.is_empty();
            estimate.tracked = starts_map && !self.frames().iter().any(|f| f.tracked);
            return (estimate, starts_map);
        };
        self.tracker.scale = result.scale;
        if let Some(measured) = result.measured_readout {
            self.tracker.readout.add(measured, 1.0 / self.frame_rate);
        }
        let per_frame = self.config.formation.response_scope == ResponseScope::Frame;
        if let (true, Some(response)) = (per_frame, result.response) {
            self.state.responses.push(response);
            estimate.response = self.state.responses.len() - 1;
        }
        if !estimate.tracked {
            let text = "tracking lost: its pose is predicted and it is not mapped";
            self.state.warn(frame.index, text);
        }
        (estimate, false)
    }

    /// Estimate and tracking result of a frame; without a map, or if not `usable`, its pose is
    /// predicted.
    fn track_on_map(
        &mut self,
        frame: &Frame,
        observation: &Observation,
        usable: bool,
    ) -> (FrameEstimate, Option<TrackingResult>) {
        let clock = Instant::now();
        let Self { config, camera, mapper, tracker, state, .. } = self;
        let SessionState { frames, keyframes, responses, vignetting, cancellation, .. } = &*state;
        let depth_timestamp = match &frame.depth {
            Some(depth) if config.input.depth_stamps => depth.timestamp + config.input.depth_delay,
            _ => frame.timestamp,
        };
        let last_keyframe =
            keyframes.last().map(|k| (k.observation.get(), frames[k.frame].depth_pose()));
        let context = TrackingContext {
            config,
            camera,
            frame_rate: tracker.frame_rate,
            readout: tracker.readout,
            timestamps: (frame.timestamp, depth_timestamp),
            frames,
            previous: frames.last(),
            before_previous: frames.len().checked_sub(2).map(|i| &frames[i]),
            exposure_motion: None,
            expected: None,
            keyframe: last_keyframe.as_ref().map(|(observation, pose)| (&**observation, *pose)),
            white_balance: state.white_balance(config),
            vignetting: vignetting.as_ref().map(LensVignetting::at_pixels),
            cancellation,
        };
        let last = responses.len() - 1;
        let predicted = ShutterPoses::still(predict_pose(&context));
        let mut estimate = FrameEstimate {
            tone: frames.last().map_or_else(FrameTone::default, |f| f.tone),
            response: last,
            tracked: false,
            gaussians: frames.last().map_or(0, |f| f.gaussians),
            ..FrameEstimate::at_pose(frame.index, frame.timestamp, predicted)
        };
        let response = config.formation.tone.then_some(&responses[last]);
        let result = match usable {
            true => mapper.track(&context, observation, response, tracker.scale),
            false => None,
        };
        if let Some(result) = &result {
            result.write_to(&mut estimate, camera, &observation.depth);
            estimate.depth_offset = result.depth_offset;
            estimate.tracked = result.tracked;
        }
        estimate.tracking_seconds = clock.elapsed().as_secs_f64();
        (estimate, result)
    }
}
