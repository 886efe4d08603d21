//! Occupancy grid: the cells of the cube that may hold something.

use super::Ray;
use super::ray::cube_range;
use crate::hashgrid::{FieldRenderer, HashGridField, OccupancySettings};
use i2slam_compute::Random;
use i2slam_geometry::Vec3;

/// A grid over a field's cube that remembers densities, so that empty space is marched over.
#[derive(Clone, Debug, PartialEq)]
pub struct Occupancy {
    settings: OccupancySettings,
    /// Remembered density \[1/m\] of each cell, x fastest.
    densities: Vec<f32>,
    /// One bit per cell.
    occupied: Vec<u64>,
    /// True for blocks with an occupied cell; the others are crossed in long steps.
    blocks: Vec<bool>,
    updates: u32,
    /// The cells that may ever be occupied; all if empty.
    allowed: Vec<u64>,
}

/// Cells along an edge of a block.
const BLOCK: u32 = 8;

/// Cells that are looked at in one go.
const CELLS: usize = 1 << 16;

impl Occupancy {
    /// A grid whose cells, 1 to 512 along an edge, all count as occupied until the first update.
    pub fn new(settings: OccupancySettings) -> Self {
        let resolution = settings.resolution.clamp(1, 512);
        let cells = (resolution as usize).pow(3);
        Self {
            settings: OccupancySettings { resolution, ..settings },
            densities: vec![0.0; cells],
            occupied: all_bits(cells),
            blocks: vec![true; (resolution.div_ceil(BLOCK) as usize).pow(3)],
            updates: 0,
            allowed: Vec::new(),
        }
    }

    /// A grid over the cube of half edge `bound` \[m\] around `centre` in which exactly the cells
    /// whose middle `is_occupied` accepts are occupied until the first update.
    pub fn of_cells(
        centre: [f64; 3],
        bound: f64,
        settings: OccupancySettings,
        is_occupied: impl Fn(Vec3<f32>) -> bool,
    ) -> Self {
        let mut occupancy = Self::new(settings);
        let resolution = occupancy.settings.resolution as usize;
        let middle = |k: usize, i: usize| {
            centre[k] + bound * (2.0 * (i as f64 + 0.5) / resolution as f64 - 1.0)
        };
        occupancy.clear();
        for cell in 0..occupancy.densities.len() {
            let index = [cell % resolution, cell / resolution % resolution];
            let [x, y] = [middle(0, index[0]), middle(1, index[1])];
            let z = middle(2, cell / (resolution * resolution));
            if is_occupied(Vec3::new(x, y, z).cast()) {
                occupancy.occupy(cell);
            }
        }
        occupancy
    }

    /// A grid whose cells are all empty until one is marked.
    pub fn empty(settings: OccupancySettings) -> Self {
        let mut occupancy = Self { updates: 1, ..Self::new(settings) };
        occupancy.clear();
        occupancy
    }

    /// From now on no cell is occupied that `others`, a grid of as many cells over the same cube,
    /// has empty, as where surfaces are known. Files keep what that has emptied, not the rule.
    ///
    /// # Panics
    /// If the grids differ in their cells.
    pub fn restrict_to(&mut self, others: &Self) {
        assert_eq!(self.settings.resolution, others.settings.resolution, "grids of other cells");
        let before = std::mem::replace(&mut self.allowed, others.occupied.clone());
        for cell in 0..self.densities.len() {
            let allows = |cells: &[u64]| cells.is_empty() || is_set(cells, cell);
            match (allows(&before), allows(&self.allowed)) {
                (_, false) => self.densities[cell] = 0.0,
                (false, true) => {
                    self.densities[cell] = self.settings.density;
                    self.occupied[cell / 64] |= 1 << (cell % 64);
                }
                (true, true) => {}
            }
        }
        self.occupied.iter_mut().zip(&self.allowed).for_each(|(bits, allowed)| *bits &= allowed);
        self.blocks.fill(false);
        let occupied: Vec<usize> = set_bits(&self.occupied).collect();
        occupied.into_iter().for_each(|cell| self.occupy(cell));
    }

    /// Occupies all allowed cells for about `updates` updates: emptied ones get samples again.
    pub fn reopen(&mut self, updates: i32) {
        let density = self.density_for(updates);
        let cells: Vec<usize> = self.allowed_cells().collect();
        cells.into_iter().for_each(|cell| self.occupy_with(cell, density));
    }

