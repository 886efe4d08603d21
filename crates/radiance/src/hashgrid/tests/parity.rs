//! The fast lane against the reference in `f64`, on every instruction set of the machine.

use super::*;
use crate::gaussian::tests::on_any_threads;
use crate::hashgrid::march::RayMarcher;
use i2slam_check::assert_close;
use i2slam_compute::simd::instruction_sets;
use i2slam_geometry::Vec3;
use pulp::Arch;

const RAYS: usize = 150;

/// Relative to the largest entry: a few hundred roundings of 6e-8 in sums and exponentials.
const TOLERANCE: f64 = 5e-5;

fn march() -> MarchSettings {
    MarchSettings { step_min: 0.05, step_max: 0.1, ..MarchSettings::cube(1.5) }
}

fn cases() -> Vec<(&'static str, FieldSettings)> {
    let one = settings();
    let wide = FieldSettings { hidden_width: 64, geometry_features: 15, ..one };
    vec![
        ("usual", one),
        ("wide", FieldSettings { levels: 16, ..wide }),
        ("four features", FieldSettings { features: 4, density_layers: 2, ..one }),
        ("one feature", FieldSettings { features: 1, colour_layers: 0, ..one }),
        ("eight features", FieldSettings { features: 8, geometry_features: 0, ..one }),
    ]
}

/// Results of one lane.
struct Outcome {
    renders: Vec<f64>,
    gradient: [Vec<f64>; 3],
    rays: Vec<f64>,
}

fn outcome(
    renders: &[RayRender<impl i2slam_geometry::Real>],
    gradient: FieldGradient<f64>,
    rays: &[RayGradient<impl i2slam_geometry::Real>],
) -> Outcome {
    Outcome {
        renders: renders.iter().flat_map(render_row).collect(),
        gradient: [gradient.table, gradient.density, gradient.colour],
        rays: rays.iter().flat_map(ray_row).collect(),
    }
}

fn fast(slopes: bool, arch: Arch, field: &HashGridField<f64>, occupancy: &Occupancy) -> Outcome {
    let field = field.cast::<f32>();
    let rays: Vec<Ray> = rays(RAYS, 2).iter().map(Ray::cast).collect();
    let mut renderer = FieldRenderer::on(arch, march());
    renderer.keep_slopes(slopes);
    let (mut renders, mut ray_gradients) = (Vec::new(), Vec::new());
    renderer.render(&field, occupancy, &rays, &mut renders);
    let cotangents: Vec<_> = cotangents(RAYS, 7).iter().map(single).collect();
    let mut gradient = FieldGradient::zeros(&field);
    let requested = (Some(&mut gradient), Some(&mut ray_gradients));
    renderer.pull_back(&field, &rays, &cotangents, requested.0, requested.1);
    let wide = |values: &[f32]| values.iter().map(|v| f64::from(*v)).collect();
    let gradient = FieldGradient {
        table: wide(&gradient.table),
        density: wide(&gradient.density),
        colour: wide(&gradient.colour),
    };
    outcome(&renders, gradient, &ray_gradients)
}

/// The samples of the fast lane, up to where the ray ends.
fn plain_samples(
    field: &HashGridField<f64>,
    occupancy: &Occupancy,
    ray: &Ray<f64>,
) -> Vec<Sample<f64>> {
    let single = field.cast::<f32>();
    let mut marcher = RayMarcher::new(&single, &march(), &ray.cast());
    let next = || marcher.next(&march(), occupancy).map(|(sample, _)| sample);
    let mut samples: Vec<Sample<f64>> = Vec::new();
    for sample in std::iter::from_fn(next) {
        let opacity = reference::render(field, ray, &samples).opacity;
        if 1.0 - opacity < f64::from(march().transmittance_min) {
            break;
        }
        samples.push(Sample { depth: sample.depth.into(), step: sample.step.into() });
    }
    samples
}

fn plain(field: &HashGridField<f64>, occupancy: &Occupancy) -> Outcome {
    let mut gradient = FieldGradient::zeros(field);
    let (mut renders, mut ray_gradients) = (Vec::new(), Vec::new());
    for (ray, cotangent) in rays(RAYS, 2).iter().zip(&cotangents(RAYS, 7)) {
        let samples = plain_samples(field, occupancy, ray);
        renders.push(reference::render(field, ray, &samples));
        let gradient = Some(&mut gradient);
        ray_gradients.push(reference::pull_back(field, ray, &samples, cotangent, gradient));
    }
    outcome(&renders, gradient, &ray_gradients)
}

