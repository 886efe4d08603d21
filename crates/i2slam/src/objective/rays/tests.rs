//! Derivatives of the objective against differences, and the rays of a batch.

use super::*;
use crate::objective::{Exposure, Sampling};
use i2slam_check::{central_differences, noise, relative_error};
use i2slam_formation::{
    CameraResponse, Formation, FrameTone, NodeSpacing, ShutterPoses, StartCurve, Vignetting,
};
use i2slam_geometry::Tangent;
use i2slam_radiance::hashgrid::{
    FieldSettings, HashGridField, Occupancy, OccupancySettings, Sample, reference,
};

const CAMERA: Camera<f32> = Camera { width: 16, height: 12, fx: 14.0, fy: 14.0, cx: 8.0, cy: 6.0 };

/// A field of broad cells, the camera within one, so that differences see few corners. It is dense,
/// so that rays end within the cube, whose end does not go along with the pose.
fn map() -> HashGridMap {
    let settings = FieldSettings {
        levels: 2,
        base_resolution: 2,
        finest_resolution: 3,
        hidden_width: 16,
        ..FieldSettings::cube([0.45, -0.35, 0.6], 2.0)
    };
    let mut field = HashGridField::<f32>::new(settings, 3).expect("settings in range");
    let [table, density, colour] = field.parameters_mut();
    colour.iter_mut().for_each(|w| *w *= 2.0);
    let numbers = noise(5, table.len());
    table.iter_mut().zip(numbers).for_each(|(v, n)| *v = 1.0 + 0.9 * n as f32);
    density.iter_mut().for_each(|w| *w = 0.8 * w.abs());
    let march = MarchSettings { step_min: 0.03, ..MarchSettings::cube(2.0) };
    let occupancy = OccupancySettings { resolution: 4, ..OccupancySettings::default() };
    HashGridMap { field, occupancy: Occupancy::new(occupancy), march }
}

/// Values far from anything that the field shows, so that no difference changes its sign.
fn observation() -> Observation {
    let index = |channel, column, row| (channel * 12 + row) * 16 + column;
    let bright = |c, x, y| if index(c, x, y) % 3 == 0 { 2.0 } else { 0.0 };
    let near = |c, x, y| if index(c, x, y) % 5 == 0 { 0.0 } else { 0.02 };
    let (colour, depth) = (Image::from_fn(16, 12, 3, bright), Image::from_fn(16, 12, 1, near));
    Observation::new(colour, depth)
}

/// Kind of depth observation.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Depth {
    Measured,
    /// Measured from a pose of its own.
    Beside,
    Estimated,
}

impl Depth {
    fn observation(self) -> Observation {
        let Observation { colour, depth, .. } = observation();
        match self {
            Self::Estimated => {
                let variance = depth.data.iter().map(|d| 0.5 + d).collect();
                Observation::estimated(
                    colour,
                    depth,
                    Image { data: variance, ..Image::new(16, 12, 1) },
                )
            }
            _ => Observation::new(colour, depth),
        }
    }
}

/// Pixels that are compared.
fn pixels() -> Vec<usize> {
    (0..16 * 12).step_by(7).collect()
}

/// A motion whose start and end pose are moved by `x`.
fn shutter(x: &[f64]) -> ShutterPoses<f64> {
    let part = |from: usize| Tangent::from_array(std::array::from_fn(|i| x[from + i]));
    let end = Pose::identity().retract(Tangent::from_array([0.02, -0.03, 0.01, 0.02, 0.03, -0.01]));
    ShutterPoses { start: Pose::identity().retract(part(0)), end: end.retract(part(6)) }
}

/// A pose of depth beside the middle of the motion.
fn beside(shutter: &ShutterPoses<f64>) -> Pose<f64> {
    let lead = Tangent::from_array([0.03, -0.02, 0.04, 0.05, -0.04, 0.03]);
    shutter.middle().retract(lead)
}

/// Pixels of a frame without tone, of a global shutter and with depth at mid-exposure.
fn batch(
    observation: &Observation,
    shutter: ShutterPoses<f64>,
    virtual_cameras: usize,
    pixels: Vec<usize>,
) -> PixelBatch<'_> {
    let sampling = Sampling { virtual_cameras, ..Sampling::SINGLE_CAMERA };
    let exposure = Exposure { shutter, sampling, readout: 0.0, depth_pose: None };
    PixelBatch { observation, variables: FrameVariables { exposure, tone: None }, pixels }
}

