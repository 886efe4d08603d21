//! The projection of one Gaussian, as in the equations.

use super::JacobianRange;
use super::path::{Ends, Path};
use crate::gaussian::{
    ColourActivation, Gaussian, GaussianMap, RasterSettings, Shape, ShutterMotion, View,
};
use i2slam_geometry::{Camera, Mat3, Real, Rotation, Tangent, Vec3};

/// The footprint of a Gaussian in an image.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Footprint<T> {
    /// Index in the map.
    pub(crate) index: usize,
    /// Centre `μ` at mid-exposure \[px\].
    pub(crate) centre: [T; 2],
    pub(crate) path: Path<T>,
    /// `Σ₂⁻¹ = [[A, B], [B, C]]` as `[A, B, C]` \[px⁻²\].
    pub(crate) conic: [T; 3],
    /// Opacity `o`.
    pub(crate) opacity: T,
    /// Linear radiance.
    pub(crate) radiance: [T; 3],
    /// Depth of the mean \[m\].
    pub(crate) depth: T,
    /// Change of depth by column and row `h` \[m/px\].
    pub(crate) depth_slope: [T; 2],
}

/// `∂L/∂` of each number of a [`Footprint`].
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct FootprintCotangent<T> {
    pub(crate) centre: [T; 2],
    pub(crate) path: Path<T>,
    pub(crate) conic: [T; 3],
    pub(crate) opacity: T,
    pub(crate) radiance: [T; 3],
    pub(crate) depth: T,
    pub(crate) depth_slope: [T; 2],
}

/// `∂L/∂` of the tangents of `world_from_camera` at mid-exposure and at both ends.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PoseCotangents<T> {
    pub(crate) middle: Tangent<T>,
    pub(crate) ends: [Tangent<T>; 2],
}

/// Camera, map and settings shared by all Gaussians of one picture.
pub(crate) struct Projector<T> {
    shape: Shape,
    activation: ColourActivation,
    camera: Camera<T>,
    /// `W`.
    pub(crate) camera_from_world: Mat3<T>,
    /// The camera's centre in the world.
    pub(crate) origin: Vec3<T>,
    ends: Ends<T>,
    range: JacobianRange<T>,
    near: T,
    far: T,
    screen_variance: T,
    alpha_min: T,
}

/// Quantities between the parameters and the footprint that both directions use.
struct Stages<T> {
    /// Mean in the camera frame.
    p: Vec3<T>,
    /// Rows of `J`.
    jacobian: [Vec3<T>; 2],
    /// `V = W Σ Wᵀ`, the covariance in the camera frame.
    covariance: Mat3<T>,
    /// The Gaussian's axes in the world (columns).
    axes: Mat3<T>,
    /// Standard deviations along the axes.
    scale: Vec3<T>,
}

impl<T: Real> Projector<T> {
    pub(crate) fn new(
        map: &GaussianMap<T>,
        view: &View<T>,
        motion: &ShutterMotion<T>,
        settings: &RasterSettings,
    ) -> Self {
        let of = |value: f32| T::of(f64::from(value));
        let ends = motion.ends(view.world_from_camera);
        Self {
            ends: Ends::new(view.camera, ends, of(settings.near)),
            shape: map.shape,
            activation: map.activation,
            camera: view.camera,
            camera_from_world: view.world_from_camera.rotation.inverse().matrix(),
            origin: view.world_from_camera.translation,
            range: JacobianRange::of(&view.camera),
            near: of(settings.near),
            far: of(settings.far),
            screen_variance: of(settings.screen_variance),
            alpha_min: of(settings.alpha_min),
        }
    }

    /// The footprint of a Gaussian in the depth range that can be seen and is finite.
    pub(crate) fn project(&self, index: usize, gaussian: &Gaussian<T>) -> Option<Footprint<T>> {
        let stages = self.stages(gaussian)?;
        let opacity = (T::one() + (-gaussian.opacity_logit).exp()).recip();
        if !(opacity > T::zero() && opacity >= self.alpha_min) {
            return None;
        }
        let (u, v) = self.camera.project(stages.p);
        let conic = inverse(self.screen_covariance(&stages))?;
        let footprint = Footprint {
            index,
            centre: [u, v],
            path: self.ends.path(Vec3::from_array(gaussian.mean), [u, v])?,
            conic,
            opacity,
            radiance: self.activation.radiance(gaussian.colour),
            depth: stages.p.z,
            depth_slope: self.depth_slope(&stages, conic),
        };
        let finite = [footprint.centre.as_slice(), &footprint.conic, &footprint.radiance];
        finite.iter().all(|v| v.iter().all(|x| x.is_finite())).then_some(footprint)
    }

