//! Adam for a field: sparse for the table, dense for the networks.

use super::{FieldGradient, HashGridField};
use i2slam_compute::{Adam, AdamSettings};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// torch-ngp's constants.
const SETTINGS: AdamSettings = AdamSettings { beta1: 0.9, beta2: 0.99, epsilon: 1e-15 };

/// Parameters per parallel task.
const CHUNK: usize = 1 << 14;

/// Parameters that are looked at together: a line of the cache.
const ROW: usize = 16;

/// Steps that a row of the table goes on by its first moment after its last gradient; 3 % of the
/// moment are left then, and are forgotten.
const COASTING: i32 = 32;

/// The moments of a field's parameters.
#[derive(Clone, Debug)]
pub struct FieldAdam {
    arch: Arch,
    /// First and second moments of the table.
    first: Vec<f32>,
    second: Vec<f32>,
    /// The step of each row's last gradient; negative before the first.
    touched: Vec<i32>,
    density: Adam,
    colour: Adam,
    steps: i32,
}

impl FieldAdam {
    /// An optimiser without history: β = (0.9, 0.99), ε = 1e-15.
    pub fn new() -> Self {
        let adam = || Adam::new(SETTINGS);
        Self {
            arch: Arch::new(),
            first: Vec::new(),
            second: Vec::new(),
            touched: Vec::new(),
            density: adam(),
            colour: adam(),
            steps: 0,
        }
    }

    /// One step against `gradient` with learning rate `rate` (torch-ngp: 1e-2, decayed), after
    /// which the gradient is zero. A gradient that is not finite counts as zero. Numbers of the
    /// table without a gradient go on by their moments, as in torch-ngp, for some steps.
    ///
    /// # Panics
    /// If `gradient` is not of the size of `field`.
    pub fn step(&mut self, field: &mut HashGridField, gradient: &mut FieldGradient, rate: f32) {
        let parameters = &mut field.parameters;
        assert!(gradient.fits(parameters), "a gradient of another field");
        self.steps = self.steps.saturating_add(1);
        let numbers = parameters.table.len();
        self.first.resize(numbers, 0.0);
        self.second.resize(numbers, 0.0);
        self.touched.resize(numbers.div_ceil(ROW), -1);
        let (arch, factors) = (self.arch, Factors::new(self.steps, rate));
        let values = parameters.table.par_chunks_mut(CHUNK);
        let moments = self.first.par_chunks_mut(CHUNK).zip(self.second.par_chunks_mut(CHUNK));
        let touched = self.touched.par_chunks_mut(CHUNK / ROW);
        let slopes = gradient.table.par_chunks_mut(CHUNK);
        values.zip(slopes).zip(moments).zip(touched).for_each(
            |(((values, slopes), (first, second)), touched)| {
                arch.dispatch(Rows { factors: &factors, values, slopes, first, second, touched });
            },
        );
        self.density.step(&mut parameters.density, &gradient.density, rate);
        self.colour.step(&mut parameters.colour, &gradient.colour, rate);
        gradient.density.fill(0.0);
        gradient.colour.fill(0.0);
    }
}

/// Factors of a step, equal for all numbers of a table.
struct Factors {
    step: i32,
    /// The learning rate over what the first moment lacks.
    correct1: f32,
    /// One over what the second moment lacks.
    correct2: f32,
}

impl Factors {
    fn new(step: i32, rate: f32) -> Self {
        let AdamSettings { beta1, beta2, .. } = SETTINGS;
        let correct1 = rate / (1.0 - beta1.powi(step));
        Self { step, correct1, correct2: 1.0 / (1.0 - beta2.powi(step)) }
    }
}

/// One step of the rows of a part of a table.
struct Rows<'a> {
    factors: &'a Factors,
    values: &'a mut [f32],
    slopes: &'a mut [f32],
    first: &'a mut [f32],
    second: &'a mut [f32],
    touched: &'a mut [i32],
}

impl WithSimd for Rows<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) {
        for row in 0..self.touched.len() {
            self.step(row);
        }
    }
}

impl Rows<'_> {
    /// Steps the numbers of a row that has had a gradient in the last [`COASTING`] steps.
    #[inline(always)]
    fn step(&mut self, row: usize) {
        let range = row * ROW..self.values.len().min((row + 1) * ROW);
        let (factors, touched) = (self.factors, &mut self.touched[row]);
        let mut still = true;
        for slope in &self.slopes[range.clone()] {
            still &= *slope == 0.0;
        }
        let idle = factors.step - *touched;
        if still && (*touched < 0 || idle > COASTING) {
            return;
        }
        if idle > COASTING + 1 {
            let faded = SETTINGS.beta2.powi(idle - COASTING - 1);
            let first = &mut self.first[range.clone()];
            for (first, second) in first.iter_mut().zip(&mut self.second[range.clone()]) {
                (*first, *second) = (0.0, faded * *second);
            }
        }
        if !still {
            *touched = factors.step;
        }
        // A length that the compiler knows becomes vectors without a loop.
        match range.len() {
            ROW => self.advance(range.start, ROW),
            count => self.advance(range.start, count),
        }
    }

    /// Adam, without a branch that depends on a number: the loop becomes vectors.
    #[inline(always)]
    fn advance(&mut self, from: usize, count: usize) {
        let AdamSettings { beta1, beta2, epsilon } = SETTINGS;
        let Factors { correct1, correct2, .. } = *self.factors;
        let (values, slopes) =
            (&mut self.values[from..][..count], &mut self.slopes[from..][..count]);
        let (first, second) = (&mut self.first[from..][..count], &mut self.second[from..][..count]);
        for i in 0..count {
            let slope = if slopes[i].is_finite() { slopes[i] } else { 0.0 };
            first[i] = beta1 * first[i] + (1.0 - beta1) * slope;
            second[i] = beta2 * second[i] + (1.0 - beta2) * slope * slope;
            values[i] -= correct1 * first[i] / ((second[i] * correct2).sqrt() + epsilon);
            slopes[i] = 0.0;
        }
    }
}