/// Evaluations of two views of the same pixels, of which the first moves by `x`: start pose, end
/// pose, log exposure and log white balance; what evaluated them, and what every ray of the first
/// adds to the derivative by its poses.
fn evaluated(
    x: &[f64],
    cameras: usize,
    depth: Depth,
    d_field: &mut FieldGradient,
    map: &HashGridMap,
) -> (Vec<Evaluation>, RayObjective, Vec<[f64; 12]>) {
    let curve = CameraResponse::<f32>::new(3, StartCurve::Srgb, NodeSpacing::Power(2.2)).curve();
    let lens = Vignetting { coefficients: [-0.3, -0.1, 0.0] }.at_pixels(&CAMERA);
    let shutter = shutter(x);
    let frame = FrameTone {
        log_exposure: x[12] as f32,
        log_white_balance: [x[13] as f32, x[14] as f32, x[15] as f32],
    };
    let sampling = Sampling { virtual_cameras: cameras, ..Sampling::SINGLE_CAMERA };
    let observation = depth.observation();
    let view = |shutter: ShutterPoses<f64>, frame| PixelBatch {
        observation: &observation,
        variables: FrameVariables {
            exposure: Exposure {
                shutter,
                sampling,
                readout: 0.3,
                depth_pose: (depth == Depth::Beside).then(|| beside(&shutter)),
            },
            tone: Some(Formation { tone: frame, curve: &curve, vignetting: Some(&lens) }),
        },
        pixels: pixels(),
    };
    let views =
        [view(shutter, frame), view(ShutterPoses::still(Pose::identity()), FrameTone::default())];
    let mut objective = RayObjective::new(CAMERA, map.march);
    let found = objective.map(map, &views, (0.5, 1.0), true, &mut Random::new(3), d_field);
    let (range, stride) = (objective.ranges[0].clone(), views[0].rays_per_pixel());
    let of_ray = |ray| objective.ray_to_shutter(&views[0], pixels()[ray / stride], ray).to_array();
    let by_ray = range.map(of_ray).collect();
    (found, objective, by_ray)
}

fn total(evaluations: &[Evaluation]) -> f64 {
    evaluations.iter().map(|e| e.total).sum()
}

/// Radiance and depth of each ray of the first view in `f64`, times its cotangents, with start and
/// end pose moved by `x`: the derivative of their sum is that of the loss.
fn first_view(objective: &RayObjective, map: &HashGridMap, x: &[f64], depth: Depth) -> Vec<f64> {
    let (field, moved, pixels) = (map.field.cast::<f64>(), shutter(x), pixels());
    let camera = CAMERA.cast::<f64>();
    let range = objective.ranges[0].clone();
    let stride = range.len() / pixels.len();
    let value = |ray: usize| {
        let pixel = pixels[(ray - range.start) / stride];
        let pose = match objective.times[ray] {
            RayTime::Exposure(u) => moved.at(u),
            RayTime::Depth if depth == Depth::Beside => beside(&moved),
            RayTime::Depth => moved.middle(),
        };
        let drawn = &objective.rays[ray];
        let samples = map.occupancy.samples(&map.field, &map.march, drawn);
        let cast = |s: Sample| Sample { depth: f64::from(s.depth), step: f64::from(s.step) };
        let samples: Vec<Sample<f64>> = samples.into_iter().map(cast).collect();
        let view = View { camera, world_from_camera: pose };
        let seen = Ray::through_pixel(&view, pixel % camera.width, pixel / camera.width);
        let shown = reference::render(&field, &seen, &samples);
        let d = &objective.cotangents[ray];
        let colour: f64 = (0..3).map(|c| f64::from(d.radiance[c]) * shown.radiance[c]).sum();
        colour + f64::from(d.depth) * shown.depth
    };
    range.clone().map(value).collect()
}

