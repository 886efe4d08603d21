//! Sparse depth of the points of a COLMAP model, with variance.

use super::source::{KeyframePose, as_valid_f32};
use crate::formats::colmap::{ModelCamera, ModelImage, ModelPoint};
use i2slam_geometry::{Camera, Image, Mat3, Vec3};
use std::cmp::Reverse;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::f64::consts::FRAC_2_PI;

/// A point with its covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SparsePoint {
    /// Position in the world [unit of the poses].
    pub(super) position: Vec3<f64>,
    /// Covariance of the position, upper triangle `[xx, xy, xz, yy, yz, zz]`.
    pub(super) covariance: [f64; 6],
}

/// Points and the images that observe them.
#[derive(Clone, Debug, Default)]
pub(super) struct SparseDepth {
    pub(super) points: Vec<SparsePoint>,
    /// Indices of the observed points, for every image of the model.
    pub(super) observed: Vec<Vec<usize>>,
    /// Depth beyond this is invalid.
    pub(super) max_depth: f64,
}

impl SparseDepth {
    /// Depth and its variance in the pixels that observed points project to, 0 elsewhere; the nearest
    /// of several points counts. The variance is that along the optical axis `r`: `rᵀ Σ r`. Points
    /// whose standard deviation reaches their depth are skipped: they have no parallax.
    pub(super) fn rasterise(
        &self,
        pose: &KeyframePose,
        camera: &Camera<f64>,
    ) -> (Image<f32>, Image<f32>) {
        let mut depth = Image::new(camera.width, camera.height, 1);
        let mut variance = depth.clone();
        let camera_from_world = pose.world_from_camera.inverse();
        let axis = pose.world_from_camera.rotation.rotate(Vec3::new(0.0, 0.0, 1.0));
        for &index in &self.observed[pose.record] {
            let point = &self.points[index];
            let p = camera_from_world * point.position;
            if !(p.z > 0.0 && p.z <= self.max_depth) {
                continue;
            }
            let (u, v) = camera.project(p);
            if !camera.contains(u, v, 0.0) {
                continue;
            }
            let spread = variance_along(&point.covariance, axis);
            if !(spread > 0.0 && spread < p.z * p.z) {
                continue;
            }
            let Some((z, Some(spread))) = as_valid_f32(p.z, Some(spread)) else { continue };
            let at = v as usize * camera.width + u as usize;
            if depth.data[at] == 0.0 || z < depth.data[at] {
                (depth.data[at], variance.data[at]) = (z, spread);
            }
        }
        (depth, variance)
    }

    /// Index into `records` of the image that shares most points with that at `index`, the first of
    /// several; `None` if none shares any.
    pub(super) fn most_covisible(&self, records: &[usize], index: usize) -> Option<usize> {
        let known: HashSet<usize> = self.observed[records[index]].iter().copied().collect();
        let shared = |other: usize| {
            self.observed[records[other]].iter().filter(|at| known.contains(at)).count()
        };
        let others = (0..records.len()).filter(|&other| other != index);
        let (count, other) = others.map(|other| (shared(other), Reverse(other))).max()?;
        (count > 0).then_some(other.0)
    }
}

fn variance_along(&[xx, xy, xz, yy, yz, zz]: &[f64; 6], r: Vec3<f64>) -> f64 {
    r.x * (xx * r.x + 2.0 * (xy * r.y + xz * r.z))
        + r.y * (yy * r.y + 2.0 * yz * r.z)
        + zz * r.z * r.z
}

/// Smallest variance of an observed pixel coordinate [px²].
const MIN_PIXEL_VARIANCE: f64 = 0.01;

/// Computes the covariance of all points that their observations determine, and for every image the
/// indices of the points that it observes.
///
/// `Σ = σ² (Σ_i J_iᵀ J_i)⁻¹`, `J_i = ∂(u, v)/∂X` in the i-th image that observes the point,
/// poses taken as exact (Hartley and Zisserman 2004, section 5.2.3). σ² is the point's
/// [`pixel_variance`], at least the mean of all points, because the residuals of a point with few
/// observations are small however wrong it is; 1 px² where no error was computed.
pub(super) fn with_covariance(
    points: &[ModelPoint],
    cameras: &BTreeMap<u32, ModelCamera>,
    images: &[ModelImage],
) -> (Vec<SparsePoint>, Vec<Vec<usize>>) {
    let records: HashMap<u32, usize> =
        images.iter().enumerate().map(|(record, image)| (image.id, record)).collect();
    let least =
        mean(points.iter().filter_map(pixel_variance)).unwrap_or(1.0).max(MIN_PIXEL_VARIANCE);
    let (mut known, mut observed) = (Vec::new(), vec![Vec::new(); images.len()]);
    for point in points {
        let mut observers: Vec<usize> =
            point.images.iter().filter_map(|id| records.get(id).copied()).collect();
        observers.sort_unstable();
        observers.dedup();
        let mut information = Mat3::zero();
        for &record in &observers {
            let focal =
                cameras.get(&images[record].camera).map(|camera| (camera.k[0], camera.k[1]));
            let rows =
                focal.and_then(|focal| projection_jacobian(&images[record], focal, point.position));
            for row in rows.into_iter().flatten() {
                information = information + Mat3::outer(row, row);
            }
        }
        let variance = pixel_variance(point).unwrap_or(least).max(least);
        let Some(covariance) = inverse(&information.scaled(variance.recip())) else {
            continue;
        };
        for record in observers {
            observed[record].push(known.len());
        }
        known.push(SparsePoint { position: point.position, covariance });
    }
    (known, observed)
}

