//! How close the re-projected exposure comes to exactly rendered virtual cameras.

use super::scene::{Scene, camera, moving};
use super::{narrow, wide};
use crate::reproject::{Interpolation, Reprojection};
use crate::shutter::{Quadrature, ShutterPoses};
use i2slam_geometry::{Camera, Image};

const SIZE: (usize, usize) = (160, 120);
const GRID: usize = 3;
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

#[test]
fn table() {
    let camera = camera(SIZE.0, SIZE.1);
    let scene = Scene::new(&camera, FINEST);
    for kind in ["rotation", "translation", "both"] {
        for length in [2.0, 5.0, 10.0, 20.0] {
            let shutter = exposure(&camera, kind, length);
            let exact = scene.blurred(&camera, &shutter, (32, Quadrature::Midpoints), GRID);
            let sharp = scene.render(&camera, &shutter.middle(), GRID);
            let border = length as usize;
            print!("{kind:12} {length:4} px  sharp {:5.1}", psnr(&sharp.0, &exact, border));
            for count in [5, 9, 17] {
                let plan = (count, Quadrature::Midpoints);
                let same = scene.blurred(&camera, &shutter, plan, GRID);
                let a = reproject(&camera, &shutter, plan, Interpolation::Cubic, &sharp);
                let b = reproject(&camera, &shutter, plan, Interpolation::Linear, &sharp);
                print!(
                    " | N={count} exact N {:5.1}, cubic {:5.1} ({:5.1} full frame) to N {:5.1}, linear {:5.1}",
                    psnr(&same, &exact, border),
                    psnr(&a, &exact, border),
                    psnr(&a, &exact, 0),
                    psnr(&a, &same, border),
                    psnr(&b, &exact, border),
                );
            }
            println!();
        }
    }
}
