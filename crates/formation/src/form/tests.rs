use super::{Formation, accumulate, scale_into};
use crate::shutter::{Quadrature, ShutterPoses};
use crate::tone::{
    CameraResponse, CurveGradient, FrameTone, FrameToneGradient, NODES, NodeSpacing, ResponseCurve,
    StartCurve,
};
use i2slam_check::{assert_close, assert_gradient, noise};
use i2slam_geometry::{Image, Pose, Real, Rotation, Tangent, Vec3};

const WIDTH: usize = 9;
const HEIGHT: usize = 5;

/// Radiance below 0, in [0, 1] and above 1.
fn radiance(seed: u64) -> Image<f64> {
    let mut image = Image::new(WIDTH, HEIGHT, 3);
    image.data = noise(seed, WIDTH * HEIGHT * 3).iter().map(|n| 0.6 + 1.3 * n).collect();
    image
}

fn tone() -> FrameTone<f64> {
    FrameTone { log_exposure: -0.2, log_white_balance: [0.3, -0.1, -0.4] }
}

fn response(curves: usize, spacing: NodeSpacing) -> CameraResponse<f64> {
    CameraResponse::new(curves, StartCurve::Srgb, spacing)
}

fn form<T: Real>(tone: &FrameTone<T>, curve: &ResponseCurve<T>, hdr: &Image<T>) -> Image<T> {
    let mut picture = Image::default();
    Formation::new(tone, curve).form(hdr, &mut picture);
    picture
}

fn dot(a: &Image<f64>, b: &Image<f64>) -> f64 {
    a.data.iter().zip(&b.data).map(|(a, b)| a * b).sum()
}

struct Gradients {
    hdr: Image<f64>,
    tone: FrameToneGradient<f64>,
    curve: CurveGradient<f64>,
}

fn pull_back(curve: &ResponseCurve<f64>, hdr: &Image<f64>, d_picture: &Image<f64>) -> Gradients {
    let mut g = Gradients {
        hdr: Image::default(),
        tone: FrameToneGradient::default(),
        curve: CurveGradient::zero(curve),
    };
    let tone = tone();
    let formation = Formation::new(&tone, curve);
    formation.pull_back(hdr, d_picture, &mut g.hdr, &mut g.tone, &mut g.curve);
    g
}

const CASES: [(usize, NodeSpacing); 4] = [
    (1, NodeSpacing::Uniform),
    (3, NodeSpacing::Uniform),
    (1, NodeSpacing::Power(2.2)),
    (3, NodeSpacing::Power(2.2)),
];

#[test]
fn all_branches_are_taken() {
    let hdr = radiance(1);
    for channel in 0..3 {
        let gain = tone().gains()[channel];
        let x: Vec<f64> = hdr.plane(channel).iter().map(|r| gain * r).collect();
        assert!(x.iter().any(|x| *x < 0.0) && x.iter().any(|x| *x > 1.0));
        assert!(x.iter().any(|x| (0.0..1.0).contains(x)));
    }
}

#[test]
fn picture_is_the_curve_of_the_gained_radiance() {
    for (curves, spacing) in CASES {
        let curve = response(curves, spacing).curve();
        let (hdr, gains) = (radiance(1), tone().gains());
        let picture = form(&tone(), &curve, &hdr);
        for channel in 0..3 {
            let expected: Vec<f64> = hdr
                .plane(channel)
                .iter()
                .map(|r| curve.evaluate(channel, gains[channel] * r))
                .collect();
            assert_eq!(picture.plane(channel), expected);
        }
    }
}

