use super::*;
use crate::tone::{CameraResponse, CurveGradient, FrameTone, FrameToneGradient, StartCurve};
use crate::{Formation, NodeSpacing};
use i2slam_check::{assert_close, assert_gradient, noise};
use i2slam_geometry::Image;

const CAMERA: Camera<f64> = Camera { width: 24, height: 16, fx: 20.0, fy: 20.0, cx: 11.0, cy: 8.5 };

const LENS: Vignetting<f64> = Vignetting { coefficients: [-0.3, -0.4, 0.2] };

fn response() -> ResponseCurve<f64> {
    CameraResponse::new(3, StartCurve::Srgb, NodeSpacing::Power(2.2)).curve()
}

fn tone() -> FrameTone<f64> {
    FrameTone { log_exposure: -0.2, log_white_balance: [0.3, 0.0, -0.4] }
}

/// Radiance below 0, in [0, 1] and above 1.
fn radiance(seed: u64) -> Image<f64> {
    let mut image = Image::new(CAMERA.width, CAMERA.height, 3);
    image.data = noise(seed, 3 * CAMERA.pixels()).iter().map(|n| 0.6 + 1.1 * n).collect();
    image
}

fn form(lens: &Vignetting<f64>, hdr: &Image<f64>) -> Image<f64> {
    let (curve, pixels) = (response(), lens.at_pixels(&CAMERA));
    let mut picture = Image::default();
    Formation { tone: tone(), curve: &curve, vignetting: Some(&pixels) }.form(hdr, &mut picture);
    picture
}

fn dot(a: &Image<f64>, b: &Image<f64>) -> f64 {
    a.data.iter().zip(&b.data).map(|(a, b)| a * b).sum()
}

/// Derivatives by radiance and tone.
fn pull_back(
    lens: &Vignetting<f64>,
    hdr: &Image<f64>,
    d_picture: &Image<f64>,
) -> (Image<f64>, FrameToneGradient<f64>) {
    let (curve, pixels) = (response(), lens.at_pixels(&CAMERA));
    let formation = Formation { tone: tone(), curve: &curve, vignetting: Some(&pixels) };
    let (mut d_hdr, mut d_tone) = (Image::default(), FrameToneGradient::default());
    let mut d_curve = CurveGradient::zero(&curve);
    formation.pull_back(hdr, d_picture, &mut d_hdr, &mut d_tone, &mut d_curve);
    (d_hdr, d_tone)
}

/// Both lanes of a formed picture: the plain equation of each pixel, and the loops over planes.
#[test]
fn a_picture_is_the_curve_of_the_darkened_radiance() {
    let (hdr, curve, gains) = (radiance(1), response(), tone().gains());
    let picture = form(&LENS, &hdr);
    let mut darkest = f64::MAX;
    for row in 0..CAMERA.height {
        for column in 0..CAMERA.width {
            let (u, v) = Camera::<f64>::pixel_centre(column, row);
            let half = 0.5 * (24.0_f64).hypot(16.0);
            let r = (u - CAMERA.cx).hypot(v - CAMERA.cy) / half;
            let share = 1.0 - 0.3 * r.powi(2) - 0.4 * r.powi(4) + 0.2 * r.powi(6);
            darkest = darkest.min(share);
            for c in 0..3 {
                let expected = curve.evaluate(c, gains[c] * share * hdr.at(c, column, row));
                assert!((picture.at(c, column, row) - expected).abs() < 1e-12);
            }
        }
    }
    assert!(darkest < 0.6, "{darkest}");
}

#[test]
fn single_precision_agrees_with_double() {
    let hdr = radiance(1);
    let single =
        Image { data: hdr.data.iter().map(|v| *v as f32).collect(), ..Image::new(24, 16, 3) };
    let lens = Vignetting { coefficients: LENS.coefficients.map(|c| c as f32) };
    let curve = CameraResponse::<f32>::new(3, StartCurve::Srgb, NodeSpacing::Power(2.2)).curve();
    let pixels = lens.at_pixels(&CAMERA.cast());
    let tone = FrameTone { log_exposure: -0.2, log_white_balance: [0.3, 0.0, -0.4] };
    let mut picture = Image::default();
    Formation { tone, curve: &curve, vignetting: Some(&pixels) }.form(&single, &mut picture);
    let single: Vec<f64> = picture.data.iter().map(|v| f64::from(*v)).collect();
    assert_close("picture", &single, &form(&LENS, &hdr).data, 1e-5);
}

