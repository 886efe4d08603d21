//! The backward lane of the reference against central differences, in `f64`.

use super::{Scene, camera, moving};
use crate::reproject::{ReferenceReprojection, ReprojectionGradient};
use crate::shutter::{Quadrature, ShutterPoses, ShutterTangent};
use i2slam_check::{assert_close, assert_gradient, central_differences, noise};
use i2slam_geometry::{Camera, Image, Pose, Tangent};

const MOTION: [f64; 6] = [0.09, -0.06, 0.05, 0.04, 0.03, -0.06];
/// Short enough that no tap crosses from one cell of the grid to the next.
const STEP: f64 = 1e-7;

struct Case {
    camera: Camera<f64>,
    /// Pixels that the render has more than the picture on every side.
    margin: usize,
    scene: Scene,
    views: usize,
    weights: Vec<f64>,
    shutter: ShutterPoses<f64>,
    readout: f64,
}

impl Case {
    fn new(scene: fn(&Camera<f64>, f64) -> Scene, views: usize, seed: u64) -> Self {
        let camera = camera(22, 17);
        let scene = scene(&camera, 5.0);
        let weights = noise(seed, 3 * camera.pixels());
        let shutter = moving(MOTION);
        Self { camera, margin: 0, scene, views, weights, shutter, readout: 0.0 }
    }

    /// With a rolling shutter of `readout` exposures.
    fn rolling(self, readout: f64) -> Self {
        Self { readout, ..self }
    }

    fn with_margin(self, margin: usize) -> Self {
        Self { margin, ..self }
    }

    fn seen(&self, pose: &Pose<f64>) -> (Image<f64>, Image<f64>) {
        self.scene.render(&self.camera.widened(self.margin), pose, 1)
    }

    fn sharp(&self, shutter: &ShutterPoses<f64>) -> (Image<f64>, Image<f64>) {
        self.seen(&shutter.middle())
    }

    fn reprojection(
        &self,
        shutter: &ShutterPoses<f64>,
        radiance: &Image<f64>,
        depth: &Image<f64>,
    ) -> ReferenceReprojection<f64> {
        ReferenceReprojection::new(
            &self.camera,
            shutter,
            self.readout,
            self.views,
            Quadrature::Endpoints,
            radiance,
            depth,
        )
    }

    fn loss(&self, shutter: &ShutterPoses<f64>, radiance: &Image<f64>, depth: &Image<f64>) -> f64 {
        let blurred = self.reprojection(shutter, radiance, depth).blur();
        blurred.data.iter().zip(&self.weights).map(|(b, w)| b * w).sum()
    }

    fn pull_back(&self) -> (Image<f64>, ReprojectionGradient) {
        let (radiance, depth) = self.sharp(&self.shutter);
        let Camera { width, height, .. } = self.camera;
        let d_blurred = Image { data: self.weights.clone(), width, height, channels: 3 };
        self.reprojection(&self.shutter, &radiance, &depth).pull_back(&d_blurred)
    }

    fn moved(&self, x: &[f64]) -> ShutterPoses<f64> {
        self.shutter.retract(&ShutterTangent::from_array(std::array::from_fn(|i| x[i])))
    }

    /// The gradient through the sharp render, as a renderer would return it, on the shutter.
    fn through_render(&self, d_radiance: &Image<f64>) -> ShutterTangent<f64> {
        let middle = self.shutter.middle();
        let d_pose = central_differences(&[0.0; 6], 1e-4, |x| {
            let pose = middle.retract(Tangent::from_array(std::array::from_fn(|i| x[i])));
            let (radiance, _) = self.seen(&pose);
            radiance.data.iter().zip(&d_radiance.data).map(|(r, d)| r * d).sum()
        });
        self.shutter.pull_back(0.5, Tangent::from_array(std::array::from_fn(|i| d_pose[i])))
    }
}