    fn stages(&self, gaussian: &Gaussian<T>) -> Option<Stages<T>> {
        let p = self.camera_from_world * (Vec3::from_array(gaussian.mean) - self.origin);
        if !(p.z >= self.near && p.z <= self.far) {
            return None;
        }
        let (axes, log_scale) = match self.shape {
            Shape::Isotropic => (Mat3::identity(), [gaussian.log_scale[0]; 3]),
            Shape::Anisotropic => {
                let [w, x, y, z] = gaussian.rotation;
                (Rotation::from_wxyz(w, x, y, z)?.matrix(), gaussian.log_scale)
            }
        };
        let scale = Vec3::from_array(log_scale.map(T::exp));
        let used = [gaussian.opacity_logit].into_iter().chain(log_scale).chain(gaussian.colour);
        let finite = used.into_iter().all(|v| v.is_finite());
        let axes_in_camera = self.camera_from_world * axes * Mat3::diagonal(scale);
        let covariance = axes_in_camera * axes_in_camera.transpose();
        finite.then(|| Stages { p, jacobian: self.jacobian(p), covariance, axes, scale })
    }

    /// `x/z`, `y/z` clamped to the range of the Jacobian, and whether each was inside.
    fn clamped(&self, p: Vec3<T>) -> [(T, bool); 2] {
        let one = |ratio: T, axis: usize| {
            let (low, high) = (self.range.low[axis], self.range.high[axis]);
            (ratio.max(low).min(high), ratio > low && ratio < high)
        };
        [one(p.x / p.z, 0), one(p.y / p.z, 1)]
    }

    /// `J = [[fx/z, 0, -fx x/z²], [0, fy/z, -fy y/z²]]`.
    fn jacobian(&self, p: Vec3<T>) -> [Vec3<T>; 2] {
        let [(a, _), (b, _)] = self.clamped(p);
        let (fx, fy) = (self.camera.fx / p.z, self.camera.fy / p.z);
        [Vec3::new(fx, T::zero(), -fx * a), Vec3::new(T::zero(), fy, -fy * b)]
    }

    /// `Σ₂ = J V Jᵀ + screen_variance I` as `[xx, xy, yy]`.
    fn screen_covariance(&self, stages: &Stages<T>) -> [T; 3] {
        let [x, y] = stages.jacobian;
        let v = stages.covariance;
        let s = self.screen_variance;
        [x.dot(v * x) + s, x.dot(v * y), y.dot(v * y) + s]
    }

    /// `c = J V e_z`, the covariance of pixel and depth; zero for balls.
    fn depth_covariance(&self, stages: &Stages<T>) -> [T; 2] {
        let across = stages.covariance * Vec3::new(T::zero(), T::zero(), T::one());
        match self.shape {
            Shape::Isotropic => [T::zero(); 2],
            Shape::Anisotropic => stages.jacobian.map(|row| row.dot(across)),
        }
    }

    /// `h = Σ₂⁻¹ c`.
    fn depth_slope(&self, stages: &Stages<T>, [a, b, c]: [T; 3]) -> [T; 2] {
        let [x, y] = self.depth_covariance(stages);
        [a * x + b * y, b * x + c * y]
    }

