//! Numbers that are not finite and pictures of nothing: both lanes stay clean.

use super::*;
use i2slam_geometry::{Pose, Real, Tangent, Vec3};

const SIZE: [usize; 2] = [40, 30];

fn map(shape: Shape) -> GaussianMap<f64> {
    let recipe = Recipe { count: 40, ..Recipe::new(shape, ColourActivation::Exponential) };
    recipe.build(&view(SIZE[0], SIZE[1]))
}

/// Picture, gradients and pose gradient of one lane.
type Outcome<T> = (Render<T>, MapGradient<T>, Tangent<f64>);

fn fast(map: &GaussianMap<f32>, view: &View<f32>) -> Outcome<f32> {
    let mut rasterizer = Rasterizer::default();
    let (mut render, mut gradient) = (Render::default(), MapGradient::new(map));
    let cotangent = single_cotangent(&cotangent(view.camera.width, view.camera.height, 3));
    map.render(&mut rasterizer, view, &mut render);
    let tangent = map.pull_back(&mut rasterizer, view, &cotangent, Some(&mut gradient));
    (render, gradient, tangent)
}

fn plain(map: &GaussianMap<f64>, view: &View<f64>) -> Outcome<f64> {
    let settings = RasterSettings::default();
    let mut gradient = MapGradient::new(map);
    let cotangent = cotangent(view.camera.width, view.camera.height, 3);
    let render = reference::render(map, view, &settings);
    let tangent = reference::pull_back(map, view, &settings, &cotangent, Some(&mut gradient));
    (render, gradient, tangent)
}

#[track_caller]
fn assert_finite<T: Real>(name: &str, (render, gradient, tangent): &Outcome<T>) {
    let images = [&render.radiance, &render.depth, &render.opacity];
    assert!(images.iter().all(|i| i.data.iter().all(|v| v.is_finite())), "{name}: picture");
    let rows = [&gradient.means, &gradient.log_scales, &gradient.colours];
    assert!(rows.iter().all(|r| r.as_flattened().iter().all(|v| v.is_finite())), "{name}: rows");
    assert!(gradient.rotations.as_flattened().iter().all(|v| v.is_finite()), "{name}: rotations");
    assert!(gradient.opacity_logits.iter().all(|v| v.is_finite()), "{name}: opacities");
    assert!(tangent.to_array().iter().all(|v| v.is_finite()), "{name}: pose");
}

/// Puts a number where it spoils a Gaussian.
type Poison = fn(&mut Gaussian<f64>, f64);

/// Ways to spoil a Gaussian, by name.
fn poisons() -> Vec<(&'static str, Poison)> {
    vec![
        ("mean x", |g, v| g.mean[0] = v),
        ("mean z", |g, v| g.mean[2] = v),
        ("scale", |g, v| g.log_scale[0] = v),
        ("last scale", |g, v| g.log_scale[2] = v),
        ("rotation", |g, v| g.rotation[1] = v),
        ("opacity", |g, v| g.opacity_logit = v),
        ("colour", |g, v| g.colour[1] = v),
    ]
}

/// A Gaussian with a number that is not finite is left out.
#[test]
fn a_spoiled_gaussian_is_left_out() {
    let view = view(SIZE[0], SIZE[1]);
    let clean = map(Shape::Anisotropic);
    let mut keep = vec![true; clean.len()];
    keep[7] = false;
    let mut without = clean.clone();
    without.retain(&keep);
    let expected = (fast(&without.cast(), &view.cast()).0, plain(&without, &view).0);
    for (name, poison) in poisons() {
        for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let mut gaussians: Vec<_> = clean.iter().collect();
            poison(&mut gaussians[7], value);
            let mut map = GaussianMap::new(clean.shape, clean.activation);
            gaussians.into_iter().for_each(|g| map.push(g));
            let (fast, plain) = (fast(&map.cast(), &view.cast()), plain(&map, &view));
            assert_finite(name, &fast);
            assert_finite(name, &plain);
            assert!(fast.0 == expected.0 && plain.0 == expected.1, "{name} {value}");
            assert!(!fast.1.seen[7] && fast.1.means[7] == [0.0; 3], "{name} {value}");
        }
    }
}

/// Numbers that are finite but whose exponentials are not.
#[test]
fn overflowing_parameters_are_left_out() {
    let view = view(SIZE[0], SIZE[1]);
    for (name, poison) in poisons() {
        for value in [1e3, -1e3, 3e38, -3e38] {
            let clean = map(Shape::Anisotropic);
            let mut spoiled = GaussianMap::new(clean.shape, clean.activation);
            for (i, mut g) in clean.iter().enumerate() {
                if i % 3 == 0 {
                    poison(&mut g, value);
                }
                spoiled.push(g);
            }
            assert_finite(name, &fast(&spoiled.cast(), &view.cast()));
            assert_finite(name, &plain(&spoiled, &view));
        }
    }
}

