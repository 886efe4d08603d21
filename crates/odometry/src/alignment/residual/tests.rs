//! Vector lanes against the reference lane, the gradient against differences of the cost.

use super::level::{DepthSamples, roughness};
use super::*;
use i2slam_check::{central_differences, relative_error};
use i2slam_formation::{CameraResponse, CentreVelocity, FrameTone, NodeSpacing, StartCurve};
use i2slam_geometry::{Camera, Image, Rotation, Tangent, Vec3};

const SIZE: (usize, usize) = (48, 36);

fn picture(channels: usize, value: impl Fn(usize, f32, f32) -> f32) -> Image<f32> {
    Image::from_fn(SIZE.0, SIZE.1, channels, |channel, column, row| {
        value(channel, column as f32, row as f32)
    })
}

fn target() -> TargetLevel {
    TargetLevel::new(
        picture(3, |c, u, v| {
            0.3 + 0.1 * (0.35 * u + c as f32).sin() + 0.1 * (0.3 * v - 0.1 * u).cos()
        }),
        picture(1, |_, u, v| 2.0 + 0.01 * u - 0.006 * v),
    )
}

/// Depth away from the border, so that every residual stays while the camera moves.
fn frame() -> FrameLevel {
    let inside = |u: f32, v: f32| (8.0..40.0).contains(&u) && (8.0..28.0).contains(&v);
    FrameLevel::new(
        Camera { width: 48, height: 36, fx: 45.0, fy: 45.0, cx: 24.0, cy: 18.0 },
        picture(3, |c, u, v| 0.55 + 0.12 * (0.33 * u + c as f32).sin() + 0.1 * (0.3 * v).cos()),
        picture(1, |_, u, v| if inside(u, v) { 2.02 + 0.009 * u - 0.005 * v } else { 0.0 }),
        1,
    )
}

/// Motion, readout and tone of a frame.
struct State {
    motion: CentreVelocity<f64>,
    readout: f64,
    tone: FrameTone<f32>,
}

fn state(x: &[f64]) -> State {
    let start = CentreVelocity {
        // Between pixel centres: at one, a bilinear picture has a kink.
        centre: Pose::new(Rotation::identity(), Vec3::new(0.013, 0.017, 0.0)),
        velocity: Tangent::from_array([0.05, -0.02, 0.01, 0.01, 0.02, 0.015]),
    };
    let part = |from: usize| Tangent::from_array(std::array::from_fn(|i| x[from + i]));
    State {
        motion: start.retract(part(0), part(6)),
        readout: 1.6 + x[READOUT],
        tone: FrameTone {
            log_exposure: x[12] as f32,
            log_white_balance: [x[13] as f32, x[14] as f32, x[15] as f32],
        },
    }
}

/// Levels, exposure and weights of one evaluation.
struct Case<'a> {
    target: TargetLevel,
    frame: FrameLevel,
    curve: Option<&'a ResponseCurve<f32>>,
    cameras: usize,
    image_weight: f32,
    lead: f64,
    rolling: bool,
}

impl<'a> Case<'a> {
    fn smooth(curve: Option<&'a ResponseCurve<f32>>, image_weight: f32) -> Self {
        let (target, frame) = (target(), frame());
        Self { target, frame, curve, cameras: 3, image_weight, lead: 0.0, rolling: false }
    }

    fn task<'b>(&'b self, state: &State) -> Linearization<'b> {
        let lead = Tangent::from_array([0.02, -0.03, 0.04, 0.005, 0.01, -0.01]);
        Linearization {
            target: &self.target,
            frame: &self.frame,
            target_from_world: Pose::identity(),
            motion: state.motion,
            readout: state.readout,
            tone: state.tone,
            curve: self.curve,
            cameras: self.cameras,
            target_rows: self
                .rolling
                .then_some(TargetRows { motion: lead.scaled(0.3), height: 36.0 }),
            rolling_height: self.rolling.then_some(36.0),
            quadrature: Quadrature::Midpoints,
            world_from_depth: state.motion.centre.retract(lead.scaled(self.lead)),
            depth_offset_ratio: self.lead,
            scales: RobustScales { depth: 0.02, image: 0.1 },
            image_weight: self.image_weight,
            derivatives: Derivatives::All,
        }
    }

    fn sums(&self, x: &[f64]) -> ResidualSums {
        self.task(&state(x)).accumulate()
    }
}

