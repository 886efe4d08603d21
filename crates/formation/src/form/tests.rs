use super::Formation;
use crate::tone::{
    CameraResponse, CurveGradient, FrameTone, FrameToneGradient, NODES, NodeSpacing, ResponseCurve,
    StartCurve,
};
use i2slam_check::{assert_close, assert_gradient, noise};
use i2slam_geometry::{Image, Real};

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
    Formation { tone: *tone, curve, vignetting: None }.form(hdr, &mut picture);
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
    let formation = Formation { tone: tone(), curve, vignetting: None };
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
fn picture_is_the_curve_of_the_gained_radiance() {
    for (curves, spacing) in CASES {
        let curve = response(curves, spacing).curve();
        let (hdr, gains) = (radiance(1), tone().gains());
        let picture = form(&tone(), &curve, &hdr);
        for channel in 0..3 {
            let x: Vec<f64> = hdr.plane(channel).iter().map(|r| gains[channel] * r).collect();
            assert!(x.iter().any(|x| *x < 0.0) && x.iter().any(|x| *x > 1.0));
            assert!(x.iter().any(|x| (0.0..1.0).contains(x)));
            let expected: Vec<f64> = x.iter().map(|x| curve.evaluate(channel, *x)).collect();
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
    let formation = Formation { tone: tone(), curve: &curve, vignetting: None };
    formation.pull_back(&hdr, &d_picture, &mut twice.hdr, &mut twice.tone, &mut twice.curve);
    assert_eq!(twice.hdr, once.hdr);
    assert_close("tone", &twice.tone.to_array(), &once.tone.to_array().map(|v| 2.0 * v), 1e-14);
    let doubled: Vec<f64> = once.curve.values.concat().iter().map(|v| 2.0 * v).collect();
    assert_close("curve", &twice.curve.values.concat(), &doubled, 1e-14);
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
