//! What a session asks of its map.

use super::keyframe::Keyframe;
use super::map_snapshot::Tracker;
use crate::config::Config;
use crate::reconstruction::{FrameEstimate, Map};
use crate::warning::Warning;
use i2slam_compute::{CancellationToken, Random};
use i2slam_formation::CameraResponse;
use i2slam_geometry::{Camera, Image};
use i2slam_radiance::hashgrid::SettingsError;
use std::sync::Arc;

/// What a session knows beside its map, while the map works on it.
pub(crate) struct MappingContext<'a> {
    pub(crate) config: &'a Config,
    pub(crate) camera: &'a Camera<f64>,
    /// All frames so far.
    pub(crate) frames: &'a mut [FrameEstimate],
    /// Keyframes so far, the current frame not among them.
    pub(crate) keyframes: &'a [Keyframe],
    pub(crate) responses: &'a mut [CameraResponse<f32>],
    /// Pixels that the camera recorded, if not all.
    pub(crate) covered: Option<&'a Image<bool>>,
    pub(crate) random: &'a mut Random,
    pub(crate) warnings: &'a mut Vec<Warning>,
    /// Whether the rest of a round is to be left undone.
    pub(crate) cancellation: &'a CancellationToken,
}

impl MappingContext<'_> {
    /// The same context with other keyframes.
    pub(crate) fn with_keyframes<'a>(
        &'a mut self,
        keyframes: &'a [Keyframe],
    ) -> MappingContext<'a> {
        MappingContext {
            config: self.config,
            camera: self.camera,
            frames: self.frames,
            keyframes,
            responses: self.responses,
            covered: self.covered,
            random: self.random,
            warnings: self.warnings,
            cancellation: self.cancellation,
        }
    }

    /// The frame whose pose and tone stay as they are: the first that was mapped.
    pub(crate) fn gauge_frame(&self, current: &Keyframe) -> usize {
        self.keyframes.first().map_or(current.frame, |k| k.frame)
    }
}

/// A map that grows with the frames of a session, and that frames are tracked against.
pub(crate) trait Mapper: Tracker {
    /// Whether nothing can be seen yet.
    fn is_empty(&self) -> bool;

    /// Why an empty map could not be started, if that was tried: its settings.
    fn failure(&self) -> Option<SettingsError> {
        None
    }

    /// Number of Gaussians, where the map consists of them.
    fn gaussians(&self) -> usize;

    /// Restricts the image terms to recorded pixels.
    fn set_covered(&mut self, covered: Arc<Image<bool>>);

    /// A copy of the map for tracking beside mapping, best in the memory of the one before; none
    /// of an empty map.
    fn snapshot(
        &self,
        camera: &Camera<f64>,
        covered: Option<Arc<Image<bool>>>,
        last: Option<Box<dyn Tracker>>,
    ) -> Option<Box<dyn Tracker>>;

    /// Makes room for what the current frame sees for the first time; starts an empty map.
    fn add(&mut self, context: &mut MappingContext<'_>, current: &Keyframe);

    /// A round of steps on the current frame and keyframes before it; `first` starts the map.
    fn refine(&mut self, context: &mut MappingContext<'_>, current: &Keyframe, first: bool);

    /// Steps over all keyframes after the last frame; `on_step(done, of)` says whether to go on.
    fn finish(
        &mut self,
        context: &mut MappingContext<'_>,
        on_step: &mut dyn FnMut(usize, usize) -> bool,
    );

    /// The map as it is now.
    fn map(&self) -> Map;
}
