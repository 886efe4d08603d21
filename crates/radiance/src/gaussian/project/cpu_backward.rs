//! Backward pass from sums over pixels to the parameters and the pose, in groups of one vector, on
//! all threads.
//!
//! Only Gaussians that touched a tile are visited. With `B = J A` and `A = W R S`, the covariance
//! in the image is `B Bᵀ` plus the low-pass; a turn of the camera by `φ` moves the columns of `A`
//! by `-φ ×` themselves. The covariance of a ball does not turn, so that only `J` is left of it.

use super::stages::{Axes, Frame, Parameters, Stages, put, symmetric_product};
use super::{CHUNK, Chunk, MotionFrame, Splat};
use crate::gaussian::bin::Bins;
use crate::gaussian::map::GradientRows;
use crate::gaussian::rasterize::{MotionTileSums, TileSums};
use crate::gaussian::{ColourActivation, Gaussian, GaussianMap, MapGradient, Shape, sort};
use i2slam_compute::simd::{Column, Lanes, MAX_LANES, combine, cross, dot, transform};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;
use std::f32::consts::LN_2;

/// The splats of the last render with the sums over their pixels.
pub(crate) struct Footprints<'a> {
    pub(crate) arch: Arch,
    pub(crate) map: &'a GaussianMap,
    pub(crate) frame: Frame,
    pub(crate) splats: &'a [Splat],
    pub(crate) chunks: &'a [Chunk],
    pub(crate) bins: &'a Bins,
    pub(crate) slots: &'a [TileSums],
    /// With a moving camera.
    pub(crate) moving: Option<(&'a MotionFrame, &'a [MotionTileSums])>,
}

/// Pose gradients of a chunk of Gaussians, or of all.
#[derive(Clone, Copy, Default)]
pub(crate) struct PoseSums {
    /// `∂L/∂(ρ, φ)` of the view's pose.
    pub(crate) middle: [f64; 6],
    /// `∂L/∂(ρ, φ)` of the poses at both ends of the exposure.
    pub(crate) ends: [[f64; 6]; 2],
    /// `∂L/∂readout`.
    pub(crate) readout: f64,
}

impl PoseSums {
    pub(crate) fn add(&mut self, other: &Self) {
        for k in 0..6 {
            self.middle[k] += other.middle[k];
            (0..2).for_each(|end| self.ends[end][k] += other.ends[end][k]);
        }
        self.readout += other.readout;
    }
}

impl Footprints<'_> {
    /// Pulls the sums back to the pose, one sum per chunk, and to a map gradient of the map's size.
    pub(crate) fn pull_back(
        &self,
        map_gradient: Option<&mut MapGradient>,
        pose_sums: &mut [PoseSums],
    ) {
        let sums = pose_sums.par_iter_mut().enumerate();
        match map_gradient {
            None => sums.for_each(|(chunk, sum)| *sum = self.pull_back_chunk(chunk, None)),
            Some(gradient) => {
                assert_eq!(gradient.len(), self.map.len(), "gradient and map differ in size");
                let rows = gradient.par_rows(&self.map.view_colours, CHUNK);
                sums.zip(rows).for_each(|((chunk, sum), rows)| {
                    *sum = self.pull_back_chunk(chunk, Some(rows));
                });
            }
        }
    }

    /// First slots of a group of visible Gaussians: independent loads wait for the memory once.
    #[inline(always)]
    fn first_slots(&self, items: &[u64]) -> [TileSums; MAX_LANES] {
        let first = |item: &u64| {
            let index = sort::index(*item);
            let mut places = self.bins.places_of(index, &self.splats[index]);
            places.next().map_or_else(TileSums::default, |at| self.slots[at])
        };
        std::array::from_fn(|i| items.get(i).map_or_else(TileSums::default, first))
    }

    fn pull_back_chunk(&self, chunk: usize, rows: Option<GradientRows<'_, f32>>) -> PoseSums {
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

/// Backward pass of one chunk; returns its pose gradients. Without `MAP` there are no rows.
struct PullBack<'a, const ANISOTROPIC: bool, const MAP: bool> {
    footprints: &'a Footprints<'a>,
    chunk: usize,
    rows: Option<GradientRows<'a, f32>>,
}

