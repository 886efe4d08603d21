//! How close the re-projected exposure comes to exactly rendered virtual cameras.

use super::scene::{Scene, camera, moving};
use super::{narrow, wide};
use crate::reproject::{Interpolation, Reprojection};
use crate::shutter::{Quadrature, ShutterPoses};
use i2slam_geometry::{Camera, Image};

const SIZE: (usize, usize) = (160, 120);
const GRID: usize = 2;
/// Finest wave of the texture [px].
const FINEST: f64 = 6.0;

/// PSNR [dB] for values in [0, 1], at least `border` pixels from the edge.
fn psnr(a: &Image<f64>, b: &Image<f64>, border: usize) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for channel in 0..3 {
        for y in border..a.height - border {
            for x in border..a.width - border {
                let value = |image: &Image<f64>| image.at(channel, x, y).clamp(0.0, 1.0);
                sum += (value(a) - value(b)).powi(2);
                count += 1.0;
            }
        }
    }
    -10.0 * f64::log10(sum / count)
}

/// The exposure during which the wall moves by `length` pixels.
fn exposure(camera: &Camera<f64>, kind: &str, length: f64) -> ShutterPoses<f64> {
    let angle = length / camera.fx;
    let distance = 2.0 * angle;
    moving(match kind {
        "rotation" => [0.0, 0.0, 0.0, 0.6 * angle, 0.8 * angle, 0.5 * angle],
        "translation" => [0.8 * distance, -0.6 * distance, 0.2 * distance, 0.0, 0.0, 0.0],
        _ => [0.6 * distance, 0.0, 0.3 * distance, 0.5 * angle, -0.2 * angle, 0.3 * angle],
    })
}

fn reproject(
    camera: &Camera<f64>,
    shutter: &ShutterPoses<f64>,
    (count, quadrature): (usize, Quadrature),
    interpolation: Interpolation,
    (radiance, depth): &(Image<f64>, Image<f64>),
) -> Image<f64> {
    let mut blurred = Image::default();
    Reprojection::new(interpolation).blur(
        &camera.cast(),
        shutter,
        count,
        quadrature,
        &narrow(radiance),
        &narrow(depth),
        &mut blurred,
    );
    wide(&blurred)
}

/// Inside the border that all virtual cameras see, and (printed only) for the full frame.
#[test]
fn close_to_exactly_rendered_virtual_cameras() {
    let camera = camera(SIZE.0, SIZE.1);
    let scene = Scene::new(&camera, FINEST);
    println!("PSNR [dB] against 32 exact views: sharp | N views: exact, re-projected, full frame");
    for kind in ["rotation", "translation", "both"] {
        for (length, least) in [(2.0, 50.0), (5.0, 50.0), (10.0, 46.0), (20.0, 38.0)] {
            let shutter = exposure(&camera, kind, length);
            let exact = scene.blurred(&camera, &shutter, (32, Quadrature::Midpoints), GRID);
            let sharp = scene.render(&camera, &shutter.middle(), GRID);
            let border = length as usize;
            print!("{kind:12}{length:3} px {:6.1}", psnr(&sharp.0, &exact, border));
            for count in [5, 9, 17] {
                let plan = (count, Quadrature::Midpoints);
                let same = scene.blurred(&camera, &shutter, plan, GRID);
                let blurred = reproject(&camera, &shutter, plan, Interpolation::Cubic, &sharp);
                let inside = psnr(&blurred, &exact, border);
                let (of_views, full) = (psnr(&same, &exact, border), psnr(&blurred, &exact, 0));
                print!(" |{count:3}: {of_views:5.1} {inside:5.1} {full:5.1}");
                assert!(inside > least, "{kind} {length} px, {count} views: {inside:.1} dB");
            }
            println!();
        }
    }
}

#[test]
fn cubic_keeps_detail_that_linear_dulls() {
    let camera = camera(SIZE.0, SIZE.1);
    let scene = Scene::new(&camera, FINEST);
    let shutter = exposure(&camera, "rotation", 2.0);
    let plan = (5, Quadrature::Midpoints);
    let exact = scene.blurred(&camera, &shutter, plan, GRID);
    let sharp = scene.render(&camera, &shutter.middle(), GRID);
    let against =
        |interpolation| psnr(&reproject(&camera, &shutter, plan, interpolation, &sharp), &exact, 2);
    let [linear, cubic] = [Interpolation::Linear, Interpolation::Cubic].map(against);
    println!("2 px of rotation: linear {linear:.1} dB, cubic {cubic:.1} dB");
    assert!(cubic > linear + 3.0, "{linear} {cubic}");
}
