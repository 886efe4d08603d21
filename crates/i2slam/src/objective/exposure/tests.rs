//! Patches: where they are, what they show, and their way back against differences.

use super::*;
use i2slam_check::{central_differences, noise, relative_error};
use i2slam_formation::Quadrature;
use i2slam_radiance::gaussian::{
    ColourActivation, Gaussian, GaussianMap, MapGradient, RasterSettings, Rasterizer, Shape, TILE,
};

const CAMERA: Camera<f32> =
    Camera { width: 48, height: 32, fx: 30.0, fy: 30.0, cx: 24.0, cy: 16.0 };

/// A dark wall, and before the left of it a bright board whose right edge lies in the middle of a
/// tile. Gaussians that overlap differ so much in depth that no turn of the tests changes their
/// order.
fn map(board: bool) -> GaussianMap {
    let mut map = GaussianMap::new(Shape::Isotropic, ColourActivation::Exponential);
    let mut grid = |z: f32, spacing: f32, [left, right]: [f32; 2], colour: f32| {
        let rows = (0.75 * z / spacing) as i32;
        for row in -rows..=rows {
            for column in 0..((right - left) / spacing) as i32 {
                let place = (12 * row + column).rem_euclid(29) as f32;
                map.push(Gaussian {
                    mean: [
                        left + spacing * column as f32,
                        spacing * row as f32,
                        z * (1.0 + 0.003 * place),
                    ],
                    log_scale: [(0.6 * spacing).ln(); 3],
                    rotation: [1.0, 0.0, 0.0, 0.0],
                    opacity_logit: 3.0,
                    colour: [colour + 0.3 * (row as f32 + 0.7 * column as f32).sin(); 3],
                });
            }
        }
    };
    grid(3.0, 0.15, [-3.5, 3.5], -1.5);
    if board {
        grid(1.0, 0.02, [-1.0, -0.26], 1.5);
    }
    map
}

/// No cut-offs, so that pictures are smooth, and a board with a narrow edge.
fn smooth() -> RasterSettings {
    RasterSettings {
        alpha_min: 1e-7,
        transmittance_min: 0.0,
        screen_variance: 0.05,
        ..RasterSettings::default()
    }
}

/// A move to the right, and by the twelve numbers of `x`.
fn moving(x: &[f64], method: BlurMethod, readout: f64) -> Exposure {
    let part = |from: usize| Tangent::from_array(std::array::from_fn(|i| x[from + i]));
    let end = Tangent::from_array([0.6, 0.02, 0.03, 0.01, -0.02, 0.01]);
    let shutter = ShutterPoses {
        start: Pose::identity().retract(part(0)),
        end: Pose::identity().retract(end).retract(part(6)),
    };
    let sampling =
        Sampling { virtual_cameras: 5, quadrature: Quadrature::Midpoints, method, margin: 16 };
    Exposure { shutter, sampling, readout, depth_pose: None }
}

fn renderer() -> ExposureRenderer<GaussianMap> {
    ExposureRenderer::new(CAMERA, smooth())
}

/// The tiles that are drawn.
fn patches(renderer: &ExposureRenderer<GaussianMap>) -> Vec<usize> {
    let mask = renderer.margin_render.patches.tile_mask().unwrap_or_default();
    (0..mask.len()).filter(|&number| mask[number]).collect()
}

/// The tile of a number of three planes.
fn tile(i: usize) -> usize {
    let (x, y) = (i % CAMERA.width, i / CAMERA.width % CAMERA.height);
    y / TILE * (CAMERA.width / TILE) + x / TILE
}

#[test]
fn only_what_is_uncovered_is_drawn() {
    let mut image = renderer();
    image.forward(&map(false), &moving(&[0.0; 12], BlurMethod::Reprojected, 0.0));
    assert!(patches(&image).is_empty());
    image.forward(&map(true), &moving(&[0.0; 12], BlurMethod::Reprojected, 0.0));
    let chosen = patches(&image);
    assert!(
        chosen.contains(&0),
        "{chosen:?} of {:?}",
        image.margin_render.reprojection.uncovered()
    );
    assert!(!chosen.contains(&2) && !chosen.contains(&5), "{chosen:?}");
    let exposure = moving(&[0.0; 12], BlurMethod::Reprojected, 0.0);
    let (view, motion) = (image.view(exposure.shutter.middle()), exposure.motion());
    let mut whole = Render::default();
    let mut rasterizer = Rasterizer::new(smooth());
    map(true).render_moving(&mut rasterizer, &view, &motion, None, None, &mut whole);
    for (i, (a, b)) in image.hdr.data.iter().zip(&whole.radiance.data).enumerate() {
        if i % CAMERA.width < TILE && i / CAMERA.width % CAMERA.height < TILE {
            assert_eq!(a, b, "patched pixel {i}");
        }
    }
    assert!(image.hdr.data != whole.radiance.data);
}

