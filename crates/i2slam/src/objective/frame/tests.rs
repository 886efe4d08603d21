//! The whole chain, map to loss, against differences: poses, tone and response together.

use super::*;
use i2slam_check::{central_differences, noise, relative_error};
use i2slam_formation::{CameraResponse, NodeSpacing, StartCurve};
use i2slam_geometry::Tangent;
use i2slam_radiance::gaussian::{ColourActivation, Gaussian, Shape};

const CAMERA: Camera<f32> =
    Camera { width: 32, height: 24, fx: 30.0, fy: 30.0, cx: 16.0, cy: 12.0 };

/// Broad, overlapping Gaussians, so that pictures are smooth, at depths so far apart that no
/// rotation of the test changes their order.
fn map() -> GaussianMap {
    let mut map = GaussianMap::new(Shape::Isotropic, ColourActivation::Exponential);
    let random = noise(5, 60 * 7);
    for (i, n) in random.chunks_exact(7).enumerate() {
        let n: Vec<f32> = n.iter().map(|&v| v as f32).collect();
        map.push(Gaussian {
            mean: [1.2 * n[0], 0.9 * n[1], 2.0 + 0.03 * i as f32],
            log_scale: [-1.6; 3],
            rotation: [1.0, 0.0, 0.0, 0.0],
            opacity_logit: n[3],
            colour: [-1.5 + 0.5 * n[4], -1.5 + 0.5 * n[5], -1.5 + 0.5 * n[6]],
        });
    }
    map
}

/// Far from every prediction, so that no difference changes its sign.
fn observation() -> Observation {
    let (mut colour, mut depth) = (Image::new(32, 24, 3), Image::new(32, 24, 1));
    colour.data.fill(0.95);
    depth.data.fill(4.0);
    Observation::new(colour, depth)
}

fn smooth() -> RasterSettings {
    RasterSettings { alpha_min: 1e-7, transmittance_min: 0.0, ..RasterSettings::default() }
}

/// Start pose, end pose, log exposure and log white balance as one vector.
fn evaluate(x: &[f64], depth_pose: bool, mapping: bool) -> Evaluation {
    let curve = CameraResponse::<f32>::new(3, StartCurve::Srgb, NodeSpacing::Power(2.2)).curve();
    let part = |from: usize| Tangent::from_array(std::array::from_fn(|i| x[from + i]));
    let base = ShutterPoses {
        start: Pose::identity(),
        end: Pose::identity().retract(Tangent::from_array([0.02, -0.03, 0.01, 0.02, 0.03, -0.01])),
    };
    let shutter =
        ShutterPoses { start: base.start.retract(part(0)), end: base.end.retract(part(6)) };
    let tone = FrameTone {
        log_exposure: x[12] as f32,
        log_white_balance: [x[13] as f32, x[14] as f32, x[15] as f32],
    };
    let variables = FrameVariables {
        shutter,
        tone: Some(Tone { frame: tone, curve: &curve }),
        virtual_cameras: 3,
        quadrature: Quadrature::Midpoints,
        depth_pose: depth_pose.then(|| shutter.middle()),
    };
    let mut objective = FrameObjective::new(CAMERA, smooth());
    let mut d_map = MapGradient::new(60);
    if mapping {
        objective.map(&map(), &observation(), &variables, 0.2, (0.5, 1.0), &mut d_map)
    } else {
        objective.track(&map(), &observation(), &variables, 0.0, (0.5, 1.0))
    }
}

#[test]
fn gradients_agree_with_differences_of_the_objective() {
    let x = [0.0; 16];
    for (depth_pose, mapping) in [(false, false), (true, false), (false, true), (true, true)] {
        let evaluation = evaluate(&x, depth_pose, mapping);
        assert!(evaluation.pixels > 500);
        let mut analytic = evaluation.shutter.to_array().to_vec();
        analytic.extend(evaluation.tone.to_array().map(f64::from));
        let numeric = central_differences(&x, 2e-3, |x| evaluate(x, depth_pose, mapping).total);
        for group in [0..3, 3..6, 6..9, 9..12, 12..16] {
            let error = relative_error(&analytic[group.clone()], &numeric[group.clone()]);
            assert!(error < 5e-3, "{depth_pose} {mapping} {group:?} {error}");
        }
    }
}

#[test]
fn unrecorded_pixels_do_not_count() {
    let covered = Arc::new(Image { width: 32, height: 24, channels: 1, data: vec![false; 768] });
    let curve = CameraResponse::<f32>::new(3, StartCurve::Srgb, NodeSpacing::Uniform).curve();
    let variables = FrameVariables {
        shutter: ShutterPoses::still(Pose::identity()),
        tone: Some(Tone { frame: FrameTone::default(), curve: &curve }),
        virtual_cameras: 1,
        quadrature: Quadrature::Midpoints,
        depth_pose: None,
    };
    let mut objective = FrameObjective::new(CAMERA, smooth());
    objective.set_covered(covered);
    let mut d_map = MapGradient::new(60);
    objective.map(&map(), &observation(), &variables, 0.2, (0.5, 0.0), &mut d_map);
    assert!(d_map.colours.iter().flatten().all(|&g| g == 0.0));
}
