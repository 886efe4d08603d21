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

use super::cpu_forward::Scene;
use super::mover::{self, BATCH, Stage};
use super::step::{MotionSums, PLANES, Passed, Step};
use super::{MomentRow, MotionSlot};
use crate::gaussian::RasterSettings;
use crate::gaussian::bin::TILE;
use crate::gaussian::rasterize::cpu_backward::{Slot, Sums};
use crate::gaussian::rasterize::cpu_forward::{Limits, Value};
use crate::gaussian::rasterize::tile::{Row, TilePixels};
use pulp::{Simd, WithSimd};

/// What the last render left, and the cotangent of its pixels.
pub(crate) struct Picture<'a> {
    pub(crate) scene: Scene<'a>,
    pub(crate) tiles: &'a [TilePixels],
    pub(crate) states: &'a [MomentRow],
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

/// The cotangent of a tile's pixels, row by row, plane by plane.
#[repr(C, align(64))]
struct Cotangent([[Row; PLANES]; TILE]);

fn pull_back_tile(picture: &Picture<'_>, number: usize, Slots { slots, motion }: Slots<'_>) {
    let Scene { arch, settings, grid, clock, splats, paths, bins } = picture.scene;
    slots.fill(Slot::default());
    motion.fill(MotionSlot::default());
    let (count, visited) = (clock.moments.len(), picture.tiles[number].visited);
    let mut cotangent = Cotangent([[[0.0; TILE]; PLANES]; TILE]);
    if count == 0 || visited == 0 || !load(picture, number, &mut cotangent) {
        return;
    }
    let (column, row) = (number % grid.columns, number / grid.columns);
    let origin = [(column * TILE) as f32 + 0.5, (row * TILE) as f32 + 0.5];
    let states = &picture.states[number * TILE * count..][..TILE * count];
    for pack in clock.packs() {
        let times = &clock.tile(pack.clone(), grid, number);
        let passed = start(states.chunks(count).flat_map(|row| &row[pack.clone()]));
        let stage = Stage { splats, paths, list: bins.entries(number), origin, times };
        let (slots, motion) = (&mut slots[..visited], &mut motion[..visited]);
        let (rows, slots) = (&cotangent.0, Slots { slots, motion });
        if picture.with_map {
            arch.dispatch(Backward::<true> { settings, stage, slots, passed, rows });
        } else {
            arch.dispatch(Backward::<false> { settings, stage, slots, passed, rows });
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
fn start<'a>(states: impl Iterator<Item = &'a MomentRow>) -> Vec<Passed> {
    let one = |state: &MomentRow| Passed {
        transmittance: state.transmittance.map(f32::abs),
        behind: [0.0; TILE],
        ended: state.ended,
    };
    states.map(one).collect()
}

/// One tile's way back. Without `MAP`, the sums that only the map needs stay zero.
struct Backward<'a, const MAP: bool> {
    settings: &'a RasterSettings,
    stage: Stage<'a>,
    /// Of the entries that were visited.
    slots: Slots<'a>,
    /// All moments of the tile's first row, then of the second.
    passed: Vec<Passed>,
    rows: &'a [[Row; PLANES]; TILE],
}

impl<const MAP: bool> WithSimd for Backward<'_, MAP> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { stage, slots: Slots { slots, motion }, mut passed, rows, .. } = self;
        let limits = Limits::new(simd, self.settings);
        let (mut movers, alive) = (mover::none(), mover::all_alive(stage.times));
        let moments = stage.times.count;
        for batch in (0..slots.len().div_ceil(BATCH)).rev() {
            let start = batch * BATCH;
            let count = stage.load(simd, start, &alive, &mut movers).min(slots.len() - start);
            for (k, mover) in movers[..count].iter().enumerate().rev() {
                let mut step = Step {
                    mover,
                    limits: &limits,
                    times: stage.times,
                    value: Value::new(simd, &mover.splat),
                    order: simd.splat_f32s((start + k) as f32),
                    sums: Sums::new(simd),
                    motion_sums: MotionSums::new(simd),
                };
                let [first, end] = mover.rows;
                for row in first..end {
                    let passed = &mut passed[row * moments..][..moments];
                    step.row::<MAP>(simd, row, &rows[row], passed);
                }
                slots[start + k].add(&step.sums.reduce::<MAP>(simd));
                motion[start + k].add(&step.motion_sums.reduce(simd));
            }
        }
    }
}