impl<const ANISOTROPIC: bool, const MAP: bool> WithSimd for PullBack<'_, ANISOTROPIC, MAP> {
    type Output = PoseSums;

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) -> PoseSums {
        let Footprints { map, frame, splats, chunks, bins, slots, moving, .. } = self.footprints;
        let motion = moving.map(|(motion, _)| motion);
        let mut sums = PoseSums::default();
        let mut group = Group::default();
        for items in chunks[self.chunk].visible.chunks(S::F32_LANES) {
            let firsts = self.footprints.first_slots(items);
            for (place, item) in items.iter().enumerate() {
                let index = sort::index(*item);
                let (splat, mut sum) = (&splats[index], TileSums::default());
                sum.add(&firsts[place]);
                for at in bins.places_of(index, splat).skip(1) {
                    sum.add(&slots[at]);
                }
                group.load(place, map, index, splat, &sum);
                if let Some((_, slots)) = moving {
                    let mut sum = MotionTileSums::default();
                    for at in bins.places_of(index, splat) {
                        sum.add(&slots[at]);
                    }
                    put(&mut group.velocity, place, &sum.velocity);
                    put(&mut group.curvature, place, &sum.curvature);
                    sums.readout += f64::from(sum.readout);
                }
            }
            group.pull_back::<S, ANISOTROPIC, MAP>(simd, frame, motion);
            for (place, item) in items.iter().enumerate() {
                for k in 0..6 {
                    sums.middle[k] += f64::from(group.pose[k][place]);
                    for end in 0..2 {
                        sums.ends[end][k] += f64::from(group.ends[end][k][place]);
                    }
                }
                let index = sort::index(*item);
                let mut gradient = group.gradient(place);
                if !map.view_colours.is_empty() {
                    let d_colour = group.colour_cotangent(place, frame.activation);
                    let d_mean = self.pull_back_view(index, d_colour);
                    (0..3).for_each(|k| gradient.mean[k] += d_mean[k]);
                    let d_centre = frame.to_camera(d_mean);
                    (0..3).for_each(|k| sums.middle[k] -= f64::from(d_centre[k]));
                }
                if let Some(rows) = &mut self.rows {
                    let row = index - self.chunk * CHUNK;
                    rows.add(row, &gradient, group.weight[place] > 0.0);
                }
            }
        }
        sums
    }
}

impl<const ANISOTROPIC: bool, const MAP: bool> PullBack<'_, ANISOTROPIC, MAP> {
    /// Through the view colour of a Gaussian, if it has one, to its coefficients; `∂L/∂mean`.
    fn pull_back_view(&mut self, index: usize, d_colour: [f32; 3]) -> [f32; 3] {
        let Footprints { map, frame, .. } = self.footprints;
        let Some(view) = map.view_colours.get(index) else { return [0.0; 3] };
        let rows = self.rows.as_mut().and_then(|rows| {
            let (range, first) = (map.view_colours.range(index)?, rows.first_view_row);
            rows.view_colours.get_mut(range.start - first..range.end - first)
        });
        view.pull_back(map.means[index], frame.origin, d_colour, rows)
    }
}

