//! Landmarks of the state that rest on measured depth, and what follows for its lengths.

use super::SfmState;
use crate::track::tracks::Observation;

/// Landmarks with a reading of depth from which on lengths are metres.
pub(crate) const MIN_MEASURED_LANDMARKS: usize = 40;

impl SfmState {
    /// Whether lengths are metres: landmarks rest on readings of depth.
    pub(crate) fn is_metric(&self) -> bool {
        self.measured_landmarks()[0] >= MIN_MEASURED_LANDMARKS
    }

    /// Whether readings hold the scale along the whole path, as most landmarks rest on some.
    pub(crate) fn is_scale_measured(&self) -> bool {
        let [measured, all] = self.measured_landmarks();
        measured >= MIN_MEASURED_LANDMARKS && 2 * measured >= all
    }

    /// Number of landmarks that rest on readings of depth, and of all landmarks.
    fn measured_landmarks(&self) -> [usize; 2] {
        if !self.has_depth() {
            return [0, self.landmarks.iter().flatten().count()];
        }
        let known = self.landmarks.iter().zip(&self.tracks.tracks).filter(|(l, _)| l.is_some());
        let is_reading =
            |o: &Observation| !o.is_outlier && o.depth().is_some() && self.poses[o.frame].is_some();
        known.fold([0; 2], |[measured, all], (_, track)| {
            [measured + usize::from(track.observations.iter().any(is_reading)), all + 1]
        })
    }
}