#[test]
fn radiance_and_tone_gradients_agree_with_differences() {
    for (curves, spacing) in CASES {
        let curve = response(curves, spacing).curve();
        let (hdr, d_picture) = (radiance(1), radiance(2));
        let g = pull_back(&curve, &hdr, &d_picture);
        // Steps small enough to stay between two nodes, where the curve is smooth.
        assert_gradient("radiance", &hdr.data, &g.hdr.data, 1e-8, 1e-6, |x| {
            let moved = Image { data: x.to_vec(), ..hdr.clone() };
            dot(&form(&tone(), &curve, &moved), &d_picture)
        });
        assert_gradient("tone", &tone().to_array(), &g.tone.to_array(), 1e-8, 1e-6, |x| {
            let moved = FrameTone::from_array(std::array::from_fn(|i| x[i]));
            dot(&form(&moved, &curve, &hdr), &d_picture)
        });
    }
}

#[test]
fn node_gradient_agrees_with_differences_through_the_picture() {
    for (curves, spacing) in CASES {
        let mut response = response(curves, spacing);
        // One step falls: the shift is active.
        response.nodes.iter_mut().for_each(|g| g[40..].iter_mut().for_each(|g| *g -= 0.1));
        let (hdr, d_picture) = (radiance(1), radiance(2));
        let g = pull_back(&response.curve(), &hdr, &d_picture);
        let gradient = response.pull_back(&g.curve).concat();
        assert_gradient("nodes", &response.nodes.concat(), &gradient, 1e-6, 1e-6, |x| {
            let mut moved = response.clone();
            moved.nodes = x.chunks(NODES).map(<[f64]>::to_vec).collect();
            dot(&form(&tone(), &moved.curve(), &hdr), &d_picture)
        });
    }
}

#[test]
fn tone_and_curve_gradients_are_added_to() {
    let curve = response(1, NodeSpacing::Uniform).curve();
    let (hdr, d_picture) = (radiance(1), radiance(2));
    let once = pull_back(&curve, &hdr, &d_picture);
    let mut twice = pull_back(&curve, &hdr, &d_picture);
    let tone = tone();
    let formation = Formation::new(&tone, &curve);
    formation.pull_back(&hdr, &d_picture, &mut twice.hdr, &mut twice.tone, &mut twice.curve);
    assert_eq!(twice.hdr, once.hdr);
    assert_close("tone", &twice.tone.to_array(), &once.tone.to_array().map(|v| 2.0 * v), 1e-14);
    let doubled: Vec<f64> = once.curve.values.concat().iter().map(|v| 2.0 * v).collect();
    assert_close("curve", &twice.curve.values.concat(), &doubled, 1e-14);
}

#[test]
fn exposure_times_k_and_radiance_over_k_form_the_same_picture() {
    let curve = response(3, NodeSpacing::Power(2.2)).curve();
    let hdr = radiance(5);
    for k in [0.1, 3.0, 40.0_f64] {
        let dimmer = Image { data: hdr.data.iter().map(|r| r / k).collect(), ..hdr.clone() };
        let mut longer = tone();
        longer.log_exposure += k.ln();
        let (a, b) = (form(&tone(), &curve, &hdr), form(&longer, &curve, &dimmer));
        assert_close("gauge", &b.data, &a.data, 1e-12);
    }
}

#[test]
fn identity_passes_both_ways_untouched() {
    let hdr = radiance(1);
    let (mut picture, mut d_hdr) = (Image::default(), Image::default());
    let formation = Formation::<f64>::identity();
    formation.form(&hdr, &mut picture);
    assert_eq!(picture, hdr);
    let mut d_tone = FrameToneGradient::default();
    let mut d_curve = CurveGradient::default();
    formation.pull_back(&hdr, &radiance(2), &mut d_hdr, &mut d_tone, &mut d_curve);
    assert_eq!(d_hdr, radiance(2));
    assert_eq!(d_tone, FrameToneGradient::default());
}

/// A radiance field that depends on the pose alone, smooth: `exp(weights · (ρ, φ))`.
fn field(pose: Pose<f64>, weights: &[f64]) -> f64 {
    let moved = Pose::identity().local(pose).to_array();
    moved.iter().zip(weights).map(|(a, b)| a * b).sum::<f64>().exp()
}