    /// `∂L/∂` of the parameters and of the poses, after [`project`](Self::project).
    pub(crate) fn pull_back(
        &self,
        gaussian: &Gaussian<T>,
        footprint: &Footprint<T>,
        cotangent: &FootprintCotangent<T>,
    ) -> Option<(Gaussian<T>, PoseCotangents<T>)> {
        let stages = self.stages(gaussian)?;
        let [jx, jy] = stages.jacobian;
        let v = stages.covariance;
        let (two, half) = (T::of(2.0), T::of(0.5));
        // h = K c: dL/dK = dL/dh cᵀ, dL/dc = K dL/dh.
        let ([cx, cy], [hx, hy]) = (self.depth_covariance(&stages), cotangent.depth_slope);
        let [a, b, c] = footprint.conic;
        let d_conic = [
            cotangent.conic[0] + hx * cx,
            cotangent.conic[1] + hx * cy + hy * cx,
            cotangent.conic[2] + hy * cy,
        ];
        let screen = inverse_cotangent(footprint.conic, d_conic);
        let across = match self.shape {
            Shape::Isotropic => [T::zero(); 2],
            Shape::Anisotropic => [a * hx + b * hy, b * hx + c * hy],
        };
        // Σ₂ = J V Jᵀ: dL/dJ = 2 G J V and dL/dV = Jᵀ G J; c = J V e: dL/dJ = dL/dc (V e)ᵀ.
        let e = Vec3::new(T::zero(), T::zero(), T::one());
        let d_jacobian = [
            (v * (jx * screen[0] + jy * screen[1])) * two + (v * e) * across[0],
            (v * (jx * screen[1] + jy * screen[2])) * two + (v * e) * across[1],
        ];
        let through = jx * across[0] + jy * across[1];
        let d_covariance = Mat3::outer(jx, jx).scaled(screen[0])
            + (Mat3::outer(jx, jy) + Mat3::outer(jy, jx)).scaled(screen[1])
            + Mat3::outer(jy, jy).scaled(screen[2])
            + (Mat3::outer(through, e) + Mat3::outer(e, through)).scaled(half);
        let d_p = self.mean_cotangent(stages.p, d_jacobian, cotangent);
        let mean = Vec3::from_array(gaussian.mean);
        let (through_path, ends) = self.ends.pull_back(mean, &cotangent.path);
        let parameters = self.parameter_cotangents(gaussian, &stages, &d_covariance);
        let o = footprint.opacity;
        let gradient = Gaussian {
            mean: (self.camera_from_world.transpose() * d_p + through_path).to_array(),
            opacity_logit: cotangent.opacity * o * (T::one() - o),
            colour: match self.activation {
                ColourActivation::Linear => cotangent.radiance,
                ColourActivation::Exponential => {
                    std::array::from_fn(|c| cotangent.radiance[c] * footprint.radiance[c])
                }
            },
            ..parameters
        };
        let middle = pose_cotangent(&stages, d_p, &d_covariance);
        Some((gradient, PoseCotangents { middle, ends }))
    }

    /// `∂L/∂p` through the centre, the Jacobian and the depth.
    fn mean_cotangent(
        &self,
        p: Vec3<T>,
        d_jacobian: [Vec3<T>; 2],
        cotangent: &FootprintCotangent<T>,
    ) -> Vec3<T> {
        let focal = [self.camera.fx, self.camera.fy];
        let (position, clamped) = ([p.x, p.y], self.clamped(p));
        let (mut lateral, mut d_z) = ([T::zero(); 2], cotangent.depth);
        // The curvature is `2 (c₊ + c₋ - 2 c₀)`.
        let through_path = cotangent.path.curvature.map(|d| T::of(-4.0) * d);
        for axis in 0..2 {
            let d_centre = cotangent.centre[axis] + through_path[axis];
            let f = focal[axis] / p.z;
            let (ratio, inside) = clamped[axis];
            let d = d_jacobian[axis];
            let d_first = [d.x, d.y][axis];
            // centre = f x / z
            lateral[axis] = d_centre * f;
            d_z -= d_centre * f * position[axis] / p.z;
            // J's rows (f/z, -f/z clamp(x/z))
            d_z += (d.z * ratio - d_first) * f / p.z;
            if inside {
                lateral[axis] -= d.z * f / p.z;
                d_z += d.z * f * position[axis] / (p.z * p.z);
            }
        }
        Vec3::new(lateral[0], lateral[1], d_z)
    }

