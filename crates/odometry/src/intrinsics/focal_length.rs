//! The focal length of a camera of which it is not known, and its lens if asked.

use crate::error::OdometryError;
use crate::progress::Stage;
use crate::register::initialization::start;
use crate::register::registration::{adjust_all, grow};
use crate::sfm_state::Scene;
use i2slam_geometry::Camera;
use rayon::prelude::*;

/// Starts, as factors of the guess.
const FACTORS: [f64; 5] = [1.0, 0.75, 1.3, 0.6, 1.7];
/// Keyframes that decide between the starts.
const KEYFRAMES: usize = 16;

/// What is known of the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Intrinsics {
    /// Calibrated: stays as it is.
    Known(Camera<f64>),
    /// A guess; the focal length is looked for, the principal point stays.
    Guess(Camera<f64>),
    /// The same, and the pictures are bent by a lens whose radial distortion is looked for.
    GuessWithDistortion(Camera<f64>),
}

impl Intrinsics {
    /// The guess for a picture of which nothing is known: a field of view of 60 degrees across the
    /// longer side.
    pub fn unknown(width: usize, height: usize) -> Self {
        let f = 0.5 * width.max(height) as f64 / 30_f64.to_radians().tan();
        let (cx, cy) = (0.5 * width as f64, 0.5 * height as f64);
        Self::Guess(Camera { width, height, fx: f, fy: f, cx, cy })
    }

    /// The same guess for pictures that a lens has bent: its radial distortion is looked for.
    pub fn unknown_with_distortion(width: usize, height: usize) -> Self {
        Self::GuessWithDistortion(*Self::unknown(width, height).camera())
    }

    /// The camera as given.
    pub fn camera(&self) -> &Camera<f64> {
        match self {
            Self::Known(camera) | Self::Guess(camera) | Self::GuessWithDistortion(camera) => camera,
        }
    }
}

/// A camera, its lens, and a score: smaller is better.
#[derive(Clone, Copy)]
struct Found {
    score: f64,
    camera: Camera<f64>,
    lens: [f64; 2],
}

/// Takes the camera whose focal length explains most: from several starts, each refined over some
/// keyframes.
pub(crate) fn find_focal(scene: &mut Scene) -> Result<(), OdometryError> {
    scene.progress.report(Stage::FocalLength, 0, 0);
    // Only keyframes are posed here, and other sights tell them nothing.
    let reduced = Scene::of_keyframes(scene);
    let tried: Vec<Result<Found, OdometryError>> =
        FACTORS.par_iter().map(|factor| try_focal(&reduced, *factor)).collect();
    let mut failure = OdometryError::NoConsistentMotion;
    let mut best: Option<Found> = None;
    for result in tried.into_iter().rev() {
        match result {
            Ok(found) if best.is_none_or(|b| found.score < b.score) => best = Some(found),
            Ok(_) => {}
            Err(why) => failure = why,
        }
    }
    let found = best.ok_or(failure)?;
    scene.camera = found.camera;
    scene.change_lens(found.lens);
    Ok(())
}

/// The refined camera from one start.
fn try_focal(scene: &Scene, factor: f64) -> Result<Found, OdometryError> {
    let mut tried = scene.clone();
    let camera = scene.camera;
    tried.camera = Camera { fx: camera.fx * factor, fy: camera.fy * factor, ..camera };
    start(&mut tried)?;
    grow(&mut tried, true, KEYFRAMES);
    adjust_all(&mut tried, true);
    let cost = adjust_all(&mut tried, true);
    let explained: usize = tried.posed().iter().map(|f| tried.agreeing(*f)).sum();
    let score = cost / (explained.max(1) as f64);
    Ok(Found { score, camera: tried.camera, lens: tried.lens })
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
