//! Dense depth of keyframes in a room that is known.

use crate::scene::{camera, moving, picture};
use i2slam_geometry::{Camera, Image, Pose};
use i2slam_odometry::{
    DenseDepthEstimator, DepthModel, KeyframePictures, MeasuredDepth, PosedView,
};
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

/// Depth of a pane before the room, where a ray meets it.
fn pane(world_from_camera: Pose<f64>, [u, v]: [f64; 2]) -> Option<f64> {
    let ray = world_from_camera.rotation.rotate(camera().unproject(u, v, 1.0));
    let from = world_from_camera.translation;
    let depth = (2.0 - from.z) / ray.z;
    let point = from + ray * depth;
    ((-0.3..0.9).contains(&point.x) && (-0.6..0.4).contains(&point.y)).then_some(depth)
}

/// Readings of the room, and of the pane, which pictures do not show.
fn measured(pose: Pose<f64>) -> MeasuredDepth {
    let room = depth(pose);
    let depth = Image::from_fn(camera().width, camera().height, 1, |_, column, row| {
        let (u, v) = Camera::<f64>::pixel_centre(column, row);
        pane(pose, [u, v]).unwrap_or(room[row * camera().width + column]) as f32
    });
    MeasuredDepth { depth: Arc::new(depth), depth_from_colour: Pose::identity() }
}

/// Pixels whose ray meets the pane, which is before a wall or not.
fn pane_pixels(pose: Pose<f64>) -> Vec<bool> {
    let at = |i: usize| Camera::<f64>::pixel_centre(i % camera().width, i / camera().width);
    (0..camera().pixels()).map(|i| pane(pose, [at(i).0, at(i).1]).is_some()).collect()
}

/// A pane or mirror is read, but pictures show what lies behind it: pictures decide.
#[test]
fn readings_that_pictures_contradict_are_left_out() {
    let (views, pictures) = views();
    let mut dense =
        DenseDepthEstimator::new(camera(), views).with_depth_model(Some(DepthModel::default()));
    let mut load = |k: usize| {
        let colour = Arc::new(pictures[k].clone());
        Some(KeyframePictures { colour, depth: Some(measured(moving(3 * k))) })
    };
    let found = dense.estimate(2, &mut load).expect("neighbours with parallax");
    let contradicted = found.contradicted.expect("readings were compared");
    let (truth, is_pane) = (depth(moving(6)), pane_pixels(moving(6)));
    let behind = is_pane.iter().filter(|is| **is).count();
    assert!(behind > 2000, "{behind} pixels of the pane");
    let rejected = |pane: bool| {
        let all = contradicted.data.iter().zip(&is_pane);
        all.filter(|(z, is)| **z > 0.0 && **is == pane).count()
    };
    assert!(10 * rejected(true) > 8 * behind, "{} of {behind}", rejected(true));
    let others = truth.len() - behind;
    assert!(30 * rejected(false) < others, "{} of {others} good ones", rejected(false));
    let errors: Vec<f64> = (0..truth.len())
        .filter(|i| contradicted.data[*i] > 0.0 && is_pane[*i] && found.depth.data[*i] > 0.0)
        .map(|i| (f64::from(found.depth.data[i]) / truth[i] - 1.0).abs())
        .collect();
    assert!(2 * errors.len() > behind, "{} of {behind} found", errors.len());
    let half = quantile(errors, 0.5);
    assert!(half < 0.02, "relative error {half}");
    // A frame between keyframes leaves out what these have found.
    let pose = moving(7);
    let between = dense.fuse(pose, 2, &measured(pose), &mut load).expect("a model of the sensor");
    let left: Vec<bool> = between.depth.data.iter().map(|z| *z > 0.0).collect();
    let count = |pane: bool| {
        let all = pane_pixels(pose).into_iter().zip(&left);
        all.filter(|(is, left)| *is == pane && **left).count()
    };
    assert!(4 * count(true) < behind, "{} left", count(true));
    assert!(10 * count(false) > 9 * others, "{} of {others} left", count(false));
}
