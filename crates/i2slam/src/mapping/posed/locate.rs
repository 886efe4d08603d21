//! The field as the map of a session.

use super::PosedField;
use crate::mapping::{Locator, PosedMapper, Story};
use crate::objective::FrameObjective;
use crate::reconstruction::{FrameEstimate, Map};
use crate::tracking::SequenceReadout;
use i2slam_geometry::Image;
use i2slam_radiance::hashgrid::{HashGridMap, SettingsError};
use std::sync::Arc;

/// What frames are found with once the field is finished.
pub(super) struct Finder {
    locator: Locator,
    objective: FrameObjective<HashGridMap>,
}

impl PosedMapper for PosedField {
    fn add(&mut self, story: &mut Story<'_>) -> Result<(), SettingsError> {
        Self::add(self, story)
    }

    fn finish(
        &mut self,
        story: &mut Story<'_>,
        on_step: &mut dyn FnMut(usize, usize) -> bool,
    ) -> Result<(), SettingsError> {
        Self::finish(self, story, on_step)
    }

    fn locate(
        &mut self,
        story: &Story<'_>,
        frame: (&mut FrameEstimate, &Image<f32>),
        before: Option<&FrameEstimate>,
    ) -> bool {
        let Some(field) = &self.field else { return false };
        let map = &field.map;
        let finder = self.finder.get_or_insert_with(|| Finder {
            locator: Locator::new(self.frame_rate, SequenceReadout::new(&story.config.input)),
            objective: FrameObjective::new(self.camera, map.march),
        });
        let scene = (map, &mut finder.objective);
        finder.locator.locate(story, scene, frame, before, story.frames)
    }

    fn set_covered(&mut self, _covered: Arc<Image<bool>>) {}

    fn map(&self) -> Map {
        Self::map(self)
    }
}
