//! The reference lane against central differences in `f64`.

use super::*;
use i2slam_check::assert_gradient;
use i2slam_geometry::Tangent;

const SIZE: [usize; 2] = [14, 11];
const STEP: f64 = 1e-4;
const TOLERANCE: f64 = 1e-6;

struct Case {
    name: String,
    map: GaussianMap<f64>,
    view: View<f64>,
    cotangent: RenderCotangent<f64>,
}

/// Both shapes and activations; with the margin, Gaussians reach into the picture from where the
/// Jacobian is clamped.
fn cases() -> Vec<Case> {
    let [width, height] = SIZE;
    let view = view(width, height);
    let mut cases = Vec::new();
    for shape in [Shape::Isotropic, Shape::Anisotropic] {
        for activation in [ColourActivation::Exponential, ColourActivation::Linear] {
            for (margin, sigma) in [(0.0, [0.8, 4.0]), (0.5, [3.0, 6.0])] {
                let recipe = Recipe { count: 9, margin, sigma, ..Recipe::new(shape, activation) };
                let name = format!("{shape:?} {activation:?} margin {margin}");
                let cotangent = cotangent(width, height, 5);
                cases.push(Case { name, map: recipe.build(&view), view, cotangent });
            }
        }
    }
    cases
}

impl Case {
    fn gradient(&self) -> (MapGradient<f64>, Tangent<f64>) {
        let mut gradient = MapGradient::new(self.map.len());
        let (map, view, cotangent) = (&self.map, &self.view, &self.cotangent);
        let tangent = reference::pull_back(map, view, &smooth(), cotangent, Some(&mut gradient));
        (gradient, tangent)
    }

    /// Check one parameter family, given how to put its numbers into a map.
    fn check(
        &self,
        family: &str,
        x: &[f64],
        gradient: &[f64],
        put: impl Fn(&mut GaussianMap<f64>, &[f64]),
    ) {
        let mut map = self.map.clone();
        let name = format!("{} {family}", self.name);
        assert_gradient(&name, x, gradient, STEP, TOLERANCE, |x| {
            put(&mut map, x);
            functional(&reference::render(&map, &self.view, &smooth()), &self.cotangent)
        });
        assert!(gradient.iter().any(|g| g.abs() > 1e-3), "{name}: nothing to check");
    }
}

#[test]
fn map_gradients_agree_with_central_differences() {
    for case in cases() {
        let (g, _) = case.gradient();
        let map = &case.map;
        case.check("means", &flat(&map.means), &flat(&g.means), |m, x| m.means = from_flat(x));
        case.check("colours", &flat(&map.colours), &flat(&g.colours), |m, x| {
            m.colours = from_flat(x);
        });
        case.check("opacities", &map.opacity_logits, &g.opacity_logits, |m, x| {
            m.opacity_logits = x.to_vec();
        });
        case.check("scales", &flat(&map.log_scales), &flat(&g.log_scales), |m, x| {
            m.log_scales = from_flat(x);
        });
        if map.shape == Shape::Anisotropic {
            case.check("rotations", &flat(&map.rotations), &flat(&g.rotations), |m, x| {
                m.rotations = from_flat(x);
            });
        }
    }
}

#[test]
fn pose_gradient_agrees_with_central_differences() {
    for case in cases() {
        let (_, tangent) = case.gradient();
        let mut view = case.view;
        let name = format!("{} pose", case.name);
        assert_gradient(&name, &[0.0; 6], &tangent.to_array(), STEP, TOLERANCE, |x| {
            let tangent = Tangent::from_array([x[0], x[1], x[2], x[3], x[4], x[5]]);
            view.world_from_camera = case.view.world_from_camera.retract(tangent);
            functional(&reference::render(&case.map, &view, &smooth()), &case.cotangent)
        });
    }
}

/// `alpha_max` stops the gradient of what it cuts, and of nothing else.
#[test]
fn gradients_hold_where_alpha_is_cut() {
    let settings = RasterSettings { alpha_max: 0.4, ..smooth() };
    let mut case = cases().remove(0);
    case.map.opacity_logits.fill(1.0);
    let mut gradient = MapGradient::new(case.map.len());
    reference::pull_back(&case.map, &case.view, &settings, &case.cotangent, Some(&mut gradient));
    let mut map = case.map.clone();
    let x = flat(&case.map.colours);
    assert_gradient("colours", &x, &flat(&gradient.colours), STEP, TOLERANCE, |x| {
        map.colours = from_flat(x);
        functional(&reference::render(&map, &case.view, &settings), &case.cotangent)
    });
}

/// Two pull-backs add.
#[test]
fn gradients_accumulate() {
    let case = cases().remove(2);
    let (once, _) = case.gradient();
    let mut twice = once.clone();
    let (map, view) = (&case.map, &case.view);
    reference::pull_back(map, view, &smooth(), &case.cotangent, Some(&mut twice));
    let doubled: Vec<f64> = flat(&once.means).iter().map(|v| 2.0 * v).collect();
    i2slam_check::assert_close("means", &flat(&twice.means), &doubled, 1e-14);
}
