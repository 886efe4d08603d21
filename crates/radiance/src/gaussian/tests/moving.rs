//! The fast lane of a moving camera: against the reference, against exact views, and against
//! itself.

use super::parity::*;
use super::*;
use i2slam_compute::simd::instruction_sets;
use i2slam_geometry::{Camera, Pose, Tangent};
use pulp::Arch;

/// A twist by about an eighth of the picture, with moments of unlike weights and a readout.
fn motion(readout: f64) -> ShutterMotion<f64> {
    let velocity = Tangent::from_array([0.05, -0.1, 0.06, 0.07, -0.06, 0.1]);
    let moments = [(-0.4, 1.0), (-0.1, 0.5), (0.15, 2.5), (0.5, 0.5)];
    let moments = moments.map(|(time, weight)| Moment { time, weight }).to_vec();
    ShutterMotion { velocity, readout, moments }
}

type Outcome = (Render, MapGradient, MotionGradient);

fn fast_on(arch: Arch, case: &Case, motion: &ShutterMotion<f64>) -> Outcome {
    masked_on(arch, case, motion, None, &single_cotangent(&case.cotangent()))
}

fn masked_on(
    arch: Arch,
    case: &Case,
    motion: &ShutterMotion<f64>,
    mask: Option<&[bool]>,
    cotangent: &RenderCotangent,
) -> Outcome {
    let (map, view, motion) = (case.map().cast(), case.view().cast(), motion.cast());
    let mut rasterizer = Rasterizer::on(arch, case.settings);
    let (mut render, mut gradient) = (Render::default(), MapGradient::new(&map));
    map.render_moving(&mut rasterizer, &view, &motion, mask, None, &mut render);
    let rows = Some(&mut gradient);
    let d = map.pull_back_moving(&mut rasterizer, &view, &motion, cotangent, rows);
    (render, gradient, d)
}

/// All numbers of a gradient but the map's.
fn numbers(d: &MotionGradient) -> Vec<f64> {
    let parts = [d.pose.to_array(), d.velocity.to_array()];
    parts.into_iter().flatten().chain([d.readout]).collect()
}

/// More moments than are composited together.
fn many_moments() -> ShutterMotion<f64> {
    let velocity = motion(0.0).velocity;
    ShutterMotion { readout: -2.5, ..ShutterMotion::global(velocity, 19) }
}

#[test]
fn a_moving_camera_agrees_with_the_reference() {
    let still = ShutterMotion { readout: 0.5, ..ShutterMotion::still() };
    let cases = cases();
    for case in &cases {
        for motion in [motion(0.0), motion(0.8), still.clone()] {
            assert_agreement(case, &motion);
        }
    }
    assert_agreement(&cases[1], &many_moments());
    assert_agreement(&cases[4], &many_moments());
}

fn assert_agreement(case: &Case, motion: &ShutterMotion<f64>) {
    let (map, view, settings) = (case.map(), case.view(), case.settings);
    let exact = reference::render_moving(&map, &view, motion, &settings);
    let mut exact_map = MapGradient::new(&map);
    let rows = Some(&mut exact_map);
    let cotangent = case.cotangent();
    let d = reference::pull_back_moving(&map, &view, motion, &settings, &cotangent, rows);
    for arch in instruction_sets() {
        let (render, gradient, fast) = fast_on(arch, case, motion);
        assert_pictures(case, &planes(&render), &planes(&exact));
        assert_gradients(case, &gradient, &exact_map);
        let single: Vec<f32> = numbers(&fast).iter().map(|v| *v as f32).collect();
        let off = distance(&single, &numbers(&d));
        assert!(off < case.gradient_tolerance(), "{} motion: {off:.2e}", case.name);
    }
}

/// Not a bit differs when there is but one moment and it stands still, whatever the velocity.
#[test]
fn without_motion_it_is_the_still_picture() {
    for case in cases() {
        let (map, view) = (case.map().cast(), case.view().cast());
        let mut rasterizer = Rasterizer::new(case.settings);
        let (mut still, mut moving) = (Render::default(), Render::default());
        map.render(&mut rasterizer, &view, &mut still);
        let mut camera = ShutterMotion::still();
        map.render_moving(&mut rasterizer, &view, &camera, None, None, &mut moving);
        assert!(still == moving, "{}", case.name);
        camera.velocity = motion(0.0).velocity.cast();
        map.render_moving(&mut rasterizer, &view, &camera, None, None, &mut moving);
        let margin_leaves_out = case.recipe.margin > 1.0;
        assert!(still == moving || margin_leaves_out, "{} with a velocity", case.name);
        let several = ShutterMotion::global(Tangent::zero(), 5);
        map.render_moving(&mut rasterizer, &view, &several, None, None, &mut moving);
        assert_pictures(&case, &planes(&moving), &planes(&still));
    }
}