/// The edge of the board uncovers wall that one render hides.
#[test]
fn patches_come_closer_to_the_exact_exposure() {
    let with = |method, virtual_cameras| {
        let mut exposure = moving(&[0.0; 12], method, 0.0);
        exposure.sampling.virtual_cameras = virtual_cameras;
        let mut renderer = renderer();
        renderer.forward(&map(true), &exposure);
        renderer
    };
    let (exact, mut image) = (with(BlurMethod::Exact, 64), with(BlurMethod::Reprojected, 15));
    let chosen = patches(&image);
    assert!(!chosen.is_empty());
    let mut without = image.hdr.clone();
    let Exposure { shutter, sampling, .. } = moving(&[0.0; 12], BlurMethod::Reprojected, 0.0);
    let MarginRender { reprojection, render, surface, .. } = &mut image.margin_render;
    let (radiance, how) = (&render.radiance, sampling.quadrature);
    reprojection.blur(&CAMERA, &shutter, 0.0, 15, how, radiance, surface, &mut without);
    let error = |hdr: &Image<f32>| -> f32 {
        let pixels = hdr.data.iter().zip(&exact.hdr.data).enumerate();
        let patched = pixels.filter(|(i, _)| chosen.contains(&tile(*i)));
        patched.map(|(_, (a, b))| (a - b).powi(2)).sum()
    };
    assert!(
        error(&image.hdr) < 0.2 * error(&without),
        "{} instead of {}",
        error(&image.hdr),
        error(&without)
    );
}

#[test]
fn patches_pull_back_to_poses_readout_and_map() {
    for readout in [0.0, 0.4] {
        let (map, exposure) =
            (map(true), |x: &[f64]| moving(x, BlurMethod::Reprojected, readout + x[12]));
        let mut renderer = renderer();
        renderer.forward(&map, &exposure(&[0.0; 13]));
        let chosen = patches(&renderer);
        assert!(!chosen.is_empty(), "readout {readout}");
        let mut weights = Image::new(CAMERA.width, CAMERA.height, 3);
        for (i, (weight, n)) in
            weights.data.iter_mut().zip(noise(3, 3 * CAMERA.pixels())).enumerate()
        {
            *weight = if chosen.contains(&tile(i)) { n as f32 } else { 0.0 };
        }
        let loss = |hdr: &Image<f32>| -> f64 {
            hdr.data.iter().zip(&weights.data).map(|(v, w)| f64::from(v * w)).sum()
        };
        let mut d_map = MapGradient::new(&map);
        let mut none = Image::new(CAMERA.width, CAMERA.height, 1);
        let (d_shutter, d_readout) = renderer.backward(
            &map,
            &exposure(&[0.0; 13]),
            &weights,
            (0, &mut none),
            Some(&mut d_map),
        );
        let numeric = central_differences(&[0.0; 13], 1e-3, |x| {
            renderer.forward(&map, &exposure(x));
            assert_eq!(patches(&renderer), chosen);
            loss(&renderer.hdr)
        });
        let mut analytic = d_shutter.to_array().to_vec();
        analytic.push(d_readout);
        let error = relative_error(&analytic, &numeric);
        assert!(error < 5e-3, "readout {readout}: poses {error}");
        // Near the edge of the board, in the middle row.
        let place = |mean: &[f32; 3]| (mean[0] + 0.28).hypot(mean[1]).hypot(mean[2] - 1.0);
        let board =
            (0..map.len()).min_by(|&a, &b| place(&map.means[a]).total_cmp(&place(&map.means[b])));
        let board = board.unwrap_or_default();
        let numeric = central_differences(&[0.0], 1e-2, |x| {
            let mut map = map.clone();
            map.colours[board][1] += x[0] as f32;
            renderer.forward(&map, &exposure(&[0.0; 13]));
            loss(&renderer.hdr)
        });
        let error = relative_error(&[f64::from(d_map.colours[board][1])], &numeric);
        assert!(numeric[0] != 0.0 && error < 5e-3, "readout {readout}: colour {error}");
    }
}
