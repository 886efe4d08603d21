//! The way back from all moments of a tile, back to front.
//!
//! With `q_i = g · v_i` for the cotangent `g` of a pixel and what splat `i` composites,
//! `v_i = (r, g, b, z, 1)`, and at each moment the transmittance `T` behind contribution `i` and
//! the light `B` from there, both times the moment's weight,
//!
//! ```text
//! a = α / (1 - α),   α ∂L/∂α = a (T q - B),   B ← B + a T q,   T ← T + a T
//! ```
//!
//! steps to the next contribution in front. What is the same at all moments, `q` and the sums of
//! the colour, is done once per row.

use super::clock::{TileTimes, Touched};
use super::cpu_forward::{MovingRow, Scene};
use super::{MomentPixels, PACK};
use crate::gaussian::RasterSettings;
use crate::gaussian::bin::{Entry, TILE};
use crate::gaussian::project::{Path, Splat};
use crate::gaussian::rasterize::cpu_backward::{Slot, Sums, accumulate};
use crate::gaussian::rasterize::cpu_forward::{Limits, Value};
use crate::gaussian::rasterize::tile::{Row, TilePixels};
use pulp::{Simd, WithSimd};

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

/// What the last render left, and the cotangent of its pixels.
pub(crate) struct Picture<'a> {
    pub(crate) scene: Scene<'a>,
    pub(crate) tiles: &'a [TilePixels],
    pub(crate) states: &'a [MomentPixels],
    /// `∂L/∂[r, g, b, depth, opacity]`.
    pub(crate) cotangent: [Option<&'a [f32]>; 5],
    /// Whether the sums that only the map needs are wanted.
    pub(crate) with_map: bool,
}

/// The slots of some tiles' entries.
struct Slots<'a> {
    slots: &'a mut [Slot],
    motion: &'a mut [MotionSlot],
}

/// Fill the slots of all entries of all tiles.
pub(crate) fn pull_back(picture: &Picture<'_>, slots: &mut [Slot], motion: &mut [MotionSlot]) {
    split_tiles(picture, 0, picture.scene.grid.len(), Slots { slots, motion });
}

/// Tiles `first..end`, whose slots these are, halved until one is left.
fn split_tiles(picture: &Picture<'_>, first: usize, end: usize, slots: Slots<'_>) {
    match end - first {
        0 => {}
        1 => pull_back_tile(picture, first, slots),
        count => {
            let middle = first + count / 2;
            let starts = &picture.scene.bins.starts;
            let at = (starts[middle] - starts[first]) as usize;
            let (left, right) = slots.slots.split_at_mut(at);
            let (left_motion, right_motion) = slots.motion.split_at_mut(at);
            rayon::join(
                || {
                    let slots = Slots { slots: left, motion: left_motion };
                    split_tiles(picture, first, middle, slots);
                },
                || {
                    let slots = Slots { slots: right, motion: right_motion };
                    split_tiles(picture, middle, end, slots);
                },
            );
        }
    }
}

/// Planes of the cotangent of a pixel: r, g, b, depth, opacity, and 1 where any is not zero.
const PLANES: usize = 6;

/// The cotangent of a tile's pixels, row by row, plane by plane.
#[repr(C, align(64))]
struct Cotangent([[Row; PLANES]; TILE]);

/// The state of a tile's pixels at one moment on the way back: `T` and `B`.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Passed([[Row; 2]; TILE]);

fn pull_back_tile(picture: &Picture<'_>, number: usize, Slots { slots, motion }: Slots<'_>) {
    let Scene { arch, settings, grid, clock, splats, paths, bins } = picture.scene;
    slots.fill(Slot::default());
    motion.fill(MotionSlot::default());
    let (count, visited) = (clock.moments.len(), picture.tiles[number].visited);
    let mut cotangent = Cotangent([[[0.0; TILE]; PLANES]; TILE]);
    if count == 0 || !load(picture, number, &mut cotangent) {
        return;
    }
    let (column, row) = (number % grid.columns, number / grid.columns);
    let origin = [(column * TILE) as f32 + 0.5, (row * TILE) as f32 + 0.5];
    let states = &picture.states[number * count..][..count];
    let mut passed = [Passed([[[0.0; TILE]; 2]; TILE]); PACK];
    for (moments, states) in clock.moments.chunks(PACK).zip(states.chunks(PACK)) {
        passed.iter_mut().zip(states).for_each(|(passed, state)| start(passed, state));
        let times = &clock.tile(moments, grid, number);
        let (rows, passed) = (&cotangent.0, &mut passed[..moments.len()]);
        let slots = slots[..visited].iter_mut().zip(&mut motion[..visited]);
        let list = bins.list(number).zip(slots);
        if picture.with_map {
            arch.dispatch(Backward::<_, true> {
                settings,
                splats,
                paths,
                list,
                origin,
                times,
                states,
                passed,
                rows,
            });
        } else {
            arch.dispatch(Backward::<_, false> {
                settings,
                splats,
                paths,
                list,
                origin,
                times,
                states,
                passed,
                rows,
            });
        }
    }
}

