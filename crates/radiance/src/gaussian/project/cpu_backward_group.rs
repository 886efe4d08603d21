//! The way back of one group of Gaussians.

use super::PathCotangents;
use super::cotangents::{covariance_cotangent, mean_cotangent, quaternion_cotangent};
use super::stages::{Axes, Frame, Parameters, Stages, put};
use super::{MotionFrame, Splat};
use crate::gaussian::rasterize::{MotionSlot, Slot};
use crate::gaussian::{ColourActivation, Gaussian, GaussianMap};
use i2slam_compute::simd::{Column, Lanes, combine, cross, dot, transform};
use pulp::Simd;
use std::f32::consts::LN_2;

/// A group on the way back.
#[derive(Default)]
pub(super) struct Group {
    parameters: Parameters,
    exponent: [Column; 3],
    radiance: [Column; 3],
    /// The sums of a [`Slot`].
    first: [Column; 2],
    second: [Column; 3],
    depth: Column,
    zeroth: Column,
    d_radiance: [Column; 3],
    pub(super) weight: Column,
    /// The sums of a [`MotionSlot`].
    velocity: [Column; 2],
    curvature: [Column; 2],
    /// `∂L/∂(ρ, φ)`.
    pub(super) pose: [Column; 6],
    /// The same of the poses at both ends of the exposure, when the camera moves.
    pub(super) ends: [[Column; 6]; 2],
    /// `∂L/∂` of the parameters.
    d_mean: [Column; 3],
    d_log_scale: [Column; 3],
    d_rotation: [Column; 4],
    d_opacity_logit: Column,
    d_colour: [Column; 3],
}

impl Group {
    #[inline(always)]
    pub(super) fn load(
        &mut self,
        place: usize,
        map: &GaussianMap,
        index: usize,
        splat: &Splat,
        sum: &Slot,
    ) {
        self.parameters.set(place, map, index);
        put(&mut self.exponent, place, &splat.exponent);
        put(&mut self.radiance, place, &splat.radiance);
        put(&mut self.first, place, &sum.first);
        put(&mut self.second, place, &sum.second);
        put(&mut self.d_radiance, place, &sum.radiance);
        self.depth[place] = sum.depth;
        self.zeroth[place] = sum.zeroth;
        self.weight[place] = sum.weight;
    }

    #[inline(always)]
    pub(super) fn load_motion(&mut self, place: usize, sum: &MotionSlot) {
        put(&mut self.velocity, place, &sum.velocity);
        put(&mut self.curvature, place, &sum.curvature);
    }

    /// The gradient of the Gaussian at `place`.
    #[inline(always)]
    pub(super) fn gradient(&self, place: usize) -> Gaussian<f32> {
        let [m, s, c] = [&self.d_mean, &self.d_log_scale, &self.d_colour];
        let q = &self.d_rotation;
        Gaussian {
            mean: [m[0][place], m[1][place], m[2][place]],
            log_scale: [s[0][place], s[1][place], s[2][place]],
            rotation: [q[0][place], q[1][place], q[2][place], q[3][place]],
            opacity_logit: self.d_opacity_logit[place],
            colour: [c[0][place], c[1][place], c[2][place]],
        }
    }

    #[inline(always)]
    pub(super) fn pull_back<S: Simd, const ANISOTROPIC: bool, const MAP: bool>(
        &mut self,
        simd: S,
        frame: &Frame,
        motion: Option<&MotionFrame>,
    ) {
        let stages = frame.stages::<S, ANISOTROPIC>(simd, &self.parameters);
        let [a, b, c] = Lanes::load_all(simd, &self.exponent);
        let conic = [a.scale(-2.0 * LN_2), b.scale(-LN_2), c.scale(-2.0 * LN_2)];
        let mut d_centre = turned(conic, Lanes::load_all(simd, &self.first));
        let mut path = None;
        if let Some(motion) = motion {
            let d_velocity = turned(conic, Lanes::load_all(simd, &self.velocity));
            let d_curvature = turned(conic, Lanes::load_all(simd, &self.curvature));
            for k in 0..2 {
                d_centre[k] = d_centre[k] - d_curvature[k].scale(4.0);
            }
            path = Some(motion.pull_back(simd, &self.parameters, d_velocity, d_curvature));
        }
        let screen = covariance_cotangent(conic, Lanes::load_all(simd, &self.second));
        let (d_jacobian, turn) = match &stages.axes {
            Some(axes) => self.pull_back_axes::<S, MAP>(frame, &stages, axes, screen),
            None => self.pull_back_ball::<S, MAP>(&stages, screen),
        };
        let d_depth = Lanes::load(simd, &self.depth);
        let d_p = mean_cotangent(frame, &stages, d_centre, d_jacobian, d_depth);
        let moment = cross(stages.p, d_p);
        for k in 0..3 {
            (-d_p[k]).store(&mut self.pose[k]);
            (turn[k] - moment[k]).store(&mut self.pose[3 + k]);
        }
        if let Some(path) = &path {
            self.store_ends(path);
        }
        if MAP {
            let mut d_mean = transform(&frame.world_from_camera, d_p);
            for k in 0..3 {
                if let Some(path) = &path {
                    d_mean[k] = d_mean[k] + path.mean[k];
                }
                d_mean[k].store(&mut self.d_mean[k]);
            }
            self.pull_back_appearance(simd, frame.activation);
        }
    }

