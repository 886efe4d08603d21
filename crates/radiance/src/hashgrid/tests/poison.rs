//! Numbers that are not finite, rays of nothing, settings out of range: clean or an error.

use super::*;
use i2slam_geometry::Vec3;

/// Rendered rays, their gradients and that of the field, and the number of samples.
type Outcome = (Vec<RayRender>, Vec<RayGradient>, FieldGradient, usize);

fn render(field: &HashGridField, rays: &[Ray], cotangent: RayRender) -> Outcome {
    let mut renderer = FieldRenderer::new(MarchSettings::cube(1.5));
    let occupancy = Occupancy::new(OccupancySettings { resolution: 4, ..Default::default() });
    let (mut renders, mut by_rays) = (vec![RayRender::default()], Vec::new());
    renderer.render(field, &occupancy, rays, &mut renders);
    let mut gradient = FieldGradient::zeros(field);
    let cotangents = vec![cotangent; rays.len()];
    let requested = (Some(&mut gradient), Some(&mut by_rays));
    renderer.pull_back(field, rays, &cotangents, requested.0, requested.1);
    (renders, by_rays, gradient, renderer.samples())
}

fn usual() -> HashGridField {
    field(settings(), 3).cast()
}

fn ray() -> Ray {
    Ray { origin: Vec3::new(0.2, -0.1, 0.4), direction: Vec3::new(0.3, 0.1, 1.0), offset: 0.5 }
}

#[test]
fn poisoned_rays_show_nothing() {
    let cotangent = single(&cotangents(1, 2)[0]);
    let (good, _, gradient, _) = render(&usual(), &[ray()], cotangent);
    assert!(good[0].opacity > 0.0 && gradient.table.iter().any(|g| *g != 0.0));
    let poisons = [
        Ray { origin: Vec3::new(f32::NAN, 0.0, 0.0), ..ray() },
        Ray { direction: Vec3::new(0.0, f32::INFINITY, 1.0), ..ray() },
        Ray { direction: Vec3::zero(), ..ray() },
        Ray { direction: Vec3::new(3e38, 3e38, 0.0), ..ray() },
        Ray { offset: f32::NAN, ..ray() },
        Ray { origin: Vec3::new(9.0, 0.0, 0.0), direction: Vec3::new(0.0, 0.0, 1.0), offset: 0.0 },
        Ray { origin: Vec3::new(0.0, 0.0, 9.0), ..ray() },
    ];
    for poison in poisons {
        let (renders, rays, gradient, _) = render(&usual(), &[poison], cotangent);
        assert_eq!(renders, [RayRender::default()], "{poison:?}");
        assert_eq!(rays, [RayGradient::default()], "{poison:?}");
        assert!(gradient.table.iter().all(|g| *g == 0.0), "{poison:?}");
    }
}

#[test]
fn huge_exponents_stay_finite() {
    let mut field = field(settings(), 3).cast::<f32>();
    field.parameters_mut()[1].iter_mut().for_each(|w| *w *= 1e6);
    field.parameters_mut()[2].iter_mut().for_each(|w| *w *= 1e6);
    let (renders, rays, ..) = render(&field, &[ray()], RayRender::default());
    assert!(render_row(&renders[0]).iter().all(|v| v.is_finite()));
    assert!(ray_row(&rays[0]).iter().all(|v| v.is_finite()));
}

#[test]
fn settings_out_of_range_are_named() {
    let named = |settings| HashGridField::<f32>::new(settings, 0).err().map(|e| e.name);
    assert_eq!(named(FieldSettings { levels: 0, ..settings() }), Some("levels"));
    assert_eq!(named(FieldSettings { features: 3, ..settings() }), Some("features"));
    assert_eq!(named(FieldSettings { bound: 0.0, ..settings() }), Some("bound"));
    let wrong = FieldSettings { finest_resolution: 2, ..settings() };
    assert_eq!(named(wrong), Some("finest_resolution"));
    assert_eq!(named(settings()), None);
}

#[test]
fn no_rays_are_no_work() {
    let (renders, rays, _, samples) = render(&usual(), &[], RayRender::default());
    assert!(renders.is_empty() && rays.is_empty() && samples == 0);
}

#[test]
fn points_outside_have_no_density() {
    let renderer = FieldRenderer::new(MarchSettings::cube(1.5));
    let points = [Vec3::new(0.2, 0.0, 0.4), Vec3::new(5.0, 0.0, 0.0)];
    let densities = renderer.densities(&usual(), &points);
    assert!(densities[0] > 0.0 && densities[1] == 0.0);
}