/// Fill the cotangent's planes; `false` when it is all zero.
fn load(picture: &Picture<'_>, number: usize, cotangent: &mut Cotangent) -> bool {
    let grid = picture.scene.grid;
    let (column, row) = (number % grid.columns * TILE, number / grid.columns * TILE);
    let width = TILE.min(grid.width - column);
    let mut any = false;
    for j in 0..TILE.min(grid.height - row) {
        let planes = &mut cotangent.0[j];
        let at = (row + j) * grid.width + column;
        for (plane, source) in planes.iter_mut().zip(&picture.cotangent) {
            if let Some(source) = source {
                plane[..width].copy_from_slice(&source[at..at + width]);
            }
        }
        for i in 0..width {
            if (0..PLANES - 1).any(|k| planes[k][i] != 0.0) {
                planes[PLANES - 1][i] = 1.0;
                any = true;
            }
        }
    }
    any
}

/// The transmittance that the render left, and no light from behind.
fn start(passed: &mut Passed, state: &MomentPixels) {
    for (j, [transmittance, behind]) in passed.0.iter_mut().enumerate() {
        for i in 0..TILE {
            transmittance[i] = state.transmittance[j][i].abs();
        }
        *behind = [0.0; TILE];
    }
}

/// One tile's way back. Without `MAP`, the sums that only the map needs stay zero.
struct Backward<'a, L, const MAP: bool> {
    settings: &'a RasterSettings,
    splats: &'a [Splat],
    paths: &'a [Path<f32>],
    list: L,
    /// Centre of the tile's first pixel \[px\].
    origin: [f32; 2],
    times: &'a TileTimes,
    states: &'a [MomentPixels],
    passed: &'a mut [Passed],
    rows: &'a [[Row; PLANES]; TILE],
}

impl<'a, L, const MAP: bool> WithSimd for Backward<'a, L, MAP>
where
    L: ExactSizeIterator<Item = (Entry, (&'a mut Slot, &'a mut MotionSlot))> + DoubleEndedIterator,
{
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { splats, paths, origin, times, states, passed, rows, .. } = self;
        let limits = Limits::new(simd, self.settings);
        for (order, (entry, (slot, motion_slot))) in self.list.enumerate().rev() {
            let (splat, path) = (&splats[entry.splat()], &paths[entry.splat()]);
            let touched = Touched::of(simd, splat, path, times, origin, &[true; PACK]);
            let order = simd.splat_f32s(order as f32);
            let value = Value::new(simd, splat);
            let mut sums = Sums::<S>::new(simd);
            let mut motion_sums = MotionSums::<S>::new(simd);
            let [first, end] = touched.rows;
            for row in first..end {
                let mut step = RowBack {
                    moving: MovingRow { splat, path, origin, times, row },
                    touched: &touched,
                    limits: &limits,
                    value: &value,
                    order,
                    sums: &mut sums,
                    motion_sums: &mut motion_sums,
                };
                step.pull_back::<MAP>(simd, &rows[row], states, passed);
            }
            slot.add(&sums.reduce::<MAP>(simd));
            motion_slot.add(&motion_sums.reduce(simd));
        }
    }
}

/// The sums of a [`MotionSlot`] in vectors.
struct MotionSums<S: Simd> {
    velocity: [S::f32s; 2],
    curvature: [S::f32s; 2],
    readout: S::f32s,
}

impl<S: Simd> MotionSums<S> {
    #[inline(always)]
    fn new(simd: S) -> Self {
        let zero = simd.splat_f32s(0.0);
        Self { velocity: [zero; 2], curvature: [zero; 2], readout: zero }
    }

    #[inline(always)]
    fn reduce(&self, simd: S) -> MotionSlot {
        let mut slot = MotionSlot::default();
        for k in 0..2 {
            slot.velocity[k] = simd.reduce_sum_f32s(self.velocity[k]);
            slot.curvature[k] = simd.reduce_sum_f32s(self.curvature[k]);
        }
        slot.readout = simd.reduce_sum_f32s(self.readout);
        slot
    }
}

/// One splat on one row of a tile.
struct RowBack<'a, S: Simd> {
    moving: MovingRow<'a>,
    touched: &'a Touched,
    limits: &'a Limits<S>,
    value: &'a Value<S>,
    /// The splat's place in the tile's list.
    order: S::f32s,
    sums: &'a mut Sums<S>,
    motion_sums: &'a mut MotionSums<S>,
}

