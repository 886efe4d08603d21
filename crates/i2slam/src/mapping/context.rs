//! State and time that a session grants mapping.

use super::keyframe::Keyframe;
use crate::config::Config;
use crate::objective::{Exposure, Observation};
use crate::reconstruction::{FrameEstimate, Map};
use crate::tracking::sampling;
use crate::warning::Warning;
use i2slam_compute::{CancellationToken, Random};
use i2slam_formation::{CameraResponse, Formation, ResponseCurve, WhiteBalanceModel};
use i2slam_geometry::{Camera, Image};
use std::collections::BTreeMap;
use std::time::Instant;

/// Called after every step of the final refinement; returns whether to continue.
pub(crate) type OnStep<'a> = &'a mut dyn FnMut(RefinementStep<'_>) -> bool;

/// A step of the final refinement that was taken.
pub(crate) struct RefinementStep<'a> {
    pub(crate) done: usize,
    /// Steps in total.
    pub(crate) of: usize,
    pub(crate) frames: &'a [FrameEstimate],
    pub(crate) responses: &'a [CameraResponse<f32>],
    /// Copies the map.
    pub(crate) map: &'a dyn Fn() -> Map,
}

/// The state of a session that mapping reads and optimises.
pub(crate) struct MappingContext<'a> {
    pub(crate) config: &'a Config,
    pub(crate) camera: &'a Camera<f64>,
    pub(crate) frames: &'a mut [FrameEstimate],
    /// Keyframes so far, the current frame included if it is one.
    pub(crate) keyframes: &'a [Keyframe],
    pub(crate) responses: &'a mut [CameraResponse<f32>],
    /// Whether the responses were found from pictures, and are no longer stepped: steps bend them as a
    /// whole, which pictures hardly tell from a change of radiance and exposures.
    pub(crate) has_found_response: bool,
    /// Powers of the response's channels over one that all have in common.
    pub(crate) channel_powers: [f64; 3],
    /// True if white balance was found from pictures, and is no longer stepped: a step of Adam is as long
    /// at the optimum as far from it.
    pub(crate) has_found_white_balance: bool,
    /// White balance of frames: that of the configuration, until it proves constant.
    pub(crate) white_balance: WhiteBalanceModel,
    /// Vignetting of every pixel, once it is found.
    pub(crate) vignetting: Option<&'a [f32]>,
    /// Mask of the pixels that the camera recorded; `None`: all.
    pub(crate) valid_mask: Option<&'a Image<bool>>,
    pub(crate) random: &'a mut Random,
    pub(crate) warnings: &'a mut Vec<Warning>,
    pub(crate) cancellation: &'a CancellationToken,
}

impl MappingContext<'_> {
    /// The first mapped frame: its pose and tone stay fixed.
    pub(crate) fn gauge_frame(&self, current: &Keyframe) -> usize {
        self.keyframes.first().map_or(current.frame, |k| k.frame)
    }

    /// The last step, of so many in total, with what it has left.
    pub(super) fn taken<'b>(
        &'b self,
        (done, of): (usize, usize),
        map: &'b dyn Fn() -> Map,
    ) -> RefinementStep<'b> {
        RefinementStep { done, of, frames: self.frames, responses: self.responses, map }
    }

    pub(super) fn is_keyframe(&self, frame: usize) -> bool {
        self.keyframes.iter().any(|keyframe| keyframe.frame == frame)
    }

    /// True for a tracked frame that is neither a keyframe nor held out.
    pub(super) fn is_between_keyframes(&self, frame: usize) -> bool {
        let estimate = &self.frames[frame];
        estimate.tracked && !estimate.held_out && !self.is_keyframe(frame)
    }

    /// Motion of a frame while its shutter is open, with the sampling that its picture asks for.
    pub(super) fn exposure(&self, frame: usize, observation: &Observation) -> Exposure {
        let estimate = &self.frames[frame];
        let exposed = (estimate.shutter, estimate.readout);
        Exposure {
            shutter: estimate.shutter,
            sampling: sampling(&self.config.formation, self.camera, exposed, observation),
            readout: estimate.readout,
            depth_pose: estimate.depth_is_apart().then(|| estimate.depth_pose()),
        }
    }

    /// From radiance to the picture of a frame, by its response curve.
    pub(super) fn formation<'b>(
        &'b self,
        frame: usize,
        curve: &'b ResponseCurve<f32>,
    ) -> Formation<'b> {
        Formation { tone: self.frames[frame].tone, curve, vignetting: self.vignetting }
    }

    /// Response curves of `views` by response index; none with `tone` off.
    pub(super) fn response_curves(
        &self,
        views: &[Keyframe],
    ) -> BTreeMap<usize, ResponseCurve<f32>> {
        if !self.config.formation.tone {
            return BTreeMap::new();
        }
        let indices = views.iter().map(|view| self.frames[view.frame].response);
        indices.map(|index| (index, self.responses[index].curve())).collect()
    }
}

/// Time for the steps of one frame: `mapping.seconds_per_frame`, unlimited if that is 0.
pub(super) struct IterationBudget {
    start: Instant,
    /// [s]
    limit: f64,
}

impl IterationBudget {
    pub(super) fn start(config: &Config) -> Self {
        Self { start: Instant::now(), limit: f64::from(config.mapping.seconds_per_frame) }
    }

    /// Whether to stop after `steps` steps, for time or cancellation; never before the first.
    pub(super) fn is_exhausted(&self, steps: usize, cancellation: &CancellationToken) -> bool {
        let late = self.limit > 0.0 && self.start.elapsed().as_secs_f64() > self.limit;
        steps > 0 && (late || cancellation.is_cancelled())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_and_cancellation_exhaust_a_budget_after_its_first_step() {
        let mut config = Config::default();
        let (none, cancelled) = (CancellationToken::default(), CancellationToken::when(|| true));
        let unlimited = IterationBudget::start(&config);
        assert!(!unlimited.is_exhausted(1000, &none));
        assert!(!unlimited.is_exhausted(0, &cancelled) && unlimited.is_exhausted(1, &cancelled));
        config.mapping.seconds_per_frame = 1e-9;
        let budget = IterationBudget::start(&config);
        std::thread::sleep(std::time::Duration::from_millis(1));
        assert!(!budget.is_exhausted(0, &none) && budget.is_exhausted(1, &none));
    }
}
