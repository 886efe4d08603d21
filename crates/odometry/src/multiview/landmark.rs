//! Landmarks in inverse-depth parametrisation, and their projection.

use crate::multiview::robust_loss::length;
use crate::multiview::whitening::Whitening;
use crate::track::tracks::Observation;
use i2slam_geometry::{Camera, Mat3, Pose, Similarity, Vec3};

/// A scene point by direction and inverse depth from a fixed origin (Civera et al. 2008): `p =
/// origin + rotation (a, b, 1) / ρ`. Points at infinity have `ρ = 0` and cause no singularity.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Landmark {
    /// Centre of the camera that first observed the point, in the world; fixed.
    pub(crate) origin: Vec3<f64>,
    /// `world_from_camera` rotation of that camera; fixed.
    pub(crate) rotation: Mat3<f64>,
    /// `(a, b, ρ)`, adjusted.
    pub(crate) values: [f64; 3],
}

/// An image position and the inverse depth there, with derivatives: rows `u`, `v` [px], `1/z`.
pub(crate) struct Projection {
    pub(crate) at: [f64; 2],
    pub(crate) inverse_depth: f64,
    /// By the pose's tangent `(ρ, φ)`.
    pub(crate) by_pose: [[f64; 6]; 3],
    /// By `(a, b, ρ)`.
    pub(crate) by_landmark: [[f64; 3]; 3],
    /// By the logarithm of the focal length.
    pub(crate) by_focal: [f64; 3],
}

impl Projection {
    /// Derivatives of the position, in the standard deviations of an observation of it.
    #[inline(always)]
    pub(crate) fn whiten(&mut self, by: &Whitening) {
        let [x, y, _] = &mut self.by_pose;
        by.apply_to_rows(x, y);
        let [x, y, _] = &mut self.by_landmark;
        by.apply_to_rows(x, y);
        let [x, y, _] = self.by_focal;
        [self.by_focal[0], self.by_focal[1]] = by.apply([x, y]);
    }
}

impl Landmark {
    /// The point at inverse depth `inverse_depth` on the ray through `at`.
    pub(crate) fn on_ray(
        camera: &Camera<f64>,
        world_from_camera: Pose<f64>,
        at: [f64; 2],
        inverse_depth: f64,
    ) -> Self {
        let ray = camera.unproject(at[0], at[1], 1.0);
        Self {
            origin: world_from_camera.translation,
            rotation: world_from_camera.rotation.matrix(),
            values: [ray.x, ray.y, inverse_depth],
        }
    }

    /// Inverse depth `ρ` in the camera of the origin.
    pub(crate) fn inverse_depth(&self) -> f64 {
        self.values[2]
    }

    /// The point after a similarity transform of the world.
    pub(crate) fn transformed(&self, by: &Similarity<f64>) -> Self {
        let [a, b, rho] = self.values;
        Self {
            origin: by.apply(self.origin),
            rotation: by.rotation.matrix() * self.rotation,
            values: [a, b, rho / by.scale],
        }
    }

    /// The point in the world; far away where the inverse depth is not positive.
    pub(crate) fn position(&self) -> Vec3<f64> {
        let [a, b, rho] = self.values;
        self.origin + self.rotation * Vec3::new(a, b, 1.0) * (1.0 / rho.max(1e-9))
    }

    /// Inverse depth in a camera.
    pub(crate) fn inverse_depth_in(&self, world_from_camera: &Pose<f64>) -> f64 {
        self.values[2] / self.scaled_point_in(world_from_camera).z
    }

    /// Derivative of the depth in a camera by `ρ`: `-(Rᵀ rotation (a, b, 1))_z / ρ²`.
    pub(crate) fn depth_by_inverse_depth(&self, world_from_camera: &Pose<f64>) -> f64 {
        let [a, b, rho] = self.values;
        let ray = self.rotation * Vec3::new(a, b, 1.0);
        -world_from_camera.rotation.inverse().rotate(ray).z / (rho * rho)
    }

