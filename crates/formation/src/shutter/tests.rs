use super::{CentreVelocity, Quadrature, ShutterPoses, ShutterTangent};
use i2slam_check::{assert_close, assert_gradient, noise};
use i2slam_geometry::{Pose, Rotation, Tangent, Vec3};

fn tangent(values: &[f64]) -> Tangent<f64> {
    Tangent::from_array(std::array::from_fn(|i| values[i]))
}

fn shutter_tangent(values: &[f64]) -> ShutterTangent<f64> {
    ShutterTangent::from_array(std::array::from_fn(|i| values[i]))
}

fn base() -> Pose<f64> {
    Pose::new(Rotation::exp(Vec3::new(0.4, -0.9, 0.3)), Vec3::new(1.0, -2.0, 0.5))
}

/// Shutter poses from no motion to more than a quarter turn.
fn examples() -> Vec<ShutterPoses<f64>> {
    [0.0, 1e-9, 1e-4, 0.05, 0.8, 1.2]
        .iter()
        .zip(1..)
        .map(|(&size, seed)| {
            let motion = tangent(&noise(seed, 6)).scaled(size);
            ShutterPoses { start: base(), end: base().retract(motion) }
        })
        .collect()
}

/// A smooth scalar of a pose whose gradient in the pose's own tangent is `weights`.
fn probe(at: Pose<f64>, pose: Pose<f64>, weights: &[f64]) -> f64 {
    at.local(pose).to_array().iter().zip(weights).map(|(a, w)| a * w).sum()
}

/// Moments beyond the mean weigh as in the integral: exactly so up to the third power.
#[test]
fn simpson_integrates_cubics() {
    let shutter = ShutterPoses::still(base());
    for count in [3, 5, 9] {
        let cameras = shutter.virtual_cameras(count, Quadrature::Simpson);
        for power in 0..4 {
            let sum: f64 = cameras.iter().map(|c| c.weight * c.u.powi(power)).sum();
            assert!((sum - 1.0 / f64::from(power + 1)).abs() < 1e-15, "{count} {power} {sum}");
        }
    }
    let three = shutter.virtual_cameras(3, Quadrature::Simpson);
    assert_eq!([0, 1, 2].map(|j| three[j].u), [0.0, 0.5, 1.0]);
    for count in [1, 2, 4] {
        let [even, midpoints] = [Quadrature::Simpson, Quadrature::Midpoints]
            .map(|quadrature| shutter.virtual_cameras(count, quadrature));
        assert_eq!(even, midpoints);
    }
}

#[test]
fn pull_back_agrees_with_differences() {
    for (shutter, seed) in examples().into_iter().zip(10..) {
        for u in [0.0, 0.25, 0.5, 0.9, 1.0] {
            let weights = noise(seed, 6);
            let gradient = shutter.pull_back(u, tangent(&weights)).to_array();
            assert_gradient("shutter", &[0.0; 12], &gradient, 1e-3, 1e-6, |x| {
                probe(shutter.at(u), shutter.retract(&shutter_tangent(x)).at(u), &weights)
            });
        }
    }
}

#[test]
fn centre_velocity_pull_back_agrees_with_differences() {
    for (shutter, seed) in examples().into_iter().zip(30..) {
        let motion = CentreVelocity::from(shutter);
        let shutter = ShutterPoses::from(motion);
        let weights = noise(seed, 12);
        let (d_centre, d_velocity) = motion.pull_back(shutter_tangent(&weights));
        let gradient = [d_centre.to_array(), d_velocity.to_array()].concat();
        assert_gradient("centre and velocity", &[0.0; 12], &gradient, 1e-3, 1e-6, |x| {
            let moved = ShutterPoses::from(motion.retract(tangent(&x[..6]), tangent(&x[6..])));
            probe(shutter.start, moved.start, &weights[..6])
                + probe(shutter.end, moved.end, &weights[6..])
        });
    }
}

#[test]
fn centre_velocity_round_trip_is_exact() {
    for shutter in examples() {
        let motion = CentreVelocity::from(shutter);
        let back = ShutterPoses::from(motion);
        let d = ShutterTangent {
            start: shutter.start.local(back.start),
            end: shutter.end.local(back.end),
        };
        assert_close("round trip", &d.to_array().map(|v| 1.0 + v), &[1.0; 12], 1e-12);
        let middle = back.middle().local(motion.centre).to_array();
        assert_close("middle", &middle.map(|v| 1.0 + v), &[1.0; 6], 1e-12);
    }
}

#[test]
fn virtual_cameras_span_the_exposure_with_weights_that_sum_to_one() {
    let shutter = examples()[4];
    for count in [0, 1, 2, 5, 16] {
        let cameras = shutter.virtual_cameras(count, Quadrature::Endpoints);
        assert_eq!(cameras.len(), count.max(1));
        let sum: f64 = cameras.iter().map(|c| c.weight).sum();
        assert!((sum - 1.0).abs() < 1e-14);
        assert!(cameras.iter().all(|c| c.world_from_camera == shutter.at(c.u)));
        let moments: f64 = cameras.iter().map(|c| c.u * c.weight).sum();
        assert!((moments - 0.5).abs() < 1e-14, "the exposure is centred");
    }
    let cameras = shutter.virtual_cameras(5, Quadrature::Endpoints);
    assert_eq!((cameras[0].u, cameras[1].u, cameras[4].u), (0.0, 0.25, 1.0));
    assert_eq!(shutter.virtual_cameras(1, Quadrature::Endpoints)[0].u, 0.5);
}

#[test]
fn cotangents_of_both_charts_carry_over_both_ways() {
    for (shutter, seed) in examples().into_iter().zip(70..) {
        let motion = CentreVelocity::from(shutter);
        let d_shutter: [f64; 12] = std::array::from_fn(|i| noise(seed, 12)[i]);
        let (d_centre, d_velocity) = motion.pull_back(shutter_tangent(&d_shutter));
        let back = motion.pull_back_to_shutter(d_centre, d_velocity).to_array();
        assert_close("shutter", &back, &d_shutter, 1e-10);
    }
}

#[test]
fn a_start_along_the_trajectory_lies_on_it() {
    let [previous, centre] = [base(), base().retract(tangent(&noise(4, 6)).scaled(0.3))];
    let shutter = ShutterPoses::from(CentreVelocity::along(previous, centre, 0.1));
    let on_the_way = |u: f64| previous.interpolate(centre, u);
    for (pose, u) in [(shutter.start, 0.95), (shutter.middle(), 1.0), (shutter.end, 1.05)] {
        let d = on_the_way(u).local(pose);
        assert!(d.translation.norm() + d.rotation.norm() < 1e-12, "{u}");
    }
}

#[test]
fn samples_have_the_documented_variance() {
    let still = ShutterPoses::still(base());
    for count in [2, 3, 5, 9] {
        let n = count as f64;
        let cases = [
            (Quadrature::Endpoints, (n + 1.0) / (n - 1.0)),
            (Quadrature::Midpoints, 1.0 - 1.0 / (n * n)),
        ];
        for (quadrature, factor) in cases {
            let cameras = still.virtual_cameras(count, quadrature);
            let variance: f64 = cameras.iter().map(|c| c.weight * (c.u - 0.5).powi(2)).sum();
            assert!((variance - factor / 12.0).abs() < 1e-12, "{quadrature:?} {count}");
        }
    }
}