/// Unmarked tiles are black and pass no gradient; the others do not change.
#[test]
fn masked_tiles_are_those_of_the_whole_picture() {
    let motion = motion(0.5);
    for case in cases().into_iter().chain([many()]) {
        let (whole, _, _) = fast_on(Arch::new(), &case, &motion);
        let view = case.view();
        let columns = view.camera.width.div_ceil(TILE);
        let is_marked = |number: usize| number % 3 == 1;
        let tiles = columns * view.camera.height.div_ceil(TILE);
        let mask: Vec<_> = (0..tiles).map(is_marked).collect();
        let at = |i: usize| {
            let (x, y) = (i % view.camera.width, i / view.camera.width % view.camera.height);
            is_marked(y / TILE * columns + x / TILE)
        };
        let mut cotangent = single_cotangent(&case.cotangent());
        let all = cotangent.clone();
        for plane in [&mut cotangent.radiance, &mut cotangent.depth, &mut cotangent.opacity] {
            plane.data.iter_mut().enumerate().for_each(|(i, d)| *d = if at(i) { *d } else { 0.0 });
        }
        let run = |mask: Option<&[bool]>, cotangent: &RenderCotangent| {
            masked_on(Arch::new(), &case, &motion, mask, cotangent)
        };
        let (render, gradient, d) = run(Some(&mask), &all);
        for (i, (part, whole)) in planes(&render).iter().zip(&planes(&whole)).enumerate() {
            assert_eq!(*part, if at(i) { *whole } else { 0.0 }, "{} pixel {i}", case.name);
        }
        let (_, expected, expected_d) = run(None, &cotangent);
        assert!(gradient == expected && d == expected_d, "{} gradient", case.name);
    }
}

#[test]
fn what_a_wider_picture_shows_is_enough() {
    let motion = motion(0.5).cast();
    for case in cases().into_iter().chain([many()]) {
        let (map, view) = (case.map().cast(), case.view().cast());
        let grid = [view.camera.width, view.camera.height].map(|size| size.div_ceil(TILE));
        let mask: Vec<_> = (0..grid[0] * grid[1]).map(|number| number % 3 == 1).collect();
        let shown_by = |view: View<f32>| {
            let [mut other, mut rasterizer] = [(); 2].map(|()| Rasterizer::new(case.settings));
            let mut render = Render::default();
            map.render(&mut other, &view, &mut render);
            let view = case.view().cast();
            let tiles = Some(mask.as_slice());
            map.render_moving(&mut rasterizer, &view, &motion, tiles, Some(&other), &mut render);
            planes(&render)
        };
        let mut whole = Render::default();
        let mut rasterizer = Rasterizer::new(case.settings);
        map.render_moving(&mut rasterizer, &view, &motion, Some(&mask), None, &mut whole);
        let wide = View { camera: view.camera.widened(64), ..view };
        assert!(shown_by(wide) == planes(&whole), "{}", case.name);
        let away = Tangent::from_array([0.0, 0.0, 0.0, 0.0, 3.0, 0.0]);
        let behind = View { world_from_camera: view.world_from_camera.retract(away), ..view };
        let any = mask.contains(&true);
        assert!(!any || shown_by(behind) != planes(&whole), "{} from behind", case.name);
    }
}

#[test]
fn a_moving_camera_does_not_depend_on_the_number_of_threads() {
    let (_, gradient, _) = on_any_threads(|| fast_on(Arch::new(), &many(), &motion(0.8)));
    assert!(gradient.seen.iter().any(|s| *s));
}

/// Moments and numbers that do not count leave a black picture or none of their own.
#[test]
fn moments_that_do_not_count_are_left_out() {
    let case = &cases()[1];
    let good = motion(0.3);
    let mut odd = good.clone();
    odd.moments.push(Moment { time: f64::NAN, weight: 1.0 });
    odd.moments.push(Moment { time: 0.1, weight: 0.0 });
    odd.moments.push(Moment { time: 0.1, weight: -1.0 });
    assert!(fast_on(Arch::new(), case, &odd) == fast_on(Arch::new(), case, &good));
    let none = ShutterMotion { moments: Vec::new(), ..good.clone() };
    let lost = ShutterMotion { readout: f64::NAN, ..good.clone() };
    let gone = ShutterMotion { velocity: Tangent::from_array([f64::NAN; 6]), ..good };
    for motion in [none, lost, gone] {
        let (render, gradient, _) = fast_on(Arch::new(), case, &motion);
        assert!(render == Render::new(case.size[0], case.size[1]), "not black");
        let zeros = MapGradient::new(&case.map());
        assert!(gradient.means == zeros.means && gradient.colours == zeros.colours);
    }
}

