//! Videos: colour, and depth where the second track is 16-bit grey.

use super::association::{AssociationRules, associate, time_warnings};
use super::{DepthEntry, FrameEntry, Layout, Listing};
use crate::camera::FormatDefaults;
use crate::text::counted;
use crate::video::{Video, VideoListing, VideoPart};
use crate::{DatasetError, DepthPairing, OpenOptions};
use std::path::Path;

/// Depth in millimetres, as depth cameras give it.
pub(super) const DEFAULTS: FormatDefaults =
    FormatDefaults { depth_scale: 1000.0, ..FormatDefaults::PLAIN };

/// Time after the last colour picture of a part for which its depth is looked for, beside the
/// tolerance [s].
const DEPTH_MARGIN: f64 = 1.0;

/// Rules by which depth is given to the colour pictures of a video, which all are frames but for
/// those that are dropped for lack of depth.
pub(crate) fn video_rules(options: &OpenOptions) -> AssociationRules {
    AssociationRules { minimum_gap: 0.0, ..AssociationRules::of(options) }
}

/// Frames of a video, those before the end of `options.frames`.
pub(super) fn list(
    path: &Path,
    options: &OpenOptions,
    frame_rate: f64,
) -> Result<Listing, DatasetError> {
    let with_depth = !options.colour_only;
    let range_end = options.frames.as_ref().map(|range| range.end);
    let end = match options.depth_pairing {
        // Which colour pictures are dropped is known behind the last one alone.
        DepthPairing::Nearest if with_depth => None,
        // The one behind tells to which of the two a depth picture between them belongs.
        _ => range_end.map(|end| end.saturating_add(usize::from(with_depth))),
    };
    let depth = with_depth.then_some(options.association_tolerance + DEPTH_MARGIN);
    let VideoListing { video, timestamps, depth_timestamps, mut warnings } =
        Video::open(path, VideoPart { end, depth, frame_rate })?;
    let depth = depth_timestamps.as_deref();
    let rules = video_rules(options);
    let association = associate(&timestamps, depth, None, rules);
    if let Some(depth) = depth.filter(|_| association.with_depth() == 0) {
        let reason = format!(
            "none of {} of its second video track, depth, lies within {} s of a colour picture; the \
             nearest is {:.3} s away",
            counted(depth.len(), "picture"),
            rules.tolerance,
            association.nearest_gap
        );
        if association.pairs.is_empty() {
            return Err(DatasetError::file(path, reason));
        }
        warnings.push(reason);
    }
    let entry = |(index, &(i, j)): (usize, &(usize, Option<usize>))| {
        let depth = depth.zip(j).map(|(stamps, j)| DepthEntry {
            path: path.to_path_buf(),
            index: j,
            timestamp: stamps[j],
            confidence: None,
        });
        let colour = path.to_path_buf();
        FrameEntry { depth, ..FrameEntry::synchronous((index, i), timestamps[i], colour, None) }
    };
    let mut entries: Vec<FrameEntry> = association.pairs.iter().enumerate().map(entry).collect();
    entries.truncate(range_end.unwrap_or(usize::MAX));
    let dropped = association.dropped();
    warnings.extend(time_warnings(&dropped, rules));
    Ok(Listing { dropped, video: Some(video), warnings, ..Listing::new(Layout::Video, entries) })
}
