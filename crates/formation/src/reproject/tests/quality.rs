//! Error of the re-projected exposure against exactly rendered virtual cameras.

use super::{Scene, camera, moving};
use super::{narrow, wide};
use crate::reproject::Reprojection;
use crate::shutter::{Quadrature, ShutterPoses};
use i2slam_geometry::{Camera, Image};

const SIZE: (usize, usize) = (128, 96);
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
    readout: f64,
    (radiance, depth): &(Image<f64>, Image<f64>),
) -> Image<f64> {
    let mut blurred = Image::default();
    Reprojection::default().blur(
        &camera.cast(),
        shutter,
        readout,
        count,
        quadrature,
        &narrow(radiance),
        &narrow(depth),
        &mut blurred,
    );
    wide(&blurred)
}

/// Every pixel of a picture whose render has a margin, and the inside of one without.
#[test]
fn close_to_exactly_rendered_virtual_cameras() {
    let camera = camera(SIZE.0, SIZE.1);
    let scene = Scene::new(&camera, FINEST);
    for kind in ["rotation", "translation", "both"] {
        for (length, least) in [(2.0, 50.0), (5.0, 49.0), (10.0, 45.0), (20.0, 38.0)] {
            let shutter = exposure(&camera, kind, length);
            let exact = scene.blurred(&camera, &shutter, (32, Quadrature::Midpoints), GRID);
            let sharp = scene.render(&camera, &shutter.middle(), GRID);
            let border = length as usize;
            let wide = scene.render(&camera.widened(border), &shutter.middle(), GRID);
            for count in [5, 9, 17] {
                let plan = (count, Quadrature::Midpoints);
                let of = |sharp| reproject(&camera, &shutter, plan, 0.0, sharp);
                let inside = psnr(&of(&sharp), &exact, border);
                for value in [inside, psnr(&of(&wide), &exact, 0)] {
                    assert!(value > least, "{kind} {length} px, {count} views: {value:.1} dB");
                }
            }
        }
    }
}

/// Rows cut out of exactly rendered views, each at its own times.
fn rolled(
    scene: &Scene,
    camera: &Camera<f64>,
    shutter: &ShutterPoses<f64>,
    readout: f64,
) -> Image<f64> {
    let mut rolled = Image::new(camera.width, camera.height, 3);
    for row in 0..camera.height {
        let late = readout * crate::row_place::<f64>(row, camera.height);
        let at = |u: f64| shutter.at(u + late);
        let exposed = ShutterPoses { start: at(0.0), end: at(1.0) };
        let strip = Camera { height: 1, cy: camera.cy - row as f64, ..*camera };
        let seen = scene.blurred(&strip, &exposed, (5, Quadrature::Midpoints), GRID);
        for channel in 0..3 {
            let to = &mut rolled.plane_mut(channel)[row * camera.width..(row + 1) * camera.width];
            to.copy_from_slice(seen.plane(channel));
        }
    }
    rolled
}

/// The top and the bottom row are 8 px apart from where they would be at mid-exposure.
#[test]
fn rows_are_where_exact_views_at_their_times_have_them() {
    let camera = camera(SIZE.0, SIZE.1);
    let scene = Scene::new(&camera, FINEST);
    for kind in ["rotation", "translation", "both"] {
        let (shutter, readout) = (exposure(&camera, kind, 4.0), 4.0);
        let exact = rolled(&scene, &camera, &shutter, readout);
        let sharp = scene.render(&camera, &shutter.middle(), GRID);
        let plan = (5, Quadrature::Midpoints);
        let of = |readout| {
            let image = reproject(&camera, &shutter, plan, readout, &sharp);
            psnr(&image, &exact, 10)
        };
        let (with, without, wrong) = (of(readout), of(0.0), of(-readout));
        assert!(with > 38.0 && with > without + 12.0 && without > wrong, "{kind} {with} {without}");
    }
}