/// Unused parameters of an isotropic Gaussian have no effect.
#[test]
fn isotropic_gaussians_ignore_rotation_and_further_scales() {
    let view = view(SIZE[0], SIZE[1]);
    let clean = map(Shape::Isotropic);
    let mut odd = clean.clone();
    odd.rotations.fill([f64::NAN; 4]);
    odd.log_scales.iter_mut().for_each(|s| (s[1], s[2]) = (f64::NAN, 90.0));
    assert_eq!(plain(&odd, &view), plain(&clean, &view));
    assert_eq!(fast(&odd.cast(), &view.cast()), fast(&clean.cast(), &view.cast()));
}

#[test]
fn a_zero_quaternion_is_left_out() {
    let view = view(SIZE[0], SIZE[1]);
    let mut map = map(Shape::Anisotropic);
    map.rotations.fill([0.0; 4]);
    let (fast, plain) = (fast(&map.cast(), &view.cast()), plain(&map, &view));
    assert!(fast.0.opacity.data.iter().all(|v| *v == 0.0));
    assert!(plain.0.opacity.data.iter().all(|v| *v == 0.0));
    assert_eq!((fast.2, plain.2), (Tangent::zero(), Tangent::zero()));
}

/// Black, empty pictures of the right size, and no gradient.
#[track_caller]
fn assert_nothing(map: &GaussianMap<f64>, view: &View<f64>) {
    let (fast, plain) = (fast(&map.cast(), &view.cast()), plain(map, view));
    let [width, height] = [view.camera.width, view.camera.height];
    assert_eq!(fast.0, Render::new(width, height));
    assert_eq!(plain.0, Render::new(width, height));
    assert_eq!((fast.2, plain.2), (Tangent::zero(), Tangent::zero()));
    assert!(fast.1 == MapGradient::new(map) && plain.1 == MapGradient::new(map));
}

#[test]
fn nothing_to_see() {
    let view = view(SIZE[0], SIZE[1]);
    assert_nothing(&GaussianMap::new(Shape::Isotropic, ColourActivation::Linear), &view);
    let mut transparent = map(Shape::Isotropic);
    transparent.opacity_logits.fill(-200.0);
    assert_nothing(&transparent, &view);
    let mut behind = view;
    behind.world_from_camera.translation = view.world_from_camera * Vec3::new(0.0, 0.0, 50.0);
    assert_nothing(&map(Shape::Anisotropic), &behind);
    let mut lost = view;
    lost.world_from_camera = Pose::identity();
    lost.world_from_camera.translation.x = f64::NAN;
    assert_nothing(&map(Shape::Anisotropic), &lost);
}

/// Settings outside of their range are taken at its border.
#[test]
fn odd_settings_leave_gradients_finite() {
    let (map, view) = (map(Shape::Anisotropic).cast(), view(SIZE[0], SIZE[1]).cast());
    let settings = RasterSettings { near: -5.0, alpha_max: 2.0, ..RasterSettings::default() };
    let mut opaque: GaussianMap = map;
    opaque.opacity_logits.fill(60.0);
    let mut rasterizer = Rasterizer::new(settings);
    let (mut render, mut gradient) = (Render::default(), MapGradient::new(&opaque));
    opaque.render(&mut rasterizer, &view, &mut render);
    let cotangent = single_cotangent(&cotangent(SIZE[0], SIZE[1], 3));
    let tangent = opaque.pull_back(&mut rasterizer, &view, &cotangent, Some(&mut gradient));
    assert_finite("odd settings", &(render, gradient, tangent));
}

#[test]
fn an_image_without_pixels() {
    for [width, height] in [[0, 0], [0, 5], [5, 0]] {
        let mut view = view(SIZE[0], SIZE[1]);
        (view.camera.width, view.camera.height) = (width, height);
        assert_nothing(&map(Shape::Isotropic), &view);
    }
}

#[test]
#[should_panic(expected = "the map and the view of the last render")]
fn a_map_of_another_size_is_refused() {
    let (view, map) = (view(SIZE[0], SIZE[1]).cast(), map(Shape::Isotropic).cast());
    let mut rasterizer = Rasterizer::default();
    let empty = GaussianMap::new(map.shape, map.activation);
    empty.render(&mut rasterizer, &view, &mut Render::default());
    map.pull_back(&mut rasterizer, &view, &RenderCotangent::default(), None);
}
