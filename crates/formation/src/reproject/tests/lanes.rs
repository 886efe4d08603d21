//! The fast lane against the reference, on any number of threads and on anything odd.

use super::{Scene, camera, moving};
use super::{narrow, wide};
use crate::reproject::{ReferenceReprojection, Reprojection, ReprojectionGradient};
use crate::shutter::{Quadrature, ShutterPoses};
use i2slam_check::{assert_close, noise, relative_error};
use i2slam_geometry::{Camera, Image};

const MOTION: [f64; 6] = [0.04, -0.03, 0.03, 0.02, 0.015, -0.03];

struct Frame {
    camera: Camera<f32>,
    radiance: Image<f32>,
    depth: Image<f32>,
    d_blurred: Image<f32>,
}

impl Frame {
    fn new(width: usize, height: usize) -> Self {
        Self::with_margin(width, height, 0)
    }

    fn with_margin(width: usize, height: usize, margin: usize) -> Self {
        let camera = camera(width, height);
        let wide = camera.widened(margin);
        let (radiance, depth) = Scene::new(&camera, 5.0).render(&wide, &moving(MOTION).middle(), 1);
        let weights = noise(9, 3 * width * height).iter().map(|&v| v as f32).collect();
        let d_blurred = Image { data: weights, width, height, channels: 3 };
        let (radiance, depth) = (narrow(&radiance), narrow(&depth));
        Self { camera: camera.cast(), radiance, depth, d_blurred }
    }

    fn run(
        &self,
        reprojection: &mut Reprojection,
        shutter: &ShutterPoses<f64>,
        (views, readout): (usize, f64),
    ) -> (Image<f32>, Image<f32>, ReprojectionGradient) {
        let (mut blurred, mut d_radiance) = (Image::default(), Image::default());
        let plan = Quadrature::Endpoints;
        let (camera, radiance, depth) = (&self.camera, &self.radiance, &self.depth);
        reprojection.blur(camera, shutter, readout, views, plan, radiance, depth, &mut blurred);
        let d_shutter = reprojection.pull_back(&self.d_blurred, &mut d_radiance);
        (blurred, d_radiance, d_shutter)
    }
}

#[test]
fn fast_lane_follows_the_reference() {
    let mut most = 0.0;
    let all = [(1, 0.0), (2, 0.0), (5, 0.0), (1, 1.5), (4, -0.8)];
    for (width, height, margin) in [(90, 70, 0), (33, 100, 0), (64, 76, 8), (90, 70, 3)] {
        let frame = Frame::with_margin(width, height, margin);
        for (views, readout) in all {
            let shutter = moving(MOTION);
            let mut fast = Reprojection::default();
            let (blurred, d_radiance, d_shutter) = frame.run(&mut fast, &shutter, (views, readout));
            let reference = ReferenceReprojection::new(
                &frame.camera,
                &shutter,
                readout,
                views,
                Quadrature::Endpoints,
                &frame.radiance,
                &frame.depth,
            );
            let (expected, d_shutter_expected) = reference.pull_back(&frame.d_blurred);
            let name = format!("{width} x {height} + {margin}, {views}, {readout}");
            let shares = reference.uncovered();
            let moves = views > 1 || readout != 0.0;
            let shown = if moves { &shares[..] } else { &[] };
            assert_eq!(fast.uncovered().len(), shown.len());
            most = shown.iter().copied().fold(most, f32::max);
            for (k, (a, b)) in fast.uncovered().iter().zip(shown).enumerate() {
                assert!((a - b).abs() < 1e-3, "uncovered, {name}, tile {k}: {a} {b}");
            }
            let picture = wide(&reference.blur()).data;
            assert_close(&format!("picture, {name}"), &wide(&blurred).data, &picture, 2e-4);
            let (a, b) = (wide(&d_radiance).data, wide(&expected).data);
            assert_close(&format!("radiance, {name}"), &a, &b, 2e-4);
            let (a, b) = (d_shutter.shutter.to_array(), d_shutter_expected.shutter.to_array());
            // Beyond the exposure the shares of start and end are large and of opposite sign.
            let tolerance = if readout == 0.0 { 2e-4 } else { 3e-3 };
            assert_close(&format!("shutter, {name}"), &a, &b, tolerance);
            let (a, b) = (d_shutter.readout, d_shutter_expected.readout);
            assert_close(&format!("readout, {name}"), &[a], &[b], 2e-3);
        }
    }
    assert!(most > 1e-3, "nothing is uncovered: {most}");
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let frame = Frame::with_margin(60, 170, 5);
    let run = |threads, readout| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        let shutter = moving(MOTION);
        pool.expect("a pool")
            .install(|| frame.run(&mut Reprojection::default(), &shutter, (5, readout)))
    };
    for readout in [0.0, 1.2] {
        let one = run(1, readout);
        assert!(one.2.shutter.to_array().iter().all(|v| v.is_finite() && *v != 0.0));
        for threads in [2, 3, 7] {
            assert!(run(threads, readout) == one, "{threads} threads");
        }
    }
}

