//! Residuals of a frame against the re-projected model, and their normal equations.
//!
//! A pixel `p` of the frame with depth `d` is a point `X` in the camera. At the moment `u` of the
//! exposure it lies at `Y_u = model_from_world T(u) X` in the model's camera, where the model has
//! radiance `M(q_u)` and depth `D(q_u)`, `q_u = π(Y_u)`. The frame says:
//!
//! ```text
//! r_c = CRF(gain_c · Σ_u w_u M_c(q_u)) - Ĉ_c(p)          blurred model against picture
//! r_d = D(q_d) - Y_d.z                                    at the moment d of the depth picture
//! ```
//!
//! With `s = u - ½` and velocity `(ν, ω)`, the point lies at `P_u = Exp(s ω) X + s ν` in the camera
//! at mid-exposure. A tangent `(ρ, φ)` of the centre moves it by `ρ + φ × P_u`, a change of the
//! velocity by `s (δν + δω × (P_u - s ν))`, where `J_l(s ω)` is taken as one, so with the row
//! `b = ∇M · ∂π/∂Y · R_model_from_centre` the derivatives are `(b, P × b)` and
//! `s (b, (P - s ν) × b)`.

use super::pyramid::{Model, Observed, surface};
use crate::tracking::adam::State;
use i2slam_compute::{NormalEquations, reduce_in_order};
use i2slam_formation::{Quadrature, ResponseCurve, ShutterPoses, VirtualCamera};
use i2slam_geometry::{Camera, Mat3, Pose, Vec3};

/// Unknowns: centre (ρ, φ), velocity (ρ, φ), log exposure, log white balance (r, g, b).
pub(super) const UNKNOWNS: usize = 16;
/// Normal equations of one frame.
pub(super) type Equations = NormalEquations<UNKNOWNS>;

/// Degrees of freedom of the t-distribution that residuals are taken to follow (Kerl 2013).
const FREEDOM: f32 = 5.0;
/// Share of the relief of model and frame by which depth is taken to be uncertain: beside edges an
/// interpolated depth is on no surface, and always errs to the same side.
const RELIEF: f32 = 0.5;
/// Depth residuals beyond this share of the depth belong to another surface.
const GATE: f32 = 0.08;
/// Rows of a parallel task.
const ROWS: usize = 8;

/// Robust scales of the two kinds of residual.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scales {
    /// Of depth, at 1 m; grows with the square of depth [m].
    pub(super) depth: f32,
    /// Of pictures [display units].
    pub(super) image: f32,
}

/// Everything that stays the same over the pixels of one evaluation.
pub(super) struct Linearization<'a> {
    pub(super) model: &'a Model,
    pub(super) observed: &'a Observed,
    /// Camera-from-world of the model's render.
    pub(super) model_from_world: Pose<f64>,
    pub(super) state: &'a State,
    pub(super) curve: Option<&'a ResponseCurve<f32>>,
    pub(super) cameras: usize,
    pub(super) quadrature: Quadrature,
    /// Where the camera was when the depth picture was taken.
    pub(super) world_from_depth: Pose<f64>,
    /// Share of the motion between frames by which that moves more than the centre.
    pub(super) depth_lead: f64,
    pub(super) scales: Scales,
    /// Weight of image residuals against depth residuals.
    pub(super) image_weight: f32,
    /// Pixels between two samples.
    pub(super) stride: usize,
}

/// Normal equations and what is needed to weigh the next ones.
#[derive(Clone, Debug, Default)]
pub(super) struct Sums {
    pub(super) equations: Equations,
    pub(super) depth_error: f64,
    pub(super) depth_count: usize,
    pub(super) image_error: f64,
    pub(super) image_count: usize,
    /// Pixels with depth, seen by the model or not.
    pub(super) candidates: usize,
    /// Those that lie on the model's surface.
    pub(super) agreeing: usize,
}

impl Sums {
    pub(super) fn merge(&mut self, other: &Self) {
        self.equations.merge(&other.equations);
        self.depth_error += other.depth_error;
        self.depth_count += other.depth_count;
        self.image_error += other.image_error;
        self.image_count += other.image_count;
        self.candidates += other.candidates;
        self.agreeing += other.agreeing;
    }

    /// Mean negative log-likelihood of the residuals: what a step has to lower.
    pub(super) fn mean_cost(&self) -> f64 {
        self.equations.cost / (self.equations.count.max(1) as f64)
    }

    /// Share of the frame's depth pixels that agree with the model's surface.
    pub(super) fn overlap(&self) -> f64 {
        self.agreeing as f64 / self.candidates.max(1) as f64
    }
}

