//! Pictures of a sequence as they were taken, for the frames of a result.

use i2slam::FrameEstimate;
use i2slam::dataset::Sequence;
use i2slam::geometry::Image;
use std::sync::Arc;

/// A loader of the picture of a frame; `None` where it cannot be read.
pub(crate) fn taken_pictures(
    sequence: &Sequence,
) -> impl FnMut(&FrameEstimate) -> Option<Image<f32>> {
    |frame| {
        let position = sequence.entries.binary_search_by_key(&frame.index, |entry| entry.index);
        let frame = sequence.load(position.ok()?).ok()?;
        Some(Arc::unwrap_or_clone(frame.colour))
    }
}
