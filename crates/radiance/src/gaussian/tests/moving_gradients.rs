//! The reference lane of a moving camera against central differences in `f64`.

use super::*;
use i2slam_check::assert_gradient;
use i2slam_geometry::Tangent;

const SIZE: [usize; 2] = [14, 11];
const STEP: f64 = 1e-4;
const TOLERANCE: f64 = 1e-6;

/// A turn and a shift of about 5 px of 14, moments of unlike weights, and rows that look one
/// after another.
fn motion() -> ShutterMotion<f64> {
    let velocity = Tangent::from_array([0.11, -0.08, 0.2, 0.15, -0.21, 0.3]);
    let moments = [(-0.4, 1.0), (0.1, 2.5), (0.5, 0.5)];
    let moments = moments.map(|(time, weight)| Moment { time, weight }).to_vec();
    ShutterMotion { velocity, readout: 0.7, moments }
}

struct Case {
    map: GaussianMap<f64>,
    view: View<f64>,
    motion: ShutterMotion<f64>,
    cotangent: RenderCotangent<f64>,
}

impl Case {
    fn new(shape: Shape) -> Self {
        let view = view(SIZE[0], SIZE[1]);
        let recipe = Recipe {
            count: 9,
            margin: 0.3,
            sigma: [1.0, 4.0],
            ..Recipe::new(shape, ColourActivation::Exponential)
        };
        let cotangent = cotangent(SIZE[0], SIZE[1], 5);
        Self { map: recipe.build(&view), view, motion: motion(), cotangent }
    }

    fn value(&self) -> f64 {
        let render = reference::render_moving(&self.map, &self.view, &self.motion, &smooth());
        functional(&render, &self.cotangent)
    }

    fn gradient(&self) -> (MapGradient<f64>, MotionGradient) {
        let mut map = MapGradient::new(self.map.len());
        let (view, motion, cotangent) = (&self.view, &self.motion, &self.cotangent);
        let settings = smooth();
        let gradient = reference::pull_back_moving(
            &self.map,
            view,
            motion,
            &settings,
            cotangent,
            Some(&mut map),
        );
        (map, gradient)
    }

    /// Check one family of numbers, given how to put them into a case.
    fn check(&self, name: &str, x: &[f64], gradient: &[f64], put: impl Fn(&mut Case, &[f64])) {
        let (map, cotangent) = (self.map.clone(), self.cotangent.clone());
        let mut case = Case { map, view: self.view, motion: self.motion.clone(), cotangent };
        assert_gradient(name, x, gradient, STEP, TOLERANCE, |x| {
            put(&mut case, x);
            case.value()
        });
        assert!(gradient.iter().any(|g| g.abs() > 1e-3), "{name}: nothing to check");
    }
}

fn tangent(x: &[f64]) -> Tangent<f64> {
    Tangent::from_array([x[0], x[1], x[2], x[3], x[4], x[5]])
}

#[test]
fn motion_gradients_agree_with_central_differences() {
    for shape in [Shape::Isotropic, Shape::Anisotropic] {
        let case = Case::new(shape);
        let (_, g) = case.gradient();
        let centre = case.view.world_from_camera;
        case.check("pose", &[0.0; 6], &g.pose.to_array(), |case, x| {
            case.view.world_from_camera = centre.retract(tangent(x));
        });
        let velocity = case.motion.velocity.to_array();
        case.check("velocity", &velocity, &g.velocity.to_array(), |case, x| {
            case.motion.velocity = tangent(x);
        });
        case.check("readout", &[case.motion.readout], &[g.readout], |case, x| {
            case.motion.readout = x[0];
        });
    }
}

#[test]
fn map_gradients_of_a_moving_camera_agree_with_central_differences() {
    for shape in [Shape::Isotropic, Shape::Anisotropic] {
        let case = Case::new(shape);
        let (g, _) = case.gradient();
        case.check("means", &flat(&case.map.means), &flat(&g.means), |case, x| {
            case.map.means = from_flat(x);
        });
        case.check("colours", &flat(&case.map.colours), &flat(&g.colours), |case, x| {
            case.map.colours = from_flat(x);
        });
        case.check("opacities", &case.map.opacity_logits, &g.opacity_logits, |case, x| {
            case.map.opacity_logits = x.to_vec();
        });
        case.check("scales", &flat(&case.map.log_scales), &flat(&g.log_scales), |case, x| {
            case.map.log_scales = from_flat(x);
        });
        if shape == Shape::Anisotropic {
            case.check("rotations", &flat(&case.map.rotations), &flat(&g.rotations), |case, x| {
                case.map.rotations = from_flat(x);
            });
        }
    }
}
