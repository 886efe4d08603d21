//! Formation of one picture of 320 x 240 x 3 and its pull-back, in `f32`.

use divan::{Bencher, black_box};
use i2slam_formation::{
    CameraResponse, CurveGradient, Formation, FrameTone, FrameToneGradient, NodeSpacing,
    StartCurve, accumulate,
};
use i2slam_geometry::Image;

const SPACINGS: [NodeSpacing; 2] = [NodeSpacing::Uniform, NodeSpacing::Power(2.2)];

fn main() {
    divan::main();
}

/// Noise whose brightness drifts over the rows, with about a tenth above 1.
fn radiance(scale: f32) -> Image<f32> {
    let mut image = Image::new(320, 240, 3);
    let mut state = 1_u32;
    for (i, v) in image.data.iter_mut().enumerate() {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let noise = (state >> 8) as f32 / (1 << 24) as f32;
        *v = scale * (noise * noise * 0.9 + 0.25 * (i as f32 * 1e-4).sin().abs());
    }
    image
}

#[divan::bench(args = [0, 1])]
fn form(bencher: Bencher<'_, '_>, spacing: usize) {
    let (hdr, tone) = (radiance(1.0), FrameTone::default());
    let curve = CameraResponse::new(3, StartCurve::Srgb, SPACINGS[spacing]).curve();
    let mut picture = Image::default();
    bencher.bench_local(|| Formation::new(&tone, &curve).form(black_box(&hdr), &mut picture));
}

#[divan::bench(args = [0, 1])]
fn pull_back(bencher: Bencher<'_, '_>, spacing: usize) {
    let (hdr, tone) = (radiance(1.0), FrameTone::default());
    let curve = CameraResponse::new(3, StartCurve::Srgb, SPACINGS[spacing]).curve();
    let (d_picture, mut d_hdr) = (radiance(0.1), Image::default());
    let (mut d_tone, mut d_curve) = (FrameToneGradient::default(), CurveGradient::zero(&curve));
    bencher.bench_local(|| {
        let formation = Formation::new(&tone, &curve);
        formation.pull_back(black_box(&hdr), &d_picture, &mut d_hdr, &mut d_tone, &mut d_curve);
    });
}

/// The worst case for the node sums: every pixel in the same segment.
#[divan::bench(args = [0, 1])]
fn pull_back_flat(bencher: Bencher<'_, '_>, spacing: usize) {
    let (mut hdr, tone) = (radiance(1.0), FrameTone::default());
    hdr.data.fill(0.3);
    let curve = CameraResponse::new(3, StartCurve::Srgb, SPACINGS[spacing]).curve();
    let (d_picture, mut d_hdr) = (radiance(0.1), Image::default());
    let (mut d_tone, mut d_curve) = (FrameToneGradient::default(), CurveGradient::zero(&curve));
    bencher.bench_local(|| {
        let formation = Formation::new(&tone, &curve);
        formation.pull_back(black_box(&hdr), &d_picture, &mut d_hdr, &mut d_tone, &mut d_curve);
    });
}

#[divan::bench]
fn accumulate_one_view(bencher: Bencher<'_, '_>) {
    let (mut hdr, view) = (radiance(1.0), radiance(1.0));
    bencher.bench_local(|| accumulate(&mut hdr, black_box(0.2), &view));
}

#[divan::bench(args = [0, 1])]
fn curve_of_the_nodes(bencher: Bencher<'_, '_>, spacing: usize) {
    let response = CameraResponse::<f32>::new(3, StartCurve::Srgb, SPACINGS[spacing]);
    bencher.bench_local(|| black_box(&response).curve());
}
