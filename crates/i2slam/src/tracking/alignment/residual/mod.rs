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
//!
//! With a rolling shutter a row at `v` sees every moment later by `readout (v/H - ½)`, so that `s`
//! is a time of its own for every sample, and the readout is an unknown with the derivative `(v/H -
//! ½) b · (ν + ω × (P - s ν))`. Depth is taken at one moment.

mod block;
mod colour;
mod depth;
mod normal_equations;
mod points;
#[cfg(test)]
mod reference;
mod row_timing;
mod samples;
#[cfg(test)]
mod tests;

pub(super) use samples::{Samples, Surface, Texels};

use super::pyramid::{Model, Observed};
use crate::tracking::first_order::State;
use colour::ColourBlock;
use depth::DepthBlock;
use i2slam_compute::simd::Lanes;
use i2slam_compute::{NormalEquations, reduce_in_order};
use i2slam_formation::{Quadrature, ResponseCurve, ShutterPoses, VirtualCamera};
use i2slam_geometry::{Camera, Mat3, Pose, Vec3};
use points::Points;
use pulp::{Arch, Simd, WithSimd};
use row_timing::Rolling;
use std::ops::Range;

/// Unknowns: centre (ρ, φ), velocity (ρ, φ), log exposure, log white balance (r, g, b), readout.
pub(super) const UNKNOWNS: usize = 17;
/// Normal equations of one frame.
pub(super) type Equations = NormalEquations<UNKNOWNS>;

/// Degrees of freedom of the t-distribution that residuals are taken to follow (Kerl 2013).
pub(super) const FREEDOM: f32 = 5.0;
/// Share of the relief of model and frame by which depth is taken to be uncertain: beside edges an
/// interpolated depth is on no surface, and always errs to the same side.
const RELIEF: f32 = 0.5;
/// Depth residuals beyond this share of the depth belong to another surface.
const GATE: f32 = 0.08;
/// Points that are not at least as far [m] are not seen.
const NEAR: f32 = 0.05;
/// The exposure among the unknowns, and the first of the white balance.
const EXPOSURE: usize = 12;
const BALANCE: usize = 13;
/// The readout among the unknowns.
pub(super) const READOUT: usize = 16;
/// Blocks of a parallel task.
const BLOCKS: usize = 8;

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
    /// Height of the picture at this level [px], an odd last row included; `None` for a global
    /// shutter.
    pub(super) rolling_height: Option<f64>,
    pub(super) quadrature: Quadrature,
    /// Where the camera was when the depth picture was taken.
    pub(super) world_from_depth: Pose<f64>,
    /// Share of the motion between frames by which that moves more than the centre.
    pub(super) depth_lead: f64,
    pub(super) scales: Scales,
    /// Weight of image residuals against depth residuals.
    pub(super) image_weight: f32,
    /// Whether gradient and Hessian are wanted beside cost and errors.
    pub(super) derivatives: bool,
}

/// Sums of absolute residuals, whatever their weights.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Errors {
    /// By the distance at which a sensor is as noisy as at 1 m [m at 1 m].
    pub(super) depth: f64,
    pub(super) depth_count: usize,
    /// [display units]
    pub(super) image: f64,
    pub(super) image_count: usize,
}

/// Normal equations and what is needed to weigh the next ones.
#[derive(Clone, Debug, Default)]
pub(super) struct Sums {
    /// Without derivatives, only the cost and the number of residuals.
    pub(super) equations: Equations,
    pub(super) errors: Errors,
    /// Pixels with depth, seen by the model or not.
    pub(super) candidates: usize,
    /// Those that lie on the model's surface.
    pub(super) agreeing: usize,
}

impl Sums {
    pub(super) fn merge(&mut self, other: &Self) {
        self.equations.merge(&other.equations);
        self.errors.depth += other.errors.depth;
        self.errors.depth_count += other.errors.depth_count;
        self.errors.image += other.errors.image;
        self.errors.image_count += other.errors.image_count;
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

    #[cfg(test)]
    fn apply(&self, point: Vec3<f32>) -> Vec3<f32> {
        self.rotation * point + self.translation
    }
}

/// Where the exposure's moments lie, for one evaluation.
struct Geometry {
    model_from_centre: Transform,
    moments: Vec<Moment>,
    centre_from_depth: Transform,
    rolling: Option<Rolling>,
}

impl Geometry {
    fn new(task: &Linearization<'_>) -> Self {
        let shutter: ShutterPoses<f64> = task.state.motion.into();
        let cameras = shutter.virtual_cameras(task.cameras, task.quadrature);
        let world_from_centre = task.state.motion.centre;
        let centre_from_world = world_from_centre.inverse();
        let moment = |camera: &VirtualCamera<f64>| Moment {
            centre_from_camera: Transform::new(centre_from_world * camera.world_from_camera),
            weight: camera.weight as f32,
            offset: (camera.u - 0.5) as f32,
        };
        Self {
            model_from_centre: Transform::new(task.model_from_world * world_from_centre),
            moments: cameras.iter().map(moment).collect(),
            centre_from_depth: Transform::new(centre_from_world * task.world_from_depth),
            rolling: task
                .rolling_height
                .map(|height| Rolling::new(task.state.readout, height, task.state.motion.velocity)),
        }
    }