/// Inputs and gradients of a group of Gaussians.
#[derive(Default)]
pub(super) struct Group {
    parameters: Parameters,
    exponent: [Column; 3],
    radiance: [Column; 3],
    /// The sums of a [`TileSums`].
    first: [Column; 2],
    second: [Column; 3],
    depth: Column,
    depth_first: [Column; 2],
    zeroth: Column,
    d_radiance: [Column; 3],
    pub(super) weight: Column,
    /// The sums of a [`MotionTileSums`].
    velocity: [Column; 2],
    curvature: [Column; 2],
    /// `∂L/∂(ρ, φ)`.
    pub(super) pose: [Column; 6],
    /// `∂L/∂(ρ, φ)` of the poses at both ends of the exposure, with a moving camera.
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
        sum: &TileSums,
    ) {
        self.parameters.set(place, map, index);
        put(&mut self.exponent, place, &splat.exponent);
        put(&mut self.radiance, place, &splat.radiance);
        put(&mut self.first, place, &sum.first);
        put(&mut self.second, place, &sum.second);
        put(&mut self.d_radiance, place, &sum.radiance);
        put(&mut self.depth_first, place, &sum.depth_first);
        self.depth[place] = sum.depth;
        self.zeroth[place] = sum.zeroth;
        self.weight[place] = sum.weight;
    }

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

    /// `∂L/∂` of the colour that is seen.
    pub(super) fn colour_cotangent(&self, place: usize, activation: ColourActivation) -> [f32; 3] {
        std::array::from_fn(|c| match activation {
            ColourActivation::Linear => self.d_radiance[c][place],
            ColourActivation::Exponential => self.d_radiance[c][place] * self.radiance[c][place],
        })
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
        let mut d_centre = symmetric_product(conic, Lanes::load_all(simd, &self.first));
        let d_depth = Lanes::load(simd, &self.depth);
        let mut path = None;
        if let Some(motion) = motion {
            let d_velocity = symmetric_product(conic, Lanes::load_all(simd, &self.velocity));
            let d_curvature = symmetric_product(conic, Lanes::load_all(simd, &self.curvature));
            for k in 0..2 {
                d_centre[k] = d_centre[k] - d_curvature[k].scale(4.0);
            }
            path = Some(motion.pull_back(simd, &self.parameters, d_velocity, d_curvature));
        }
        let mut screen = covariance_cotangent(conic, Lanes::load_all(simd, &self.second));
        let (d_jacobian, turn) = match &stages.axes {
            Some(axes) => {
                let slope = symmetric_product(conic, stages.depth_covariance(axes));
                let d_slope = Lanes::load_all(simd, &self.depth_first);
                let d_across = symmetric_product(conic, d_slope);
                // h = K c: dL/dc = K dL/dh, and dL/dΣ₂ = -½ (dL/dc hᵀ + h dL/dcᵀ).
                let [[g, k], [x, y]] = [d_across, slope];
                screen =
                    [screen[0] - g * x, screen[1] - (g * y + k * x).scale(0.5), screen[2] - k * y];
                // The depth at a pixel is z + h · (pixel - centre); moving splats count it already.
                if motion.is_none() {
                    (0..2).for_each(|k| d_centre[k] = d_centre[k] - slope[k] * d_depth);
                }
                self.pull_back_axes::<S, MAP>(frame, &stages, axes, screen, d_across)
            }
            None => self.pull_back_ball::<S, MAP>(&stages, screen),
        };
        let d_p = mean_cotangent(frame, &stages, d_centre, d_jacobian, d_depth);
        let moment = cross(stages.p, d_p);
        for k in 0..3 {
            (-d_p[k]).store(&mut self.pose[k]);
            (turn[k] - moment[k]).store(&mut self.pose[3 + k]);
        }
        if let Some(path) = &path {
            for end in 0..2 {
                for k in 0..6 {
                    path.ends[end][k].store(&mut self.ends[end][k]);
                }
            }
        }
        if MAP {
            let mut d_mean = transform(&frame.world_from_camera, d_p);
            for k in 0..3 {
                if let Some(path) = &path {
                    d_mean[k] += path.mean[k];
                }
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
        d_across: [Lanes<S>; 2],
    ) -> ([[Lanes<S>; 2]; 2], [Lanes<S>; 3]) {
        let (j, [a0, a1, a2]) = (&stages.jacobian, axes.rows);
        let [bx, by] = stages.screen_axes(axes);
        // Σ₂ = B Bᵀ: dL/dB = 2 G B, dL/dJ = dL/dB Aᵀ, dL/dA = Jᵀ dL/dB.
        let (xx, xy, yy) = (xx.scale(2.0), xy.scale(2.0), yy.scale(2.0));
        let (mut d_bx, mut d_by) = (combine(xx, bx, xy, by), combine(xy, bx, yy, by));
        // c = B a_z.
        for k in 0..3 {
            d_bx[k] += d_across[0] * a2[k];
            d_by[k] += d_across[1] * a2[k];
        }
        let d_jacobian = [[dot(d_bx, a0), dot(d_bx, a2)], [dot(d_by, a1), dot(d_by, a2)]];
        let zero = xx.constant(0.0);
        let mut d_rows = [
            combine(j.x[0], d_bx, zero, d_by),
            combine(zero, d_bx, j.y[0], d_by),
            combine(j.x[1], d_bx, j.y[1], d_by),
        ];
        let d_depth_row = combine(d_across[0], bx, d_across[1], by);
        (0..3).for_each(|k| d_rows[2][k] += d_depth_row[k]);
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

/// `∂L/∂Σ₂` as a symmetric matrix `[xx, xy, yy]`, from the second moments `M = Σ e d dᵀ`: with
/// `K = Σ₂⁻¹`, `∂L/∂K = -½ M` and `∂L/∂Σ₂ = ½ K M K`.
#[inline(always)]
pub(crate) fn covariance_cotangent<S: Simd>(
    [a, b, c]: [Lanes<S>; 3],
    m: [Lanes<S>; 3],
) -> [Lanes<S>; 3] {
    let (p, q) = (a * m[0] + b * m[1], a * m[1] + b * m[2]);
    let (r, s) = (b * m[0] + c * m[1], b * m[1] + c * m[2]);
    [(p * a + q * b).scale(0.5), (p * b + q * c).scale(0.5), (r * b + s * c).scale(0.5)]
}

/// `∂L/∂p` through the centre, the Jacobian and the depth.
#[inline(always)]
pub(crate) fn mean_cotangent<S: Simd>(
    frame: &Frame,
    stages: &Stages<S>,
    d_centre: [Lanes<S>; 2],
    d_jacobian: [[Lanes<S>; 2]; 2],
    d_depth: Lanes<S>,
) -> [Lanes<S>; 3] {
    let (j, inverse_depth) = (&stages.jacobian, stages.inverse_depth);
    let focal = [j.x[0], j.y[0]];
    let (mut lateral, mut d_z) = ([d_depth; 2], d_depth);
    for axis in 0..2 {
        let ([first, last], [low, high]) = (d_jacobian[axis], frame.range(axis));
        let ratio = stages.ratio[axis];
        // J's rows are f/z and -f/z clamp(x/z); the clamp passes nothing on outside.
        let slope = ratio.strictly_within(low, high).keep(last * focal[axis] * inverse_depth);
        lateral[axis] = d_centre[axis] * focal[axis] - slope;
        d_z = d_z - lateral[axis] * ratio;
        d_z += (last * stages.clamped[axis] - first) * focal[axis] * inverse_depth;
    }
    [lateral[0], lateral[1], d_z]
}

/// `∂L/∂q` of the stored quaternion from the columns of `∂L/∂R`.
#[inline(always)]
pub(crate) fn quaternion_cotangent<S: Simd>(
    axes: &Axes<S>,
    d: &[[Lanes<S>; 3]; 3],
) -> [Lanes<S>; 4] {
    let [w, x, y, z] = axes.unit;
    // Entry (row, column) of ∂L/∂R is d[column][row].
    let turn = [d[1][2] - d[2][1], d[2][0] - d[0][2], d[0][1] - d[1][0]];
    let (xy, xz, yz) = (d[1][0] + d[0][1], d[2][0] + d[0][2], d[2][1] + d[1][2]);
    let unit = [
        x * turn[0] + y * turn[1] + z * turn[2],
        y * xy + z * xz + w * turn[0] - (x * (d[1][1] + d[2][2])).scale(2.0),
        x * xy + z * yz + w * turn[1] - (y * (d[0][0] + d[2][2])).scale(2.0),
        x * xz + y * yz + w * turn[2] - (z * (d[0][0] + d[1][1])).scale(2.0),
    ];
    let along = unit[0] * w + unit[1] * x + unit[2] * y + unit[3] * z;
    let factor = axes.inverse_norm.scale(2.0);
    [
        (unit[0] - w * along) * factor,
        (unit[1] - x * along) * factor,
        (unit[2] - y * along) * factor,
        (unit[3] - z * along) * factor,
    ]
}
