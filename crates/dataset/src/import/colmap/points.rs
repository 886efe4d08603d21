//! How uncertain the points of a model are, and who sees them.

use super::camera::ModelCamera;
use super::{ModelImage, ModelPoint};
use crate::import::sparse::SparsePoint;
use i2slam_geometry::{Mat3, Vec3};
use std::collections::{BTreeMap, HashMap};

/// Smallest reprojection error that is believed [px].
const LEAST_ERROR: f64 = 0.1;

/// The points that are fixed by their views, with covariance, and for every image the places of
/// those that it sees.
///
/// `Σ = σ² (Σ_i J_iᵀ J_i)⁻¹`, `J_i = ∂(u, v)/∂X` in the i-th image that sees the point, poses taken
/// as exact (Hartley and Zisserman 2004, section 5.2.3). σ is the point's mean reprojection error
/// [px], at least a tenth and the mean one of all points, because the error of a point that few
/// images see is small however wrong it is.
pub(super) fn with_covariance(
    points: &[ModelPoint],
    cameras: &BTreeMap<u32, ModelCamera>,
    images: &[ModelImage],
) -> (Vec<SparsePoint>, Vec<Vec<usize>>) {
    let records: HashMap<u32, usize> =
        images.iter().enumerate().map(|(record, image)| (image.id, record)).collect();
    let mean = points.iter().map(|point| point.error.max(0.0)).sum::<f64>() / points.len() as f64;
    let (mut known, mut seen) = (Vec::new(), vec![Vec::new(); images.len()]);
    for point in points {
        let mut by: Vec<usize> =
            point.images.iter().filter_map(|id| records.get(id).copied()).collect();
        by.sort_unstable();
        by.dedup();
        let mut information = Mat3::zero();
        for &record in &by {
            let focal =
                cameras.get(&images[record].camera).map(|camera| (camera.k[0], camera.k[1]));
            let rows = focal.and_then(|focal| slopes(&images[record], focal, point.position));
            for row in rows.into_iter().flatten() {
                information = information + outer(row);
            }
        }
        let sigma = point.error.max(mean).max(LEAST_ERROR);
        let Some(covariance) = inverse(&information.scaled((sigma * sigma).recip())) else {
            continue;
        };
        for record in by {
            seen[record].push(known.len());
        }
        known.push(SparsePoint { position: point.position, covariance });
    }
    (known, seen)
}

/// `∂u/∂X` and `∂v/∂X`; `None` behind the camera.
fn slopes(image: &ModelImage, (fx, fy): (f64, f64), position: Vec3<f64>) -> Option<[Vec3<f64>; 2]> {
    let camera_from_world = image.world_from_camera.inverse();
    let p = camera_from_world * position;
    let rotation = image.world_from_camera.rotation;
    (p.z > 0.0).then(|| {
        let by_u = Vec3::new(fx / p.z, 0.0, -fx * p.x / (p.z * p.z));
        let by_v = Vec3::new(0.0, fy / p.z, -fy * p.y / (p.z * p.z));
        [rotation.rotate(by_u), rotation.rotate(by_v)]
    })
}

fn outer(v: Vec3<f64>) -> Mat3<f64> {
    let v = v.to_array();
    Mat3 { rows: v.map(|a| v.map(|b| a * b)) }
}

/// The upper triangle of the inverse of a symmetric matrix; `None` if it is singular.
fn inverse(m: &Mat3<f64>) -> Option<[f64; 6]> {
    let [a, b, c] = m.rows.map(Vec3::from_array);
    let (x, y, z) = (b.cross(c), c.cross(a), a.cross(b));
    let determinant = a.dot(x);
    let scale = a.norm() * b.norm() * c.norm();
    let usable = determinant.is_finite() && determinant > 1e-12 * scale;
    let d = determinant;
    usable.then(|| [x.x / d, x.y / d, x.z / d, y.y / d, y.z / d, z.z / d])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::distortion::Distortion;
    use i2slam_geometry::{Pose, Rotation};

    /// Two cameras `baseline` apart see a point straight ahead of their middle at depth `z`.
    fn covariance(baseline: f64, z: f64) -> Vec<SparsePoint> {
        let camera = ModelCamera {
            size: (100, 100),
            k: [50.0, 50.0, 50.0, 50.0],
            lens: Distortion::default(),
        };
        let image = |id: u32, x: f64| ModelImage {
            id,
            camera: 1,
            name: String::new(),
            world_from_camera: Pose::new(Rotation::identity(), Vec3::new(x, 0.0, 0.0)),
        };
        let images = [image(1, -0.5 * baseline), image(2, 0.5 * baseline)];
        let position = Vec3::new(0.0, 0.0, z);
        let point = ModelPoint { position, error: 0.5, images: vec![1, 2] };
        with_covariance(&[point], &BTreeMap::from([(1, camera)]), &images).0
    }

    #[test]
    fn depth_of_two_views_is_as_uncertain_as_stereo_says() {
        // Var(z) = σ² z⁴ / (f² b²) · 2, the disparity being a difference of two positions.
        let (baseline, z) = (0.4_f64, 3.0_f64);
        let found = covariance(baseline, z)[0].covariance[5];
        let due = 0.25 * z.powi(4) * 2.0 / (50.0 * baseline).powi(2);
        assert!((found / due - 1.0).abs() < 1e-9, "{found} {due}");
    }

    #[test]
    fn a_point_without_parallax_is_none() {
        assert!(covariance(0.0, 3.0).is_empty());
    }
}
