//! The reference lane against central differences in `f64`, with a camera at rest and in motion.

use super::*;
use i2slam_check::{assert_close, assert_gradient};
use i2slam_geometry::Tangent;

const SIZE: [usize; 2] = [14, 11];
const STEP: f64 = 1e-4;
const TOLERANCE: f64 = 1e-6;

#[derive(Clone)]
struct Case {
    name: String,
    map: GaussianMap<f64>,
    view: View<f64>,
    motion: ShutterMotion<f64>,
    settings: RasterSettings,
    cotangent: RenderCotangent<f64>,
}

/// A turn and a shift of about 5 px of 14, moments of unlike weights, and a rolling shutter.
fn motion() -> ShutterMotion<f64> {
    let velocity = Tangent::from_array([0.11, -0.08, 0.2, 0.15, -0.21, 0.3]);
    let moments = [(-0.4, 1.0), (0.1, 2.5), (0.5, 0.5)];
    let moments = moments.map(|(time, weight)| Moment { time, weight }).to_vec();
    ShutterMotion { velocity, readout: 0.7, moments }
}

/// Both shapes and activations at rest, and both shapes in motion; with the margin, Gaussians reach
/// into the picture from where the Jacobian is clamped.
fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    let mut add = |name: &str, recipe: Recipe, motion: ShutterMotion<f64>| {
        let (view, settings) = (view(SIZE[0], SIZE[1]), smooth());
        let (map, cotangent) = (recipe.build(&view), cotangent(SIZE[0], SIZE[1], 5));
        let name = format!("{name} {:?} {:?} {}", map.shape, map.activation, recipe.margin);
        cases.push(Case { name, map, view, motion, settings, cotangent });
    };
    for shape in [Shape::Isotropic, Shape::Anisotropic] {
        for activation in [ColourActivation::Exponential, ColourActivation::Linear] {
            for (margin, sigma) in [(0.0, [0.8, 4.0]), (0.5, [3.0, 6.0])] {
                let recipe = Recipe { count: 9, margin, sigma, ..Recipe::new(shape, activation) };
                add("still", recipe, ShutterMotion::still());
            }
        }
        let recipe = Recipe::new(shape, ColourActivation::Exponential);
        let moving = Recipe { count: 9, margin: 0.3, sigma: [1.0, 4.0], ..recipe };
        add("moving", moving, motion());
        add("glossy, moving", Recipe { has_view_colours: true, ..moving }, motion());
    }
    cases
}

impl Case {
    fn value(&self) -> f64 {
        let Self { map, view, motion, settings, cotangent, .. } = self;
        functional(&reference::render_moving(map, view, motion, settings), cotangent)
    }

    /// Adds to the map's gradient.
    fn pull_back(&self, gradient: &mut MapGradient<f64>) -> MotionGradient {
        let Self { map, view, motion, settings, cotangent, .. } = self;
        reference::pull_back_moving(map, view, motion, settings, cotangent, Some(gradient))
    }

    /// Checks one family of numbers, given how to put them into a case.
    fn check(&self, family: &str, x: &[f64], gradient: &[f64], put: impl Fn(&mut Self, &[f64])) {
        let (name, mut case) = (format!("{} {family}", self.name), self.clone());
        assert_gradient(&name, x, gradient, STEP, TOLERANCE, |x| {
            put(&mut case, x);
            case.value()
        });
        assert!(gradient.iter().any(|g| g.abs() > 1e-3), "{name}: nothing to check");
    }
}

#[test]
fn map_gradients_agree_with_central_differences() {
    for case in cases() {
        let mut g = MapGradient::new(&case.map);
        case.pull_back(&mut g);
        let map = &case.map;
        case.check("means", &flat(&map.means), &flat(&g.means), |c, x| c.map.means = from_flat(x));
        case.check("colours", &flat(&map.colours), &flat(&g.colours), |c, x| {
            c.map.colours = from_flat(x);
        });
        case.check("opacities", &map.opacity_logits, &g.opacity_logits, |c, x| {
            c.map.opacity_logits = x.to_vec();
        });
        case.check("scales", &flat(&map.log_scales), &flat(&g.log_scales), |c, x| {
            c.map.log_scales = from_flat(x);
        });
        let coefficients = map.view_colours.coefficients().as_flattened();
        if !coefficients.is_empty() {
            case.check("view colours", coefficients, g.view_colours.as_flattened(), |c, x| {
                c.map.view_colours.coefficients_mut().as_flattened_mut().copy_from_slice(x);
            });
        }
        if map.shape == Shape::Anisotropic {
            case.check("rotations", &flat(&map.rotations), &flat(&g.rotations), |c, x| {
                c.map.rotations = from_flat(x);
            });
        }
    }
}

#[test]
fn pose_and_motion_gradients_agree_with_central_differences() {
    let tangent = |x: &[f64]| Tangent::from_array([x[0], x[1], x[2], x[3], x[4], x[5]]);
    for case in cases() {
        let g = case.pull_back(&mut MapGradient::new(&case.map));
        let middle = case.view.world_from_camera;
        case.check("pose", &[0.0; 6], &g.pose.to_array(), |c, x| {
            c.view.world_from_camera = middle.retract(tangent(x));
        });
        if case.motion == ShutterMotion::still() {
            continue;
        }
        let velocity = case.motion.velocity.to_array();
        case.check("velocity", &velocity, &g.velocity.to_array(), |c, x| {
            c.motion.velocity = tangent(x);
        });
        case.check("readout", &[case.motion.readout], &[g.readout], |c, x| c.motion.readout = x[0]);
    }
}

/// `alpha_max` stops the gradient of what it cuts, and of nothing else.
#[test]
fn gradients_hold_where_alpha_is_cut() {
    let mut case = cases().remove(0);
    case.settings.alpha_max = 0.4;
    case.map.opacity_logits.fill(1.0);
    let mut g = MapGradient::new(&case.map);
    case.pull_back(&mut g);
    case.check("colours", &flat(&case.map.colours), &flat(&g.colours), |c, x| {
        c.map.colours = from_flat(x);
    });
}

#[test]
fn gradients_accumulate() {
    let case = cases().remove(2);
    let mut once = MapGradient::new(&case.map);
    case.pull_back(&mut once);
    let mut twice = once.clone();
    case.pull_back(&mut twice);
    let doubled: Vec<f64> = flat(&once.means).iter().map(|v| 2.0 * v).collect();
    assert_close("means", &flat(&twice.means), &doubled, 1e-14);
}
