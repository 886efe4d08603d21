//! Depth readings of observations, compared with the landmarks that they see.

use crate::multiview::landmark::Landmark;
use crate::sfm_state::SfmState;
use crate::track::tracks::{DepthReading, Observation};
use i2slam_geometry::Pose;

/// Difference to the landmark from which on a reading shows something else [standard deviations].
const MAX_READING_ERROR: f64 = 6.0;

/// Gives every observation of a frame with a depth picture its reading; readings that contradict a
/// landmark are left out.
pub(crate) fn read_depth(state: &mut SfmState) {
    if !state.has_depth() {
        return;
    }
    let (maps, model, poses) = (&state.depth_maps, &state.depth_model, &state.poses);
    for (landmark, track) in state.landmarks.iter().zip(&mut state.tracks.tracks) {
        for o in &mut track.observations {
            let map = maps.get(o.frame).and_then(Option::as_ref);
            let at = std::array::from_fn(|i| o.raw[i] + model.shift[i]);
            let inverse = map.and_then(|map| map.inverse_at(at));
            o.depth = inverse.map(|inverse| DepthReading { inverse, sigma: model.sigma(inverse) });
            let residual = residual(landmark.as_ref(), poses[o.frame].as_ref(), o);
            let fits = |reading: DepthReading| {
                residual.is_none_or(|r| r.abs() <= MAX_READING_ERROR * reading.sigma)
            };
            o.depth = o.depth.filter(|reading| fits(*reading));
        }
    }
}

/// Updates the sensor's deviations from all registered frames, and reads depth anew.
pub(crate) fn update_depth_model(state: &mut SfmState) {
    if !state.has_depth() {
        return;
    }
    let mut residuals = Vec::new();
    for (landmark, track) in state.landmarks.iter().zip(&state.tracks.tracks) {
        for o in track.observations.iter().filter(|o| !o.is_outlier) {
            let off = residual(landmark.as_ref(), state.poses[o.frame].as_ref(), o);
            residuals.extend(off.zip(o.depth).map(|(off, reading)| [reading.inverse, off]));
        }
    }
    state.depth_model.fit_deviation(residuals);
    read_depth(state);
}

/// Inverse depth of a landmark in a frame minus the one read there.
fn residual(landmark: Option<&Landmark>, pose: Option<&Pose<f64>>, o: &Observation) -> Option<f64> {
    Some(landmark?.inverse_depth_in(pose?) - o.depth?.inverse)
}
