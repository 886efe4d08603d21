//! The fast lane against the reference lane, and against itself.
//!
//! | case | what | against | tolerance | why |
//! |---|---|---|---|---|
//! | without cut-offs | picture | reference, `f32` and `f64` | 1e-4 | another exponential, other orders of sums, and against `f64` the rounding of the projection |
//! | without cut-offs | gradients | reference, `f64` | 2e-5 relative L2 per family | the same; about 5e-6 is measured |
//! | all others | picture | as above | 1e-4, in 2 of 1000 values 3e-2 | a contribution at the edge of `alpha_min` may fall to either side; it weighs 1/255 of what lies there |
//! | all others | gradients | as above | 1e-3 | the same: 3e-6 is measured without, 7e-4 with one such contribution |
//! | all | everything | 1, 2 and 5 threads | 0 | sums are in a fixed order |
//!
//! Every case runs on every instruction set of the machine.

use super::*;
use i2slam_compute::simd::instruction_sets;
use i2slam_geometry::{Real, Tangent};
use pulp::Arch;

const PICTURE: f64 = 1e-4;
/// Largest change by one contribution at the edge of `alpha_min`, for values of a few units.
const EDGE: f64 = 3e-2;
/// Part of the pixels that may hold such a contribution.
const EDGE_PART: f64 = 2e-3;
const GRADIENT: f64 = 1e-3;
const SMOOTH_GRADIENT: f64 = 2e-5;

pub(super) struct Case {
    pub(super) name: &'static str,
    pub(super) size: [usize; 2],
    pub(super) recipe: Recipe,
    pub(super) settings: RasterSettings,
}

pub(super) fn cases() -> Vec<Case> {
    let settings = RasterSettings::default();
    let balls = Recipe::new(Shape::Isotropic, ColourActivation::Exponential);
    let ellipsoids = Recipe::new(Shape::Anisotropic, ColourActivation::Linear);
    let dense = Recipe { count: 1500, logit: [2.0, 6.0], sigma: [2.0, 6.0], ..balls };
    let thin = Recipe { sigma: [0.05, 20.0], count: 200, margin: 0.4, ..ellipsoids };
    let long = Recipe { sigma: [0.3, 150.0], count: 80, margin: 1.5, seed: 4, ..ellipsoids };
    let glossy = Recipe { has_view_colours: true, ..ellipsoids };
    let smooth = RasterSettings { alpha_min: 0.0, transmittance_min: 0.0, ..settings };
    vec![
        Case { name: "balls", size: [64, 48], recipe: balls, settings },
        Case { name: "ellipsoids", size: [64, 48], recipe: ellipsoids, settings },
        Case { name: "glossy", size: [64, 48], recipe: glossy, settings },
        Case { name: "not of tiles", size: [37, 29], recipe: ellipsoids, settings },
        Case { name: "smaller than a tile", size: [5, 3], recipe: balls, settings },
        Case { name: "opaque", size: [48, 48], recipe: dense, settings },
        Case { name: "thin, from outside", size: [70, 50], recipe: thin, settings },
        Case { name: "longer than the image", size: [70, 50], recipe: long, settings },
        Case { name: "without cut-offs", size: [40, 33], recipe: ellipsoids, settings: smooth },
    ]
}

/// So many Gaussians that every stage is split.
pub(super) fn many() -> Case {
    let recipe = Recipe {
        count: 30_000,
        sigma: [0.4, 2.0],
        ..Recipe::new(Shape::Anisotropic, ColourActivation::Exponential)
    };
    Case { name: "many", size: [200, 150], recipe, settings: RasterSettings::default() }
}

impl Case {
    /// True if a contribution may fall to either side of a cut-off.
    pub(super) fn has_edges(&self) -> bool {
        self.settings.alpha_min > 0.0
    }

    pub(super) fn gradient_tolerance(&self) -> f64 {
        if self.has_edges() { GRADIENT } else { SMOOTH_GRADIENT }
    }