/// Ray by ray, because much of what a pose changes cancels over a view.
#[test]
fn gradients_of_poses_agree_with_differences() {
    // The reference has no early end.
    let mut map = map();
    map.march.transmittance_min = 0.0;
    let with = |cameras| [Depth::Measured, Depth::Beside, Depth::Estimated].map(|d| (cameras, d));
    for (cameras, depth) in [with(1), with(4)].concat() {
        let mut d_field = FieldGradient::zeros(&map.field);
        let (found, objective, by_ray) = evaluated(&[0.0; 16], cameras, depth, &mut d_field, &map);
        for (k, whole) in found[0].shutter.to_array().into_iter().enumerate() {
            let moved =
                |h: f64| std::array::from_fn::<f64, 12, _>(|i| if i == k { h } else { 0.0 });
            let at = |h: f64| first_view(&objective, &map, &moved(h), depth);
            let numeric: Vec<f64> =
                at(1e-7).iter().zip(at(-1e-7)).map(|(a, b)| (a - b) / 2e-7).collect();
            let analytic: Vec<f64> = by_ray.iter().map(|d| d[k]).collect();
            let error = relative_error(&analytic, &numeric);
            let scale = numeric.iter().fold(0.0_f64, |most, n| most.max(n.abs()));
            let pairs = analytic.iter().zip(&numeric);
            let off = pairs.filter(|(a, n)| (*a - *n).abs() > 1e-5 * scale).count();
            // A sample beside the border of a cell, where the slope jumps, may be on its other side
            // in `f32`.
            assert!(50 * off <= numeric.len(), "{cameras} {depth:?} {k} {off}");
            assert!(error < 1e-3, "{cameras} {depth:?} {k} {error}");
            let sum: f64 = analytic.iter().sum();
            assert!((whole - sum).abs() <= 1e-9 * sum.abs(), "{whole} {sum}");
        }
    }
}

#[test]
fn gradients_of_tone_agree_with_differences() {
    let map = map();
    for (cameras, depth) in [(1, Depth::Measured), (4, Depth::Beside)] {
        let mut d_field = FieldGradient::zeros(&map.field);
        let mut at = |tone: &[f64]| {
            let x: Vec<f64> = [0.0; 12].iter().chain(tone).copied().collect();
            evaluated(&x, cameras, depth, &mut d_field, &map).0
        };
        let analytic = at(&[0.0; 4])[0].tone.to_array().map(f64::from);
        // A larger step takes a pixel over the kink of the absolute difference.
        let numeric = central_differences(&[0.0; 4], 1e-3, |x| total(&at(x)));
        let error = relative_error(&analytic, &numeric);
        assert!(error < 5e-3, "{cameras} {depth:?} {error}");
    }
}

#[test]
fn the_gradient_of_the_field_agrees_with_differences() {
    let map = map();
    let mut d_field = FieldGradient::zeros(&map.field);
    evaluated(&[0.0; 16], 3, Depth::Beside, &mut d_field, &map);
    let start: Vec<f64> = map.field.parameters().colour[..24].iter().map(|v| (*v).into()).collect();
    let numeric = central_differences(&start, 5e-3, |x| {
        let mut moved = map.clone();
        let colour = &mut moved.field.parameters_mut()[2][..24];
        colour.iter_mut().zip(x).for_each(|(c, v)| *c = *v as f32);
        let mut unused = FieldGradient::zeros(&map.field);
        total(&evaluated(&[0.0; 16], 3, Depth::Beside, &mut unused, &moved).0)
    });
    let analytic: Vec<f64> = d_field.colour[..24].iter().map(|v| (*v).into()).collect();
    let error = relative_error(&analytic, &numeric);
    assert!(error < 2e-2, "{error}");
}

/// Many random times average to what the exposure integral is.
#[test]
fn random_moments_average_to_the_exposure() {
    let map = map();
    let mut objective = RayObjective::new(CAMERA, map.march);
    let observation = observation();
    let end = Pose::identity().retract(Tangent::from_array([0.2, -0.1, 0.1, 0.2, 0.3, -0.1]));
    let shutter = ShutterPoses { start: Pose::identity(), end };
    let mut mean = |cameras: usize, seeds: u64| {
        let view = [batch(&observation, shutter, cameras, vec![70, 101])];
        let mut sum = [0.0_f64; 6];
        for seed in 0..seeds {
            let mut d_field = FieldGradient::zeros(&map.field);
            let mut random = Random::new(seed);
            objective.map(&map, &view, (1.0, 0.0), false, &mut random, &mut d_field);
            sum.iter_mut().zip(&objective.hdr.data).for_each(|(s, v)| *s += f64::from(*v));
        }
        sum.iter().map(|s| s / seeds as f64).collect::<Vec<_>>()
    };
    let (few, many, still) = (mean(2, 400), mean(200, 2), mean(1, 1));
    let error = |a: &[f64]| relative_error(a, &many);
    assert!(error(&few) < 0.2 * error(&still), "{} {}", error(&few), error(&still));
}

