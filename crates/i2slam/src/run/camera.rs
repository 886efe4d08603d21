//! Camera as estimated from pictures alone.

use crate::keyframes::OdometryReconstruction;
use i2slam_dataset::{EstimatedCamera, Sequence};

/// Relative change of a focal length from which on what was made with it counts as outdated.
const MAX_FOCAL_CHANGE: f64 = 0.02;

/// True if a focal length is so far from the one before that what was made with that is outdated.
pub(super) fn is_focal_length_changed(before: f64, now: f64) -> bool {
    (now / before).ln().abs() > MAX_FOCAL_CHANGE
}

/// Camera of a sequence as visual odometry knows it in the end.
#[derive(Clone, Debug)]
pub struct CameraEstimate {
    /// Source of the assumed camera, in words.
    pub source: String,
    /// Assumed focal length [px].
    pub assumed_focal_length: f64,
    /// Focal length in the end [px].
    pub focal_length: f64,
    /// Whether the focal length was estimated.
    pub is_focal_length_estimated: bool,
    /// Standard deviation of the estimated focal length, as a fraction of it.
    pub focal_length_deviation: Option<f64>,
    /// Horizontal field of view in the end [degrees].
    pub field_of_view: f64,
    /// Time from the first to the last row of a picture [s], 0 for a global shutter.
    pub rolling_shutter_readout: f64,
    /// Time from the time stamps of depth pictures to when they were taken, as estimated \[s\].
    pub depth_delay: f64,
    /// Displacement of depth to the right and down against the mapped pictures, as estimated \[px\].
    pub depth_shift: [f64; 2],
    /// Whether lens distortion was estimated.
    pub is_distortion_estimated: bool,
    /// Camera of the recorded pictures with the estimated distortion, unless that is zero.
    pub lens: Option<EstimatedCamera>,
}

impl CameraEstimate {
    /// Source of the focal length in words: the pictures if they changed it, else the source of the
    /// assumed camera.
    pub fn source_of_focal_length(&self) -> String {
        let is_changed = (self.focal_length / self.assumed_focal_length).ln().abs() > 1e-6;
        let pictures = match self.focal_length_deviation {
            Some(_) if self.is_focal_length_estimated => "the pictures",
            None if self.is_focal_length_estimated && is_changed => {
                "the pictures, which do not tell how exactly"
            }
            _ => return self.source.clone(),
        };
        format!("{pictures}; assumed first: {}", self.source)
    }

    pub(super) fn new(sequence: &Sequence, found: &OdometryReconstruction) -> Self {
        Self {
            source: sequence.camera_source.clone(),
            assumed_focal_length: sequence.camera.fx,
            focal_length: found.camera.fx,
            is_focal_length_estimated: sequence.camera_is_guess,
            focal_length_deviation: found.focal_deviation,
            field_of_view: found.camera.horizontal_field_of_view().to_degrees(),
            rolling_shutter_readout: found.rolling_shutter_readout,
            depth_delay: found.depth_model.as_ref().map_or(0.0, |model| model.delay),
            depth_shift: found.depth_model.as_ref().map_or([0.0; 2], |model| model.shift),
            is_distortion_estimated: found.distortion.is_some(),
            lens: found
                .distortion
                .filter(|lens| *lens != [0.0; 2])
                .map(|lens| sequence.estimated_camera(&found.camera, lens)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_source_of_a_focal_length_is_what_changed_it() {
        let estimate = |focal_length: f64, deviation: Option<f64>, is_estimated: bool| {
            let camera = CameraEstimate {
                source: "a guess".to_owned(),
                assumed_focal_length: 100.0,
                focal_length,
                is_focal_length_estimated: is_estimated,
                focal_length_deviation: deviation,
                field_of_view: 60.0,
                rolling_shutter_readout: 0.0,
                depth_delay: 0.0,
                depth_shift: [0.0; 2],
                is_distortion_estimated: false,
                lens: None,
            };
            camera.source_of_focal_length()
        };
        assert_eq!(estimate(120.0, Some(0.01), true), "the pictures; assumed first: a guess");
        assert!(estimate(120.0, None, true).contains("do not tell how exactly; assumed first"));
        assert_eq!(estimate(100.0, None, true), "a guess");
        assert_eq!(estimate(100.0, None, false), "a guess");
    }
}
