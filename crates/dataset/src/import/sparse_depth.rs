//! How uncertain the points of a model are, and who sees them.

use super::camera::ModelCamera;
use super::{ModelImage, ModelPoint};
use crate::import::sparse::SparsePoint;
use i2slam_geometry::{Mat3, Vec3};
use std::collections::{BTreeMap, HashMap};
use std::f64::consts::FRAC_2_PI;

/// Smallest variance of a pixel coordinate that is believed [px²].
const MIN_VARIANCE: f64 = 0.01;

/// The points that are fixed by their views, with covariance, and for every image the places of
/// those that it sees.
///
/// `Σ = σ² (Σ_i J_iᵀ J_i)⁻¹`, `J_i = ∂(u, v)/∂X` in the i-th image that sees the point, poses taken
/// as exact (Hartley and Zisserman 2004, section 5.2.3). σ² is [that](variance) of the point, at
/// least the mean of all points, because the error of a point that few images see is small however
/// wrong it is; 1 px² where no error was computed.
pub(super) fn with_covariance(
    points: &[ModelPoint],
    cameras: &BTreeMap<u32, ModelCamera>,
    images: &[ModelImage],
) -> (Vec<SparsePoint>, Vec<Vec<usize>>) {
    let records: HashMap<u32, usize> =
        images.iter().enumerate().map(|(record, image)| (image.id, record)).collect();
    let least = mean(points.iter().filter_map(variance)).unwrap_or(1.0).max(MIN_VARIANCE);
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
                information = information + Mat3::outer(row, row);
            }
        }
        let variance = variance(point).unwrap_or(least).max(least);
        let Some(covariance) = inverse(&information.scaled(variance.recip())) else {
            continue;
        };
        for record in by {
            seen[record].push(known.len());
        }
        known.push(SparsePoint { position: point.position, covariance });
    }
    (known, seen)
}

/// Variance of a coordinate of a point in its n images [px²], from the mean length e of its
/// residuals there: `e² (2/π) · 2n / (2n − 3)`. The length of a normal pair has the mean σ √(π/2),
/// and the position of the point has taken 3 of the 2n degrees of freedom. `None` where the error
/// is not above 0: it was not computed (−1).
fn variance(point: &ModelPoint) -> Option<f64> {
    let numbers = 2.0 * point.images.len() as f64;
    (point.error > 0.0 && numbers > 3.0)
        .then(|| point.error.powi(2) * FRAC_2_PI * numbers / (numbers - 3.0))
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_usize), |(sum, count), v| (sum + v, count + 1));
    (count > 0).then(|| sum / count as f64)
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

/// The upper triangle of the inverse of a symmetric matrix; `None` if it is singular.
///
/// How near it is to that depends on the axes of the world, so what comes of it is judged instead
/// ([`SparseDepth::at`](crate::import::sparse::SparseDepth::at)).
fn inverse(m: &Mat3<f64>) -> Option<[f64; 6]> {
    let [a, b, c] = m.rows.map(Vec3::from_array);
    let (x, y, z) = (b.cross(c), c.cross(a), a.cross(b));
    let determinant = a.dot(x);
    let d = determinant;
    let usable = d.is_finite() && d > 0.0;
    usable.then(|| [x.x / d, x.y / d, x.z / d, y.y / d, y.z / d, z.z / d])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::distortion::Distortion;
    use crate::import::keyframe::KeyframePose;
    use crate::import::sparse::SparseDepth;
    use i2slam_geometry::{Camera, Pose, Rotation};

    /// What two cameras see of a point straight ahead of their middle.
    struct Pair {
        focal: f64,
        baseline: f64,
        z: f64,
        error: f64,
        /// The world is turned by this.
        turn: [f64; 3],
    }

    const PAIR: Pair = Pair { focal: 50.0, baseline: 0.4, z: 3.0, error: 0.5, turn: [0.0; 3] };

    impl Pair {
        /// Depth and its variance in the first image; 0 for none.
        fn seen(&self) -> (f32, f32) {
            let turn =
                Pose::new(Rotation::exp(Vec3::from_array(self.turn)), Vec3::new(3.0, -2.0, 1.0));
            let camera = ModelCamera {
                size: (100, 100),
                k: [self.focal, self.focal, 50.0, 50.0],
                lens: Distortion::default(),
            };
            let image = |id: u32, x: f64| {
                let place = Pose::new(Rotation::identity(), Vec3::new(x, 0.0, 0.0));
                ModelImage { id, camera: 1, name: String::new(), world_from_camera: turn * place }
            };
            let images = [image(1, -0.5 * self.baseline), image(2, 0.5 * self.baseline)];
            let position = turn * Vec3::new(0.0, 0.0, self.z);
            let point = ModelPoint { position, error: self.error, images: vec![1, 2] };
            let cameras = BTreeMap::from([(1, camera)]);
            let (points, seen) = with_covariance(&[point], &cameras, &images);
            let world_from_camera = images[0].world_from_camera;
            let pose = KeyframePose {
                index: 0,
                timestamp: 0.0,
                world_from_camera,
                position: 0,
                record: 0,
            };
            let focal = self.focal;
            let camera =
                Camera { width: 100, height: 100, fx: focal, fy: focal, cx: 50.0, cy: 50.0 };
            let found = SparseDepth { points, seen, max_depth: f64::INFINITY };
            let (depth, variance) = found.at(&pose, &camera);
            let at = depth.data.iter().position(|&z| z > 0.0);
            at.map_or((0.0, 0.0), |at| (depth.data[at], variance.data[at]))
        }
    }

    /// Variance of the depth of a pair [unit²]: `2 σ² z⁴ / (f² b²)`, the disparity being a
    /// difference of two positions; at small angles.
    fn stereo(pair: &Pair, variance: f64) -> f64 {
        2.0 * variance * pair.z.powi(4) / (pair.focal * pair.baseline).powi(2)
    }

    const TURNS: [[f64; 3]; 4] =
        [[0.0, 0.0, 0.0], [0.6, -1.1, 0.4], [-2.0, 0.3, 1.0], [0.1, 0.7, -2.4]];

    #[test]
    fn depth_of_two_views_is_as_uncertain_as_stereo_says() {
        for turn in TURNS {
            let pair = Pair { turn, ..PAIR };
            let (z, variance) = pair.seen();
            // An error of 0.5 px in two images: 0.25 · 2/π · 4.
            let due = stereo(&pair, 2.0 / std::f64::consts::PI);
            assert!((f64::from(z) / 3.0 - 1.0).abs() < 1e-6, "{z}");
            assert!((f64::from(variance) / due - 1.0).abs() < 1e-5, "{variance} {due}");
        }
    }

    #[test]
    fn where_no_error_was_computed_it_is_a_pixel() {
        for error in [-1.0, 0.0] {
            let pair = Pair { error, ..PAIR };
            let due = stereo(&pair, 1.0);
            assert!((f64::from(pair.seen().1) / due - 1.0).abs() < 1e-5);
        }
    }

    #[test]
    fn parallax_is_judged_alike_however_the_world_lies() {
        for turn in TURNS {
            for (focal, baseline, is_seen) in
                [(50.0, 0.0, false), (50.0, 3e-5, false), (5e5, 3e-5, true), (5e5, 0.0, false)]
            {
                let pair = Pair { turn, focal, baseline, error: 0.1, ..PAIR };
                assert_eq!(pair.seen().0 > 0.0, is_seen, "{turn:?} {focal} {baseline}");
            }
        }
    }
}