impl Default for FieldAdam {
    fn default() -> Self {
        Self::new()
    }
}

/// torch-ngp's schedule: `initial · 0.1^(step / horizon)`, with a horizon of 30 000 steps there.
pub fn decayed_rate(initial: f32, step: i32, horizon: i32) -> f32 {
    initial * 0.1_f32.powf(step as f32 / horizon.max(1) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hashgrid::FieldSettings;
    use i2slam_compute::simd::instruction_sets;

    #[test]
    fn entries_move_while_they_have_momentum() {
        let settings = FieldSettings { log2_table: 6, ..FieldSettings::cube([0.0; 3], 1.0) };
        let mut field = HashGridField::new(settings, 1).expect("settings");
        let mut gradient = FieldGradient::zeros(&field);
        let (before, mut adam) = (field.clone(), FieldAdam::new());
        (gradient.table[5], gradient.table[9]) = (2.0, f32::NAN);
        adam.step(&mut field, &mut gradient, 0.1);
        let moved = |i: usize| field.parameters.table[i] - before.parameters.table[i];
        assert!((moved(5) + 0.1).abs() < 1e-5);
        assert!((0..100).filter(|&i| i != 5).all(|i| moved(i) == 0.0));
        assert!(gradient.table.iter().all(|g| *g == 0.0));
        let once = field.clone();
        adam.step(&mut field, &mut gradient, 0.1);
        let coasts = |i: usize| field.parameters.table[i] < once.parameters.table[i];
        assert!((0..100).all(|i| coasts(i) == (i == 5)));
        for _ in 0..2 * COASTING {
            adam.step(&mut field, &mut gradient, 0.1);
        }
        let rest = field.clone();
        adam.step(&mut field, &mut gradient, 0.1);
        assert_eq!(rest.parameters.table, field.parameters.table);
    }

    /// The table moves as with an optimiser of all numbers, in the short last row too.
    #[test]
    fn rare_gradients_move_the_table_as_dense_adam() {
        let settings = FieldSettings { log2_table: 13, ..FieldSettings::cube([0.0; 3], 1.0) };
        let start = HashGridField::new(settings, 1).expect("settings");
        let last = start.parameters.table.len() - 1;
        assert!(last > 5 * CHUNK && !(last + 1).is_multiple_of(ROW));
        // Entries with a gradient in every step, every 7th, every 60th.
        let every = |step: usize| {
            [(1, 1e-4), (7, 1e-4), (60, 0.03)].map(|(n, close)| (step.is_multiple_of(n), close))
        };
        let entries =
            [[3, 40, 80], [CHUNK, 2 * CHUNK - 1, 5 * CHUNK + 100], [last, last - 20, last - 40]];
        for arch in instruction_sets() {
            let mut field = start.clone();
            let mut gradient = FieldGradient::zeros(&field);
            let (mut adam, mut dense) =
                (FieldAdam { arch, ..FieldAdam::new() }, Adam::new(SETTINGS));
            let mut values = start.parameters.table.clone();
            for step in 0..150_usize {
                for of in entries {
                    for (entry, (now, _)) in of.into_iter().zip(every(step)) {
                        gradient.table[entry] = if now { 0.5 + (step % 3) as f32 } else { 0.0 };
                    }
                }
                dense.step(&mut values, &gradient.table, 0.01);
                adam.step(&mut field, &mut gradient, 0.01);
            }
            for (entry, (_, close)) in
                entries.into_iter().flat_map(|of| of.into_iter().zip(every(0)))
            {
                let moved = field.parameters.table[entry] - values[entry];
                let way = start.parameters.table[entry] - values[entry];
                assert!(way.abs() > 0.1, "{arch:?} {entry} hardly moves: {way}");
                assert!(moved.abs() < close * way.abs(), "{arch:?} {entry}: {moved} of {way}");
            }
        }
    }

    #[test]
    fn the_rate_falls_tenfold_over_the_horizon() {
        assert_eq!(decayed_rate(1e-2, 0, 30_000), 1e-2);
        assert!((decayed_rate(1e-2, 30_000, 30_000) - 1e-3).abs() < 1e-8);
    }
}
