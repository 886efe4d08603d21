//! The focal length of a camera of which it is not known, and its lens if asked.

use crate::error::OdometryError;
use crate::grow::{adjust_all, grow};
use crate::progress::Stage;
use crate::scene::Scene;
use crate::start::start;
use i2slam_geometry::Camera;
use rayon::prelude::*;

/// Starts, as factors of the guess.
const FACTORS: [f64; 5] = [1.0, 0.75, 1.3, 0.6, 1.7];
/// Keyframes that decide between the starts.
const KEYFRAMES: usize = 16;

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