    /// `∂L/∂` of scales and rotation from `∂L/∂V`; the other entries are zero.
    fn parameter_cotangents(
        &self,
        gaussian: &Gaussian<T>,
        stages: &Stages<T>,
        d_covariance: &Mat3<T>,
    ) -> Gaussian<T> {
        let w = self.camera_from_world;
        let scale = Mat3::diagonal(stages.scale);
        // Σ = M Mᵀ with M = R S: dL/dM = 2 G M.
        let d_sigma = w.transpose() * *d_covariance * w;
        let d_m = (d_sigma * stages.axes * scale).scaled(T::of(2.0));
        let by_axis: [T; 3] = std::array::from_fn(|axis| {
            (0..3).map(|r| d_m[(r, axis)] * stages.axes[(r, axis)] * scale[(axis, axis)]).sum()
        });
        let zero = T::zero();
        let (log_scale, rotation) = match self.shape {
            Shape::Isotropic => ([by_axis.into_iter().sum(), zero, zero], [zero; 4]),
            Shape::Anisotropic => {
                (by_axis, quaternion_cotangent(gaussian.rotation, &(d_m * scale)))
            }
        };
        Gaussian { mean: [zero; 3], log_scale, rotation, opacity_logit: zero, colour: [zero; 3] }
    }
}

/// `∂L/∂(ρ, φ)`: to first order `p ← p - ρ - φ × p` and `V ← V - [φ]× V + V [φ]×`.
fn pose_cotangent<T: Real>(stages: &Stages<T>, d_p: Vec3<T>, d_covariance: &Mat3<T>) -> Tangent<T> {
    // <G, V [φ] - [φ] V> = tr((G V - V G) [φ]) = 2 φ · (K_yz, K_zx, K_xy), K = G V - V G.
    let k =
        *d_covariance * stages.covariance + (stages.covariance * *d_covariance).scaled(-T::one());
    let turn = Vec3::new(k[(1, 2)], k[(2, 0)], k[(0, 1)]) * T::of(2.0);
    Tangent { translation: -d_p, rotation: turn - stages.p.cross(d_p) }
}

/// The inverse of the symmetric matrix `[[a, b], [b, c]]`, if it is positive definite.
pub(super) fn inverse<T: Real>([a, b, c]: [T; 3]) -> Option<[T; 3]> {
    let determinant = a * c - b * b;
    (determinant > T::zero()).then(|| [c / determinant, -b / determinant, a / determinant])
}

/// `∂L/∂Σ` as a symmetric matrix `[xx, xy, yy]` from `∂L/∂[A, B, C]` of `K = Σ⁻¹`:
/// `-K G K` with `G = [[dA, dB/2], [dB/2, dC]]`.
pub(super) fn inverse_cotangent<T: Real>([a, b, c]: [T; 3], [da, db, dc]: [T; 3]) -> [T; 3] {
    let db = db * T::of(0.5);
    let (p, q) = (a * da + b * db, a * db + b * dc);
    let (r, s) = (b * da + c * db, b * db + c * dc);
    [-(p * a + q * b), -(p * b + q * c), -(r * b + s * c)]
}

/// `∂L/∂q` of the rotation matrix of `q / |q|`, from `∂L/∂R`.
pub(super) fn quaternion_cotangent<T: Real>(q: [T; 4], d: &Mat3<T>) -> [T; 4] {
    let norm = q.iter().map(|v| *v * *v).sum::<T>().sqrt();
    let [w, x, y, z] = q.map(|v| v / norm);
    let (two, m) = (T::of(2.0), &d.rows);
    let unit = [
        two * (x * (m[2][1] - m[1][2]) + y * (m[0][2] - m[2][0]) + z * (m[1][0] - m[0][1])),
        two * (y * (m[0][1] + m[1][0]) + z * (m[0][2] + m[2][0]) + w * (m[2][1] - m[1][2])
            - two * x * (m[1][1] + m[2][2])),
        two * (x * (m[0][1] + m[1][0]) + z * (m[1][2] + m[2][1]) + w * (m[0][2] - m[2][0])
            - two * y * (m[0][0] + m[2][2])),
        two * (x * (m[0][2] + m[2][0]) + y * (m[1][2] + m[2][1]) + w * (m[1][0] - m[0][1])
            - two * z * (m[0][0] + m[1][1])),
    ];
    let along = unit[0] * w + unit[1] * x + unit[2] * y + unit[3] * z;
    std::array::from_fn(|i| (unit[i] - [w, x, y, z][i] * along) / norm)
}