    /// The point in a camera, times its inverse depth: `Rᵀ (ρ (origin - t) + rotation (a, b, 1))`.
    pub(crate) fn scaled_point_in(&self, world_from_camera: &Pose<f64>) -> Vec3<f64> {
        let [a, b, rho] = self.values;
        let offset = self.origin - world_from_camera.translation;
        let inverse = world_from_camera.rotation.inverse();
        inverse.rotate(offset * rho + self.rotation * Vec3::new(a, b, 1.0))
    }

    /// Projection into a camera; `None` behind it.
    pub(crate) fn image_position(
        &self,
        camera: &Camera<f64>,
        world_from_camera: &Pose<f64>,
    ) -> Option<[f64; 2]> {
        let q = self.scaled_point_in(world_from_camera);
        let (u, v) = camera.project(q);
        (q.z > 1e-6).then_some([u, v])
    }

    /// Projection with derivatives; `None` behind the camera.
    #[inline(always)]
    pub(crate) fn project(
        &self,
        camera: &Camera<f64>,
        world_from_camera: &Pose<f64>,
    ) -> Option<Projection> {
        let q = self.scaled_point_in(world_from_camera);
        if q.z <= 1e-6 {
            return None;
        }
        let inverse = world_from_camera.rotation.inverse();
        let rotation = inverse.matrix() * self.rotation;
        let by_rho = inverse.rotate(self.origin - world_from_camera.translation);
        let (x, y, iz) = (q.x / q.z, q.y / q.z, 1.0 / q.z);
        // The inverse depth in the camera is ρ / q.z.
        let rows = [
            Vec3::new(camera.fx * iz, 0.0, -camera.fx * x * iz),
            Vec3::new(0.0, camera.fy * iz, -camera.fy * y * iz),
            Vec3::new(0.0, 0.0, -self.values[2] * iz * iz),
        ];
        let rho = self.values[2];
        let columns = rotation.transpose().rows.map(Vec3::from_array);
        let by_pose = rows.map(|g| {
            // Moving the camera by R ρ moves q by -ρ; turning it by φ moves q by q × φ.
            let (t, r) = (g * -rho, g.cross(q));
            [t.x, t.y, t.z, r.x, r.y, r.z]
        });
        let mut by_landmark = rows.map(|g| [g.dot(columns[0]), g.dot(columns[1]), g.dot(by_rho)]);
        by_landmark[2][2] += iz;
        let at = [camera.fx * x + camera.cx, camera.fy * y + camera.cy];
        let by_focal = [camera.fx * x, camera.fy * y, 0.0];
        Some(Projection { at, inverse_depth: rho * iz, by_pose, by_landmark, by_focal })
    }
}

/// A landmark and its observation in one frame.
pub(crate) type Match<'a> = (&'a Landmark, &'a Observation);

/// Reprojection error up to which a match is an inlier [standard deviations].
pub(crate) const MAX_INLIER_ERROR: f64 = 5.0;

/// Standard deviation of where a map that is not finished shows a point [px]: rows, lens, and the landmarks
/// themselves are not final, though positions are often found to a twentieth of a pixel.
pub(crate) const MAP_SIGMA: f64 = 0.4;

/// Deviation of an observation, `noise` times the claimed one, from what a map that is not finished shows.
pub(crate) fn registration_whitening(observation: &Observation, noise: f64) -> Whitening {
    observation.whitening().scaled(noise).plus(&Whitening::isotropic(MAP_SIGMA))
}

/// [`reprojection_error`] by a map that is not finished: of [`registration_whitening`].
pub(crate) fn registration_error(
    camera: &Camera<f64>,
    pose: &Pose<f64>,
    m: &Match<'_>,
    noise: f64,
) -> f64 {
    whitened_error(camera, pose, m, &registration_whitening(m.1, noise))
}

