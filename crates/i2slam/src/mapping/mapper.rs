//! The interface between a session of tracked frames and its map.

use super::keyframe::Keyframe;
use super::map_snapshot::Tracker;
use crate::config::Config;
use crate::reconstruction::{FrameEstimate, Map};
use crate::warning::Warning;
use i2slam_compute::{CancellationToken, Random};
use i2slam_formation::{CameraResponse, ResponseCurve};
use i2slam_geometry::{Camera, Image};
use i2slam_radiance::hashgrid::SettingsError;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The state of a session that mapping reads and optimises.
pub(crate) struct MappingContext<'a> {
    pub(crate) config: &'a Config,
    pub(crate) camera: &'a Camera<f64>,
    /// All frames so far.
    pub(crate) frames: &'a mut [FrameEstimate],
    /// Keyframes so far, without the current frame.
    pub(crate) keyframes: &'a [Keyframe],
    pub(crate) responses: &'a mut [CameraResponse<f32>],
    /// Mask of the pixels that the camera recorded; `None`: all.
    pub(crate) covered: Option<&'a Image<bool>>,
    pub(crate) random: &'a mut Random,
    pub(crate) warnings: &'a mut Vec<Warning>,
    pub(crate) cancellation: &'a CancellationToken,
}

impl MappingContext<'_> {
    /// A reborrow with other keyframes.
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

    /// The first mapped frame: its pose and tone stay fixed.
    pub(crate) fn gauge_frame(&self, current: &Keyframe) -> usize {
        self.keyframes.first().map_or(current.frame, |k| k.frame)
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

/// A map that grows with tracked frames.
pub(crate) trait Mapper: Send {
    /// Whether the map has no content yet.
    fn is_empty(&self) -> bool;

    /// Invalid settings for which the map could not be started.
    fn failure(&self) -> Option<SettingsError> {
        None
    }

    /// Number of Gaussians; 0 of a map without.
    fn gaussians(&self) -> usize;

    /// Restricts the image terms to recorded pixels.
    fn set_covered(&mut self, covered: Arc<Image<bool>>);

    /// Tracks frames against the map; `None` while it is empty.
    fn tracker(&mut self) -> Option<&mut dyn Tracker>;

    /// A copy of the map to track against while the map is optimised, reusing the memory of
    /// `last`; `None` while the map is empty.
    fn snapshot(
        &self,
        camera: &Camera<f64>,
        covered: Option<Arc<Image<bool>>>,
        last: Option<Box<dyn Tracker>>,
    ) -> Option<Box<dyn Tracker>>;

    /// Extends the map by what the current frame sees for the first time; starts an empty map.
    fn add(&mut self, context: &mut MappingContext<'_>, current: &Keyframe);

    /// Optimises map and keyframes on the current frame and earlier keyframes; `first` allows the
    /// iterations of a new map.
    fn refine(&mut self, context: &mut MappingContext<'_>, current: &Keyframe, first: bool);

    /// Final optimisation over all keyframes; stops when `on_step(done, total)` returns false.
    fn finish(
        &mut self,
        context: &mut MappingContext<'_>,
        on_step: &mut dyn FnMut(usize, usize) -> bool,
    );

    /// A copy of the map.
    fn map(&self) -> Map;
}
