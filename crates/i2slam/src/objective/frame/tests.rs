//! The whole chain, map to loss, against differences: poses, tone and response together.

use super::*;
use crate::objective::{BlurRoute, Sampling};
use i2slam_check::{central_differences, noise, relative_error};
use i2slam_formation::{CameraResponse, NodeSpacing, Quadrature, ShutterPoses, StartCurve};
use i2slam_geometry::Tangent;
use i2slam_radiance::View;
use i2slam_radiance::gaussian::{
    ColourActivation, Gaussian, GaussianMap, MapGradient, RasterSettings, Rasterizer, Shape,
};

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
fn evaluate(
    x: &[f64],
    (route, readout): (BlurRoute, f64),
    depth_pose: bool,
    mapping: bool,
) -> Evaluation {
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
    let lead = Tangent::from_array([0.03, -0.02, 0.04, 0.05, -0.04, 0.03]);
    let variables = FrameVariables {
        exposure: Exposure {
            shutter,
            sampling: Sampling {
                virtual_cameras: 3,
                quadrature: Quadrature::Midpoints,
                route,
                margin: 4,
            },
            readout: readout + x.get(16).unwrap_or(&0.0),
            depth_pose: depth_pose.then(|| shutter.middle().retract(lead)),
        },
        tone: Some(Tone { frame: tone, curve: &curve }),
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
    // Re-projection holds the depth that it looks up by fixed.
    let routes = [
        ((BlurRoute::Exact, 0.0), 5e-3),
        ((BlurRoute::Image, 0.0), 0.1),
        ((BlurRoute::Image, 0.8), 0.1),
    ];
    for (route, tolerance) in routes {
        for (depth_pose, mapping) in [(false, false), (true, false), (false, true), (true, true)] {
            check_gradient(route, tolerance, depth_pose, mapping);
        }
    }
}

fn check_gradient(route: (BlurRoute, f64), tolerance: f64, depth_pose: bool, mapping: bool) {
    let x = [0.0; 17];
    let evaluation = evaluate(&x, route, depth_pose, mapping);
    assert!(evaluation.pixels > 500);
    let mut analytic = evaluation.shutter.to_array().to_vec();
    analytic.extend(evaluation.tone.to_array().map(f64::from));
    analytic.push(evaluation.readout);
    let numeric = central_differences(&x, 2e-3, |x| evaluate(x, route, depth_pose, mapping).total);
    let groups = [0..3, 3..6, 6..9, 9..12, 12..16, 16..17];
    for group in groups.into_iter().take(if route.1 == 0.0 { 5 } else { 6 }) {
        let error = relative_error(&analytic[group.clone()], &numeric[group.clone()]);
        assert!(error < tolerance, "{route:?} {depth_pose} {mapping} {group:?} {error}");
    }
}

/// The routes are approximations of one integral.
#[test]
fn all_routes_blur_alike() {
    let curve = CameraResponse::<f32>::new(3, StartCurve::Srgb, NodeSpacing::Power(2.2)).curve();
    let shutter = ShutterPoses {
        start: Pose::identity(),
        end: Pose::identity().retract(Tangent::from_array([0.0, 0.0, 0.0, 0.06, 0.08, -0.02])),
    };
    let mut objective = FrameObjective::new(CAMERA, smooth());
    let mut predict = |shutter, (route, readout), virtual_cameras| {
        let sampling =
            Sampling { virtual_cameras, quadrature: Quadrature::Midpoints, route, margin: 8 };
        let variables = FrameVariables {
            exposure: Exposure { shutter, sampling, readout, depth_pose: None },
            tone: Some(Tone { frame: FrameTone::default(), curve: &curve }),
        };
        objective.predict(&map(), &variables).clone()
    };
    let error = |a: &Image<f32>, b: &Image<f32>| {
        let places = (0..24).flat_map(|row| (0..32).map(move |column| (row, column)));
        let square = |(row, column)| f64::from(a.at(1, column, row) - b.at(1, column, row)).powi(2);
        (places.map(square).sum::<f64>() / 768.0).sqrt()
    };
    let exact = predict(shutter, (BlurRoute::Exact, 0.0), 9);
    let still = ShutterPoses::still(shutter.middle());
    let sharp = error(&predict(still, (BlurRoute::Exact, 0.0), 1), &exact);
    let off = error(&predict(shutter, (BlurRoute::Image, 0.0), 9), &exact);
    assert!(off < 0.2 * sharp, "{off} {sharp}");
    let image = predict(shutter, (BlurRoute::Image, 1.0), 9);
    assert_eq!(predict(shutter, (BlurRoute::Exact, 1.0), 9), image);
    let exposure = Exposure {
        shutter,
        sampling: Sampling {
            virtual_cameras: 9,
            quadrature: Quadrature::Midpoints,
            route: BlurRoute::Image,
            margin: 8,
        },
        readout: 1.0,
        depth_pose: None,
    };
    let view = View { camera: CAMERA, world_from_camera: shutter.middle().cast() };
    let (mut moved, mut picture) = (Render::default(), Image::default());
    let motion = exposure.motion();
    Rasterizer::new(smooth()).render_moving(&map(), &view, &motion, None, &mut moved);
    let tone = Tone { frame: FrameTone::default(), curve: &curve };
    form(Some(&tone), &moved.radiance, &mut picture);
    let (off, rolled) = (error(&picture, &image), error(&picture, &exact));
    assert!(off < 0.2 * rolled, "rolling: {off} {rolled}");
}

#[test]
fn unrecorded_pixels_do_not_count() {
    let covered = Arc::new(Image { width: 32, height: 24, channels: 1, data: vec![false; 768] });
    let curve = CameraResponse::<f32>::new(3, StartCurve::Srgb, NodeSpacing::Uniform).curve();
    let variables = FrameVariables {
        exposure: Exposure {
            shutter: ShutterPoses::still(Pose::identity()),
            sampling: Sampling::SHARP,
            readout: 0.0,
            depth_pose: None,
        },
        tone: Some(Tone { frame: FrameTone::default(), curve: &curve }),
    };
    let mut objective = FrameObjective::new(CAMERA, smooth());
    objective.set_covered(covered);
    let mut d_map = MapGradient::new(60);
    objective.map(&map(), &observation(), &variables, 0.2, (0.5, 0.0), &mut d_map);
    assert!(d_map.colours.iter().flatten().all(|&g| g == 0.0));
}