/// By differences: this test is about the chain, not about the field.
fn field_gradient(pose: Pose<f64>, weights: &[f64]) -> Tangent<f64> {
    let gradient = i2slam_check::central_differences(&[0.0; 6], 1e-3, |x| {
        field(pose.retract(Tangent::from_array(std::array::from_fn(|i| x[i]))), weights)
    });
    Tangent::from_array(std::array::from_fn(|i| gradient[i]))
}

#[test]
fn the_whole_chain_from_shutter_to_picture_agrees_with_differences() {
    let weights = noise(3, 6);
    let end = Pose::new(Rotation::exp(Vec3::new(0.3, -0.2, 0.1)), Vec3::new(0.3, -0.1, 0.2));
    let shutter = ShutterPoses { start: Pose::identity(), end };
    let curve = response(1, NodeSpacing::Uniform).curve();
    let tone = FrameTone { log_exposure: -1.0, ..FrameTone::default() };
    let blurred = |shutter: &ShutterPoses<f64>| {
        let mut hdr = Image::new(1, 1, 3);
        for camera in shutter.virtual_cameras(5, Quadrature::Endpoints) {
            let radiance = vec![field(camera.world_from_camera, &weights); 3];
            let view = Image { width: 1, height: 1, channels: 3, data: radiance };
            accumulate(&mut hdr, camera.weight, &view);
        }
        hdr
    };
    let hdr = blurred(&shutter);
    let ones = Image { data: vec![1.0; 3], ..hdr.clone() };
    let (mut d_hdr, mut d_view) = (Image::default(), Image::default());
    let (mut d_tone, mut d_curve) = (FrameToneGradient::default(), CurveGradient::zero(&curve));
    let formation = Formation::new(&tone, &curve);
    formation.pull_back(&hdr, &ones, &mut d_hdr, &mut d_tone, &mut d_curve);
    let mut total = crate::ShutterTangent::zero();
    for camera in shutter.virtual_cameras(5, Quadrature::Endpoints) {
        scale_into(&d_hdr, camera.weight, &mut d_view);
        let d_radiance: f64 = d_view.data.iter().sum();
        let d_pose = field_gradient(camera.world_from_camera, &weights).scaled(d_radiance);
        total = total.plus(shutter.pull_back(camera.u, d_pose));
    }
    assert_gradient("chain", &[0.0; 12], &total.to_array(), 1e-5, 1e-6, |x| {
        let tangent = crate::ShutterTangent::from_array(std::array::from_fn(|i| x[i]));
        form(&tone, &curve, &blurred(&shutter.retract(&tangent))).data.iter().sum()
    });
}

#[test]
fn poison_stays_in_its_pixel_and_can_be_masked() {
    for (curves, spacing) in CASES {
        let curve = response(curves, spacing).curve();
        let mut hdr = radiance(1);
        (hdr.data[3], hdr.data[7], hdr.data[11]) = (f64::NAN, f64::INFINITY, f64::NEG_INFINITY);
        let picture = form(&tone(), &curve, &hdr);
        assert!(picture.data[3].is_nan());
        assert_eq!(picture.data.iter().filter(|v| v.is_nan()).count(), 1);
        let mut d_picture = radiance(2);
        assert!(pull_back(&curve, &hdr, &d_picture).tone.log_exposure.is_nan());
        for masked in [3, 7, 11] {
            d_picture.data[masked] = 0.0;
        }
        let g = pull_back(&curve, &hdr, &d_picture);
        assert!(g.tone.log_exposure.is_finite());
        assert!(g.hdr.data.iter().chain(&g.curve.values.concat()).all(|v| v.is_finite()));
    }
}

#[test]
#[should_panic(expected = "different shape")]
fn another_shape_is_refused() {
    let curve = response(1, NodeSpacing::Uniform).curve();
    pull_back(&curve, &radiance(1), &Image::new(2, 2, 3));
}
