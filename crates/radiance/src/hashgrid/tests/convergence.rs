//! A field learns a room from a few small pictures, and shows it from elsewhere.

use crate::hashgrid::*;
use crate::{RadianceMap, Render, View};
use i2slam_compute::Random;
use i2slam_geometry::{Camera, Pose, Rotation, Vec3};

const SIZE: usize = 32;

/// Half of the room's edge \[m\].
const WALL: f32 = 1.0;

/// Colour and depth along a ray from within the room: smooth colours, another on every wall.
fn room(ray: &Ray) -> ([f32; 3], f32) {
    let (o, d) = (ray.origin.to_array(), ray.direction.to_array());
    let to_wall = |k: usize| (WALL * d[k].signum() - o[k]) / d[k];
    let (mut depth, mut axis) = (f32::MAX, 0);
    for k in 0..3 {
        if d[k] != 0.0 && to_wall(k) < depth {
            (depth, axis) = (to_wall(k), k);
        }
    }
    let p: [f32; 3] = std::array::from_fn(|k| o[k] + depth * d[k]);
    let side = if d[axis] > 0.0 { 0.25 } else { -0.25 };
    let (u, v) = (p[(axis + 1) % 3], p[(axis + 2) % 3]);
    let colour = [0, 1, 2].map(|c| {
        let base = if c == axis { 0.6 + side } else { 0.4 };
        base + 0.12 * (4.0 * u + c as f32).sin() * (3.0 * v).cos()
    });
    (colour, depth)
}

/// A camera near the middle of the room that looks somewhere.
fn view(seed: u64) -> View<f32> {
    let mut random = Random::new(seed);
    let mut any = |size: f64| (random.uniform() * 2.0 - 1.0) * size;
    let position = Vec3::new(any(0.4), any(0.4), any(0.4)).cast();
    let turn = Vec3::new(any(0.4), any(3.1), any(0.4)).cast();
    let (f, c) = (SIZE as f32 * 0.5, SIZE as f32 * 0.5);
    let camera = Camera { width: SIZE, height: SIZE, fx: f, fy: f, cx: c, cy: c };
    View { camera, world_from_camera: Pose::new(Rotation::exp(turn), position) }
}

fn map() -> (HashGridMap, FieldRenderer) {
    let settings = FieldSettings {
        levels: 6,
        log2_table: 14,
        base_resolution: 8,
        finest_resolution: 64,
        hidden_width: 32,
        ..FieldSettings::cube([0.0; 3], 1.1)
    };
    let march = MarchSettings { step_min: 0.02, step_max: 0.04, ..MarchSettings::cube(1.1) };
    let occupancy = OccupancySettings { resolution: 24, ..OccupancySettings::default() };
    let map = HashGridMap {
        field: HashGridField::new(settings, 1).expect("settings in range"),
        occupancy: Occupancy::new(occupancy),
        march,
    };
    (map, FieldRenderer::new(march))
}

/// Derivatives of the mean squared errors of radiance and depth.
fn cotangents(rays: &[Ray], renders: &[RayRender]) -> Vec<RayRender> {
    let scale = 2.0 / rays.len() as f32;
    let of = |(ray, render): (&Ray, &RayRender)| {
        let (colour, depth) = room(ray);
        let radiance = std::array::from_fn(|c| scale * (render.radiance[c] - colour[c]));
        RayRender { radiance, depth: scale * (render.depth - depth), opacity: 0.0 }
    };
    rays.iter().zip(renders).map(of).collect()
}

fn train(map: &mut HashGridMap, renderer: &mut FieldRenderer, steps: i32) {
    let views: Vec<_> = (0..24).map(|i| view(100 + i)).collect();
    let HashGridMap { field, occupancy, .. } = map;
    let (mut adam, mut random) = (FieldAdam::new(), Random::new(7));
    let (mut gradient, mut renders) = (FieldGradient::zeros(field), Vec::new());
    for step in 0..steps {
        if step % 16 == 0 {
            occupancy.refresh(field, renderer, 3);
        }
        let ray = |random: &mut Random| {
            let view = &views[random.below(views.len())];
            let ray = Ray::through_pixel(view, random.below(SIZE), random.below(SIZE));
            Ray { offset: random.uniform() as f32, ..ray }
        };
        let rays: Vec<Ray> = (0..512).map(|_| ray(&mut random)).collect();
        renderer.render(field, occupancy, &rays, &mut renders);
        let cotangents = cotangents(&rays, &renders);
        renderer.pull_back(field, &rays, &cotangents, Some(&mut gradient), None);
        adam.step(field, &mut gradient, decayed_rate(1e-2, step, steps));
    }
}

/// PSNR of radiance \[dB\] and mean error of depth \[m\] in a view.
fn quality(map: &HashGridMap, renderer: &mut FieldRenderer, view: &View<f32>) -> (f64, f64) {
    let mut render = Render::default();
    map.render(renderer, view, &mut render);
    let (mut squared, mut depth_error) = (0.0, 0.0);
    let pixels = SIZE * SIZE;
    for i in 0..pixels {
        let (colour, depth) = room(&Ray::through_pixel(view, i % SIZE, i / SIZE));
        for c in 0..3 {
            squared += f64::from(render.radiance.data[c * pixels + i] - colour[c]).powi(2);
        }
        depth_error += f64::from((render.depth.data[i] - depth).abs());
    }
    let mean = squared / (3 * pixels) as f64;
    (-10.0 * mean.log10(), depth_error / pixels as f64)
}

#[test]
fn a_room_is_learnt_from_a_few_pictures() {
    let (mut map, mut renderer) = map();
    let held_out = view(7);
    let (before, _) = quality(&map, &mut renderer, &held_out);
    train(&mut map, &mut renderer, 350);
    let (after, depth) = quality(&map, &mut renderer, &held_out);
    let share = map.occupancy.occupied_share();
    assert!(before < 20.0 && after > 25.0, "{before:.1} dB before, {after:.1} dB after");
    assert!(depth < 0.05, "depth error {depth:.3} m");
    assert!(share < 0.6, "{share:.2} of the cells are occupied");
}