/// A moment of the exposure as a map from the frame's camera then to that at mid-exposure.
struct Moment {
    centre_from_camera: Transform,
    weight: f32,
    offset: f32,
}

/// A rigid transform as a matrix, for many points.
struct Transform {
    rotation: Mat3<f32>,
    translation: Vec3<f32>,
}

impl Transform {
    fn new(pose: Pose<f64>) -> Self {
        let rows = pose.rotation.matrix().rows.map(|r| r.map(|v| v as f32));
        Self { rotation: Mat3 { rows }, translation: pose.translation.cast() }
    }

    fn apply(&self, point: Vec3<f32>) -> Vec3<f32> {
        self.rotation * point + self.translation
    }
}

/// Where the exposure's moments lie, for one evaluation.
struct Geometry {
    model_from_centre: Transform,
    moments: Vec<Moment>,
    centre_from_depth: Transform,
}

impl Linearization<'_> {
    /// Residuals and derivatives summed over the frame.
    pub(super) fn accumulate(&self) -> Sums {
        let shutter: ShutterPoses<f64> = self.state.motion.into();
        let cameras = shutter.virtual_cameras(self.cameras, self.quadrature);
        let world_from_centre = self.state.motion.centre;
        let centre_from_world = world_from_centre.inverse();
        let moment = |camera: &VirtualCamera<f64>| Moment {
            centre_from_camera: Transform::new(centre_from_world * camera.world_from_camera),
            weight: camera.weight as f32,
            offset: (camera.u - 0.5) as f32,
        };
        let geometry = Geometry {
            model_from_centre: Transform::new(self.model_from_world * world_from_centre),
            moments: cameras.iter().map(moment).collect(),
            centre_from_depth: Transform::new(centre_from_world * self.world_from_depth),
        };
        let mut total = Sums::default();
        reduce_in_order(
            self.observed.depth.height,
            ROWS,
            |rows| self.accumulate_rows(rows, &geometry),
            |part| total.merge(&part),
        );
        total
    }

    fn accumulate_rows(&self, rows: std::ops::Range<usize>, geometry: &Geometry) -> Sums {
        let mut sums = Sums::default();
        let (camera, depth) = (&self.observed.camera, &self.observed.depth);
        for row in rows.filter(|row| row % self.stride == 0) {
            for column in (0..depth.width).step_by(self.stride) {
                let z = depth.at(0, column, row);
                if z <= 0.0 {
                    continue;
                }
                sums.candidates += 1;
                let (u, v) = Camera::<f32>::pixel_centre(column, row);
                let point = geometry.centre_from_depth.apply(camera.unproject(u, v, z));
                let reading = (z, self.observed.relief.at(0, column, row));
                if self.add_depth(point, reading, geometry, &mut sums) && self.image_weight > 0.0 {
                    self.add_colour(point, geometry, &mut sums);
                }
            }
        }
        sums
    }

    /// Adds the depth residual of a point read at depth `z` beside `relief`, given in the camera
    /// at mid-exposure; whether the model has this pixel's surface.
    fn add_depth(
        &self,
        point: Vec3<f32>,
        (z, relief): (f32, f32),
        geometry: &Geometry,
        sums: &mut Sums,
    ) -> bool {
        let place = geometry.model_from_centre.apply(point);
        if place.z <= 0.05 {
            return false;
        }
        let (u, v) = self.observed.camera.project(place);
        let Some(tap) = self.model.depth.tap(u, v) else { return false };
        let Some((d, d_u, d_v)) = surface(tap, &self.model.depth.data) else { return false };
        let residual = d - place.z;
        if residual.abs() > GATE * place.z {
            return false;
        }
        let mut by_place = self.by_place(place, d_u, d_v);
        by_place.z -= 1.0;
        let row = geometry.model_from_centre.rotation.transpose() * by_place;
        // By the observed depth, not by `place`: a scale that moved with the pose would be
        // lowered by moving away.
        let spread = z * z.max(1.0);
        let rough = tap.values(&self.model.relief.data).into_iter().fold(relief, f32::max);
        let scale = (self.scales.depth * spread).hypot(RELIEF * rough);
        // A residual along the optical axis counts by its distance to the surface.
        let normal = by_place.norm().max(1.0);
        let (weight, cost) = robust(residual / normal, scale);
        // The depth's pose leads the centre by a share of the motion, which the centre ends.
        let row = row * (1.0 + self.depth_lead as f32);
        let rest = Vec3::zero();
        let jacobian = jacobian([row, point.cross(row), rest, rest], [0.0; 4]);
        sums.equations.add(&jacobian, f64::from(residual), f64::from(weight / (normal * normal)));
        sums.equations.cost += cost - f64::from(weight * residual * residual / (normal * normal));
        sums.depth_error += f64::from(residual.abs() / normal / spread);
        sums.depth_count += 1;
        sums.agreeing += 1;
        true
    }

    /// Adds the three colour residuals of the blurred model, at the pixel position of `point` (in
    /// the camera at mid-exposure).
    fn add_colour(&self, point: Vec3<f32>, geometry: &Geometry, sums: &mut Sums) {
        if point.z <= 0.05 {
            return;
        }
        let (u, v) = self.observed.camera.project(point);
        let Some(pixel) = self.observed.colour.tap(u, v) else { return };
        let mut radiance = [0.0_f32; 3];
        // Per channel: by ρ and φ of the centre, by ν and ω of the velocity.
        let mut by_motion = [[Vec3::<f32>::zero(); 4]; 3];
        let turn_back = geometry.model_from_centre.rotation.transpose();
        for moment in &geometry.moments {
            let seen = moment.centre_from_camera.apply(point);
            let place = geometry.model_from_centre.apply(seen);
            let (u, v) = self.observed.camera.project(place);
            let Some(tap) = self.model.radiance.tap(u, v) else { return };
            for channel in 0..3 {
                let (m, m_u, m_v) = tap.sample(self.model.radiance.plane(channel));
                let by_place = self.by_place(place, m_u, m_v);
                let row = turn_back * by_place * moment.weight;
                let spin = (seen - moment.centre_from_camera.translation).cross(row);
                radiance[channel] += moment.weight * m;
                let rows = [row, seen.cross(row), row * moment.offset, spin * moment.offset];
                by_motion[channel].iter_mut().zip(rows).for_each(|(sum, row)| *sum += row);
            }
        }
        let gains = self.state.tone.gains();
        for channel in 0..3 {
            let (value, slope, by_log_gain) = match self.curve {
                Some(curve) => {
                    let x = gains[channel] * radiance[channel];
                    let slope = curve.slope(channel, x);
                    (curve.evaluate(channel, x), slope * gains[channel], slope * x)
                }
                None => (radiance[channel], 1.0, 0.0),
            };
            let residual = value - pixel.sample(self.observed.colour.plane(channel)).0;
            let mut by_tone = [0.0; 4];
            by_tone[0] = by_log_gain;
            by_tone[1 + channel] = by_log_gain;
            let jacobian = jacobian(by_motion[channel].map(|row| row * slope), by_tone);
            let (weight, cost) = robust(residual, self.scales.image);
            let share = f64::from(self.image_weight);
            sums.equations.add(&jacobian, f64::from(residual), share * f64::from(weight));
            sums.equations.cost += share * (cost - f64::from(weight * residual * residual));
            sums.image_error += f64::from(residual.abs());
            sums.image_count += 1;
        }
    }

    /// From an image gradient to a gradient by the point in the model's camera.
    fn by_place(&self, place: Vec3<f32>, by_u: f32, by_v: f32) -> Vec3<f32> {
        let camera = &self.observed.camera;
        let inverse = 1.0 / place.z;
        let (gx, gy) = (by_u * camera.fx * inverse, by_v * camera.fy * inverse);
        Vec3::new(gx, gy, -(gx * place.x + gy * place.y) * inverse)
    }
}

