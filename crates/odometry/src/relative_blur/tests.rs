use super::*;
use crate::result::SparseDepth;
use i2slam_geometry::{Pose, Rotation, Vec3};

const CAMERA: Camera<f64> =
    Camera { width: 160, height: 120, fx: 140.0, fy: 140.0, cx: 80.0, cy: 60.0 };
const DEPTH: f64 = 2.0;

/// Brightness of a wall.
fn wall(x: f64, y: f64) -> f64 {
    let waves = (0..24).map(|i| {
        let (turn, size) = (f64::from(i) * 2.4, 3.0 + 3.7 * f64::from(i));
        (size * (x * turn.cos() + y * turn.sin()) + f64::from(i * i)).sin()
    });
    0.3 + 0.045 * waves.sum::<f64>()
}

fn pose(x: f64, turn: f64) -> Pose<f64> {
    Pose::new(Rotation::exp(Vec3::new(0.0, 0.0, turn)), Vec3::new(x, 0.05 * x, 0.0))
}

/// A photograph of the wall at `exposure` whose picture moves by `motion` [px].
fn photograph(pose: Pose<f64>, motion: [f64; 2], exposure: f64) -> Arc<Image<f32>> {
    let samples = 10;
    let light = |u: f64, v: f64| {
        let point = pose * CAMERA.unproject(u, v, DEPTH);
        wall(point.x, point.y)
    };
    Arc::new(Image::from_fn(160, 120, 1, |_, column, row| {
        let moved = (0..samples).map(|i| (f64::from(i) + 0.5) / f64::from(samples) - 0.5);
        let (u, v) = (column as f64 + 0.5, row as f64 + 0.5);
        let sum: f64 = moved.map(|s| light(u + s * motion[0], v + s * motion[1])).sum();
        (exposure * sum / f64::from(samples)).max(0.0).powf(1.0 / 2.2) as f32
    }))
}

fn keyframe(index: usize, world_from_camera: Pose<f64>) -> Keyframe {
    let at = |i: usize| [8.0 + 9.0 * (i % 17) as f64, 8.0 + 9.0 * (i / 17) as f64];
    let depths = (0..12 * 17).map(|i| SparseDepth { at: at(i), depth: DEPTH, variance: 1e-6 });
    Keyframe { index, timestamp: index as f64, world_from_camera, depths: depths.collect() }
}

/// Motions found of photographs of the wall with `motions`, as those of the middle of the picture [px].
fn found(motions: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let poses: Vec<Pose<f64>> = (0..motions.len())
        .map(|i| pose(0.15 * i as f64 - 0.2, [0.0, 0.3, -0.5, 0.1][i % 4]))
        .collect();
    let keyframes: Vec<Keyframe> = poses.iter().enumerate().map(|(i, p)| keyframe(i, *p)).collect();
    let mut load = |i: usize| Some(photograph(poses[i], motions[i], 0.8 + 0.2 * (i % 2) as f64));
    let found = photograph_motions(&CAMERA, &keyframes, &mut load, &CancellationToken::default());
    let in_pixels = |motion: Option<Tangent<f64>>| {
        let [.., x, y, z] = motion.unwrap_or_else(Tangent::zero).to_array();
        assert_eq!(z, 0.0);
        [-y * CAMERA.fx, x * CAMERA.fy]
    };
    found.into_iter().map(in_pixels).collect()
}

/// Distance of two motions of either sign.
fn error(a: [f64; 2], b: [f64; 2]) -> f64 {
    let distance = |sign: f64| (a[0] - sign * b[0]).hypot(a[1] - sign * b[1]);
    distance(1.0).min(distance(-1.0))
}

#[test]
fn motions_are_found_up_to_their_sign() {
    let motions = [[0.0, 0.0], [5.0, 0.0], [0.0, 2.5], [-4.0, 4.0], [1.5, 2.5]];
    for (found, expected) in found(&motions).into_iter().zip(motions) {
        let length = expected[0].hypot(expected[1]);
        assert!(error(found, expected) < 0.4 + 0.15 * length, "{found:?} {expected:?}");
    }
}

#[test]
fn sharp_photographs_are_at_rest() {
    assert_eq!(found(&[[0.0; 2]; 4]), [[0.0; 2]; 4]);
}

#[test]
fn the_motion_of_a_photograph_alone_is_not_known() {
    let load = &mut |_: usize| Some(photograph(pose(0.0, 0.0), [4.0, 0.0], 1.0));
    let alone = [keyframe(0, pose(0.0, 0.0))];
    assert_eq!(photograph_motions(&CAMERA, &alone, load, &CancellationToken::default()), [None]);
}

#[test]
fn a_photograph_that_cannot_be_read_is_left_out() {
    let keyframes: Vec<Keyframe> =
        (0..3).map(|i| keyframe(i, pose(0.15 * i as f64, 0.0))).collect();
    let mut load = |i: usize| {
        let motion = [0.0, 0.0, 4.0][i];
        (i != 1).then(|| photograph(keyframes[i].world_from_camera, [motion, 0.0], 1.0))
    };
    let found = photograph_motions(&CAMERA, &keyframes, &mut load, &CancellationToken::default());
    assert_eq!(found[..2], [Some(Tangent::zero()), None]);
    let moved = found[2].expect("found").rotation.norm() * CAMERA.fx;
    assert!((moved - 4.0).abs() < 1.0, "{moved}");
}
