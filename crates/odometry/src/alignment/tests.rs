//! Alignment of views of a textured corner of a room, drawn pixel by pixel.

use super::{DenseConstraint, DensePyramid, DenseView, ExposureMotion, align};
use i2slam_compute::Random;
use i2slam_geometry::{Camera, Image, Pose, Tangent, Vec3};

const CAMERA: Camera<f64> =
    Camera { width: 160, height: 120, fx: 130.0, fy: 130.0, cx: 80.0, cy: 60.0 };

/// Point on the nearest of three walls and the ground, along a ray.
fn hit(origin: Vec3<f64>, ray: Vec3<f64>) -> Vec3<f64> {
    let walls = [
        (Vec3::new(0.6, 0.0, 1.0), 2.4),
        (Vec3::new(-0.7, 0.1, 1.0), 2.2),
        (Vec3::new(0.0, 1.0, 0.1), 0.9),
        (Vec3::new(0.1, -1.0, 0.3), 1.3),
    ];
    let distances = walls.iter().map(|(n, d)| (d - n.dot(origin)) / n.dot(ray));
    let nearest = distances.filter(|t| *t > 0.0).fold(f64::INFINITY, f64::min);
    origin + ray * nearest
}

fn texture(point: Vec3<f64>, channel: usize) -> f64 {
    let wave = |x: f64, y: f64, z: f64| (x * point.x + y * point.y + z * point.z).sin();
    let c = channel as f64;
    0.5 + 0.16 * wave(9.0, 5.0 + c, 3.0) + 0.14 * wave(-4.0, 8.0, 7.0 - c) * wave(5.0, 1.0, 6.0)
}

/// Picture, averaged over `moments` of the motion, and depth, with noise of these deviations.
fn draw(
    pose: Pose<f64>,
    blur: Tangent<f64>,
    (depth_noise, image_noise): (f64, f64),
    gain: f64,
    seed: u64,
) -> (Image<f32>, Image<f32>) {
    let mut random = Random::new(seed);
    let mut normal = || (0..12).map(|_| random.uniform()).sum::<f64>() - 6.0;
    let poses: Vec<Pose<f64>> =
        (0..7).map(|i| pose.retract(blur.scaled((f64::from(i) + 0.5) / 7.0 - 0.5))).collect();
    let (width, height) = (CAMERA.width, CAMERA.height);
    let (mut picture, mut depth) = (Image::new(width, height, 3), Image::new(width, height, 1));
    for row in 0..height {
        for column in 0..width {
            let (u, v) = Camera::<f64>::pixel_centre(column, row);
            let ray = CAMERA.unproject(u, v, 1.0);
            let seen = |pose: &Pose<f64>| hit(pose.translation, pose.rotation.rotate(ray));
            let z = (pose.inverse() * seen(&pose)).z;
            depth.data[row * width + column] = (z + depth_noise * z * z * normal()) as f32;
            let points: Vec<Vec3<f64>> = poses.iter().map(seen).collect();
            for channel in 0..3 {
                let mean = points.iter().map(|p| texture(*p, channel)).sum::<f64>() / 7.0;
                let value = (gain * mean).powf(1.0 / 2.2) + image_noise * normal();
                picture.data[(channel * height + row) * width + column] = value as f32;
            }
        }
    }
    (picture, depth)
}

fn true_pose() -> Pose<f64> {
    Pose::identity().retract(Tangent::from_array([0.06, -0.03, 0.04, 0.02, -0.05, 0.03]))
}

fn start() -> Pose<f64> {
    true_pose().retract(Tangent::from_array([0.01, 0.01, -0.01, -0.006, 0.008, 0.005]))
}

fn still(pictures: &DensePyramid) -> DenseView<'_> {
    DenseView { pictures, motion: ExposureMotion::still() }
}

fn pyramid((picture, depth): &(Image<f32>, Image<f32>)) -> DensePyramid {
    DensePyramid::new(&CAMERA, picture, Some(depth))
}

fn error(found: &DenseConstraint) -> [f64; 6] {
    found.reference_from_frame.local(true_pose()).to_array()
}

fn largest(error: &[f64]) -> f64 {
    error.iter().fold(0.0, |most, e| e.abs().max(most))
}

