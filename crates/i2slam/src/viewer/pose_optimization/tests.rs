//! A textured wall, seen from a pose that is known.

use super::*;
use crate::config::Config;
use crate::reconstruction::{Map, Reconstruction};
use i2slam_check::noise;
use i2slam_formation::{CameraResponse, NodeSpacing, StartCurve};
use i2slam_geometry::Camera;
use i2slam_radiance::gaussian::{ColourActivation, Gaussian, GaussianMap, Shape};

/// Gaussians at depths of 1.5 to 2.5 m with colours of their own.
pub(crate) fn room() -> Reconstruction {
    let mut map = GaussianMap::new(Shape::Isotropic, ColourActivation::Exponential);
    let random: Vec<f32> = noise(3, 2500 * 5).iter().map(|&v| v as f32).collect();
    for (i, n) in random.chunks_exact(5).enumerate() {
        let (x, y) = ((i % 50) as f32 / 25.0 - 1.0, (i / 50) as f32 / 25.0 - 1.0);
        map.push(Gaussian {
            mean: [1.6 * x, 1.6 * y, 2.0 + 0.5 * n[0]],
            log_scale: [-3.2; 3],
            rotation: [1.0, 0.0, 0.0, 0.0],
            opacity_logit: 3.0,
            colour: [-1.0 + n[1], -1.0 + n[2], -1.0 + n[3]],
        });
    }
    Reconstruction {
        config: Config::default(),
        camera: Camera { width: 96, height: 72, fx: 90.0, fy: 90.0, cx: 48.0, cy: 36.0 },
        frames: Vec::new(),
        map: Map::Gaussians(map),
        responses: vec![CameraResponse::new(3, StartCurve::Srgb, NodeSpacing::Uniform)],
        rolling_shutter_readout: 0.0,
    }
}

fn moved(step: [f64; 6]) -> Pose<f64> {
    Pose::identity().retract(Tangent::from_array(step))
}

fn psnr(error: f64) -> f64 {
    -10.0 * error.log10()
}

#[test]
fn a_disturbed_pose_returns() {
    let room = room();
    let mut viewer = room.viewer();
    let true_pose = moved([0.02, -0.03, 0.01, 0.01, 0.02, -0.01]);
    let truth = viewer.sharp_clamped(&room.imagined_frame(0, true_pose), true_pose);
    // Two pixels of rotation, one and a half of translation.
    let wrong = true_pose.retract(Tangent::from_array([0.03, -0.02, 0.02, -0.015, 0.02, 0.01]));
    let frame = room.imagined_frame(0, wrong);
    let found = viewer.optimise_pose(&frame, &truth);
    assert!(psnr(found.error_after) > psnr(found.error_before) + 20.0);
    let left = true_pose.local(found.world_from_camera);
    assert!(left.translation.norm() < 1e-3 && left.rotation.norm() < 5e-4, "{left:?}");
    assert_eq!(found.picture, viewer.sharp_clamped(&frame, found.world_from_camera));
}

#[test]
fn motions_are_those_of_projected_points() {
    let camera = Camera { width: 96, height: 72, fx: 90.0, fy: 85.0, cx: 48.0, cy: 36.0 };
    let (point, units) = (Vec3::new(0.4, -0.3, 1.7), [0.02, 0.02, 0.02, 0.01, 0.01, 0.01]);
    let motions = image_motion(&camera, point, units);
    for (k, motion) in motions.iter().enumerate() {
        let seen = |size: f64| {
            let mut step = [0.0; 6];
            step[k] = size * units[k];
            camera.project(moved(step).inverse() * point)
        };
        let ((ua, va), (ub, vb)) = (seen(1e-4), seen(-1e-4));
        for (ours, due) in motion.iter().zip([ua - ub, va - vb]) {
            let due = due / 2e-4;
            assert!(
                (f64::from(*ours) - due).abs() < 1e-5 * due.abs().max(1.0),
                "{k}: {ours} {due}"
            );
        }
    }
}

#[test]
fn the_best_pose_stays() {
    let room = room();
    let mut viewer = room.viewer();
    let frame = room.imagined_frame(0, moved([0.01, 0.0, 0.02, 0.0, 0.01, 0.0]));
    let truth = viewer.sharp_clamped(&frame, frame.middle());
    let found = viewer.optimise_pose(&frame, &truth);
    assert_eq!((found.error_before, found.error_after), (0.0, 0.0));
    assert_eq!(found.world_from_camera, frame.middle());
}

#[test]
fn a_picture_of_something_else_never_makes_it_worse() {
    let room = room();
    let mut viewer = room.viewer();
    let frame = room.imagined_frame(0, Pose::identity());
    for seed in 0..3 {
        let mut other = viewer.sharp_clamped(&frame, Pose::identity());
        let random = noise(11 + seed, other.data.len());
        other.data.iter_mut().zip(random).for_each(|(v, n)| *v = 0.5 + 0.5 * n as f32);
        let found = viewer.optimise_pose(&frame, &other);
        assert!(found.error_after <= found.error_before);
        assert!(found.world_from_camera.is_finite());
    }
}