/// Variance of an observed coordinate [px²] from the mean residual length e in n images:
/// `e² (2/π) · 2n / (2n − 3)`. The length of a normal pair has mean σ √(π/2), and the point's
/// position takes 3 of the 2n degrees of freedom. `None` if no error was computed (−1).
fn pixel_variance(point: &ModelPoint) -> Option<f64> {
    let numbers = 2.0 * point.images.len() as f64;
    (point.error > 0.0 && numbers > 3.0)
        .then(|| point.error.powi(2) * FRAC_2_PI * numbers / (numbers - 3.0))
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_usize), |(sum, count), v| (sum + v, count + 1));
    (count > 0).then(|| sum / count as f64)
}

/// `∂u/∂X` and `∂v/∂X`; `None` behind the camera.
fn projection_jacobian(
    image: &ModelImage,
    (fx, fy): (f64, f64),
    position: Vec3<f64>,
) -> Option<[Vec3<f64>; 2]> {
    let camera_from_world = image.world_from_camera.inverse();
    let p = camera_from_world * position;
    let rotation = image.world_from_camera.rotation;
    (p.z > 0.0).then(|| {
        let by_u = Vec3::new(fx / p.z, 0.0, -fx * p.x / (p.z * p.z));
        let by_v = Vec3::new(0.0, fy / p.z, -fy * p.y / (p.z * p.z));
        [rotation.rotate(by_u), rotation.rotate(by_v)]
    })
}

/// Upper triangle of the inverse of a symmetric matrix; `None` if singular. Nearly singular ones are
/// inverted too, because a limit would depend on the axes of the world;
/// [`SparseDepth::rasterise`] rejects their points by the variance of depth.
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

    #[test]
    fn the_most_covisible_image_is_found() {
        let observed = vec![vec![1, 2, 3], vec![7], vec![3, 9], vec![2, 3, 8], vec![3, 1]];
        let depth = SparseDepth { observed, ..SparseDepth::default() };
        let records = [4, 3, 2, 1, 0];
        assert_eq!(depth.most_covisible(&records, 4), Some(0));
        assert_eq!(depth.most_covisible(&records, 1), Some(4));
        assert_eq!(depth.most_covisible(&records, 3), None);
        assert_eq!(depth.most_covisible(&records[..1], 0), None);
    }

    use crate::camera::Distortion;
    use i2slam_geometry::{Pose, Rotation};

    /// Two cameras that observe a point straight ahead of their midpoint.
    struct StereoPair {
        focal: f64,
        baseline: f64,
        z: f64,
        error: f64,
        /// Rotation of the world, as a rotation vector.
        turn: [f64; 3],
    }

    const PAIR: StereoPair =
        StereoPair { focal: 50.0, baseline: 0.4, z: 3.0, error: 0.5, turn: [0.0; 3] };

    impl StereoPair {
        /// Depth and its variance in the first image; 0 for none.
        fn depth_and_variance(&self) -> (f32, f32) {
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
            let (points, observed) = with_covariance(&[point], &cameras, &images);
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
            let found = SparseDepth { points, observed, max_depth: f64::INFINITY };
            let (depth, variance) = found.rasterise(&pose, &camera);
            let at = depth.data.iter().position(|&z| z > 0.0);
            at.map_or((0.0, 0.0), |at| (depth.data[at], variance.data[at]))
        }
    }

    /// Variance of stereo depth at small angles [unit²]: `2 σ² z⁴ / (f² b²)`.
    fn stereo(pair: &StereoPair, variance: f64) -> f64 {
        2.0 * variance * pair.z.powi(4) / (pair.focal * pair.baseline).powi(2)
    }

    const TURNS: [[f64; 3]; 4] =
        [[0.0, 0.0, 0.0], [0.6, -1.1, 0.4], [-2.0, 0.3, 1.0], [0.1, 0.7, -2.4]];

    #[test]
    fn variance_of_two_views_is_that_of_stereo() {
        for turn in TURNS {
            let pair = StereoPair { turn, ..PAIR };
            let (z, variance) = pair.depth_and_variance();
            // An error of 0.5 px in two images: 0.25 · 2/π · 4.
            let due = stereo(&pair, 2.0 / std::f64::consts::PI);
            assert!((f64::from(z) / 3.0 - 1.0).abs() < 1e-6, "{z}");
            assert!((f64::from(variance) / due - 1.0).abs() < 1e-5, "{variance} {due}");
        }
    }

    #[test]
    fn without_a_computed_error_it_is_one_pixel() {
        for error in [-1.0, 0.0] {
            let pair = StereoPair { error, ..PAIR };
            let due = stereo(&pair, 1.0);
            assert!((f64::from(pair.depth_and_variance().1) / due - 1.0).abs() < 1e-5);
        }
    }

    #[test]
    fn rejection_does_not_depend_on_the_axes_of_the_world() {
        for turn in TURNS {
            for (focal, baseline, is_seen) in
                [(50.0, 0.0, false), (50.0, 3e-5, false), (5e5, 3e-5, true), (5e5, 0.0, false)]
            {
                let pair = StereoPair { turn, focal, baseline, error: 0.1, ..PAIR };
                assert_eq!(
                    pair.depth_and_variance().0 > 0.0,
                    is_seen,
                    "{turn:?} {focal} {baseline}"
                );
            }
        }
    }
}