fn assert_lanes(name: &str, fast: &Outcome, plain: &Outcome) {
    assert_close(&format!("{name} renders"), &fast.renders, &plain.renders, TOLERANCE);
    assert_close(&format!("{name} rays"), &fast.rays, &plain.rays, TOLERANCE);
    for (k, family) in ["table", "density", "colour"].iter().enumerate() {
        let name = format!("{name} {family}");
        assert_close(&name, &fast.gradient[k], &plain.gradient[k], TOLERANCE);
    }
}

#[test]
fn lanes_agree() {
    for (name, settings) in cases() {
        let (field, occupancy) = (field(settings, 4), Occupancy::new(coarse()));
        let expected = plain(&field, &occupancy);
        for arch in instruction_sets() {
            for slopes in [true, false] {
                let name = format!("{name} {arch:?}, slopes {slopes}");
                assert_lanes(&name, &fast(slopes, arch, &field, &occupancy), &expected);
            }
        }
    }
}

fn coarse() -> OccupancySettings {
    OccupancySettings { resolution: 8, ..OccupancySettings::default() }
}

/// With empty cells, lanes agree and the samples are those of the full march in occupied cells.
#[test]
fn empty_cells_are_marched_over() {
    let mut field = field(settings(), 4);
    field.parameters_mut()[1].iter_mut().for_each(|w| *w *= 2.0);
    let mut occupancy = Occupancy::new(OccupancySettings { density: 1.0, ..coarse() });
    let full = occupancy.clone();
    occupancy.refresh(&field.cast(), &mut FieldRenderer::new(march()), 1);
    assert!((0.05..0.95).contains(&occupancy.occupied_share()), "{}", occupancy.occupied_share());
    assert_lanes(
        "sparse",
        &fast(true, Arch::new(), &field, &occupancy),
        &plain(&field, &occupancy),
    );
    assert_marched(&field.cast(), &full, &occupancy);
}

/// Parity with many empty cells that fill whole blocks.
#[test]
fn empty_blocks_are_marched_over() {
    let field = field(settings(), 4).cast::<f32>();
    let updates = OccupancySettings { resolution: 50, ..coarse() };
    let (centre, bound) = (settings().centre, settings().bound);
    let shell = |p: Vec3<f32>| {
        let away = (p - Vec3::from_array(centre).cast()).norm();
        (away - 0.7 * bound as f32).abs() < 0.05 * bound as f32
    };
    let occupancy = Occupancy::of_cells(centre, bound, updates, shell);
    assert!((0.02..0.3).contains(&occupancy.occupied_share()), "{}", occupancy.occupied_share());
    assert_marched(&field, &Occupancy::new(updates), &occupancy);
}

/// The samples in `occupancy` are those of `full` that lie in its cells.
fn assert_marched(field: &HashGridField, full: &Occupancy, occupancy: &Occupancy) {
    let mut found = 0;
    for ray in rays(RAYS, 2) {
        let samples = |occupancy: &Occupancy| -> Vec<(f32, [f32; 3])> {
            let mut marcher = RayMarcher::new(field, &march(), &ray.cast());
            let next = || marcher.next(&march(), occupancy).map(|(s, p)| (s.depth, p));
            std::iter::from_fn(next).collect()
        };
        let mut expected = samples(full);
        expected.retain(|(_, position)| occupancy.is_occupied(*position));
        assert_eq!(samples(occupancy), expected);
        found += expected.len();
    }
    assert!(found > 0, "no ray meets an occupied cell");
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let field = field(FieldSettings { levels: 8, ..settings() }, 4);
    on_any_threads(|| {
        let outcome = fast(true, Arch::new(), &field, &Occupancy::new(coarse()));
        (outcome.renders, outcome.gradient, outcome.rays)
    });
}

/// The comparison above fails for a slightly different field.
#[test]
#[should_panic(expected = "relative error")]
fn another_field_is_told_apart() {
    let (mut field, occupancy) = (field(settings(), 4), Occupancy::new(coarse()));
    let expected = plain(&field, &occupancy);
    field.parameters_mut()[1][0] += 0.01;
    assert_lanes("changed", &fast(true, Arch::new(), &field, &occupancy), &expected);
}