/// Affine warp of the surroundings of a landmark, taken to face one camera, into another one.
pub(crate) fn warp_between_views(
    camera: &Camera<f64>,
    landmark: &Landmark,
    from: &Pose<f64>,
    to: &Pose<f64>,
) -> Option<[[f32; 2]; 2]> {
    let seen = from.inverse() * landmark.position();
    let (u, v) = camera.project(seen);
    let there = |du: f64, dv: f64| {
        let p = to.inverse() * (*from * camera.unproject(u + du, v + dv, seen.z));
        (seen.z > 0.0 && p.z > 1e-6 * seen.z).then(|| camera.project(p))
    };
    let (centre, right, below) = (there(0.0, 0.0)?, there(1.0, 0.0)?, there(0.0, 1.0)?);
    let slope = |a: f64, b: f64| (a - b) as f32;
    Some([
        [slope(right.0, centre.0), slope(below.0, centre.0)],
        [slope(right.1, centre.1), slope(below.1, centre.1)],
    ])
}

/// Length of a match's reprojection error [standard deviations]; infinite behind the camera.
pub(crate) fn reprojection_error(camera: &Camera<f64>, pose: &Pose<f64>, m: &Match<'_>) -> f64 {
    whitened_error(camera, pose, m, m.1.whitening())
}

fn whitened_error(
    camera: &Camera<f64>,
    pose: &Pose<f64>,
    m: &Match<'_>,
    whitening: &Whitening,
) -> f64 {
    m.0.image_position(camera, pose).map_or(f64::INFINITY, |at| {
        length(whitening.apply([at[0] - m.1.at()[0], at[1] - m.1.at()[1]]))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::assert_gradient;
    use i2slam_geometry::{Rotation, Tangent};

    /// A camera, and the pose from which landmarks are first observed.
    fn view() -> (Camera<f64>, Pose<f64>) {
        let camera = Camera { width: 320, height: 240, fx: 251.0, fy: 249.0, cx: 160.0, cy: 121.0 };
        let rotation = Rotation::exp(Vec3::new(0.1, -0.2, 0.05));
        (camera, Pose::new(rotation, Vec3::new(0.3, 0.1, -0.2)))
    }

    #[test]
    fn derivatives_agree_with_differences() {
        let (camera, first) = view();
        let pose = Pose::new(Rotation::exp(Vec3::new(0.0, -0.1, 0.1)), Vec3::new(0.5, 0.0, -0.1));
        for rho in [0.6, 1e-4, -0.05] {
            let landmark = Landmark::on_ray(&camera, first, [100.0, 90.0], rho);
            let projection = landmark.project(&camera, &pose).expect("in front");
            for row in 0..3 {
                let f = |x: &[f64]| {
                    let pose = pose.retract(Tangent::from_array(std::array::from_fn(|i| x[i])));
                    let mut moved = landmark;
                    (0..3).for_each(|i| moved.values[i] += x[6 + i]);
                    let scale = x[9].exp();
                    let camera = Camera { fx: camera.fx * scale, fy: camera.fy * scale, ..camera };
                    let projected = moved.project(&camera, &pose).expect("in front");
                    [projected.at[0], projected.at[1], projected.inverse_depth][row]
                };
                let mut gradient = projection.by_pose[row].to_vec();
                gradient.extend(projection.by_landmark[row]);
                gradient.push(projection.by_focal[row]);
                assert_gradient("projection", &[0.0; 10], &gradient, 1e-3, 1e-6, f);
            }
        }
    }

    /// In a camera that has moved forward the slope is not minus the squared depth.
    #[test]
    fn slope_of_the_depth_agrees_with_differences() {
        let (camera, first) = view();
        let moved = first.retract(Tangent::from_array([0.1, 0.0, 1.0, 0.02, 0.1, 0.0]));
        let landmark = Landmark::on_ray(&camera, first, [100.0, 90.0], 0.4);
        for pose in [first, moved] {
            let depth = |x: &[f64]| {
                let [a, b, rho] = landmark.values;
                let there = Landmark { values: [a, b, rho + x[0]], ..landmark };
                (pose.inverse() * there.position()).z
            };
            let gradient = [landmark.depth_by_inverse_depth(&pose)];
            assert_gradient("depth", &[0.0], &gradient, 1e-4, 1e-6, depth);
        }
        let z = (moved.inverse() * landmark.position()).z;
        assert!(landmark.depth_by_inverse_depth(&moved).abs() > 2.0 * z * z);
    }
}
