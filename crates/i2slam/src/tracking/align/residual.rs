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
//! A tangent `(ρ, φ)` of `T(u)` moves `X` to `X + φ × X + ρ`, so with the row
//! `a = ∇M · ∂π/∂Y · R` the derivative is `(a, X × a)`. Centre `δ_c` and velocity `δ_v` of the
//! exposure move `T(u)` by `δ_c + (u - ½) δ_v`; frames within one exposure are taken as parallel
//! in the derivative, not in the residual.

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
}

impl Sums {
    pub(super) fn merge(&mut self, other: &Self) {
        self.equations.merge(&other.equations);
        self.depth_error += other.depth_error;
        self.depth_count += other.depth_count;
        self.image_error += other.image_error;
        self.image_count += other.image_count;
        self.candidates += other.candidates;
    }

    /// Mean negative log-likelihood of the residuals: what a step has to lower.
    pub(super) fn mean_cost(&self) -> f64 {
        self.equations.cost / (self.equations.count.max(1) as f64)
    }

    /// Share of the frame's depth pixels that agree with the model's surface.
    pub(super) fn overlap(&self) -> f64 {
        self.depth_count as f64 / self.candidates.max(1) as f64
    }
}

/// A moment of the exposure as a map from the frame's camera to the model's.
struct Moment {
    rotation: Mat3<f32>,
    translation: Vec3<f32>,
    weight: f32,
    offset: f32,
}

impl Linearization<'_> {
    /// Residuals and derivatives summed over the frame.
    pub(super) fn accumulate(&self) -> Sums {
        let shutter: ShutterPoses<f64> = self.state.motion.into();
        let cameras = shutter.virtual_cameras(self.cameras, self.quadrature);
        let moments: Vec<Moment> = cameras.iter().map(|c| self.moment(c)).collect();
        let at_depth = self.moment(&VirtualCamera {
            u: 0.5,
            weight: 1.0,
            world_from_camera: self.world_from_depth,
        });
        let colour_from_depth = self.state.motion.centre.inverse() * self.world_from_depth;
        let colour_from_depth: Pose<f32> = colour_from_depth.cast();
        let mut total = Sums::default();
        reduce_in_order(
            self.observed.depth.height,
            ROWS,
            |rows| self.accumulate_rows(rows, &moments, &at_depth, colour_from_depth),
            |part| total.merge(&part),
        );
        total
    }

    fn moment(&self, camera: &VirtualCamera<f64>) -> Moment {
        let model_from_camera = self.model_from_world * camera.world_from_camera;
        let rotation = model_from_camera.rotation.matrix();
        Moment {
            rotation: Mat3 { rows: rotation.rows.map(|r| r.map(|v| v as f32)) },
            translation: model_from_camera.translation.cast(),
            weight: camera.weight as f32,
            offset: (camera.u - 0.5) as f32,
        }
    }

    fn accumulate_rows(
        &self,
        rows: std::ops::Range<usize>,
        moments: &[Moment],
        at_depth: &Moment,
        colour_from_depth: Pose<f32>,
    ) -> Sums {
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
                let point = camera.unproject(u, v, z);
                if self.add_depth(point, at_depth, &mut sums) && self.image_weight > 0.0 {
                    self.add_colour(colour_from_depth * point, moments, &mut sums);
                }
            }
        }
        sums
    }

    /// Adds the depth residual; whether the model has this pixel's surface.
    fn add_depth(&self, point: Vec3<f32>, moment: &Moment, sums: &mut Sums) -> bool {
        let place = moment.rotation * point + moment.translation;
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
        let row = moment.rotation.transpose() * by_place;
        let scale = self.scales.depth * place.z * place.z.max(1.0);
        // A residual along the optical axis counts by its distance to the surface.
        let normal = by_place.norm().max(1.0);
        let (weight, cost) = robust(residual / normal, scale);
        // The depth's pose leads the centre by a share of the motion, which the centre ends.
        let row = row * (1.0 + self.depth_lead as f32);
        let jacobian = jacobian(point, row, Vec3::zero(), [0.0; 4]);
        sums.equations.add(&jacobian, f64::from(residual), f64::from(weight / (normal * normal)));
        sums.equations.cost += cost - f64::from(weight * residual * residual / (normal * normal));
        sums.depth_error += f64::from(residual.abs() / normal / (place.z * place.z.max(1.0)));
        sums.depth_count += 1;
        true
    }

    /// Adds the three colour residuals of the blurred model, at the pixel position of `point` (in
    /// the camera at mid-exposure).
    fn add_colour(&self, point: Vec3<f32>, moments: &[Moment], sums: &mut Sums) {
        if point.z <= 0.05 {
            return;
        }
        let (u, v) = self.observed.camera.project(point);
        let Some(pixel) = self.observed.colour.tap(u, v) else { return };
        let mut radiance = [0.0_f32; 3];
        let mut centre = [Vec3::<f32>::zero(); 3];
        let mut velocity = [Vec3::<f32>::zero(); 3];
        for moment in moments {
            let place = moment.rotation * point + moment.translation;
            let (u, v) = self.observed.camera.project(place);
            let Some(tap) = self.model.radiance.tap(u, v) else { return };
            for channel in 0..3 {
                let (m, m_u, m_v) = tap.sample(self.model.radiance.plane(channel));
                let by_place = self.by_place(place, m_u, m_v);
                let row = moment.rotation.transpose() * by_place * moment.weight;
                radiance[channel] += moment.weight * m;
                centre[channel] += row;
                velocity[channel] += row * moment.offset;
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
            let jacobian =
                jacobian(point, centre[channel] * slope, velocity[channel] * slope, by_tone);
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

fn jacobian(
    point: Vec3<f32>,
    centre: Vec3<f32>,
    velocity: Vec3<f32>,
    tone: [f32; 4],
) -> [f64; UNKNOWNS] {
    let (turn, spin) = (point.cross(centre), point.cross(velocity));
    let parts = [centre, turn, velocity, spin].map(Vec3::to_array);
    let mut all = [0.0; UNKNOWNS];
    for (i, value) in parts.iter().flatten().chain(&tone).enumerate() {
        all[i] = f64::from(*value);
    }
    all
}