#[test]
fn buffers_of_another_frame_leave_no_trace() {
    let (small, large) = (Frame::new(40, 31), Frame::with_margin(75, 90, 9));
    let mut used = Reprojection::default();
    large.run(&mut used, &moving(MOTION), (9, 0.5));
    let shutter = moving(MOTION.map(|v| -0.5 * v));
    let expected = small.run(&mut Reprojection::default(), &shutter, (4, 0.0));
    assert!(small.run(&mut used, &shutter, (4, 0.0)) == expected);
}

#[test]
fn a_still_camera_sees_the_sharp_render() {
    let frame = Frame::new(50, 40);
    let still = ShutterPoses::still(moving(MOTION).middle());
    let (blurred, d_radiance, _) = frame.run(&mut Reprojection::default(), &still, (5, 1.0));
    let (a, b) = (wide(&blurred).data, wide(&frame.radiance).data);
    assert_close("picture", &a, &b, 1e-4);
    let (a, b) = (wide(&d_radiance).data, wide(&frame.d_blurred).data);
    assert_close("cotangent", &a, &b, 1e-4);
    let one = frame.run(&mut Reprojection::default(), &moving(MOTION), (1, 0.0));
    assert_eq!(one.0, frame.radiance);
    assert_eq!(one.2, ReprojectionGradient::default());
}

#[test]
fn without_motion_the_margin_is_cropped() {
    let wide = Frame::with_margin(50, 40, 6);
    let (blurred, d_radiance, _) =
        wide.run(&mut Reprojection::default(), &moving(MOTION), (1, 0.0));
    let frame = Frame::new(50, 40);
    let (a, b) = (super::wide(&blurred).data, super::wide(&frame.radiance).data);
    assert_close("picture", &a, &b, 1e-5);
    let sum = |image: &Image<f32>| image.data.iter().map(|&v| f64::from(v)).sum::<f64>();
    assert_eq!((d_radiance.width, d_radiance.height), (62, 52));
    assert!((sum(&d_radiance) - sum(&wide.d_blurred)).abs() < 1e-6);
    assert_eq!(d_radiance.at(1, 6, 6), wide.d_blurred.at(1, 0, 0));
}

#[test]
fn unknown_depth_is_filled_from_its_row_or_far_away() {
    let mut frame = Frame::new(80, 60);
    let translation = moving([0.05, -0.03, 0.01, 0.0, 0.0, 0.0]);
    let full = frame.run(&mut Reprojection::default(), &translation, (5, 0.0)).0;
    for (i, z) in frame.depth.data.iter_mut().enumerate() {
        *z = match i % 41 {
            0 => 0.0,
            13 => f32::NAN,
            20 => -1.0,
            _ => *z,
        };
    }
    let holes = frame.run(&mut Reprojection::default(), &translation, (5, 0.0)).0;
    assert!(relative_error(&wide(&holes).data, &wide(&full).data) < 0.25);
    let squares: f32 = holes.data.iter().zip(&full.data).map(|(a, b)| (a - b) * (a - b)).sum();
    assert!((squares / full.data.len() as f32).sqrt() < 0.01, "{squares}");
    frame.depth.data.fill(0.0);
    let far = frame.run(&mut Reprojection::default(), &translation, (5, 0.0)).0;
    assert_close("far", &wide(&far).data, &wide(&frame.radiance).data, 1e-4);
}

#[test]
fn nothing_odd_panics() {
    let shutters = [
        moving(MOTION),
        moving([f64::NAN; 6]),
        moving([1e9, -1e9, 5.0, 1.0, 1.0, 1.0]),
        moving([0.0, 0.0, 0.0, 0.0, 3.0, 0.0]),
    ];
    for (width, height) in [(1, 1), (3, 2), (1, 50), (17, 1), (0, 0), (40, 41)] {
        let mut frame = Frame::new(width, height);
        for shutter in &shutters {
            for z in [2.0, 0.0, f32::NAN, f32::MIN_POSITIVE, f32::INFINITY] {
                frame.depth.data.iter_mut().step_by(3).for_each(|v| *v = z);
                for readout in [0.0, 1.0, f64::NAN] {
                    let (blurred, d_radiance, _) =
                        frame.run(&mut Reprojection::default(), shutter, (5, readout));
                    assert_eq!(blurred.data.len(), 3 * width * height);
                    assert_eq!(d_radiance.data.len(), 3 * width * height);
                }
            }
        }
    }
}