impl<S: Simd> RowBack<'_, S> {
    #[inline(always)]
    fn pull_back<const MAP: bool>(
        &mut self,
        simd: S,
        cotangent: &[Row; PLANES],
        states: &[MomentPixels],
        passed: &mut [Passed],
    ) {
        let row = self.moving.row;
        for v in 0..TILE / S::F32_LANES {
            let g = |k: usize| S::as_simd_f32s(&cotangent[k]).0[v];
            let mut q = g(4);
            for k in 0..4 {
                q = simd.mul_add_e_f32s(g(k), self.value.0[k], q);
            }
            let zero = simd.splat_f32s(0.0);
            let (mut weights, mut first, mut moved) = (zero, [zero; 2], [zero; 2]);
            for (j, passed) in passed.iter_mut().enumerate() {
                if !self.touched.contains(j, row) {
                    continue;
                }
                let ended = S::as_simd_f32s(&states[j].ended[row]).0[v];
                let [transmittance, behind] = &mut passed.0[row];
                let transmittance = &mut S::as_mut_simd_f32s(transmittance).0[v];
                let behind = &mut S::as_mut_simd_f32s(behind).0[v];
                let exponent = self.moving.exponent(simd, j);
                let dx = exponent.dx(simd, v);
                let free = exponent.alpha(simd, dx);
                let alpha = simd.min_f32s(free, self.limits.alpha_max);
                let visible = simd.greater_than_or_equal_f32s(alpha, self.limits.alpha_min);
                let counts = simd.and_m32s(visible, simd.less_than_f32s(self.order, ended));
                let odds = simd.div_f32s(alpha, simd.sub_f32s(simd.splat_f32s(1.0), alpha));
                let odds = simd.select_f32s(counts, odds, zero);
                let weight = simd.mul_f32s(odds, *transmittance);
                let gain = simd.negate_mul_add_e_f32s(*transmittance, q, *behind);
                let varies = simd.less_than_or_equal_f32s(free, self.limits.alpha_max);
                let e = simd.mul_f32s(simd.select_f32s(varies, odds, zero), simd.neg_f32s(gain));
                *behind = simd.mul_add_e_f32s(weight, q, *behind);
                *transmittance = simd.add_f32s(*transmittance, weight);
                weights = simd.add_f32s(weights, weight);
                let s = simd.splat_f32s(self.moving.time(j));
                let (ex, ey) = (simd.mul_f32s(e, dx), simd.mul_f32s(e, exponent.dy));
                first = [simd.add_f32s(first[0], ex), simd.add_f32s(first[1], ey)];
                accumulate(simd, &mut self.sums.second[0], ex, dx);
                accumulate(simd, &mut self.sums.second[1], ex, exponent.dy);
                accumulate(simd, &mut self.sums.second[2], ey, exponent.dy);
                let (sx, sy) = (simd.mul_f32s(s, ex), simd.mul_f32s(s, ey));
                moved = [simd.add_f32s(moved[0], sx), simd.add_f32s(moved[1], sy)];
                accumulate(simd, &mut self.motion_sums.curvature[0], s, sx);
                accumulate(simd, &mut self.motion_sums.curvature[1], s, sy);
                if MAP {
                    self.sums.zeroth = simd.add_f32s(self.sums.zeroth, e);
                }
            }
            self.add_first(simd, first, moved);
            accumulate(simd, &mut self.sums.depth, weights, g(3));
            if MAP {
                accumulate(simd, &mut self.sums.weight, weights, g(PLANES - 1));
                for k in 0..3 {
                    accumulate(simd, &mut self.sums.radiance[k], weights, g(k));
                }
            }
        }
    }

    /// Add a row's `Σ e d` and `Σ e s d`, which also tell what the readout does: it moves the
    /// centre by its place times `v + 2 s h`.
    #[inline(always)]
    fn add_first(&mut self, simd: S, first: [S::f32s; 2], moved: [S::f32s; 2]) {
        let MovingRow { splat, path, times, row, .. } = self.moving;
        let place = times.places[row];
        let speed = [path.velocity[0] * place, path.velocity[1] * place];
        let bend = [path.curvature[0] * 2.0 * place, path.curvature[1] * 2.0 * place];
        let (speed, bend) = (splat.gradient(speed), splat.gradient(bend));
        for k in 0..2 {
            self.sums.first[k] = simd.add_f32s(self.sums.first[k], first[k]);
            self.motion_sums.velocity[k] = simd.add_f32s(self.motion_sums.velocity[k], moved[k]);
            let readout = &mut self.motion_sums.readout;
            accumulate(simd, readout, first[k], simd.splat_f32s(speed[k]));
            accumulate(simd, readout, moved[k], simd.splat_f32s(bend[k]));
        }
    }
}
