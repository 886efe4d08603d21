//! Dense depth of keyframes in a room that is known.

use crate::scene::{camera, moving, picture};
use i2slam_geometry::{Camera, Image, Pose};
use i2slam_odometry::{DenseDepthEstimator, KeyframePictures, PosedView};
use std::sync::Arc;

/// The true depth at the centre of every pixel.
fn depth(world_from_camera: Pose<f64>) -> Vec<f64> {
    let at = |i: usize| Camera::<f64>::pixel_centre(i % camera().width, i / camera().width);
    let depth = |i: usize| crate::scene::depth(world_from_camera, [at(i).0, at(i).1]);
    (0..camera().pixels()).map(depth).collect()
}

fn quantile(mut all: Vec<f64>, share: f64) -> f64 {
    all.sort_by(f64::total_cmp);
    all[(share * all.len() as f64) as usize]
}

/// Keyframes at every third place, each a little brighter than the one before.
fn views() -> (Vec<PosedView>, Vec<Image<f32>>) {
    let view = |k: usize| {
        let truth = depth(moving(3 * k));
        let landmarks = truth.iter().copied().step_by(97).collect();
        PosedView { world_from_camera: moving(3 * k), landmarks }
    };
    let shown = |k: usize| picture(1, moving(3 * k), 0.8 + 0.05 * k as f32);
    ((0..6).map(view).collect(), (0..6).map(shown).collect())
}

#[test]
fn most_depths_are_found_and_their_variances_are_true() {
    let (views, pictures) = views();
    let mut dense = DenseDepthEstimator::new(camera(), views);
    let mut asked = vec![0; pictures.len()];
    let mut load = |k: usize| {
        asked[k] += 1;
        Some(KeyframePictures::colour_only(Arc::new(pictures[k].clone())))
    };
    let found = dense.estimate(2, &mut load).expect("neighbours with parallax");
    let again = dense.estimate(3, &mut load).expect("neighbours with parallax");
    assert!(again.depth.data.iter().any(|d| *d > 0.0));
    assert!(asked.iter().all(|times| *times <= 1), "{asked:?}");
    let truth = depth(moving(6));
    let known: Vec<(f64, f64)> = (0..truth.len())
        .filter(|i| found.depth.data[*i] > 0.0)
        .map(|i| {
            let off = (f64::from(found.depth.data[i]) - truth[i]).abs();
            (off / truth[i], off / f64::from(found.variance.data[i]).sqrt())
        })
        .collect();
    assert!(10 * known.len() > 6 * truth.len(), "{} of {}", known.len(), truth.len());
    let errors: Vec<f64> = known.iter().map(|k| k.0).collect();
    let (half, most) = (quantile(errors.clone(), 0.5), quantile(errors, 0.9));
    assert!(half < 0.01 && most < 0.06, "relative errors {half} {most}");
    // Half of a normal distribution lies within 0.67 deviations; these pictures have no noise.
    let deviations = quantile(known.iter().map(|k| k.1).collect(), 0.5);
    assert!((0.15..1.0).contains(&deviations), "median error {deviations} deviations");
}

#[test]
fn nothing_is_known_without_parallax_or_pictures() {
    let (views, pictures) = views();
    let alone = vec![views[0].clone(); 3];
    let mut dense = DenseDepthEstimator::new(camera(), alone);
    assert!(
        dense
            .estimate(1, &mut |_| Some(KeyframePictures::colour_only(Arc::new(
                pictures[0].clone()
            ))))
            .is_none()
    );
    let mut dense = DenseDepthEstimator::new(camera(), views);
    assert!(dense.estimate(1, &mut |_| None).is_none());
    assert!(dense.estimate(99, &mut |_| None).is_none());
}
