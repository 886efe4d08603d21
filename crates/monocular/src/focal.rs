//! The focal length of a camera of which it is not known.

use crate::failure::Failure;
use crate::grow::{adjust_all, grow};
use crate::scene::Scene;
use crate::start::start;
use i2slam_geometry::Camera;
use rayon::prelude::*;

/// Starts, as factors of the guess.
const FACTORS: [f64; 5] = [1.0, 0.75, 1.3, 0.6, 1.7];
/// Keyframes that decide between the starts.
const KEYFRAMES: usize = 16;

/// The camera whose focal length explains most: from several starts, each refined over some
/// keyframes.
pub(crate) fn find_focal(scene: &Scene) -> Result<Camera<f64>, Failure> {
    let tried: Vec<Result<(f64, Camera<f64>), Failure>> =
        FACTORS.par_iter().map(|factor| try_focal(scene, *factor)).collect();
    let mut failure = Failure::NoConsistentMotion;
    let mut best: Option<(f64, Camera<f64>)> = None;
    for result in tried.into_iter().rev() {
        match result {
            Ok(found) if best.is_none_or(|b| found.0 < b.0) => best = Some(found),
            Ok(_) => {}
            Err(why) => failure = why,
        }
    }
    best.map(|b| b.1).ok_or(failure)
}

/// A score, smaller is better, and the refined camera.
fn try_focal(scene: &Scene, factor: f64) -> Result<(f64, Camera<f64>), Failure> {
    let mut tried = scene.clone();
    let camera = scene.camera;
    tried.camera = Camera { fx: camera.fx * factor, fy: camera.fy * factor, ..camera };
    start(&mut tried)?;
    grow(&mut tried, true, KEYFRAMES);
    adjust_all(&mut tried, true);
    let cost = adjust_all(&mut tried, true);
    let explained: usize = tried.posed().iter().map(|f| tried.agreeing(*f)).sum();
    Ok((cost / (explained.max(1) as f64), tried.camera))
}
