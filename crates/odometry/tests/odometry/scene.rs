//! Small pictures of a textured room, for tests.

use i2slam_geometry::{Camera, Image, Pose, Rotation, Vec3};
use i2slam_odometry::{FrameUpdate, FrontEnd, Intrinsics};

/// Time between pictures [s].
const INTERVAL: f64 = 1.0 / 30.0;

/// The camera of all pictures.
pub(crate) fn camera() -> Camera<f64> {
    Camera { width: 192, height: 144, fx: 150.0, fy: 150.0, cx: 96.0, cy: 72.0 }
}

/// A front end that has tracked some pictures.
pub(crate) fn tracked(
    intrinsics: Intrinsics,
    pictures: impl Iterator<Item = Image<f32>>,
) -> FrontEnd {
    let mut front_end = FrontEnd::new(intrinsics);
    track(&mut front_end, pictures);
    front_end
}

/// Tracks pictures; returns their updates.
pub(crate) fn track(
    front_end: &mut FrontEnd,
    pictures: impl Iterator<Item = Image<f32>>,
) -> Vec<FrameUpdate> {
    let push = |(i, picture): (usize, Image<f32>)| {
        front_end.push(&picture, i as f64 * INTERVAL, None).expect("a picture of the right size")
    };
    pictures.enumerate().map(push).collect()
}

/// A camera that moves to the right and turns, with parallax in every frame.
pub(crate) fn moving(i: usize) -> Pose<f64> {
    moving_at(i as f64)
}

/// A picture of the room, blurred by motion over half the time to the next one.
pub(crate) fn blurred(seed: u32, i: usize, gain: f32) -> Image<f32> {
    let moments = [-0.2, -0.1, 0.0, 0.1, 0.2].map(|u| moving_at(i as f64 + u));
    let mut out = Image::new(camera().width, camera().height, 3);
    for pose in moments {
        let sharp = picture(seed, pose, gain);
        out.data.iter_mut().zip(&sharp.data).for_each(|(sum, value)| *sum += 0.2 * value);
    }
    out
}

fn moving_at(s: f64) -> Pose<f64> {
    let turn = Vec3::new(0.02 * (0.4 * s).sin(), -0.006 * s, 0.01 * (0.3 * s).cos() - 0.01);
    Pose::new(Rotation::exp(turn), Vec3::new(0.04 * s, 0.02 * (0.5 * s).sin(), 0.01 * s))
}

/// A picture of the room of `seed`: walls, a floor and a box, `gain` times as bright.
pub(crate) fn picture(seed: u32, world_from_camera: Pose<f64>, gain: f32) -> Image<f32> {
    render(world_from_camera, gain, |from, direction| radiance(seed, from, direction))
}

/// A picture of what `radiance` gives for every ray, `gain` times as bright.
pub(crate) fn render(
    world_from_camera: Pose<f64>,
    gain: f32,
    radiance: impl Fn(Vec3<f64>, Vec3<f64>) -> f64,
) -> Image<f32> {
    let ray = |u: f64, v: f64| camera().unproject(u, v, 1.0);
    render_rays(world_from_camera, gain, ray, radiance)
}

/// A picture of the room through a lens with radial distortion `k1` as in OpenCV.
pub(crate) fn through_lens(seed: u32, world_from_camera: Pose<f64>, k1: f64) -> Image<f32> {
    let ray = |u: f64, v: f64| {
        let shown = camera().unproject(u, v, 1.0);
        let mut factor = 1.0;
        for _ in 0..20 {
            let square = (shown.x * shown.x + shown.y * shown.y) * factor * factor;
            factor = 1.0 / (1.0 + k1 * square);
        }
        Vec3::new(shown.x * factor, shown.y * factor, 1.0)
    };
    render_rays(world_from_camera, 1.0, ray, |from, direction| radiance(seed, from, direction))
}

