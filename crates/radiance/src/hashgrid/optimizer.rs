//! Adam for a field: sparse for the table, dense for the networks.

use super::{FieldGradient, HashGridField};
use i2slam_compute::{Adam, AdamSettings};
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
    /// First and second moment.
    table: Vec<[f32; 2]>,
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
        Self { table: Vec::new(), touched: Vec::new(), density: adam(), colour: adam(), steps: 0 }
    }

    /// Number of steps so far.
    pub fn steps(&self) -> i32 {
        self.steps
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
        self.table.resize(parameters.table.len(), [0.0; 2]);
        self.touched.resize(parameters.table.len().div_ceil(ROW), -1);
        let row = Row::new(self.steps, rate);
        let rows = gradient.table.par_chunks_mut(CHUNK).zip(self.table.par_chunks_mut(CHUNK));
        let values = parameters.table.par_chunks_mut(CHUNK);
        values.zip(rows).zip(self.touched.par_chunks_mut(CHUNK / ROW)).for_each(
            |((values, (gradient, moments)), touched)| {
                let rows = gradient.chunks_mut(ROW).zip(moments.chunks_mut(ROW));
                for ((values, rows), touched) in values.chunks_mut(ROW).zip(rows).zip(touched) {
                    row.step(values, rows, touched);
                }
            },
        );
        self.density.step(&mut parameters.density, &gradient.density, rate);
        self.colour.step(&mut parameters.colour, &gradient.colour, rate);
        gradient.density.fill(0.0);
        gradient.colour.fill(0.0);
    }
}

/// One step of the rows of a table.
struct Row {
    step: i32,
    /// The learning rate over what the first moment lacks.
    correct1: f32,
    /// One over what the second moment lacks.
    correct2: f32,
}

impl Row {
    fn new(step: i32, rate: f32) -> Self {
        let AdamSettings { beta1, beta2, .. } = SETTINGS;
        let correct1 = rate / (1.0 - beta1.powi(step));
        Self { step, correct1, correct2: 1.0 / (1.0 - beta2.powi(step)) }
    }

    /// Steps numbers that have had a gradient in the last [`COASTING`] steps.
    fn step(
        &self,
        values: &mut [f32],
        (gradient, moments): (&mut [f32], &mut [[f32; 2]]),
        touched: &mut i32,
    ) {
        let still = gradient.iter().fold(true, |zero, g| zero & (*g == 0.0));
        let idle = self.step - *touched;
        if still && (*touched < 0 || idle > COASTING) {
            return;
        }
        let AdamSettings { beta1, beta2, epsilon } = SETTINGS;
        if idle > COASTING + 1 {
            let faded = beta2.powi(idle - COASTING - 1);
            moments.iter_mut().for_each(|m| *m = [0.0, faded * m[1]]);
        }
        if !still {
            *touched = self.step;
        }
        for ((value, g), [first, second]) in values.iter_mut().zip(gradient).zip(moments) {
            let slope = if g.is_finite() { *g } else { 0.0 };
            *first = beta1 * *first + (1.0 - beta1) * slope;
            *second = beta2 * *second + (1.0 - beta2) * slope * slope;
            *value -= self.correct1 * *first / ((*second * self.correct2).sqrt() + epsilon);
            *g = 0.0;
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

    /// The table moves as an optimiser of all numbers moves it, up to what is forgotten.
    #[test]
    fn rare_gradients_move_the_table_as_dense_adam() {
        let settings = FieldSettings { log2_table: 6, ..FieldSettings::cube([0.0; 3], 1.0) };
        let mut field = HashGridField::new(settings, 1).expect("settings");
        let mut gradient = FieldGradient::zeros(&field);
        let start = field.parameters.table.clone();
        let (mut adam, mut dense) = (FieldAdam::new(), Adam::new(SETTINGS));
        let mut values = start.clone();
        for step in 0..150_usize {
            // Entries with a gradient in every step, every 7th, every 60th.
            for (entry, every) in [(3, 1), (40, 7), (80, 60)] {
                if step % every == 0 {
                    gradient.table[entry] = 0.5 + (step % 3) as f32;
                }
            }
            dense.step(&mut values, &gradient.table, 0.01);
            adam.step(&mut field, &mut gradient, 0.01);
        }
        for (entry, close) in [(3, 1e-4), (40, 1e-4), (80, 0.03)] {
            let moved = field.parameters.table[entry] - values[entry];
            let way = start[entry] - values[entry];
            assert!(moved.abs() < close * way.abs(), "{entry}: {moved} of {way}");
        }
    }

    #[test]
    fn the_rate_falls_tenfold_over_the_horizon() {
        assert_eq!(decayed_rate(1e-2, 0, 30_000), 1e-2);
        assert!((decayed_rate(1e-2, 30_000, 30_000) - 1e-3).abs() < 1e-8);
    }
}
