//! One splat on the way back: row by row, with all moments at a time.

use super::PACK;
use super::clock::TileTimes;
use super::mover::Mover;
use crate::gaussian::bin::TILE;
use crate::gaussian::rasterize::cpu_backward::{Sums, accumulate};
use crate::gaussian::rasterize::cpu_forward::{ExponentRow, Limits, Value};
use crate::gaussian::rasterize::tile::Row;
use pulp::Simd;

/// What a [`Slot`] lacks of one splat over the pixels of one tile, with `e = α ∂L/∂α`.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct MotionSlot {
    /// `Σ e s dx, Σ e s dy`.
    pub(crate) velocity: [f32; 2],
    /// `Σ e s² dx, Σ e s² dy`.
    pub(crate) curvature: [f32; 2],
    /// `∂L/∂readout`.
    pub(crate) readout: f32,
}

impl MotionSlot {
    pub(crate) fn add(&mut self, other: &Self) {
        (0..2).for_each(|k| self.velocity[k] += other.velocity[k]);
        (0..2).for_each(|k| self.curvature[k] += other.curvature[k]);
        self.readout += other.readout;
    }
}

/// Planes of the cotangent of a pixel: r, g, b, depth, opacity, and 1 where any is not zero.
pub(super) const PLANES: usize = 6;

/// One row of a tile at one moment on the way back.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct Passed {
    /// `T`.
    pub(super) transmittance: Row,
    /// `B`.
    pub(super) behind: Row,
    /// The place in the list at which pixels ended.
    pub(super) ended: Row,
}

/// The sums of a [`MotionSlot`] in vectors.
pub(super) struct MotionSums<S: Simd> {
    velocity: [S::f32s; 2],
    curvature: [S::f32s; 2],
    readout: S::f32s,
}

impl<S: Simd> MotionSums<S> {
    #[inline(always)]
    pub(super) fn new(simd: S) -> Self {
        let zero = simd.splat_f32s(0.0);
        Self { velocity: [zero; 2], curvature: [zero; 2], readout: zero }
    }

    #[inline(always)]
    pub(super) fn reduce(&self, simd: S) -> MotionSlot {
        let mut slot = MotionSlot::default();
        for k in 0..2 {
            slot.velocity[k] = simd.reduce_sum_f32s(self.velocity[k]);
            slot.curvature[k] = simd.reduce_sum_f32s(self.curvature[k]);
        }
        slot.readout = simd.reduce_sum_f32s(self.readout);
        slot
    }
}

/// One splat on its way back.
pub(super) struct Step<'a, S: Simd> {
    pub(super) mover: &'a Mover,
    pub(super) limits: &'a Limits<S>,
    pub(super) times: &'a TileTimes,
    pub(super) value: Value<S>,
    /// Its place in the tile's list.
    pub(super) order: S::f32s,
    pub(super) sums: Sums<S>,
    pub(super) motion_sums: MotionSums<S>,
}

