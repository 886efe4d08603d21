//! Depth pictures and the frames that they belong to.

use crate::depth::depth_map::DepthMap;
use crate::depth::readings::read_depth;
use crate::sfm_state::SfmState;
use std::sync::Arc;

/// Gives every depth picture to the frame whose colour picture was taken nearest to it, the delay of
/// the sensor included, and reads it there; of two that are nearest to one frame the nearer.
///
/// A reading is corrected by the motion between both pictures, which the poses tell that it corrects:
/// a whole interval later it would tell nothing of its frame.
pub(super) fn pair_depth(state: &mut SfmState) {
    let (stamps, delay) = (Arc::clone(&state.timestamps), state.depth_model.delay);
    let nearest = |map: &DepthMap| {
        let time = map.timestamp + delay;
        let after = stamps.partition_point(|stamp| *stamp < time);
        let frames = after.saturating_sub(1)..stamps.len().min(after + 1);
        let distances = frames.map(|frame| ((stamps[frame] - time).abs(), frame));
        distances.min_by(|a, b| a.0.total_cmp(&b.0))
    };
    let maps = state.depth_maps.iter().flatten();
    let mut found: Vec<_> = maps.filter_map(|map| Some((nearest(map)?, map.clone()))).collect();
    found.sort_by(|((a, _), _), ((b, _), _)| b.total_cmp(a));
    let mut paired = vec![None; state.depth_maps.len()];
    for ((_, frame), map) in found {
        paired[frame] = Some(map);
    }
    state.depth_maps = Arc::new(paired);
    let observations = state.tracks.tracks.iter_mut().flat_map(|track| &mut track.observations);
    observations.for_each(|o| *o = o.with_depth(None));
    read_depth(state);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::depth::depth_map::DepthPicture;
    use crate::fixtures::camera;
    use crate::track::tracks::Tracks;
    use i2slam_geometry::Image;
    use i2slam_storage::ScratchStore;

    /// Timestamps of the depth of frames at 0, 30, 60 and 90 ms after pairing [ms].
    fn paired(recorded: [Option<f64>; 4], delay: f64) -> Vec<Option<f64>> {
        let mut state = SfmState::new(camera(), Tracks { frames: 4, ..Tracks::default() });
        state.timestamps = Arc::new(vec![0.0, 0.03, 0.06, 0.09]);
        let depth = Image::new(4, 4, 1);
        let map = |ms: f64| {
            DepthMap::new(
                &DepthPicture { depth: &depth, timestamp: 1e-3 * ms },
                &ScratchStore::in_memory(),
            )
        };
        state.depth_maps = Arc::new(recorded.map(|ms| ms.map(map)).to_vec());
        state.depth_model.delay = 1e-3 * delay;
        pair_depth(&mut state);
        let stamp = |map: &DepthMap| (1e3 * map.timestamp).round();
        state.depth_maps.iter().map(|map| map.as_ref().map(stamp)).collect()
    }

    #[test]
    fn depth_belongs_to_the_nearest_frame_with_its_delay() {
        let recorded = [None, Some(16.0), Some(46.0), None];
        assert_eq!(paired(recorded, 0.0), [None, Some(16.0), Some(46.0), None]);
        assert_eq!(paired(recorded, -20.0), [Some(16.0), Some(46.0), None, None]);
        assert_eq!(paired(recorded, 20.0), [None, Some(16.0), Some(46.0), None]);
        // Before the first frame and after the last; the nearer of two.
        assert_eq!(
            paired([Some(2.0), Some(28.0), None, None], -40.0),
            [Some(28.0), None, None, None]
        );
        assert_eq!(
            paired([None, None, Some(60.0), Some(90.0)], 30.0),
            [None, None, None, Some(60.0)]
        );
    }
}