    #[inline(always)]
    fn store_ends<S: Simd>(&mut self, path: &PathCotangents<S>) {
        for end in 0..2 {
            for k in 0..6 {
                path.ends[end][k].store(&mut self.ends[end][k]);
            }
        }
    }

    /// `∂L/∂` of `J`'s entries and of a turn, for balls.
    #[inline(always)]
    fn pull_back_ball<S: Simd, const MAP: bool>(
        &mut self,
        stages: &Stages<S>,
        [xx, xy, yy]: [Lanes<S>; 3],
    ) -> ([[Lanes<S>; 2]; 2], [Lanes<S>; 3]) {
        let j = &stages.jacobian;
        let variance = (stages.scale[0] * stages.scale[0]).scale(2.0);
        let d_x = [xx * j.x[0], xx * j.x[1] + xy * j.y[1]];
        let d_y = [yy * j.y[0], xy * j.x[1] + yy * j.y[1]];
        if MAP {
            let along = d_x[0] * j.x[0] + d_x[1] * j.x[1] + d_y[0] * j.y[0] + d_y[1] * j.y[1];
            (variance * along).store(&mut self.d_log_scale[0]);
        }
        let d_jacobian =
            [[variance * d_x[0], variance * d_x[1]], [variance * d_y[0], variance * d_y[1]]];
        (d_jacobian, [variance.constant(0.0); 3])
    }

    /// `∂L/∂` of `J`'s entries and of a turn, for ellipsoids.
    #[inline(always)]
    fn pull_back_axes<S: Simd, const MAP: bool>(
        &mut self,
        frame: &Frame,
        stages: &Stages<S>,
        axes: &Axes<S>,
        [xx, xy, yy]: [Lanes<S>; 3],
    ) -> ([[Lanes<S>; 2]; 2], [Lanes<S>; 3]) {
        let (j, [a0, a1, a2]) = (&stages.jacobian, axes.rows);
        let [bx, by] = stages.screen_axes(axes);
        // Σ₂ = B Bᵀ: dL/dB = 2 G B, dL/dJ = dL/dB Aᵀ, dL/dA = Jᵀ dL/dB.
        let (xx, xy, yy) = (xx.scale(2.0), xy.scale(2.0), yy.scale(2.0));
        let (d_bx, d_by) = (combine(xx, bx, xy, by), combine(xy, bx, yy, by));
        let d_jacobian = [[dot(d_bx, a0), dot(d_bx, a2)], [dot(d_by, a1), dot(d_by, a2)]];
        let zero = xx.constant(0.0);
        let d_rows = [
            combine(j.x[0], d_bx, zero, d_by),
            combine(zero, d_bx, j.y[0], d_by),
            combine(j.x[1], d_bx, j.y[1], d_by),
        ];
        let columns = |m: &[[Lanes<S>; 3]; 3], k: usize| [m[0][k], m[1][k], m[2][k]];
        let mut turn = [zero; 3];
        let mut d_rotation = [[zero; 3]; 3];
        for k in 0..3 {
            let (column, d_column) = (columns(&axes.rows, k), columns(&d_rows, k));
            let moment = cross(column, d_column);
            turn = [turn[0] - moment[0], turn[1] - moment[1], turn[2] - moment[2]];
            if MAP {
                dot(column, d_column).store(&mut self.d_log_scale[k]);
                let world = transform(&frame.world_from_camera, d_column);
                let s = stages.scale[k];
                d_rotation[k] = [world[0] * s, world[1] * s, world[2] * s];
            }
        }
        if MAP {
            let d = quaternion_cotangent(axes, &d_rotation);
            for k in 0..4 {
                d[k].store(&mut self.d_rotation[k]);
            }
        }
        (d_jacobian, turn)
    }

    #[inline(always)]
    fn pull_back_appearance<S: Simd>(&mut self, simd: S, activation: ColourActivation) {
        // o = 1 / (1 + e), do/dlogit = o (1 - o), and 1 - o = e / (1 + e).
        let e = (-Lanes::load(simd, &self.parameters.opacity_logit)).exp();
        let rest = e * (e.constant(1.0) + e).recip();
        (Lanes::load(simd, &self.zeroth) * rest).store(&mut self.d_opacity_logit);
        let d: [Lanes<S>; 3] = Lanes::load_all(simd, &self.d_radiance);
        let radiance = Lanes::load_all(simd, &self.radiance);
        for k in 0..3 {
            let d = match activation {
                ColourActivation::Linear => d[k],
                ColourActivation::Exponential => d[k] * radiance[k],
            };
            d.store(&mut self.d_colour[k]);
        }
    }
}

/// `K d` of the symmetric matrix `K = [[a, b], [b, c]]`.
#[inline(always)]
fn turned<S: Simd>([a, b, c]: [Lanes<S>; 3], [x, y]: [Lanes<S>; 2]) -> [Lanes<S>; 2] {
    [a * x + b * y, b * x + c * y]
}
