use super::blocks::weighted_residual;
use super::*;
use crate::fixtures::camera;
use crate::multiview::lens_distortion::distortion_jacobian;
use crate::progress::Progress;
use i2slam_check::{assert_gradient, noise};
use i2slam_geometry::{Rotation, Vec3};

/// Six cameras along an arc, 60 points; observations with `spread` pixels of noise.
fn scene(spread: f64) -> (Bundle, Vec<Vec3<f64>>) {
    let camera = camera();
    let pose = |i: usize| {
        let s = i as f64 * 0.1;
        Pose::new(
            Rotation::exp(Vec3::new(0.05 * s, -0.3 * s, 0.2 * s)),
            Vec3::new(s, 0.1 * s * s, 0.2 * s),
        )
    };
    let poses: Vec<_> = (0..6).map(pose).collect();
    let points: Vec<_> =
        noise(1, 180).chunks_exact(3).map(|n| Vec3::new(n[0], n[1], 2.5 + 0.8 * n[2])).collect();
    let errors = noise(2, 60 * 12);
    let observation = |i: usize, k: usize| {
        let (u, v) = camera.project(poses[k].inverse() * points[i]);
        let e = &errors[(i * 6 + k) * 2..];
        let at = [u + spread * e[0], v + spread * e[1]];
        let camera_jacobian = distortion_jacobian(&camera, at);
        // A long ellipse, across the axes.
        let whitening = Whitening::of_covariance([0.2, 0.12, 0.15]);
        BundleObservation { pose: k, at, whitening, camera_jacobian, depth: None }
    };
    let observations: Vec<Vec<BundleObservation>> =
        (0..60).map(|i| (0..6).map(|k| observation(i, k)).collect()).collect();
    let landmarks = (0..60)
        .map(|i| Landmark::on_ray(&camera, poses[0], observations[i][0].at, 1.0 / points[i].z))
        .collect();
    (bundle(poses, 1, landmarks, observations), points)
}

/// A bundle with fixed intrinsics whose first `fixed` poses are fixed.
fn bundle(
    poses: Vec<Pose<f64>>,
    fixed: usize,
    landmarks: Vec<Landmark>,
    observations: Vec<Vec<BundleObservation>>,
) -> Bundle {
    Bundle {
        camera: camera(),
        fixed: (0..poses.len()).map(|i| i < fixed).collect(),
        poses,
        landmarks,
        observations: Arc::new(observations),
        relative_poses: Arc::default(),
        camera_change: [0.0; 2],
        free_intrinsics: FreeIntrinsics::None,
    }
}

fn disturbed(mut bundle: Bundle) -> Bundle {
    let n = noise(3, 60);
    for k in 1..6 {
        let by = std::array::from_fn(|i| 0.02 * n[6 * k + i]);
        bundle.poses[k] = bundle.poses[k].retract(Tangent::from_array(by));
    }
    for (landmark, n) in bundle.landmarks.iter_mut().zip(noise(4, 60)) {
        landmark.values[2] *= 1.0 + 0.2 * n;
    }
    bundle
}

#[test]
fn disturbed_poses_and_points_return() {
    let (truth, points) = scene(0.0);
    let mut bundle = disturbed(truth.clone());
    assert!(bundle.adjust(60, &Progress::default()) < 1e-12);
    let scale = bundle.poses[5].translation.norm() / truth.poses[5].translation.norm();
    for (found, point) in bundle.landmarks.iter().zip(points) {
        assert!((found.position() * scale.recip() - point).norm() < 1e-4);
    }
    for (found, pose) in bundle.poses.iter().zip(&truth.poses) {
        assert!((found.translation * scale.recip() - pose.translation).norm() < 1e-4);
    }
}