    /// Whether residuals depend on the velocity: a single moment of all rows does not.
    fn has_velocity(&self) -> bool {
        self.moments.len() > 1 || self.rolling.is_some()
    }

    /// From the model's camera to that at mid-exposure, for derivatives.
    #[inline(always)]
    fn turn_back<S: Simd>(&self, simd: S, by_place: Points<S>) -> Points<S> {
        let row = |k| self.model_from_centre.row(simd, k);
        let rest = row(1).mul_add(by_place.y, row(2).scaled(by_place.z));
        row(0).mul_add(by_place.x, rest)
    }
}

impl Linearization<'_> {
    /// Residuals and derivatives summed over the frame.
    pub(super) fn accumulate(&self) -> Sums {
        let geometry = Geometry::new(self);
        let arch = Arch::new();
        let samples = &self.observed.samples;
        let mut total = Sums { candidates: samples.count, ..Sums::default() };
        reduce_in_order(
            samples.blocks.len(),
            BLOCKS,
            |blocks| arch.dispatch(Blocks { task: self, geometry: &geometry, blocks }),
            |part| total.merge(&part),
        );
        add_exposure(&mut total.equations);
        total
    }
}

/// Some blocks of samples, on any instruction set.
struct Blocks<'a> {
    task: &'a Linearization<'a>,
    geometry: &'a Geometry,
    blocks: Range<usize>,
}

impl WithSimd for Blocks<'_> {
    type Output = Sums;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Sums {
        let Self { task, geometry, blocks } = self;
        let mut sums = Sums::default();
        let (mut depth, mut colour) = (DepthBlock::new(), ColourBlock::new());
        for samples in &task.observed.samples.blocks[blocks] {
            let agreeing = depth.add(simd, task, geometry, samples, &mut sums);
            if agreeing > 0 && task.image_weight > 0.0 {
                colour.add(simd, task, geometry, &depth, &mut sums);
            }
        }
        sums
    }
}

/// The exposure acts as the white balance of all three channels does, and no residual depends on
/// that of two.
fn add_exposure(equations: &mut Equations) {
    for c in BALANCE..READOUT {
        equations.hessian[EXPOSURE][READOUT] += equations.hessian[c][READOUT];
        for a in 0..EXPOSURE {
            equations.hessian[a][EXPOSURE] += equations.hessian[a][c];
        }
        equations.hessian[EXPOSURE][c] = equations.hessian[c][c];
        equations.hessian[EXPOSURE][EXPOSURE] += equations.hessian[c][c];
        equations.gradient[EXPOSURE] += equations.gradient[c];
    }
}

/// Image position of each lane's point.
#[inline(always)]
fn project<S: Simd>(simd: S, camera: &Camera<f32>, point: Points<S>) -> (Lanes<S>, Lanes<S>) {
    let number = |value| Lanes::splat(simd, value);
    let u = number(camera.fx) * point.x / point.z + number(camera.cx);
    let v = number(camera.fy) * point.y / point.z + number(camera.cy);
    (u, v)
}

/// A harmless point for lanes that do not count.
#[inline(always)]
fn on_axis<S: Simd>(simd: S) -> Points<S> {
    Points::splat(simd, Vec3::new(0.0, 0.0, 1.0))
}

/// From an image gradient to a gradient by the point in the model's camera.
#[inline(always)]
fn by_place<S: Simd>(
    simd: S,
    camera: &Camera<f32>,
    place: Points<S>,
    (by_u, by_v): (Lanes<S>, Lanes<S>),
) -> Points<S> {
    let inverse = place.z.recip();
    let x = by_u * Lanes::splat(simd, camera.fx) * inverse;
    let y = by_v * Lanes::splat(simd, camera.fy) * inverse;
    let z = (Lanes::zero(simd) - x.mul_add(place.x, y * place.y)) * inverse;
    Points { x, y, z }
}

/// Cost `(ν + 1) ln(1 + r²/ν)` of a residual under a t-distribution, by the square `r²` of the
/// normalised residual.
#[inline(always)]
fn cost<S: Simd>(simd: S, square: Lanes<S>) -> Lanes<S> {
    let number = |value| Lanes::splat(simd, value);
    number(FREEDOM + 1.0) * square.mul_add(number(1.0 / FREEDOM), number(1.0)).ln()
}