#[test]
fn a_blurred_darker_frame_is_found() {
    let reference = pyramid(&draw(Pose::identity(), Tangent::zero(), (0.0, 0.0), 1.0, 1));
    let blur = Tangent::from_array([0.03, 0.0, 0.01, 0.0, 0.02, -0.01]);
    let drawn = draw(true_pose(), blur, (0.0, 0.0), 0.7, 2);
    let frame = pyramid(&drawn);
    let velocity = blur.scaled(1.0 / 0.02);
    let motion = ExposureMotion { velocity, exposure: 0.02, readout: 0.0 };
    let moving = DenseView { pictures: &frame, motion };
    let found = align(still(&reference), moving, start()).expect("a constraint");
    assert!(largest(&error(&found)[..3]) < 2e-4, "{:?}", error(&found));
    assert!(largest(&error(&found)[3..]) < 2e-4, "{:?}", error(&found));
    assert!(found.overlap > 0.6);
    assert!(found.log_gains.iter().all(|g| *g < -0.1), "{found:?}");
    // By picture alone, whose curve is not the one that pictures are compared through.
    let drawn = draw(true_pose(), Tangent::zero(), (0.0, 0.0), 1.0, 2);
    let bare = DensePyramid::new(&CAMERA, &drawn.0, None);
    let by_picture = align(still(&reference), still(&bare), start()).expect("a constraint");
    assert!(largest(&error(&by_picture)) < 1e-3, "{:?}", error(&by_picture));
    let neither = DensePyramid::new(&CAMERA, &drawn.0, None);
    assert!(align(still(&bare), still(&neither), start()).is_none());
}

/// Errors of noisy pairs scatter as the information says: their mean square over the claimed
/// variance is 1 within a factor of two for each of translation and rotation.
#[test]
fn errors_are_those_that_the_information_claims() {
    let mut squares = [0.0; 2];
    let pairs = 24;
    for seed in 0..pairs {
        let noise = (0.004, 0.02);
        let reference = pyramid(&draw(Pose::identity(), Tangent::zero(), noise, 1.0, 2 * seed));
        let frame = pyramid(&draw(true_pose(), Tangent::zero(), noise, 1.0, 2 * seed + 1));
        let found = align(still(&reference), still(&frame), start()).expect("a constraint");
        let error = error(&found);
        for (group, sum) in squares.iter_mut().enumerate() {
            // Along each axis with the others free to follow: eᵢ² over the variance of eᵢ.
            for axis in 3 * group..3 * group + 3 {
                let mut matrix = found.information.concat();
                let mut variance = [0.0; 6];
                variance[axis] = 1.0;
                assert!(i2slam_compute::solve_positive_definite(&mut matrix, &mut variance));
                *sum += error[axis].powi(2) / variance[axis] / (3 * pairs) as f64;
            }
        }
    }
    assert!(squares.iter().all(|s| (0.4..2.5).contains(s)), "{squares:?}");
}

/// A frame without depth is aligned by that of the reference, with the information of its own
/// tangent.
#[test]
fn exchanged_views_give_the_inverse() {
    let [a, b] = [(Pose::identity(), 5), (true_pose(), 6)]
        .map(|(pose, seed)| draw(pose, Tangent::zero(), (0.001, 0.01), 1.0, seed));
    let (with_depth, without) = (pyramid(&a), DensePyramid::new(&CAMERA, &b.0, None));
    let found = align(still(&with_depth), still(&without), start()).expect("a constraint");
    let other = align(still(&without), still(&with_depth), start().inverse()).expect("one");
    let apart = found.reference_from_frame.local(other.reference_from_frame.inverse());
    assert!(largest(&apart.to_array()) < 1e-12);
    // The cost of a small motion is the same from either side.
    let tangent = Tangent::from_array([3e-4, -2e-4, 1e-4, 2e-4, 1e-4, -3e-4]);
    let moved = found.reference_from_frame.retract(tangent);
    let other_tangent = other.reference_from_frame.local(moved.inverse()).to_array();
    let cost = |information: &[[f64; 6]; 6], t: &[f64; 6]| -> f64 {
        (0..6).map(|i| (0..6).map(|j| t[i] * information[i][j] * t[j]).sum::<f64>()).sum()
    };
    let costs =
        [cost(&found.information, &tangent.to_array()), cost(&other.information, &other_tangent)];
    assert!((costs[0] / costs[1] - 1.0).abs() < 1e-2, "{costs:?}");
}

/// Views that share too little, or nothing, give no constraint.
#[test]
fn too_little_overlap_gives_no_constraint() {
    let reference = pyramid(&draw(Pose::identity(), Tangent::zero(), (0.0, 0.0), 1.0, 1));
    let aside = Pose::identity().retract(Tangent::from_array([0.0, 0.0, 0.0, 0.0, 1.2, 0.0]));
    let frame = pyramid(&draw(aside, Tangent::zero(), (0.0, 0.0), 1.0, 2));
    assert!(align(still(&reference), still(&frame), aside).is_none());
    let empty =
        DensePyramid::new(&CAMERA, &Image::new(160, 120, 3), Some(&Image::new(160, 120, 1)));
    assert!(align(still(&reference), still(&empty), Pose::identity()).is_none());
}