/// Error of the logarithm of the focal length and its claimed deviation, where observations have
/// `own` independent noise and `shared` noise common to all but the first of a point [px].
fn focal_error(seed: u64, own: f64, shared: f64) -> (f64, f64) {
    let (truth, _) = scene(0.0);
    let mut bundle = truth.clone();
    let errors = noise(100 + seed, 60 * 14);
    for (i, observations) in Arc::make_mut(&mut bundle.observations).iter_mut().enumerate() {
        for (k, observation) in observations.iter_mut().enumerate() {
            for axis in 0..2 {
                let common = if k > 0 { shared * errors[14 * i + 12 + axis] } else { 0.0 };
                observation.at[axis] += own * errors[14 * i + 2 * k + axis] + common;
            }
        }
    }
    (bundle.camera.fx, bundle.camera.fy, bundle.free_intrinsics) =
        (260.0, 260.0, FreeIntrinsics::FocalLength);
    bundle.adjust(60, &Progress::default());
    let deviation = bundle.camera_covariance().expect("defined")[0][0].sqrt();
    ((bundle.camera.fx / 250.0).ln(), deviation)
}

/// The deviation covers the error, also where residuals along a track are equal, and where they are
/// far smaller or larger than claimed.
#[test]
fn the_deviation_of_the_focal_length_covers_its_error() {
    for (own, shared) in [(0.3, 0.0), (0.05, 0.0), (0.1, 0.4), (1.5, 0.0)] {
        let all: Vec<(f64, f64)> = (0..40).map(|seed| focal_error(seed, own, shared)).collect();
        let rms = |of: &dyn Fn(&(f64, f64)) -> f64| {
            (all.iter().map(|a| of(a) * of(a)).sum::<f64>() / all.len() as f64).sqrt()
        };
        let (error, ratio) = (rms(&|a| a.0), rms(&|a| a.0 / a.1));
        assert!((0.5..1.4).contains(&ratio) && error > 1e-4, "{own} {shared}: {error} {ratio}");
    }
}

#[test]
fn the_gradient_agrees_with_differences() {
    let (bundle, _) = scene(4.0);
    let free_intrinsics = FreeIntrinsics::FocalLengthAndDistortion;
    let bundle = Bundle { free_intrinsics, camera_change: [0.02, -0.01], ..disturbed(bundle) };
    let sparsity = BlockSparsity::new(&bundle);
    let [gradient, of_smoothed] = [Curvature::Majorizing, Curvature::Smoothed]
        .map(|curvature| SchurSystem::new(&bundle, &sparsity, curvature).half_gradient(2));
    for (a, b) in gradient.iter().zip(&of_smoothed) {
        assert!((a - b).abs() <= 1e-9 * a.abs().max(1.0), "{a} {b}");
    }
    let f = |x: &[f64]| {
        let mut step = BundleStep {
            poses: vec![[0.0; 6]; 6],
            landmarks: vec![[0.0; 3]; 60],
            globals: [x[9], x[10], x[11]],
        };
        step.poses[1] = std::array::from_fn(|i| x[i]);
        step.landmarks[2] = std::array::from_fn(|i| x[6 + i]);
        0.5 * bundle.apply_step(&step).cost()
    };
    assert_gradient("bundle", &[0.0; 12], &gradient, 1e-6, 1e-6, f);
}

/// Steps of landmarks alone and of all parameters are accepted by one cost.
#[test]
fn weighted_residuals_have_the_cost_of_their_observations() {
    let (mut bundle, _) = scene(0.3);
    // The last pose looks back.
    let back = Rotation::exp(Vec3::new(0.0, std::f64::consts::PI, 0.0));
    bundle.poses[5].rotation = bundle.poses[5].rotation * back;
    let measured = Arc::make_mut(&mut bundle.observations)[1].iter_mut();
    measured.for_each(|o| o.depth = Some(DepthReading { inverse: 0.45, sigma: 0.01 }));
    let mut of_each = [0; 3];
    for (landmark, observations) in bundle.landmarks.iter().zip(bundle.observations.iter()) {
        for o in observations {
            let weighted = weighted_residual(&bundle, landmark, o, Curvature::Majorizing);
            of_each[weighted.as_ref().map_or(2, |w| w.rows - 2)] += 1;
            let cost = weighted.map_or_else(|| o.cost_behind_camera(), |w| w.cost);
            let due = bundle.observation_cost(landmark, o);
            assert!((cost - due).abs() <= 1e-9 * due.max(1.0), "{cost} for {due}");
        }
    }
    assert!(of_each.iter().all(|count| *count > 0), "{of_each:?}");
}

