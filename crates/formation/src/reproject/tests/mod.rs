//! Tests of re-projection on scenes of textured boards.

use crate::shutter::{Quadrature, ShutterPoses};
use i2slam_geometry::{Camera, Image, Pose, Rotation, Tangent, Vec3};
use rayon::prelude::*;

mod gradient;
mod lanes;
mod quality;

/// Converts to single precision.
fn narrow(image: &Image<f64>) -> Image<f32> {
    let data = image.data.iter().map(|&v| v as f32).collect();
    Image { width: image.width, height: image.height, channels: image.channels, data }
}

/// Converts to double precision.
fn wide(image: &Image<f32>) -> Image<f64> {
    let data = image.data.iter().map(|&v| f64::from(v)).collect();
    Image { width: image.width, height: image.height, channels: image.channels, data }
}

/// A textured rectangle in its own plane z = 0.
#[derive(Clone, Copy)]
pub(super) struct Board {
    board_from_world: Pose<f64>,
    /// Half its size [m]; infinite for the wall.
    half: [f64; 2],
    phase: f64,
    brightness: f64,
}

#[derive(Clone)]
pub(super) struct Scene {
    pub(super) boards: Vec<Board>,
    /// Wavelengths of the texture [m], with their amplitudes.
    waves: [(f64, f64); 4],
}

pub(super) fn camera(width: usize, height: usize) -> Camera<f64> {
    let (w, h) = (width as f64, height as f64);
    Camera { width, height, fx: 0.9 * w, fy: 0.91 * w, cx: 0.49 * w, cy: 0.52 * h }
}

/// The pose in front of the scene.
pub(super) fn pose() -> Pose<f64> {
    Pose::new(Rotation::exp(Vec3::new(0.3, -0.5, 0.2)), Vec3::new(0.5, -0.2, 1.0))
}

/// An exposure during which the camera moves by `motion`, with [`pose`] in its middle.
pub(super) fn moving(motion: [f64; 6]) -> ShutterPoses<f64> {
    let half = Tangent::from_array(motion).scaled(0.5);
    ShutterPoses { start: pose().retract(half.scaled(-1.0)), end: pose().retract(half) }
}

fn in_front(at: [f64; 3], turn: [f64; 3]) -> Pose<f64> {
    Pose {
        rotation: pose().rotation * Rotation::exp(Vec3::from_array(turn)),
        translation: pose() * Vec3::from_array(at),
    }
}

impl Scene {
    /// Wall (about 2 m away) and board (1.3 m), with texture no finer than `finest` pixels.
    pub(super) fn new(camera: &Camera<f64>, finest: f64) -> Self {
        let wall = Board {
            board_from_world: in_front([0.0, 0.0, 2.0], [0.25, -0.35, 0.1]).inverse(),
            half: [f64::INFINITY; 2],
            phase: 0.3,
            brightness: 0.4,
        };
        let board = Board {
            board_from_world: in_front([-0.1, 0.05, 1.3], [-0.1, 0.2, 0.3]).inverse(),
            half: [0.3, 0.2],
            phase: 2.1,
            brightness: 0.6,
        };
        let pixel = 2.0 / camera.fx;
        let wave = |n: f64| (n * finest * pixel, 0.04 * n.sqrt());
        Self { boards: vec![wall, board], waves: [1.0, 1.7, 3.1, 7.0].map(wave) }
    }

    /// The scene without the board.
    pub(super) fn wall(camera: &Camera<f64>, finest: f64) -> Self {
        let mut scene = Self::new(camera, finest);
        scene.boards.truncate(1);
        scene
    }

    /// Both in planes of constant depth, as seen from [`pose`].
    pub(super) fn facing(camera: &Camera<f64>, finest: f64) -> Self {
        let mut scene = Self::new(camera, finest);
        for board in &mut scene.boards {
            let place = board.board_from_world.inverse().translation;
            board.board_from_world = Pose::new(pose().rotation, place).inverse();
        }
        scene
    }

    /// Radiance and depth along the ray through (`u`, `v`), nearest board first.
    fn look(&self, camera: &Camera<f64>, from: &Pose<f64>, u: f64, v: f64) -> ([f64; 3], f64) {
        let direction = from.rotation.rotate(camera.unproject(u, v, 1.0));
        let mut best = ([0.0; 3], f64::INFINITY);
        for board in &self.boards {
            let board_from_world = board.board_from_world;
            let origin = board_from_world * from.translation;
            let ray = board_from_world.rotation.rotate(direction);
            let z = -origin.z / ray.z;
            let hit = origin + ray * z;
            let inside = hit.x.abs() <= board.half[0] && hit.y.abs() <= board.half[1];
            if z > 0.0 && z < best.1 && inside {
                best = (self.texture(board, hit.x, hit.y), z);
            }
        }
        best
    }

    fn texture(&self, board: &Board, x: f64, y: f64) -> [f64; 3] {
        let mut sum = 0.0;
        let mut shift = 0.0;
        for (k, (length, amplitude)) in self.waves.iter().enumerate() {
            let turn = board.phase + 1.1 * k as f64;
            let wave = |turn: f64| {
                let along = x * turn.cos() + y * turn.sin();
                (along * std::f64::consts::TAU / length + turn).sin()
            };
            sum += amplitude * (wave(turn) + wave(turn + 1.5));
            shift += amplitude * wave(turn + 0.8);
        }
        [sum + 0.05, 0.7 * sum + 0.5 * shift, shift - 0.05].map(|v| board.brightness + v)
    }

    /// Radiance and depth averaged over `grid x grid` points of each pixel: as in a render of
    /// splats, the pixels along an edge hold a mixture of both depths.
    pub(super) fn render(
        &self,
        camera: &Camera<f64>,
        from: &Pose<f64>,
        grid: usize,
    ) -> (Image<f64>, Image<f64>) {
        let (mut radiance, mut depth) = (
            Image::new(camera.width, camera.height, 3),
            Image::new(camera.width, camera.height, 1),
        );
        let pixels: Vec<_> = (0..camera.pixels())
            .into_par_iter()
            .map(|i| {
                let (x, y) = ((i % camera.width) as f64, (i / camera.width) as f64);
                let (mut mean, mut z) = ([0.0; 3], 0.0);
                for k in 0..grid * grid {
                    let offset = |k: usize| (k as f64 + 0.5) / grid as f64;
                    let (u, v) = (x + offset(k % grid), y + offset(k / grid));
                    let (colour, depth) = self.look(camera, from, u, v);
                    z += depth / (grid * grid) as f64;
                    (0..3).for_each(|c| mean[c] += colour[c] / (grid * grid) as f64);
                }
                (mean, z)
            })
            .collect();
        for (i, (colour, z)) in pixels.into_iter().enumerate() {
            (0..3).for_each(|c| radiance.plane_mut(c)[i] = colour[c]);
            depth.data[i] = z;
        }
        (radiance, depth)
    }

    /// The average over `count` exactly rendered virtual cameras.
    pub(super) fn blurred(
        &self,
        camera: &Camera<f64>,
        shutter: &ShutterPoses<f64>,
        (count, quadrature): (usize, Quadrature),
        grid: usize,
    ) -> Image<f64> {
        let mut sum = Image::new(camera.width, camera.height, 3);
        for view in shutter.virtual_cameras(count, quadrature) {
            let (radiance, _) = self.render(camera, &view.world_from_camera, grid);
            crate::accumulate(&mut sum, view.weight, &radiance);
        }
        sum
    }
}