/// `2 Σ w r j` is the derivative of the cost, up to kinks of the bilinear pictures and the
/// neglected `J_l(s ω)`.
#[test]
fn gradient_agrees_with_differences_of_the_cost() {
    let curve = CameraResponse::<f32>::new(3, StartCurve::Srgb, NodeSpacing::Power(2.2)).curve();
    let x = [0.0; UNKNOWNS];
    let cases = [
        (None, 0.0, None),
        (None, 1.0, None),
        (Some(&curve), 1.0, None),
        (None, 1.0, Some(1)),
        (Some(&curve), 1.0, Some(3)),
    ];
    for (curve, image_weight, rolling) in cases {
        let mut case = Case::smooth(curve, image_weight);
        case.rolling = rolling.is_some();
        case.cameras = rolling.unwrap_or(case.cameras);
        let at_x = case.sums(&x);
        assert!(at_x.errors.depth_count > 500);
        let numeric = central_differences(&x, 2e-4, |x| case.sums(x).equations.cost);
        let analytic: Vec<f64> = at_x.equations.gradient.iter().map(|g| 2.0 * g).collect();
        for group in [0..3, 3..6, 6..9, 9..12, 12..16, 16..17] {
            let error = relative_error(&analytic[group.clone()], &numeric[group.clone()]);
            assert!(error < 0.03, "{group:?} {error} {analytic:?} {numeric:?}");
        }
    }
}

/// Edges, holes and a hidden corner, up to the border.
fn rough_case(curve: Option<&ResponseCurve<f32>>, cameras: usize, lead: f64) -> Case<'_> {
    let depth = |u: f32, v: f32| {
        let step = if (15.0..25.0).contains(&u) { -0.4 } else { 0.0 };
        let hole = ((u * 3.0 + v * 7.0) as usize).is_multiple_of(11);
        if hole { 0.0 } else { 1.5 + step + 0.02 * v + 0.003 * (u * v).sin() }
    };
    let smooth = Case::smooth(curve, 0.4);
    let camera = smooth.frame.camera;
    let frame = FrameLevel::new(camera, smooth.frame.colour, picture(1, |_, u, v| depth(u, v)), 1);
    let far = |u: f32, v: f32| if u + v < 12.0 { 9.0 } else { 0.01 + 1.5 + 0.02 * v };
    let target = TargetLevel::new(
        smooth.target.radiance,
        picture(1, |_, u, v| if (15.0..25.0).contains(&u) { depth(u, v) } else { far(u, v) }),
    );
    Case { target, frame, curve, cameras, image_weight: 0.4, lead, rolling: false }
}

/// Largest difference of cost, gradient and Hessian, each entry relative to its unknowns' own size.
fn worst(lanes: &Equations, pixels: &Equations) -> f64 {
    let size = |a: usize| pixels.hessian[a][a].sqrt().max(1e-9);
    let root = pixels.cost.sqrt();
    let mut worst = (lanes.cost / pixels.cost - 1.0).abs();
    let all = lanes.hessian.as_flattened().iter().chain(&lanes.gradient);
    assert!(all.clone().all(|v| v.is_finite()));
    for a in 0..UNKNOWNS {
        let gradient = lanes.gradient[a] - pixels.gradient[a];
        worst = worst.max(gradient.abs() / (size(a) * root));
        for b in a..UNKNOWNS {
            let entry = lanes.hessian[a][b] - pixels.hessian[a][b];
            worst = worst.max(entry.abs() / (size(a) * size(b)));
        }
    }
    worst
}

