//! A ball between six cameras.

use super::clean::without_specks;
use super::extract::surface;
use super::volume::{DepthView, Volume};
use super::*;
use i2slam::geometry::{Camera, Pose, Rotation};
use std::collections::HashMap;
use std::f64::consts::{FRAC_PI_2, PI};

const RADIUS: f64 = 0.4;
const DISTANCE: f64 = 2.0;

fn camera() -> Camera<f64> {
    Camera { width: 160, height: 160, fx: 300.0, fy: 300.0, cx: 80.0, cy: 80.0 }
}

/// Depth of a ball in the middle of the world; all poses look at it.
fn ball() -> Image<f32> {
    let camera = camera();
    Image::from_fn(160, 160, 1, |_, column, row| {
        let ray = camera.unproject(column as f64 + 0.5, row as f64 + 0.5, 1.0);
        let (along, square) = (ray.z * DISTANCE / ray.norm_squared(), ray.norm_squared());
        let inside = RADIUS.powi(2) - DISTANCE.powi(2) + along.powi(2) * square;
        if inside > 0.0 { (along - (inside / square).sqrt()) as f32 } else { 0.0 }
    })
}

fn poses() -> Vec<Pose<f64>> {
    let turns = [
        Vec3::zero(),
        Vec3::new(0.0, FRAC_PI_2, 0.0),
        Vec3::new(0.0, PI, 0.0),
        Vec3::new(0.0, -FRAC_PI_2, 0.0),
        Vec3::new(FRAC_PI_2, 0.0, 0.0),
        Vec3::new(-FRAC_PI_2, 0.0, 0.0),
    ];
    let pose = |turn| {
        let rotation = Rotation::exp(turn);
        Pose::new(rotation, rotation.rotate(Vec3::new(0.0, 0.0, -DISTANCE)))
    };
    turns.into_iter().map(pose).collect()
}

fn fused() -> Mesh {
    let (camera, depth) = (camera(), ball());
    let colour = Image { channels: 3, data: vec![0.25; 3 * 160 * 160], ..depth.clone() };
    let mut volume = Volume::new(0.02);
    for world_from_camera in poses() {
        let view = DepthView { camera: &camera, world_from_camera, depth: &depth, colour: &colour };
        assert!(volume.add(&view));
    }
    surface(&volume)
}

#[test]
fn a_ball_becomes_a_closed_mesh_that_faces_outside() {
    let mesh = fused();
    let worst = mesh.positions.iter().map(|p| (p.norm() - RADIUS).abs()).fold(0.0, f64::max);
    assert!(worst < 0.004, "{worst}");
    assert!(mesh.colours.iter().flatten().all(|c| (c - 0.25).abs() < 0.01));
    let mut area = 0.0;
    let mut edges: HashMap<(u32, u32), i32> = HashMap::new();
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|vertex| mesh.positions[vertex as usize]);
        let normal = (b - a).cross(c - a) * 0.5;
        assert!(normal.dot(a) >= -1e-9, "faces inside");
        area += normal.norm();
        for i in 0..3 {
            let (from, to) = (triangle[i], triangle[(i + 1) % 3]);
            *edges.entry((from.min(to), from.max(to))).or_default() +=
                if from < to { 1 } else { -1 };
        }
    }
    let due = 4.0 * PI * RADIUS * RADIUS;
    assert!((area / due - 1.0).abs() < 0.02, "{area} {due}");
    // Every edge has a triangle on either side.
    assert!(edges.values().all(|&count| count == 0));
}

#[test]
fn specks_go_and_the_ball_stays() {
    let ball = fused();
    let mut mesh = ball.clone();
    let first = mesh.positions.len() as u32;
    mesh.positions.extend([Vec3::new(5.0, 0.0, 0.0), Vec3::new(5.0, 1.0, 0.0), Vec3::zero()]);
    mesh.colours.extend([[0.0; 3]; 3]);
    mesh.triangles.insert(0, [first, first + 1, first + 2]);
    let clean = without_specks(&mesh);
    assert_eq!(clean.triangles.len(), ball.triangles.len());
    assert_eq!(clean.positions.len(), ball.positions.len());
    assert!(clean.positions.iter().all(|p| p.norm() < 1.0));
}

#[test]
fn a_scene_with_too_many_voxels_is_refused() {
    let (camera, depth) = (camera(), ball());
    let colour = Image { channels: 3, data: vec![0.25; 3 * 160 * 160], ..depth.clone() };
    let view = DepthView {
        camera: &camera,
        world_from_camera: poses()[0],
        depth: &depth,
        colour: &colour,
    };
    let mut volume = Volume::new(0.02);
    volume.max_blocks = 10;
    assert!(!volume.add(&view));
    let refused = |pixel| too_many_voxels(0.02, pixel).to_string();
    assert!(refused(None).contains("--voxel 0.040") && refused(None).contains("--crop"));
    assert!(refused(Some(0.1)).contains("--voxel 0.10"), "{}", refused(Some(0.1)));
}