/// Residuals of a pose that all happen to be somewhat longer than the Huber threshold hold it still.
#[test]
fn residuals_beyond_the_threshold_hold_a_pose() {
    let scatter_of_last_pose = |offset: f64| {
        let (mut bundle, _) = scene(0.1);
        for (i, observations) in Arc::make_mut(&mut bundle.observations).iter_mut().enumerate() {
            let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
            let of_last = observations.iter_mut().filter(|o| o.pose == 5);
            of_last.for_each(|o| o.at = o.at.map(|v| v + sign * offset));
        }
        let scatter = bundle.pose_scatter(1.0).expect("determined");
        let squares = scatter.samples.iter().map(|sample| sample[5][0] * sample[5][0]);
        (squares.sum::<f64>() / scatter.samples.len() as f64).sqrt()
    };
    let [within, beyond] = [0.4, 0.8].map(scatter_of_last_pose);
    assert!(beyond > within && beyond < 8.0 * within, "{within} {beyond}");
}

/// A camera that goes round `count` poses, every one beginning `each` points that the next `seen`
/// poses observe; the last poses observe the points of the first if the path is `closed`.
fn round_trip(count: usize, each: usize, seen: usize, closed: bool) -> Bundle {
    let camera = camera();
    let pose = |i: usize| {
        let angle = std::f64::consts::TAU * i as f64 / count as f64;
        let place = Vec3::new(angle.cos(), 0.0, angle.sin()) * (0.02 * count as f64);
        // Looking outward, so that neighbours see the same points and others do not.
        Pose::new(Rotation::exp(Vec3::new(0.0, std::f64::consts::FRAC_PI_2 - angle, 0.0)), place)
    };
    let poses: Vec<_> = (0..count).map(pose).collect();
    let numbers = noise(7, 3 * count * each);
    let (mut landmarks, mut observations) = (Vec::new(), Vec::new());
    for (index, n) in numbers.chunks_exact(3).enumerate() {
        let begin = index / each;
        let mut by: Vec<usize> = (begin..begin + seen).collect();
        if closed {
            by.iter_mut().for_each(|pose| *pose %= count);
        }
        by.retain(|pose| *pose < count);
        by.sort_unstable();
        let depth = 3.0 + n[2];
        let at = [160.0 + 120.0 * n[0], 120.0 + 100.0 * n[1]];
        let landmark = Landmark::on_ray(&camera, poses[begin], at, depth.recip());
        let observation = |pose: usize| {
            let at = landmark.image_position(&camera, &poses[pose])?;
            Some(BundleObservation {
                pose,
                at,
                whitening: Whitening::isotropic(0.5),
                camera_jacobian: [[0.0; 2]; 2],
                depth: None,
            })
        };
        let all: Vec<BundleObservation> = by.into_iter().filter_map(observation).collect();
        if all.len() > 1 {
            landmarks.push(landmark);
            observations.push(all);
        }
    }
    bundle(poses, 2, landmarks, observations)
}

#[test]
fn a_thousand_poses_take_room_in_proportion_to_their_number() {
    for closed in [false, true] {
        let entries =
            |count: usize| BlockSparsity::new(&round_trip(count, 4, 10, closed)).block_count();
        let (few, many) = (entries(150), entries(1200));
        assert!(many < 9 * few, "{few} {many}");
        // A closed path is folded, which makes the band twice as wide.
        let widest = if closed { 22 } else { 11 };
        assert!(many <= widest * 1200, "{many}");
    }
}

#[test]
fn a_thousand_disturbed_poses_return() {
    let truth = round_trip(1000, 6, 12, true);
    let mut bundle = truth.clone();
    for (i, n) in noise(9, 6 * 998).chunks_exact(6).enumerate() {
        let by = std::array::from_fn(|k| 0.002 * n[k]);
        bundle.poses[2 + i] = bundle.poses[2 + i].retract(Tangent::from_array(by));
    }
    let cost = bundle.adjust(12, &Progress::default());
    assert!(cost < 1e-6, "{cost}");
    for (found, pose) in bundle.poses.iter().zip(&truth.poses) {
        assert!((found.translation - pose.translation).norm() < 1e-3);
    }
}