impl<S: Simd> Step<'_, S> {
    /// Pull one row back at all moments.
    #[inline(always)]
    pub(super) fn row<const MAP: bool>(
        &mut self,
        simd: S,
        row: usize,
        cotangent: &[Row; PLANES],
        passed: &mut [Passed],
    ) {
        for v in 0..TILE / S::F32_LANES {
            let mut g = [simd.splat_f32s(0.0); PLANES];
            for k in 0..PLANES {
                g[k] = S::as_simd_f32s(&cotangent[k]).0[v];
            }
            let mut q = g[4];
            for k in 0..4 {
                q = simd.mul_add_e_f32s(g[k], self.value.0[k], q);
            }
            let mut sums = RowSums::new(simd);
            for (j, passed) in passed.iter_mut().enumerate().take(PACK) {
                if self.mover.touches(j, row) {
                    let s = simd.splat_f32s(self.times.first[j] + self.times.step * row as f32);
                    let exponent = self.mover.exponent(simd, row, j);
                    let light = self.step(simd, &exponent, v, q, passed);
                    self.add::<MAP>(simd, &exponent, v, s, &light, &mut sums);
                }
            }
            self.add_row(simd, row, &sums);
            accumulate(simd, &mut self.sums.depth, sums.weight, g[3]);
            if MAP {
                accumulate(simd, &mut self.sums.weight, sums.weight, g[PLANES - 1]);
                for k in 0..3 {
                    accumulate(simd, &mut self.sums.radiance[k], sums.weight, g[k]);
                }
            }
        }
    }

    /// Step over the contribution to one vector of pixels at one moment.
    #[inline(always)]
    fn step(
        &self,
        simd: S,
        exponent: &ExponentRow<S>,
        v: usize,
        q: S::f32s,
        passed: &mut Passed,
    ) -> Light<S> {
        let transmittance = &mut S::as_mut_simd_f32s(&mut passed.transmittance).0[v];
        let behind = &mut S::as_mut_simd_f32s(&mut passed.behind).0[v];
        let ended = S::as_simd_f32s(&passed.ended).0[v];
        let (zero, one) = (simd.splat_f32s(0.0), simd.splat_f32s(1.0));
        let free = exponent.alpha(simd, exponent.dx(simd, v));
        let alpha = simd.min_f32s(free, self.limits.alpha_max);
        let visible = simd.greater_than_or_equal_f32s(alpha, self.limits.alpha_min);
        let counts = simd.and_m32s(visible, simd.less_than_f32s(self.order, ended));
        let odds = simd.div_f32s(alpha, simd.sub_f32s(one, alpha));
        let odds = simd.select_f32s(counts, odds, zero);
        let weight = simd.mul_f32s(odds, *transmittance);
        // α ∂L/∂α = a (T q - B), with T and B behind the contribution.
        let gain = simd.sub_f32s(simd.mul_f32s(*transmittance, q), *behind);
        let varies = simd.less_than_or_equal_f32s(free, self.limits.alpha_max);
        let e = simd.mul_f32s(simd.select_f32s(varies, odds, zero), gain);
        *behind = simd.mul_add_e_f32s(weight, q, *behind);
        *transmittance = simd.add_f32s(*transmittance, weight);
        Light { e, weight }
    }

    /// Add to the sums what depends on the moment.
    #[inline(always)]
    fn add<const MAP: bool>(
        &mut self,
        simd: S,
        exponent: &ExponentRow<S>,
        v: usize,
        s: S::f32s,
        light: &Light<S>,
        row: &mut RowSums<S>,
    ) {
        let (dx, dy) = (exponent.dx(simd, v), exponent.dy);
        let (ex, ey) = (simd.mul_f32s(light.e, dx), simd.mul_f32s(light.e, dy));
        let (sx, sy) = (simd.mul_f32s(s, ex), simd.mul_f32s(s, ey));
        row.weight = simd.add_f32s(row.weight, light.weight);
        row.first = [simd.add_f32s(row.first[0], ex), simd.add_f32s(row.first[1], ey)];
        row.moved = [simd.add_f32s(row.moved[0], sx), simd.add_f32s(row.moved[1], sy)];
        accumulate(simd, &mut self.sums.second[0], ex, dx);
        accumulate(simd, &mut self.sums.second[1], ex, dy);
        accumulate(simd, &mut self.sums.second[2], ey, dy);
        accumulate(simd, &mut self.motion_sums.curvature[0], s, sx);
        accumulate(simd, &mut self.motion_sums.curvature[1], s, sy);
        if MAP {
            self.sums.zeroth = simd.add_f32s(self.sums.zeroth, light.e);
        }
    }

    /// Add the sums of a row, which also tell what the readout does: it moves the centre by its
    /// place times `v + 2 s h`.
    #[inline(always)]
    fn add_row(&mut self, simd: S, row: usize, sums: &RowSums<S>) {
        let Mover { splat, path, .. } = self.mover;
        let place = self.times.places[row];
        let speed = [path.velocity[0] * place, path.velocity[1] * place];
        let bend = [path.curvature[0] * 2.0 * place, path.curvature[1] * 2.0 * place];
        let (speed, bend) = (splat.gradient(speed), splat.gradient(bend));
        for k in 0..2 {
            let (first, moved) = (&mut self.sums.first[k], &mut self.motion_sums.velocity[k]);
            *first = simd.add_f32s(*first, sums.first[k]);
            *moved = simd.add_f32s(*moved, sums.moved[k]);
            let readout = &mut self.motion_sums.readout;
            accumulate(simd, readout, sums.first[k], simd.splat_f32s(speed[k]));
            accumulate(simd, readout, sums.moved[k], simd.splat_f32s(bend[k]));
        }
    }
}

/// One contribution: `e = α ∂L/∂α` and its weight.
struct Light<S: Simd> {
    e: S::f32s,
    weight: S::f32s,
}

/// Sums over the moments of one row.
struct RowSums<S: Simd> {
    weight: S::f32s,
    /// `Σ e dx, Σ e dy`.
    first: [S::f32s; 2],
    /// `Σ e s dx, Σ e s dy`.
    moved: [S::f32s; 2],
}

impl<S: Simd> RowSums<S> {
    #[inline(always)]
    fn new(simd: S) -> Self {
        let zero = simd.splat_f32s(0.0);
        Self { weight: zero, first: [zero; 2], moved: [zero; 2] }
    }
}