/// Weight of a residual under a t-distribution, and its cost `(ν + 1) ln(1 + r²/ν)`.
fn robust(residual: f32, scale: f32) -> (f32, f64) {
    let normalised = residual / scale;
    let square = normalised * normalised;
    let weight = (FREEDOM + 1.0) / (FREEDOM + square) / (scale * scale);
    (weight, f64::from((FREEDOM + 1.0) * (square / FREEDOM).ln_1p()))
}

/// By ρ and φ of the centre, ν and ω of the velocity, and the tone.
fn jacobian(by_motion: [Vec3<f32>; 4], by_tone: [f32; 4]) -> [f64; UNKNOWNS] {
    let mut all = [0.0; UNKNOWNS];
    let by_motion = by_motion.map(Vec3::to_array);
    for (i, value) in by_motion.iter().flatten().chain(&by_tone).enumerate() {
        all[i] = f64::from(*value);
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::{central_differences, relative_error};
    use i2slam_formation::{
        CameraResponse, CentreVelocity, FrameTone, NodeSpacing, StartCurve, TrajectoryScale,
    };
    use i2slam_geometry::{Image, Rotation, Tangent};

    const SIZE: (usize, usize) = (48, 36);

    fn picture(channels: usize, value: impl Fn(usize, f32, f32) -> f32) -> Image<f32> {
        let mut image = Image::new(SIZE.0, SIZE.1, channels);
        for channel in 0..channels {
            for row in 0..SIZE.1 {
                for column in 0..SIZE.0 {
                    let i = (channel * SIZE.1 + row) * SIZE.0 + column;
                    image.data[i] = value(channel, column as f32, row as f32);
                }
            }
        }
        image
    }

    fn model() -> Model {
        Model::new(
            picture(3, |c, u, v| {
                0.3 + 0.1 * (0.35 * u + c as f32).sin() + 0.1 * (0.3 * v - 0.1 * u).cos()
            }),
            picture(1, |_, u, v| 2.0 + 0.01 * u - 0.006 * v),
        )
    }

    /// Depth away from the border, so that every residual stays while the camera moves.
    fn observed() -> Observed {
        let inside = |u: f32, v: f32| (8.0..40.0).contains(&u) && (8.0..28.0).contains(&v);
        Observed::new(
            Camera { width: 48, height: 36, fx: 45.0, fy: 45.0, cx: 24.0, cy: 18.0 },
            picture(3, |c, u, v| 0.55 + 0.12 * (0.33 * u + c as f32).sin() + 0.1 * (0.3 * v).cos()),
            picture(1, |_, u, v| if inside(u, v) { 2.02 + 0.009 * u - 0.005 * v } else { 0.0 }),
        )
    }

    fn state(x: &[f64]) -> State {
        let start = CentreVelocity {
            // Between pixel centres: at one, a bilinear picture has a kink.
            centre: Pose::new(Rotation::identity(), Vec3::new(0.013, 0.017, 0.0)),
            velocity: Tangent::from_array([0.05, -0.02, 0.01, 0.01, 0.02, 0.015]),
        };
        let part = |from: usize| Tangent::from_array(std::array::from_fn(|i| x[from + i]));
        State {
            motion: start.retract(part(0), part(6)),
            tone: FrameTone {
                log_exposure: x[12] as f32,
                log_white_balance: [x[13] as f32, x[14] as f32, x[15] as f32],
            },
            response: None,
            scale: TrajectoryScale { a: 1.0 },
        }
    }

    fn sums(x: &[f64], curve: Option<&ResponseCurve<f32>>, image_weight: f32) -> Sums {
        let (model, observed, state) = (model(), observed(), state(x));
        Linearization {
            model: &model,
            observed: &observed,
            model_from_world: Pose::identity(),
            state: &state,
            curve,
            cameras: 3,
            quadrature: Quadrature::Midpoints,
            world_from_depth: state.motion.centre,
            depth_lead: 0.0,
            scales: Scales { depth: 0.02, image: 0.1 },
            image_weight,
            stride: 1,
        }
        .accumulate()
    }

    /// `2 Σ w r j` is the derivative of the cost, up to kinks of the bilinear pictures and the
    /// neglected `J_l(s ω)`.
    #[test]
    fn gradient_agrees_with_differences_of_the_cost() {
        let curve =
            CameraResponse::<f32>::new(3, StartCurve::Srgb, NodeSpacing::Power(2.2)).curve();
        let x = [0.0; UNKNOWNS];
        for (curve, image_weight) in [(None, 0.0), (None, 1.0), (Some(&curve), 1.0)] {
            let at_x = sums(&x, curve, image_weight);
            assert!(at_x.depth_count > 500);
            let numeric =
                central_differences(&x, 2e-4, |x| sums(x, curve, image_weight).equations.cost);
            let analytic: Vec<f64> = at_x.equations.gradient.iter().map(|g| 2.0 * g).collect();
            for group in [0..3, 3..6, 6..9, 9..12, 12..16] {
                let error = relative_error(&analytic[group.clone()], &numeric[group.clone()]);
                assert!(error < 0.03, "{group:?} {error} {analytic:?} {numeric:?}");
            }
        }
    }

    #[test]
    fn the_step_finds_a_small_motion() {
        let still = sums(&[0.0; UNKNOWNS], None, 0.0).mean_cost();
        let mut x = [0.0; UNKNOWNS];
        for _ in 0..8 {
            let mut equations = sums(&x, None, 0.0).equations;
            super::super::prior::freeze(&mut equations, 3..16);
            let step = equations.step(1e-6).expect("depth of a slanted plane fixes one direction");
            x.iter_mut().zip(step).for_each(|(x, s)| *x += s);
        }
        assert!(sums(&x, None, 0.0).mean_cost() < 0.5 * still);
    }
}
