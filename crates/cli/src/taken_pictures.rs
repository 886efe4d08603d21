//! Pictures of a sequence as they were taken, for the frames of a result.

use crate::console::print_status;
use i2slam::FrameEstimate;
use i2slam::dataset::{Sequence, is_stream};
use i2slam::geometry::Image;
use i2slam_result::RunInput;
use std::path::Path;
use std::sync::Arc;

/// The sequence that a result was made of, where it is still there; else a warning that says what is
/// `missing` without it.
pub(crate) fn sequence_of(result: &Path, missing: &str) -> Option<Sequence> {
    let warn = |reason: &str| print_status(&format!("warning: {missing}: {reason}"));
    let input = RunInput::load(result).map_err(|error| warn(&error.to_string())).ok()??;
    match Sequence::open(&input.dataset, &input.options) {
        Ok(sequence) => Some(sequence),
        Err(error) => {
            let file = result.join("input.json");
            match is_stream(&input.dataset) {
                true => warn(&error.to_string()),
                false => warn(&format!(
                    "{error}; if it was moved, write its new place into `dataset` of {}",
                    file.display()
                )),
            }
            None
        }
    }
}

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

/// [`taken_pictures`] that are black where the camera saw nothing and the edge of the picture is repeated.
pub(crate) fn covered_pictures(
    sequence: &Sequence,
) -> impl FnMut(&FrameEstimate) -> Option<Image<f32>> {
    let mut load = taken_pictures(sequence);
    move |frame| {
        let mut picture = load(frame)?;
        if let Some(valid) = &sequence.valid_mask {
            for channel in 0..picture.channels {
                let pixels = picture.plane_mut(channel).iter_mut().zip(&valid.data);
                pixels.filter(|(_, valid)| !**valid).for_each(|(value, _)| *value = 0.0);
            }
        }
        Some(picture)
    }
}