#[test]
fn lanes_agree_with_the_reference() {
    let curve = CameraResponse::<f32>::new(3, StartCurve::Srgb, NodeSpacing::Power(2.5)).curve();
    let x: [f64; UNKNOWNS] = std::array::from_fn(|i| 0.002 * (i as f64 - 7.0));
    let state = state(&x);
    let cases = [
        (None, 1, 0.0, false),
        (Some(&curve), 1, 0.3, false),
        (Some(&curve), 5, -0.4, false),
        (None, 1, 0.0, true),
        (Some(&curve), 5, 0.2, true),
    ];
    for (curve, cameras, lead, rolling) in cases {
        let case = Case { rolling, ..rough_case(curve, cameras, lead) };
        let mut task = case.task(&state);
        let (lanes, pixels) = (task.accumulate(), task.accumulate_pixels());
        assert_eq!(lanes.candidates, pixels.candidates);
        assert_eq!(lanes.agreeing, pixels.agreeing);
        assert_eq!(lanes.equations.count, pixels.equations.count);
        assert!(lanes.agreeing > 500 && lanes.agreeing < lanes.candidates - 100);
        assert!(pixels.errors.image_count > 3 * 500);
        let error = worst(&lanes.equations, &pixels.equations);
        assert!(error < 1e-4, "{cameras} {lead}: {error}");
        for (a, b) in
            [(lanes.errors.depth, pixels.errors.depth), (lanes.errors.image, pixels.errors.image)]
        {
            assert!((a / b - 1.0).abs() < 1e-5, "{a} {b}");
        }
        task.derivatives = Derivatives::None;
        let bare = task.accumulate();
        assert_eq!(bare.equations.cost, lanes.equations.cost);
        assert_eq!(bare.errors, lanes.errors);
    }
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let case = rough_case(None, 3, 0.1);
    let state = state(&[0.001; UNKNOWNS]);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.expect("threads").install(|| case.task(&state).accumulate().equations)
    };
    let (one, three) = (run(1), run(3));
    assert_eq!((one.hessian, one.gradient, one.cost), (three.hessian, three.gradient, three.cost));
}

/// Samples do not depend on where blocks end.
#[test]
fn every_other_pixel_is_a_quarter_of_them() {
    let case = rough_case(None, 1, 0.0);
    let FrameLevel { camera, depth, .. } = &case.frame;
    let roughness = roughness(depth);
    let some = DepthSamples::new(camera, depth, &roughness, 2);
    let expected = (0..SIZE.1).step_by(2).flat_map(|row| {
        (0..SIZE.0).step_by(2).map(move |column| depth.at(0, column, row)).filter(|&z| z > 0.0)
    });
    let z = some.blocks.iter().flat_map(|block| block.point[2].0);
    assert!(z.filter(|&z| z > 0.0).eq(expected));
}

/// A target without depth sees every point in view, by picture alone.
#[test]
fn lanes_agree_with_the_reference_before_a_target_without_depth() {
    let mut case = rough_case(None, 3, 0.0);
    case.target = TargetLevel::new(target().radiance, Image::default());
    let state = state(&[0.001; UNKNOWNS]);
    let task = case.task(&state);
    let (lanes, pixels) = (task.accumulate(), task.accumulate_pixels());
    assert_eq!((lanes.agreeing, lanes.errors.depth_count), (pixels.agreeing, 0));
    assert!(pixels.errors.image_count > 3 * 500);
    assert!(worst(&lanes.equations, &pixels.equations) < 1e-4);
}

/// Tiles hold every sample once, and their sums add up to those of all.
#[test]
fn tiles_add_up_to_the_picture() {
    let case = rough_case(None, 1, 0.0);
    let state = state(&[0.001; UNKNOWNS]);
    let task = case.task(&state);
    let tiles = case.frame.tiles(1, [5, 3]);
    let mut sum = ResidualSums::default();
    tiles.iter().for_each(|tile| sum.merge(&task.accumulate_over(tile)));
    let all = task.accumulate();
    assert_eq!((sum.candidates, sum.agreeing), (task.frame.samples.count, all.agreeing));
    assert!(worst(&sum.equations, &all.equations) < 1e-5);
}
