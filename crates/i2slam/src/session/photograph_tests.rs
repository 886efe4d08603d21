//! Photographs, whose motion is found by comparison with others.

use super::*;
use crate::keyframes::PosedKeyframe;
use crate::session::posed_tests::{path_pose, posed_on_path};
use crate::session::tracked_tests::{CAMERA, frame};
use i2slam_geometry::Tangent;

/// A photograph whose camera turns during the exposure, with the motion that was found.
fn photograph(index: usize, turned: Tangent<f64>, found: Option<Tangent<f64>>) -> PosedKeyframe {
    let sharp = posed_on_path(index, true);
    let moments = (0..9).map(|i| f64::from(i) / 8.0 - 0.5);
    let pictures: Vec<_> = moments
        .map(|moment| frame(index, path_pose(index).retract(turned.scaled(moment))).colour)
        .collect();
    let mut colour = (*sharp.colour).clone();
    for (pixel, value) in colour.data.iter_mut().enumerate() {
        *value = pictures.iter().map(|p| p.data[pixel]).sum::<f32>() / pictures.len() as f32;
    }
    let world_from_camera = path_pose(index);
    PosedKeyframe {
        colour: Arc::new(colour),
        exposure_motion: found,
        world_from_camera,
        before: None,
        ..sharp
    }
}

/// The motion of a photograph that turns after its alignment with a map of two sharp ones.
fn aligned_motion(turned: Tangent<f64>, found: Option<Tangent<f64>>) -> Tangent<f64> {
    let mut config = Config::preset("default-rgb").expect("known");
    (config.mapping.iterations, config.mapping.final_iterations) = (15, 60);
    let mut session = Session::refining(config, CAMERA, 30.0);
    session.set_unordered(true);
    let still = Tangent::zero();
    for (index, turned, found) in [(0, still, None), (1, still, None), (2, turned, found)] {
        session.add_keyframe(photograph(index, turned, found)).expect("photographs of one size");
    }
    let shutter = session.frames()[2].shutter;
    shutter.start.local(shutter.end)
}

#[test]
fn alignment_starts_from_the_motion_that_was_found() {
    let turn = |x: f64, y: f64| Tangent::from_array([0.0, 0.0, 0.0, x, y, 0.0]);
    let turned = turn(0.0, 5.0 / CAMERA.fx);
    let error = |found: Option<Tangent<f64>>| {
        let end = aligned_motion(turned, found);
        (end.rotation - turned.rotation).norm().min((end.rotation + turned.rotation).norm())
            * CAMERA.fx
    };
    let (with, without) = (error(Some(turned.scaled(0.9))), error(None));
    assert!(with < 1.0 && with < without, "{with} {without} px");
    let still = aligned_motion(Tangent::zero(), Some(Tangent::zero()));
    assert!(still.rotation.norm() * CAMERA.fx < 0.5, "{still:?}");
}