    pub(super) fn view(&self) -> View<f64> {
        view(self.size[0], self.size[1])
    }

    pub(super) fn map(&self) -> GaussianMap<f64> {
        self.recipe.build(&self.view())
    }

    pub(super) fn cotangent(&self) -> RenderCotangent<f64> {
        cotangent(self.size[0], self.size[1], 11)
    }

    /// Picture and gradients of the fast lane.
    fn fast(&self) -> (Render, MapGradient, Tangent<f64>) {
        self.fast_on(Arch::new())
    }

    fn fast_on(&self, arch: Arch) -> (Render, MapGradient, Tangent<f64>) {
        let (map, view) = (self.map().cast(), self.view().cast());
        let mut rasterizer = Rasterizer::on(arch, self.settings);
        let (mut render, mut gradient) = (Render::default(), MapGradient::new(&map));
        map.render(&mut rasterizer, &view, &mut render);
        let cotangent = single_cotangent(&self.cotangent());
        let tangent = map.pull_back(&mut rasterizer, &view, &cotangent, Some(&mut gradient));
        (render, gradient, tangent)
    }
}

/// All planes in one row.
pub(super) fn planes<T: Real>(render: &Render<T>) -> Vec<f64> {
    let all = [&render.radiance, &render.depth, &render.opacity];
    all.iter().flat_map(|image| image.data.iter().map(|&v| v.to_f64())).collect()
}

#[track_caller]
pub(super) fn assert_pictures(case: &Case, actual: &[f64], expected: &[f64]) {
    let name = case.name;
    let off = |limit: f64| {
        actual
            .iter()
            .zip(expected)
            .filter(|(a, e)| (*a - *e).abs().total_cmp(&limit).is_gt())
            .count()
    };
    assert_eq!(off(EDGE), 0, "{name}: beyond one contribution");
    let part = if case.has_edges() { EDGE_PART } else { 0.0 };
    let allowed = (part * actual.len() as f64) as usize;
    assert!(off(PICTURE) <= allowed, "{name}: {} of {}", off(PICTURE), actual.len());
}

#[test]
fn pictures_agree_with_the_reference() {
    for case in cases() {
        let (map, view) = (case.map(), case.view());
        let single = reference::render(&map.cast::<f32>(), &view.cast(), &case.settings);
        let double = reference::render(&map, &view, &case.settings);
        for arch in instruction_sets() {
            let (render, _, _) = case.fast_on(arch);
            assert_pictures(&case, &planes(&render), &planes(&single));
            assert_pictures(&case, &planes(&render), &planes(&double));
        }
    }
}

/// The distance of two vectors relative to the length of the second.
pub(super) fn distance<'a>(
    actual: impl IntoIterator<Item = &'a f32>,
    expected: impl IntoIterator<Item = &'a f64>,
) -> f64 {
    let (mut difference, mut length) = (0.0_f64, 0.0_f64);
    for (a, e) in actual.into_iter().zip(expected) {
        difference += (f64::from(*a) - e).powi(2);
        length += e * e;
    }
    if length == 0.0 { difference } else { (difference / length).sqrt() }
}

#[test]
fn gradients_agree_with_the_reference() {
    for case in cases() {
        let (map, view, cotangent) = (case.map(), case.view(), case.cotangent());
        let mut exact = MapGradient::new(&map);
        let tangent =
            reference::pull_back(&map, &view, &case.settings, &cotangent, Some(&mut exact));
        for arch in instruction_sets() {
            let (_, fast, fast_tangent) = case.fast_on(arch);
            assert_gradients(&case, &fast, &exact);
            let single = fast_tangent.to_array().map(|v| v as f32);
            let pose = distance(&single, &tangent.to_array());
            assert!(pose < case.gradient_tolerance(), "{} pose: {pose:.2e}", case.name);
        }
    }
}

