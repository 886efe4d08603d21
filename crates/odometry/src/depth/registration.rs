//! Registration of a depth picture to the colour picture.

use super::depth_map::interpolated_depth;
use i2slam_geometry::{Camera, Image, Pose};

/// Fixed-point iterations: each multiplies the error by the slope of the depth along the motion.
const ITERATIONS: usize = 3;
/// Largest change of the depth in the last iteration over the depth.
const MAX_LAST_CHANGE: f64 = 2e-3;
/// Motion between both pictures below which they count as one view [px].
const NEGLIGIBLE_MOTION: f64 = 0.02;

/// Depth \[m\] as the colour camera sees it, 0 where that is not known: of every pixel, the point on
/// its ray that the depth picture shows. `shift` is the offset of positions in the depth picture
/// \[px\].
///
/// For a depth picture taken `t` later than its colour picture under the velocity `v`, the pose is
/// `Pose::identity().retract(v.scaled(t)).inverse()`.
pub fn register_depth(
    depth: &Image<f32>,
    camera: &Camera<f64>,
    shift: [f64; 2],
    depth_from_colour: &Pose<f64>,
) -> Image<f32> {
    if is_registered(camera, shift, depth_from_colour) {
        return depth.clone();
    }
    Image::from_fn(depth.width, depth.height, 1, |_, column, row| {
        let at = Camera::<f64>::pixel_centre(column, row);
        let start = f64::from(depth.at(0, column, row));
        registered_pixel(depth, camera, shift, depth_from_colour, (at, start)).unwrap_or(0.0) as f32
    })
}

fn is_registered(camera: &Camera<f64>, shift: [f64; 2], motion: &Pose<f64>) -> bool {
    let turn = motion.rotation.log().norm() * camera.fx;
    // A metre is as near as most sensors see.
    let moved = motion.translation.norm() * camera.fx;
    shift[0].abs().max(shift[1].abs()).max(turn).max(moved) < NEGLIGIBLE_MOTION
}

fn registered_pixel(
    depth: &Image<f32>,
    camera: &Camera<f64>,
    shift: [f64; 2],
    depth_from_colour: &Pose<f64>,
    ((u, v), start): ((f64, f64), f64),
) -> Option<f64> {
    let mut z =
        if start > 0.0 { start } else { interpolated_depth(depth, [u + shift[0], v + shift[1]])? };
    let mut change = f64::INFINITY;
    for _ in 0..ITERATIONS {
        let point = *depth_from_colour * camera.unproject(u, v, z);
        let (x, y) = (point.z > 0.0).then(|| camera.project(point))?;
        let read = interpolated_depth(depth, [x + shift[0], y + shift[1]])?;
        change = read - point.z;
        z += change;
        if z <= 0.0 {
            return None;
        }
    }
    (change.abs() <= MAX_LAST_CHANGE * z).then_some(z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_geometry::{Rotation, Vec3};

    /// A slanted plane seen a little later, by a picture whose origin is shifted.
    #[test]
    fn a_plane_seen_from_elsewhere_is_registered() {
        let camera = Camera { width: 64, height: 48, fx: 60.0, fy: 60.0, cx: 32.0, cy: 24.0 };
        let normal = Vec3::new(0.2, -0.1, 1.0);
        let plane = |pose: &Pose<f64>, u: f64, v: f64| {
            let ray = pose.rotation.rotate(camera.unproject(u, v, 1.0));
            (2.0 - normal.dot(pose.translation)) / normal.dot(ray)
        };
        let later =
            Pose::new(Rotation::exp(Vec3::new(0.01, 0.04, 0.0)), Vec3::new(0.02, 0.0, 0.01));
        let shift = [1.5, -0.75];
        let depth = Image::from_fn(64, 48, 1, |_, column, row| {
            let (u, v) = Camera::<f64>::pixel_centre(column, row);
            plane(&later, u - shift[0], v - shift[1]) as f32
        });
        let found = register_depth(&depth, &camera, shift, &later.inverse());
        let identity = Pose::identity();
        let mut read = 0;
        for (column, row) in (0..64).flat_map(|c| (0..48).map(move |r| (c, r))) {
            let (z, (u, v)) =
                (f64::from(found.at(0, column, row)), Camera::<f64>::pixel_centre(column, row));
            if z > 0.0 {
                assert!((z - plane(&identity, u, v)).abs() < 2e-4, "{column} {row} {z}");
                read += 1;
            }
        }
        assert!(read > 2400, "{read}");
        let same = register_depth(&depth, &camera, [0.0; 2], &identity);
        assert_eq!(same.data, depth.data);
    }
}
