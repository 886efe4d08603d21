//! Camera intrinsics of the input, and the search for an unknown focal length.

use crate::error::OdometryError;
use crate::progress::Stage;
use crate::register::initialization::initialize;
use crate::register::registration::{adjust_globally, register_keyframes};
use crate::sfm_state::SfmState;
use i2slam_geometry::Camera;
use rayon::prelude::*;

/// Initial focal lengths, as factors of the guess.
const START_FACTORS: [f64; 5] = [1.0, 0.75, 1.3, 0.6, 1.7];
/// Keyframes that decide between them.
const SEARCH_KEYFRAMES: usize = 16;

/// Knowledge of the camera's intrinsics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Intrinsics {
    /// Calibrated: fixed.
    Known(Camera<f64>),
    /// A guess: the focal length is estimated, the principal point is fixed.
    Guess(Camera<f64>),
    /// A guess for a lens with radial distortion: focal length and distortion are estimated.
    GuessWithDistortion(Camera<f64>),
}

impl Intrinsics {
    /// A guess from the size of the pictures: field of view of 60 degrees across the longer side.
    pub fn unknown(width: usize, height: usize) -> Self {
        let f = 0.5 * width.max(height) as f64 / 30_f64.to_radians().tan();
        let (cx, cy) = (0.5 * width as f64, 0.5 * height as f64);
        Self::Guess(Camera { width, height, fx: f, fy: f, cx, cy })
    }

    /// The camera as given.
    pub fn camera(&self) -> &Camera<f64> {
        match self {
            Self::Known(camera) | Self::Guess(camera) | Self::GuessWithDistortion(camera) => camera,
        }
    }
}

/// Sets the focal length of best score among several, each adjusted with some keyframes.
pub(crate) fn search_focal_length(state: &mut SfmState) -> Result<(), OdometryError> {
    state.progress.report(Stage::FocalLength, 0, 0);
    // Only keyframes are registered here, and observations in other frames do not affect them.
    let reduced = state.keyframes_only();
    let tried: Vec<Result<(f64, SfmState), OdometryError>> =
        START_FACTORS.par_iter().map(|factor| evaluate_start(&reduced, *factor)).collect();
    let mut failure = OdometryError::NoConsistentMotion;
    let mut best: Option<(f64, SfmState)> = None;
    for result in tried.into_iter().rev() {
        match result {
            Ok(found) if best.as_ref().is_none_or(|b| found.0 < b.0) => best = Some(found),
            Ok(_) => {}
            Err(why) => failure = why,
        }
    }
    let (_, found) = best.ok_or(failure)?;
    state.camera = found.camera;
    state.update_distortion(found.distortion);
    Ok(())
}

/// The state adjusted from one initial focal length with its score, of which the least is best.
fn evaluate_start(state: &SfmState, factor: f64) -> Result<(f64, SfmState), OdometryError> {
    let mut tried = state.clone();
    let camera = state.camera;
    tried.camera = Camera { fx: camera.fx * factor, fy: camera.fy * factor, ..camera };
    initialize(&mut tried, 0..state.tracks.keyframes.len())?;
    register_keyframes(&mut tried, true, SEARCH_KEYFRAMES);
    adjust_globally(&mut tried, true);
    let cost = adjust_globally(&mut tried, true);
    let explained: usize = tried.posed_frames().iter().map(|f| tried.count_inliers(*f)).sum();
    Ok((cost / (explained.max(1) as f64), tried))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_camera_stays_the_same_turned_upright() {
        let focal = |width, height| Intrinsics::unknown(width, height).camera().fx;
        assert_eq!(focal(640, 480), focal(480, 640));
        assert!((focal(320, 240) - 277.128).abs() < 1e-3);
    }
}