#[track_caller]
pub(super) fn assert_gradients(case: &Case, fast: &MapGradient, exact: &MapGradient<f64>) {
    let name = case.name;
    let families = [
        ("means", distance(fast.means.as_flattened(), exact.means.as_flattened())),
        ("scales", distance(fast.log_scales.as_flattened(), exact.log_scales.as_flattened())),
        ("rotations", distance(fast.rotations.as_flattened(), exact.rotations.as_flattened())),
        ("colours", distance(fast.colours.as_flattened(), exact.colours.as_flattened())),
        (
            "view colours",
            distance(fast.view_colours.as_flattened(), exact.view_colours.as_flattened()),
        ),
        ("opacities", distance(&fast.opacity_logits, &exact.opacity_logits)),
    ];
    for (family, distance) in families {
        assert!(distance < case.gradient_tolerance(), "{name} {family}: {distance:.2e}");
    }
    let unlike = fast.seen.iter().zip(&exact.seen).filter(|(a, b)| a != b).count();
    assert!(unlike <= 1, "{name}: {unlike} differ in being seen");
}

/// Leaving the map out changes nothing for the pose but the order of nothing.
#[test]
fn the_pose_gradient_does_not_need_the_map() {
    for case in cases() {
        let (map, view) = (case.map().cast(), case.view().cast());
        let mut rasterizer = Rasterizer::new(case.settings);
        map.render(&mut rasterizer, &view, &mut Render::default());
        let cotangent = single_cotangent(&case.cotangent());
        let alone = map.pull_back(&mut rasterizer, &view, &cotangent, None);
        assert_eq!(alone, case.fast().2, "{}", case.name);
    }
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let (_, gradient, _) = on_any_threads(|| many().fast());
    assert!(gradient.seen.iter().any(|s| *s));
}

/// Buffers that another map and another size have filled leave no trace.
#[test]
fn a_used_rasterizer_gives_what_a_new_one_gives() {
    let mut rasterizer = Rasterizer::new(RasterSettings::default());
    let mut render = Render::default();
    for case in cases().iter().filter(|case| case.settings == RasterSettings::default()) {
        let (map, view) = (case.map().cast(), case.view().cast());
        map.render(&mut rasterizer, &view, &mut render);
        let mut gradient = MapGradient::new(&map);
        let cotangent = single_cotangent(&case.cotangent());
        let tangent = map.pull_back(&mut rasterizer, &view, &cotangent, Some(&mut gradient));
        assert!((render.clone(), gradient, tangent) == case.fast(), "{}", case.name);
    }
}

/// A cotangent without some planes is one with zeros.
#[test]
fn missing_planes_are_zeros() {
    let case = &cases()[1];
    let (map, view) = (case.map().cast(), case.view().cast());
    let mut rasterizer = Rasterizer::new(case.settings);
    map.render(&mut rasterizer, &view, &mut Render::default());
    let mut with_zeros = single_cotangent(&case.cotangent());
    with_zeros.depth.data.fill(0.0);
    with_zeros.opacity.data.fill(0.0);
    let mut missing =
        RenderCotangent { radiance: with_zeros.radiance.clone(), ..Default::default() };
    let tangent = map.pull_back(&mut rasterizer, &view, &with_zeros, None);
    assert_eq!(tangent, map.pull_back(&mut rasterizer, &view, &missing, None));
    assert_ne!(tangent, Tangent::zero());
    missing = RenderCotangent::default();
    assert_eq!(Tangent::zero(), map.pull_back(&mut rasterizer, &view, &missing, None));
}

/// The comparison above fails for a slightly brighter map.
#[test]
#[should_panic(expected = "beyond one contribution")]
fn a_brighter_map_is_told_apart() {
    let case = &cases()[0];
    let (view, mut map) = (case.view(), case.map());
    map.colours.iter_mut().for_each(|c| *c = c.map(|v| v + 0.1));
    let brighter = reference::render(&map, &view, &case.settings);
    assert_pictures(case, &planes(&case.fast().0), &planes(&brighter));
}
