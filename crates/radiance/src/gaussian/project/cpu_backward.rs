//! From sums over pixels to the parameters and the pose, in groups of one vector, on all threads.
//!
//! Only Gaussians that touched a tile are visited. With `B = J A` and `A = W R S`, the covariance
//! in the image is `B Bᵀ` plus the low-pass; a turn of the camera by `φ` moves the columns of `A`
//! by `-φ ×` themselves. The covariance of a ball does not turn, so that only `J` is left of it.

use super::cotangents::{covariance_cotangent, mean_cotangent, quaternion_cotangent};
use super::lanes::{Column, Lanes, combine, cross, dot, transform};
use super::stages::{Axes, Frame, Parameters, Stages, put};
use super::{CHUNK, Chunk, Splat};
use crate::gaussian::bin::Bins;
use crate::gaussian::gradient::GradientRows;
use crate::gaussian::rasterize::Slot;
use crate::gaussian::{ColourActivation, Gaussian, GaussianMap, MapGradient, Shape, sort};
use pulp::{Arch, Simd, WithSimd};
use std::f32::consts::LN_2;

/// The splats of the last render with the sums over their pixels.
pub(crate) struct Footprints<'a> {
    pub(crate) arch: Arch,
    pub(crate) map: &'a GaussianMap,
    pub(crate) frame: Frame,
    pub(crate) splats: &'a [Splat],
    pub(crate) chunks: &'a [Chunk],
    pub(crate) bins: &'a Bins,
    pub(crate) slots: &'a [Slot],
}

impl Footprints<'_> {
    /// Pull the sums back to the map and, one sum per chunk, to the pose.
    ///
    /// # Panics
    /// If `map_gradient` is not of the map's size.
    pub(crate) fn pull_back(
        &self,
        map_gradient: Option<&mut MapGradient>,
        pose_sums: &mut [[f64; 6]],
    ) {
        let rows = map_gradient.map(|gradient| {
            assert_eq!(gradient.len(), self.map.len(), "gradient and map differ in size");
            gradient.rows()
        });
        self.split_chunks(0, rows, pose_sums);
    }

    /// Chunks from `first` on, whose rows and sums these are, halved until one is left.
    fn split_chunks(
        &self,
        first: usize,
        rows: Option<GradientRows<'_, f32>>,
        pose_sums: &mut [[f64; 6]],
    ) {
        match pose_sums {
            [] => {}
            [sum] => *sum = self.pull_back_chunk(first, rows),
            _ => {
                let middle = pose_sums.len() / 2;
                let (left_sums, right_sums) = pose_sums.split_at_mut(middle);
                let (left, right) = rows.map(|rows| rows.split_at(middle * CHUNK)).unzip();
                rayon::join(
                    || self.split_chunks(first, left, left_sums),
                    || self.split_chunks(first + middle, right, right_sums),
                );
            }
        }
    }

    fn pull_back_chunk(&self, chunk: usize, rows: Option<GradientRows<'_, f32>>) -> [f64; 6] {
        let footprints = self;
        match (self.map.shape, rows.is_some()) {
            (Shape::Isotropic, false) => {
                self.arch.dispatch(PullBack::<false, false> { footprints, chunk, rows })
            }
            (Shape::Isotropic, true) => {
                self.arch.dispatch(PullBack::<false, true> { footprints, chunk, rows })
            }
            (Shape::Anisotropic, false) => {
                self.arch.dispatch(PullBack::<true, false> { footprints, chunk, rows })
            }
            (Shape::Anisotropic, true) => {
                self.arch.dispatch(PullBack::<true, true> { footprints, chunk, rows })
            }
        }
    }
}

/// The way back of one chunk; gives its part of `∂L/∂(ρ, φ)`. Without `MAP` there are no rows.
struct PullBack<'a, const ANISOTROPIC: bool, const MAP: bool> {
    footprints: &'a Footprints<'a>,
    chunk: usize,
    rows: Option<GradientRows<'a, f32>>,
}

impl<const ANISOTROPIC: bool, const MAP: bool> WithSimd for PullBack<'_, ANISOTROPIC, MAP> {
    type Output = [f64; 6];

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) -> [f64; 6] {
        let Footprints { map, frame, splats, chunks, bins, slots, .. } = self.footprints;
        let mut pose = [0.0; 6];
        let mut group = Group::default();
        for items in chunks[self.chunk].visible.chunks(S::F32_LANES) {
            for (place, item) in items.iter().enumerate() {
                let index = sort::index(*item);
                group.load(place, map, index, &splats[index], bins, slots);
            }
            group.pull_back::<S, ANISOTROPIC, MAP>(simd, frame);
            for (place, item) in items.iter().enumerate() {
                for k in 0..6 {
                    pose[k] += f64::from(group.pose[k][place]);
                }
                if let Some(rows) = &mut self.rows {
                    let row = sort::index(*item) - self.chunk * CHUNK;
                    rows.add(row, &group.gradient(place), group.weight[place] > 0.0);
                }
            }
        }
        pose
    }
}

/// A group on the way back.
#[derive(Default)]
struct Group {
    parameters: Parameters,
    exponent: [Column; 3],
    radiance: [Column; 3],
    /// The sums of a [`Slot`].
    first: [Column; 2],
    second: [Column; 3],
    depth: Column,
    zeroth: Column,
    d_radiance: [Column; 3],
    weight: Column,
    /// `∂L/∂(ρ, φ)`.
    pose: [Column; 6],
    /// `∂L/∂` of the parameters.
    d_mean: [Column; 3],
    d_log_scale: [Column; 3],
    d_rotation: [Column; 4],
    d_opacity_logit: Column,
    d_colour: [Column; 3],
}

impl Group {
    #[inline(always)]
    fn load(
        &mut self,
        place: usize,
        map: &GaussianMap,
        index: usize,
        splat: &Splat,
        bins: &Bins,
        slots: &[Slot],
    ) {
        self.parameters.set(place, map, index);
        put(&mut self.exponent, place, &splat.exponent);
        put(&mut self.radiance, place, &splat.radiance);
        let mut sum = Slot::default();
        for at in bins.places_of(index, splat) {
            sum.add(&slots[at]);
        }
        put(&mut self.first, place, &sum.first);
        put(&mut self.second, place, &sum.second);
        put(&mut self.d_radiance, place, &sum.radiance);
        self.depth[place] = sum.depth;
        self.zeroth[place] = sum.zeroth;
        self.weight[place] = sum.weight;
    }

    /// The gradient of the Gaussian at `place`.
    #[inline(always)]
    fn gradient(&self, place: usize) -> Gaussian<f32> {
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
    fn pull_back<S: Simd, const ANISOTROPIC: bool, const MAP: bool>(
        &mut self,
        simd: S,
        frame: &Frame,
    ) {
        let stages = frame.stages::<S, ANISOTROPIC>(simd, &self.parameters);
        let [a, b, c] = Lanes::load_all(simd, &self.exponent);
        let conic = [a.times(-2.0 * LN_2), b.times(-LN_2), c.times(-2.0 * LN_2)];
        let [x, y] = Lanes::load_all(simd, &self.first);
        let d_centre = [conic[0] * x + conic[1] * y, conic[1] * x + conic[2] * y];
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
        if MAP {
            let d_mean = transform(&frame.world_from_camera, d_p);
            for k in 0..3 {
                d_mean[k].store(&mut self.d_mean[k]);
            }
            self.pull_back_appearance(simd, frame.activation);
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
        let variance = (stages.scale[0] * stages.scale[0]).times(2.0);
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
        let (xx, xy, yy) = (xx.times(2.0), xy.times(2.0), yy.times(2.0));
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
