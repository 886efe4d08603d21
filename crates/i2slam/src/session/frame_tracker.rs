//! Front end of a session: tracking of one frame against the map.

use crate::config::Config;
use crate::mapping::{Keyframe, Tracker};
use crate::objective::{Observation, blur_length};
use crate::reconstruction::FrameEstimate;
use crate::tracking::{SequenceReadout, TrackingContext, TrackingResult, predict_pose};
use i2slam_compute::CancellationToken;
use i2slam_dataset::Frame;
use i2slam_formation::{CameraResponse, FrameTone, ShutterPoses, TrajectoryScale};
use i2slam_geometry::Camera;
use std::time::Instant;

/// The parts of a session that tracking reads; mapping may change the rest meanwhile.
pub(super) struct FrameTracker<'a> {
    pub(super) config: &'a Config,
    pub(super) camera: &'a Camera<f64>,
    pub(super) frame_rate: f64,
    pub(super) scale: TrajectoryScale<f64>,
    pub(super) readout: SequenceReadout,
    /// All frames before.
    pub(super) frames: &'a [FrameEstimate],
    /// The last keyframe.
    pub(super) keyframe: Option<&'a Keyframe>,
    /// Index and value of the last response.
    pub(super) response: (usize, &'a CameraResponse<f32>),
    pub(super) cancellation: &'a CancellationToken,
}

impl FrameTracker<'_> {
    /// Estimate and tracking result of a frame; without a `tracker` its pose is predicted.
    pub(super) fn track(
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
            estimate.shutter = result.shutter;
            estimate.readout = result.readout;
            estimate.depth_lead = result.depth_offset;
            estimate.tone = result.tone;
            estimate.losses = result.losses;
            estimate.convergence = result.convergence;
            estimate.tracked = result.tracked;
            estimate.blur_length = blur_length(self.camera, &result.shutter, &observation.depth);
        }
        estimate.tracking_seconds = clock.elapsed().as_secs_f64();
        (estimate, result)
    }

    fn context(&self, frame: &Frame) -> TrackingContext<'_> {
        let (input, frames) = (&self.config.input, self.frames);
        let depth_timestamp = match input.depth_stamps {
            true => frame.depth_timestamp + input.depth_delay,
            false => frame.timestamp,
        };
        TrackingContext {
            tracking: &self.config.tracking,
            formation: &self.config.formation,
            parameters: &self.config.parameters,
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