fn render_rays(
    world_from_camera: Pose<f64>,
    gain: f32,
    ray_of: impl Fn(f64, f64) -> Vec3<f64>,
    radiance: impl Fn(Vec3<f64>, Vec3<f64>) -> f64,
) -> Image<f32> {
    let camera = camera();
    let mut out = Image::new(camera.width, camera.height, 3);
    for row in 0..camera.height {
        for column in 0..camera.width {
            let mut value = 0.0;
            // Four rays a pixel, against jagged edges.
            for (dx, dy) in [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)] {
                let ray = ray_of(column as f64 + dx, row as f64 + dy);
                let direction = world_from_camera.rotation.rotate(ray);
                value += 0.25 * radiance(world_from_camera.translation, direction);
            }
            for channel in 0..3 {
                out.data[(channel * camera.height + row) * camera.width + column] =
                    (gain * value as f32).min(1.0);
            }
        }
    }
    out
}

/// Brightness of the nearest surface on a ray.
fn radiance(seed: u32, from: Vec3<f64>, direction: Vec3<f64>) -> f64 {
    let (_, face, point) = nearest(from, direction);
    let (s, t) = match face {
        0 | 3 => (point.x, point.y),
        1 => (point.x, point.z),
        _ => (point.z, point.y),
    };
    texture(seed * 8 + face, s, t)
}

/// Depth of the room at an image position.
pub(crate) fn depth(world_from_camera: Pose<f64>, at: [f64; 2]) -> f64 {
    let ray = camera().unproject(at[0], at[1], 1.0);
    nearest(world_from_camera.translation, world_from_camera.rotation.rotate(ray)).0
}

/// Distance, face and point of the nearest surface on a ray.
fn nearest(from: Vec3<f64>, direction: Vec3<f64>) -> (f64, u32, Vec3<f64>) {
    let mut nearest = (f64::INFINITY, 0, from);
    let mut meet = |distance: f64, inside: &dyn Fn(Vec3<f64>) -> bool, face: u32| {
        let point = from + direction * distance;
        if distance > 1e-3 && distance < nearest.0 && inside(point) {
            nearest = (distance, face, point);
        }
    };
    meet((4.0 - from.z) / direction.z, &|_| true, 0);
    meet((1.2 - from.y) / direction.y, &|p| p.z < 4.0, 1);
    meet((-2.0 - from.x) / direction.x, &|p| p.z < 4.0, 2);
    meet((3.2 - from.x) / direction.x, &|p| p.z < 4.0, 2);
    let on_box = |p: Vec3<f64>| (-0.3..0.5).contains(&p.x) && (-0.2..1.2).contains(&p.y);
    meet((2.2 - from.z) / direction.z, &on_box, 3);
    nearest
}

/// Blotches of several sizes, in [0.1, 0.9].
pub(crate) fn texture(seed: u32, s: f64, t: f64) -> f64 {
    let octave = |k: u32, scale: f64| smooth_noise(seed * 4 + k, s * scale, t * scale);
    0.1 + 0.8 * (0.4 * octave(0, 3.0) + 0.35 * octave(1, 7.0) + 0.25 * octave(2, 15.0))
}

fn smooth_noise(seed: u32, s: f64, t: f64) -> f64 {
    let (i, j) = (s.floor(), t.floor());
    let ease = |u: f64| u * u * (3.0 - 2.0 * u);
    let (u, v) = (ease(s - i), ease(t - j));
    let at = |di: f64, dj: f64| hash(seed, (i + di) as i64, (j + dj) as i64);
    let top = at(0.0, 0.0) * (1.0 - u) + at(1.0, 0.0) * u;
    let bottom = at(0.0, 1.0) * (1.0 - u) + at(1.0, 1.0) * u;
    top * (1.0 - v) + bottom * v
}

fn hash(seed: u32, i: i64, j: i64) -> f64 {
    let mut z = u64::from(seed) ^ (i as u64).wrapping_mul(0x9e37_79b9) ^ (j as u64) << 32;
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
}