#[test]
#[should_panic(expected = "the map and the view of the last render")]
fn another_motion_is_refused() {
    let case = &cases()[0];
    let (map, view) = (case.map().cast(), case.view().cast());
    let mut rasterizer = Rasterizer::default();
    map.render_moving(
        &mut rasterizer,
        &view,
        &motion(0.0).cast(),
        None,
        None,
        &mut Render::default(),
    );
    let other = motion(0.1).cast();
    map.pull_back_moving(&mut rasterizer, &view, &other, &RenderCotangent::default(), None);
}

/// Camera motions that move the median point by about 10 px.
const TWISTS: [(&str, [f64; 6]); 5] = [
    ("sideways", [0.09, 0.0, 0.0, 0.0, 0.0, 0.0]),
    ("forward", [0.0, 0.0, 0.24, 0.0, 0.0, 0.0]),
    ("pan", [0.0, 0.0, 0.0, 0.0, 0.038, 0.0]),
    ("roll", [0.0, 0.0, 0.0, 0.0, 0.0, 0.11]),
    ("hand", [0.04, -0.03, 0.06, 0.02, -0.025, 0.04]),
];

/// 320x240 with small Gaussians at depths from 1 to 4 m.
fn small_gaussians() -> (GaussianMap<f32>, View<f32>) {
    let camera = Camera { width: 320, height: 240, fx: 260.0, fy: 260.0, cx: 160.0, cy: 120.0 };
    let view = View { camera, world_from_camera: Pose::identity() };
    let recipe = Recipe {
        count: 20_000,
        sigma: [0.8, 1.6],
        ..Recipe::new(Shape::Isotropic, ColourActivation::Exponential)
    };
    (recipe.build(&view).cast(), view.cast())
}

/// PSNR \[dB\] of pairs of a value and its exact average, for a peak of the largest average.
fn psnr(pairs: impl Iterator<Item = (f64, f64)>) -> f64 {
    let (mut squares, mut peak, mut count) = (0.0, 0.0_f64, 0.0);
    for (value, average) in pairs {
        squares += (value - average).powi(2);
        peak = peak.max(average);
        count += 1.0;
    }
    10.0 * (peak * peak * count / squares).log10()
}

/// The average of some renders at one place.
fn average(views: &[Render], at: impl Fn(&Render) -> f64) -> f64 {
    views.iter().map(at).sum::<f64>() / views.len() as f64
}

fn exact_views(map: &GaussianMap, view: &View<f32>, motion: &ShutterMotion) -> Vec<Render> {
    let mut rasterizer = Rasterizer::default();
    let at = |moment: &Moment| {
        let tangent = motion.velocity.scaled(moment.time);
        let world_from_camera = view.world_from_camera.retract(tangent);
        let mut render = Render::default();
        map.render(&mut rasterizer, &View { world_from_camera, ..*view }, &mut render);
        render
    };
    motion.moments.iter().map(at).collect()
}

/// 10 px of blur, against 32 exact views, with as many moments and with five.
#[test]
fn a_moving_camera_shows_the_average_of_exact_views() {
    let (map, view) = small_gaussians();
    for (name, twist) in TWISTS {
        let exact = ShutterMotion::global(Tangent::from_array(twist).cast(), 32);
        let views = exact_views(&map, &view, &exact);
        let mut render = Render::default();
        let mut psnr = |count: usize| {
            let motion = ShutterMotion::global(exact.velocity, count);
            map.render_moving(&mut Rasterizer::default(), &view, &motion, None, None, &mut render);
            psnr((0..render.radiance.data.len()).map(|i| {
                let at = |render: &Render| f64::from(render.radiance.data[i]);
                (at(&render), average(&views, at))
            }))
        };
        let found = [5, 32].map(&mut psnr);
        assert!(found[0] >= 36.0, "{name}: {found:.1?} dB");
        assert!(found[1] >= 45.0, "{name}: {found:.1?} dB");
    }
}

/// A readout as long as the exposure, against rows cut out of exact views at the times of each.
#[test]
fn a_rolling_shutter_shows_rows_of_exact_views() {
    let (map, view) = small_gaussians();
    let velocity = Tangent::from_array(TWISTS[4].1).cast();
    let motion = ShutterMotion { readout: 1.0, ..ShutterMotion::global(velocity, 5) };
    let mut picture = Render::default();
    map.render_moving(&mut Rasterizer::default(), &view, &motion, None, None, &mut picture);
    let mut pairs = Vec::new();
    for row in (5..240).step_by(30) {
        let mut shifted = motion.clone();
        let row_time = motion.readout * ((row as f32 + 0.5) / 240.0 - 0.5);
        shifted.moments.iter_mut().for_each(|moment| moment.time += row_time);
        let views = exact_views(&map, &view, &shifted);
        for (channel, column) in (0..3).flat_map(|c| (0..320).map(move |x| (c, x))) {
            let at = |render: &Render| f64::from(render.radiance.at(channel, column, row));
            pairs.push((at(&picture), average(&views, at)));
        }
    }
    let psnr = psnr(pairs.into_iter());
    assert!(psnr >= 45.0, "{psnr:.1} dB");
}