#[test]
fn gradients_agree_with_differences() {
    let (hdr, d_picture) = (radiance(1), radiance(2));
    let (d_hdr, d_tone) = pull_back(&LENS, &hdr, &d_picture);
    assert_gradient("radiance", &hdr.data, &d_hdr.data, 1e-8, 1e-6, |x| {
        dot(&form(&LENS, &Image { data: x.to_vec(), ..hdr.clone() }), &d_picture)
    });
    let gain = [d_tone.log_exposure];
    assert_gradient("exposure", &[0.0], &gain, 1e-8, 1e-6, |x| {
        let scaled = hdr.data.iter().map(|v| v * x[0].exp()).collect();
        dot(&form(&LENS, &Image { data: scaled, ..hdr.clone() }), &d_picture)
    });
    let gradient = LENS.pull_back(&CAMERA, &hdr, &d_hdr);
    assert_gradient("vignetting", &LENS.coefficients, &gradient, 1e-8, 1e-6, |x| {
        dot(&form(&Vignetting { coefficients: [x[0], x[1], x[2]] }, &hdr), &d_picture)
    });
}

#[test]
fn held_values_have_no_gradient() {
    let (hdr, d_picture) = (radiance(1), radiance(2));
    for coefficients in [[-20.0, 0.0, 0.0], [20.0, 0.0, 0.0]] {
        let lens = Vignetting { coefficients };
        assert_eq!(lens.corner(), if coefficients[0] < 0.0 { 0.2 } else { 1.2 });
        let (d_hdr, _) = pull_back(&lens, &hdr, &d_picture);
        let gradient = lens.pull_back(&CAMERA, &hdr, &d_hdr);
        assert_gradient("held", &coefficients, &gradient, 1e-5, 2e-6, |x| {
            dot(&form(&Vignetting { coefficients: [x[0], x[1], x[2]] }, &hdr), &d_picture)
        });
    }
}

#[test]
fn no_vignetting_changes_nothing() {
    let (hdr, curve) = (radiance(1), response());
    let mut plain = Image::default();
    Formation { tone: tone(), curve: &curve, vignetting: None }.form(&hdr, &mut plain);
    assert!(Vignetting::<f64>::default().is_none() && !LENS.is_none());
    assert_eq!(form(&Vignetting::default(), &hdr), plain);
}

#[test]
fn vignetting_is_taken_out_of_a_picture() {
    let mut hdr = radiance(1);
    hdr.data.iter_mut().for_each(|v| *v = 0.1 + 0.4 * v.clamp(0.0, 1.0));
    let back = without_vignetting(&form(&LENS, &hdr), &response(), &LENS.at_pixels(&CAMERA));
    assert_close("picture", &back.data, &form(&Vignetting::default(), &hdr).data, 1e-9);
}

#[test]
#[should_panic(expected = "vignetting of another picture")]
fn vignetting_of_another_size_is_refused() {
    let (curve, mut picture) = (response(), Image::default());
    let formation = Formation { tone: tone(), curve: &curve, vignetting: Some(&[1.0; 7]) };
    formation.form(&radiance(1), &mut picture);
}

/// Points that pairs of pictures show at random radii, with noise, gains of their own and some points
/// of another brightness altogether.
fn pairs(lens: &Vignetting<f64>, noise_level: f64, seed: u64) -> Vec<Vec<RadiancePair>> {
    let pair = |index: u64| {
        let random = noise(1000 * seed + index, 4 * 300);
        let point = |n: &[f64]| {
            let squared_radii = [n[0], n[1]].map(|n| (0.5 + 0.5 * n).clamp(0.0, 1.0));
            let [v, w] = squared_radii.map(|r2| lens.at(r2));
            let outlier = if n[3] > 0.8 { 1.5 * n[2] + 0.5 } else { 0.0 };
            let log_ratio = (v / w).ln() + 0.3 * index as f64 + noise_level * n[2] + outlier;
            RadiancePair { log_ratio, squared_radii, deviation: 0.02 }
        };
        random.chunks(4).map(point).collect()
    };
    (0..8).map(pair).collect()
}

#[test]
fn vignetting_is_found_within_its_deviation() {
    for seed in 0..5 {
        for coefficients in [[-0.2, -0.4, 0.1], [-0.9, 0.5, -0.1], [0.0, -0.1, 0.0]] {
            let lens = Vignetting { coefficients };
            let found = estimate(&pairs(&lens, 0.03, seed)).expect("points");
            let error = (found.vignetting.corner() - lens.corner()).abs();
            assert!(error < 0.01 && error < 6.0 * found.corner_deviation, "{error} {found:?}");
            assert!(found.is_significant(0.025), "{found:?}");
            for r2 in [0.2, 0.5, 0.8] {
                let error = (found.vignetting.at(r2) - lens.at(r2)).abs();
                assert!(error < 0.01, "{error} at {r2}: {found:?}");
            }
        }
    }
}

#[test]
fn nothing_is_found_where_there_is_none() {
    for seed in 0..20 {
        let found = estimate(&pairs(&Vignetting::default(), 0.05, seed)).expect("points");
        assert!(!found.is_significant(0.025), "{found:?}");
    }
    assert_eq!(estimate(&pairs(&LENS, 0.0, 1)[..2]), None);
    let mut still = pairs(&LENS, 0.0, 1);
    still.iter_mut().flatten().for_each(|point| point.squared_radii = [0.3; 2]);
    assert_eq!(estimate(&still), None);
}