/// The blur is linear in the render: its transpose is right if both sides agree on any render.
#[test]
fn pull_back_is_the_transpose() {
    let cases = [
        Case::new(Scene::new, 5, 1),
        Case::new(Scene::wall, 2, 2),
        Case::new(Scene::new, 5, 8).with_margin(4),
        Case::new(Scene::new, 3, 8).rolling(1.4),
        Case::new(Scene::new, 3, 8).rolling(-0.7).with_margin(3),
    ];
    for (case, seed) in cases.iter().zip(20..) {
        let (radiance, depth) = case.sharp(&case.shutter);
        let (d_radiance, _) = case.pull_back();
        for seed in [seed, seed + 10, seed + 20] {
            let other = Image { data: noise(seed, radiance.data.len()), ..radiance.clone() };
            let there = case.loss(&case.shutter, &other, &depth);
            let back: f64 = other.data.iter().zip(&d_radiance.data).map(|(r, d)| r * d).sum();
            assert!((there - back).abs() < 1e-11 * (1.0 + there.abs()), "{there} {back}");
        }
    }
}

#[test]
fn relative_motion_agrees_with_differences() {
    let cases = [
        (Case::new(Scene::wall, 3, 3), 1e-6),
        (Case::new(Scene::wall, 2, 4), 1e-6),
        (Case::new(Scene::facing, 5, 5), 1e-6),
        // Between the ends, views follow the parabola in time.
        (Case::new(Scene::wall, 7, 7), 1e-3),
        (Case::new(Scene::wall, 3, 9).with_margin(3), 1e-6),
        (Case::new(Scene::wall, 3, 9).rolling(1.3), 1e-6),
        (Case::new(Scene::wall, 1, 10).rolling(-0.9).with_margin(3), 1e-6),
    ];
    for (number, (case, tolerance)) in cases.into_iter().enumerate() {
        let name = format!("case {number}");
        let (radiance, depth) = case.sharp(&case.shutter);
        let (_, gradient) = case.pull_back();
        assert_gradient(&name, &[0.0; 12], &gradient.shutter.to_array(), STEP, tolerance, |x| {
            case.loss(&case.moved(x), &radiance, &depth)
        });
    }
}

#[test]
fn the_whole_chain_agrees_with_differences() {
    for margin in [0, 4] {
        let case = Case::new(Scene::wall, 3, 6).with_margin(margin);
        let (_, depth) = case.sharp(&case.shutter);
        let (d_radiance, relative) = case.pull_back();
        let total = relative.shutter.plus(case.through_render(&d_radiance)).to_array();
        assert_gradient("chain, depth held", &[0.0; 12], &total, STEP, 1e-6, |x| {
            let shutter = case.moved(x);
            case.loss(&shutter, &case.sharp(&shutter).0, &depth)
        });
        let everything = central_differences(&[0.0; 12], STEP, |x| {
            let shutter = case.moved(x);
            let (radiance, depth) = case.sharp(&shutter);
            case.loss(&shutter, &radiance, &depth)
        });
        assert_close("chain, depth rendered anew", &total, &everything, 0.03);
    }
}

#[test]
fn readout_agrees_with_differences() {
    for (views, readout) in [(1, 1.1), (3, -0.7), (4, 2.0)] {
        let mut case = Case::new(Scene::wall, views, 11).rolling(readout);
        let (radiance, depth) = case.sharp(&case.shutter);
        let analytic = case.pull_back().1.readout;
        let shutter = case.shutter;
        assert_gradient("readout", &[readout], &[analytic], STEP, 1e-6, |x| {
            case.readout = x[0];
            case.loss(&shutter, &radiance, &depth)
        });
    }
}

#[test]
fn a_global_shutter_is_the_limit_of_a_rolling_one() {
    let case = Case::new(Scene::wall, 3, 12);
    let (radiance, depth) = case.sharp(&case.shutter);
    let (_, global) = case.pull_back();
    let global_loss = case.loss(&case.shutter, &radiance, &depth);
    let case = case.rolling(1e-7);
    let (_, rolling) = case.pull_back();
    let loss = case.loss(&case.shutter, &radiance, &depth);
    assert!((loss - global_loss).abs() < 1e-3 * global_loss.abs(), "{loss} {global_loss}");
    let (a, b) = (rolling.shutter.to_array(), global.shutter.to_array());
    assert_close("global limit", &a, &b, 1e-3);
    assert_eq!(global.readout, 0.0);
}