    /// The cells that may be occupied, in order.
    fn allowed_cells(&self) -> impl Iterator<Item = usize> + '_ {
        let all = if self.allowed.is_empty() { 0..self.densities.len() } else { 0..0 };
        all.chain(set_bits(&self.allowed))
    }

    fn clear(&mut self) {
        self.occupied.fill(0);
        self.blocks.fill(false);
    }

    fn occupy(&mut self, cell: usize) {
        self.occupied[cell / 64] |= 1 << (cell % 64);
        let resolution = self.settings.resolution as usize;
        let [x, y] = [cell % resolution, cell / resolution % resolution];
        let block = self.block([x, y, cell / (resolution * resolution)]);
        self.blocks[block] = true;
    }

    /// Index of the block of a cell.
    fn block(&self, cell: [usize; 3]) -> usize {
        let blocks = self.settings.resolution.div_ceil(BLOCK) as usize;
        let [x, y, z] = cell.map(|i| i / BLOCK as usize);
        (z * blocks + y) * blocks + x
    }

    /// Occupies the cells that a ray crosses between two depths until updates forget them.
    pub fn mark_cells(&mut self, field: &HashGridField, ray: &Ray, from: f32, to: f32) {
        self.updates = self.updates.max(1);
        let density = self.settings.density;
        self.visit_crossed(field, ray, (from, to), |occupancy, cell| {
            occupancy.occupy_with(cell, density)
        });
    }

    /// Occupies the allowed cells that a ray crosses for about `updates` updates.
    pub fn reopen_along(&mut self, field: &HashGridField, ray: &Ray, updates: i32) {
        let density = self.density_for(updates);
        self.visit_crossed(field, ray, (0.0, f32::MAX), |occupancy, cell| {
            if occupancy.allowed.is_empty() || is_set(&occupancy.allowed, cell) {
                occupancy.occupy_with(cell, density);
            }
        });
    }

    /// The density of a cell that stays occupied for about `updates` updates.
    fn density_for(&self, updates: i32) -> f32 {
        self.settings.density / self.settings.decay.powi(updates)
    }

    /// Occupies a cell, remembering at least a density.
    fn occupy_with(&mut self, cell: usize, density: f32) {
        self.densities[cell] = self.densities[cell].max(density);
        self.occupy(cell);
    }

    /// Visits the cells that a ray crosses between two depths \[units of its direction\].
    fn visit_crossed(
        &mut self,
        field: &HashGridField,
        ray: &Ray,
        (from, to): (f32, f32),
        mut visit: impl FnMut(&mut Self, usize),
    ) {
        let length = ray.direction.norm();
        if !(from <= to && ray.origin.is_finite() && length.is_finite() && length > 0.0) {
            return;
        }
        let (scale, offset) = field.to_unit();
        let (o, d) = (ray.origin.to_array(), ray.direction.to_array());
        let origin = std::array::from_fn(|k| o[k] * scale + offset[k]);
        let direction = d.map(|d| d * scale);
        let inverse = direction.map(|d| 1.0 / d);
        let (enter, leave) = cube_range(origin, direction);
        let (mut depth, to) = (from.max(enter), to.min(leave));
        // What takes a position clearly beyond the side of a cell.
        let least = 1e-3 / (length * scale * self.settings.resolution as f32);
        while depth <= to {
            let place: [f32; 3] = std::array::from_fn(|k| origin[k] + depth * direction[k]);
            let cell = self.cell(place);
            visit(self, cell);
            let step = self.end(place, inverse, place.map(|x| self.coordinate(x)), 1).max(least);
            // Far away the step may be lost in rounding.
            depth = (depth + step).max(depth.next_up());
        }
    }

    /// A grid with densities that it remembered after `updates` updates.
    pub(crate) fn restored(settings: OccupancySettings, densities: Vec<f32>, updates: u32) -> Self {
        let mut occupancy = Self { densities, updates, ..Self::new(settings) };
        if updates > 0 {
            occupancy.update_bits();
        }
        occupancy
    }

    /// Number of updates so far.
    pub fn updates(&self) -> u32 {
        self.updates
    }

    /// The settings.
    pub fn settings(&self) -> &OccupancySettings {
        &self.settings
    }

    /// The remembered densities \[1/m\] of all cells, x fastest.
    pub fn densities(&self) -> &[f32] {
        &self.densities
    }

    /// Share of the cells that are occupied, in `[0, 1]`.
    pub fn occupied_share(&self) -> f64 {
        let cells = 0..self.densities.len();
        cells.clone().filter(|&cell| self.bit(cell)).count() as f64 / cells.len() as f64
    }

    fn bit(&self, cell: usize) -> bool {
        is_set(&self.occupied, cell)
    }

    /// True if the cell of a position in the unit cube is occupied; outside, the nearest cell.
    #[cfg(test)]
    pub(crate) fn is_occupied(&self, position: [f32; 3]) -> bool {
        self.bit(self.cell(position))
    }

    /// Depth from a position in the unit cube (outside: of the nearest cell) to the end of its
    /// empty cell or block; none if occupied. `inverse` is one over each part of the direction.
    pub(crate) fn empty_until(&self, position: [f32; 3], inverse: [f32; 3]) -> Option<f32> {
        let resolution = self.settings.resolution as usize;
        let cell = position.map(|x| self.coordinate(x));
        let [x, y, z] = cell.map(|i| i as usize);
        if !self.blocks[self.block([x, y, z])] {
            return Some(self.end(position, inverse, cell.map(|i| i / BLOCK), BLOCK));
        }
        let occupied = self.bit((z * resolution + y) * resolution + x);
        (!occupied).then(|| self.end(position, inverse, cell, 1))
    }

    /// Depth from a position to the end of a box of `edge` cells, the `index`-th along each axis.
    fn end(&self, position: [f32; 3], inverse: [f32; 3], index: [u32; 3], edge: u32) -> f32 {
        let size = edge as f32 / self.settings.resolution as f32;
        (0..3).fold(f32::MAX, |end, k| {
            let side = if inverse[k] > 0.0 { index[k] as f32 + 1.0 } else { index[k] as f32 };
            let depth = (side * size - position[k]) * inverse[k];
            // NaN where the direction has no part along the axis.
            if depth < end { depth.max(0.0) } else { end }
        })
    }

    /// Index of the cell of a position in the unit cube; outside, of the nearest one.
    fn cell(&self, position: [f32; 3]) -> usize {
        let resolution = self.settings.resolution as usize;
        let [x, y, z] = position.map(|x| self.coordinate(x) as usize);
        (z * resolution + y) * resolution + x
    }

    /// Index along an axis.
    fn coordinate(&self, x: f32) -> u32 {
        ((x * self.settings.resolution as f32) as u32).min(self.settings.resolution - 1)
    }

    /// Samples the field again at a random place of some cells: all of them the first
    /// [`full_updates`](OccupancySettings::full_updates) times, later a random quarter of all and
    /// as many occupied ones. Of the decayed old and the new density the larger is kept. Cells that
    /// are not [allowed](Self::restrict_to) are left out. torch-ngp updates every 16 steps.
    pub fn refresh(&mut self, field: &HashGridField, renderer: &mut FieldRenderer, seed: u64) {
        let mut random = Random::new(seed ^ (u64::from(self.updates) << 32));
        let mut chosen: Vec<usize> = self.allowed_cells().collect();
        if self.updates >= self.settings.full_updates {
            let quarter = (chosen.len() / 4).max(1);
            let occupied: Vec<usize> = chosen.iter().copied().filter(|&c| self.bit(c)).collect();
            let mut draw = |from: &[usize]| -> Vec<usize> {
                let count = if from.is_empty() { 0 } else { quarter };
                (0..count).map(|_| from[random.below(from.len())]).collect()
            };
            chosen = [draw(&chosen), draw(&occupied)].concat();
            chosen.sort_unstable();
            chosen.dedup();
        }
        chosen
            .chunks(CELLS)
            .for_each(|part| self.sample_densities(field, renderer, &mut random, part));
        self.updates = self.updates.saturating_add(1);
        self.update_bits();
    }

    fn sample_densities(
        &mut self,
        field: &HashGridField,
        renderer: &mut FieldRenderer,
        random: &mut Random,
        cells: &[usize],
    ) {
        let resolution = self.settings.resolution as usize;
        let size = 1.0 / resolution as f32;
        let mut place = |cell: usize| {
            let index = [cell % resolution, cell / resolution % resolution, cell];
            let index = [index[0], index[1], index[2] / (resolution * resolution)];
            index.map(|i| (i as f32 + random.uniform() as f32) * size)
        };
        let positions: Vec<[f32; 3]> = cells.iter().map(|&cell| place(cell)).collect();
        for (&cell, density) in cells.iter().zip(renderer.unit_densities(field, &positions)) {
            let kept = self.densities[cell] * self.settings.decay;
            self.densities[cell] = if density.is_finite() { kept.max(density) } else { kept };
        }
    }

    fn update_bits(&mut self) {
        let density = |cell: usize| self.densities[cell];
        let cells: Vec<usize> = self.allowed_cells().filter(|&cell| density(cell) > 0.0).collect();
        let sum: f64 = cells.iter().map(|&cell| f64::from(density(cell))).sum();
        let mean = (sum / cells.len().max(1) as f64) as f32;
        let threshold = (0.5 * mean).min(self.settings.density);
        self.clear();
        for cell in cells {
            if self.densities[cell] >= threshold {
                self.occupy(cell);
            }
        }
    }
}

/// Words of which the first `count` bits are set.
fn all_bits(count: usize) -> Vec<u64> {
    let mut words = vec![u64::MAX; count.div_ceil(64)];
    if let (Some(last), rest @ 1..) = (words.last_mut(), count % 64) {
        *last = (1 << rest) - 1;
    }
    words
}

fn is_set(words: &[u64], bit: usize) -> bool {
    words[bit / 64] >> (bit % 64) & 1 == 1
}

/// The numbers of the bits that are set.
fn set_bits(words: &[u64]) -> impl Iterator<Item = usize> + '_ {
    words.iter().enumerate().flat_map(|(word, &bits)| {
        let rest = |bits: &u64| Some(bits & (bits - 1)).filter(|rest| *rest != 0);
        let words = std::iter::successors((bits != 0).then_some(bits), rest);
        words.map(move |bits| 64 * word + bits.trailing_zeros() as usize)
    })
}
