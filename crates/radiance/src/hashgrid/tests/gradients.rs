//! The reference lane against central differences in `f64`.

use super::*;
use i2slam_check::assert_gradient;
use i2slam_geometry::Vec3;

const STEP: f64 = 1e-5;
const TOLERANCE: f64 = 1e-6;
const RAYS: usize = 3;
const SAMPLES: usize = 12;

struct Case {
    name: &'static str,
    field: HashGridField<f64>,
}

fn cases() -> Vec<Case> {
    let one = settings();
    let deep = FieldSettings { density_layers: 2, colour_layers: 3, features: 4, ..one };
    let flat = FieldSettings { density_layers: 0, colour_layers: 0, levels: 1, ..one };
    let none = FieldSettings { geometry_features: 0, features: 1, ..one };
    let cases = [("usual", one), ("deep", deep), ("linear", flat), ("no geometry", none)];
    cases.map(|(name, settings)| Case { name, field: field(settings, 5) }).into()
}

fn loss(field: &HashGridField<f64>, rays: &[Ray<f64>]) -> f64 {
    let parts = rays.iter().zip(cotangents(RAYS, 3));
    parts.map(|(ray, c)| functional(&reference::render(field, ray, &samples(SAMPLES)), &c)).sum()
}

fn gradient(field: &HashGridField<f64>) -> (FieldGradient<f64>, Vec<RayGradient<f64>>) {
    let mut gradient = FieldGradient::zeros(field);
    let pull = |(ray, cotangent): (&Ray<f64>, &RayRender<f64>)| {
        reference::pull_back(field, ray, &samples(SAMPLES), cotangent, Some(&mut gradient))
    };
    let rows = rays(RAYS, 1).iter().zip(&cotangents(RAYS, 3)).map(pull).collect();
    (gradient, rows)
}

#[test]
fn field_gradients_agree_with_central_differences() {
    for case in cases() {
        let (gradient, _) = gradient(&case.field);
        let families = [&gradient.table, &gradient.density, &gradient.colour];
        for (k, (name, gradient)) in ["table", "density", "colour"].iter().zip(families).enumerate()
        {
            let name = format!("{} {name}", case.name);
            assert!(gradient.iter().any(|g| g.abs() > 1e-3), "{name}: nothing to check");
            // All weights, and of the table the entries that the rays touch.
            let checked: Vec<usize> = (0..gradient.len()).filter(|&i| gradient[i] != 0.0).collect();
            let mut field = case.field.clone();
            let x: Vec<f64> = checked.iter().map(|&i| field.parameters_mut()[k][i]).collect();
            let expected: Vec<f64> = checked.iter().map(|&i| gradient[i]).collect();
            assert_gradient(&name, &x, &expected, STEP, TOLERANCE, |x| {
                let values = &mut field.parameters_mut()[k];
                checked.iter().zip(x).for_each(|(&i, x)| values[i] = *x);
                loss(&field, &rays(RAYS, 1))
            });
        }
    }
}

#[test]
fn ray_gradients_agree_with_central_differences() {
    for case in cases() {
        let (_, gradients) = gradient(&case.field);
        let start = rays(RAYS, 1);
        let x: Vec<f64> = start
            .iter()
            .flat_map(|r| [r.origin.to_array(), r.direction.to_array()].concat())
            .collect();
        let gradient = gradients.iter().map(ray_row).collect::<Vec<_>>().concat();
        assert!(gradient.iter().any(|g| g.abs() > 1e-3), "{}: nothing to check", case.name);
        assert_gradient(case.name, &x, &gradient, STEP, TOLERANCE, |x| {
            let mut rays = start.clone();
            for (ray, x) in rays.iter_mut().zip(x.as_chunks::<6>().0) {
                ray.origin = Vec3::new(x[0], x[1], x[2]);
                ray.direction = Vec3::new(x[3], x[4], x[5]);
            }
            loss(&case.field, &rays)
        });
    }
}

/// The exact sums of equations 1 and 2 for a field of one density and one colour.
#[test]
fn a_uniform_field_renders_as_the_closed_form() {
    let field = HashGridField::<f64>::zeros(settings()).expect("settings in range");
    let ray = rays(1, 1)[0];
    let render = reference::render(&field, &ray, &samples(SAMPLES));
    let length = ray.direction.norm();
    let opacity = 1.0 - (-0.05 * SAMPLES as f64 * length).exp();
    let fade = (-0.05 * length).exp();
    let depth: f64 =
        (0..SAMPLES).map(|i| (0.05 + 0.05 * i as f64) * fade.powi(i as i32) * (1.0 - fade)).sum();
    let expected = [opacity, opacity, opacity, depth, opacity];
    i2slam_check::assert_close("uniform", &render_row(&render), &expected, 1e-12);
}