/// Times are evenly spaced without jitter, and within their share of each `N`-th with it.
#[test]
fn times_keep_to_their_share() {
    let map = map();
    let observation = observation();
    let still = ShutterPoses::still(Pose::identity());
    let view = [batch(&observation, still, 4, pixels())];
    let farthest = |share: f32| {
        let mut objective = RayObjective::new(CAMERA, map.march);
        objective.set_time_jitter(share);
        objective.create_rays(&view, &mut Random::new(3));
        let off_the_middle = |time: &RayTime| match time {
            RayTime::Exposure(u) => Some(((4.0 * u).fract() - 0.5).abs()),
            RayTime::Depth => None,
        };
        objective.times.iter().filter_map(off_the_middle).fold(0.0, f64::max)
    };
    assert!(farthest(0.0) < 1e-12);
    let (half, whole) = (farthest(0.5), farthest(1.0));
    assert!(half > 0.2 && half <= 0.25 && whole > 0.4 && whole <= 0.5, "{half} {whole}");
}

/// `JᵀJ` of all colour values against differences of the formed picture.
#[test]
fn the_shutter_hessian_agrees_with_differences() {
    let map = map();
    let curve = CameraResponse::<f32>::new(3, StartCurve::Srgb, NodeSpacing::Power(2.2)).curve();
    let observation = observation();
    let end = Pose::identity().retract(Tangent::from_array([0.02, -0.03, 0.01, 0.02, 0.03, -0.01]));
    let still = ShutterPoses { start: Pose::identity(), end };
    let view = |x: &[f64]| {
        let step = ShutterTangent::from_array(std::array::from_fn(|i| x[i]));
        let pixels = (0..16 * 12).step_by(5).collect();
        let mut view = batch(&observation, still.retract(&step), 3, pixels);
        view.variables.tone =
            Some(Formation { tone: FrameTone::default(), curve: &curve, vignetting: None });
        view
    };
    let mut objective = RayObjective::new(CAMERA, map.march);
    let hessian = objective.shutter_hessian(&map, &view(&[0.0; 12]), &mut Random::new(3));
    let mut picture = |x: &[f64]| -> Vec<f64> {
        let mut d_field = FieldGradient::zeros(&map.field);
        let mut random = Random::new(3);
        objective.map(&map, &[view(x)], (1.0, 0.0), false, &mut random, &mut d_field);
        objective.picture.data.iter().map(|v| f64::from(*v)).collect()
    };
    let step = 4e-3;
    let columns: Vec<Vec<f64>> = (0..12)
        .map(|k| {
            let at = |s: f64| std::array::from_fn::<f64, 12, _>(|i| if i == k { s } else { 0.0 });
            let (ahead, behind) = (picture(&at(step)), picture(&at(-step)));
            ahead.iter().zip(&behind).map(|(a, b)| (a - b) / (2.0 * step)).collect()
        })
        .collect();
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let numeric: Vec<f64> = (0..144)
        .map(|i| dot(&columns[i / 12], &columns[i % 12]) / columns[0].len() as f64)
        .collect();
    let error = relative_error(&hessian.concat(), &numeric);
    assert!(error < 0.1, "{error}");
}

/// All rays through an empty field, none through a dense one.
#[test]
fn rays_of_low_opacity_are_listed() {
    let observation = observation();
    let still = ShutterPoses::still(Pose::identity());
    let view = [batch(&observation, still, 3, vec![70, 101])];
    let low_opacity_rays = |map: &HashGridMap| {
        let mut objective = RayObjective::new(CAMERA, map.march);
        let mut d_field = FieldGradient::zeros(&map.field);
        objective.map(map, &view, (1.0, 0.0), false, &mut Random::new(3), &mut d_field);
        objective.low_opacity_rays().count()
    };
    let dense = map();
    let settings = *dense.occupancy.settings();
    let empty = HashGridMap { occupancy: Occupancy::empty(settings), ..dense.clone() };
    let rays = 2 * view[0].rays_per_pixel();
    assert_eq!((low_opacity_rays(&dense), low_opacity_rays(&empty)), (0, rays));
}

#[test]
fn median_depth_and_samples_are_of_the_last_batch() {
    let map = map();
    let observation = observation();
    let still = ShutterPoses::still(Pose::identity());
    let view = [batch(&observation, still, 1, vec![70, 101, 120])];
    let mut objective = RayObjective::new(CAMERA, map.march);
    assert_eq!((objective.median_depth(0), objective.samples_per_pixel()), (None, None));
    let mut d_field = FieldGradient::zeros(&map.field);
    objective.map(&map, &view, (1.0, 0.0), false, &mut Random::new(1), &mut d_field);
    let depth = objective.median_depth(0).expect("a dense field");
    assert!(depth > 0.05 && depth < 2.5, "{depth}");
    let each = objective.samples_per_pixel().expect("samples");
    assert_eq!((3.0 * each).round() as usize, objective.renderer.samples());
}
