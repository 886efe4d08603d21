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

/// The moments of a field's parameters. A number of the table whose gradient is exactly zero, as
/// of every entry that no sample touched, keeps its value and its moments.
#[derive(Clone, Debug)]
pub struct FieldAdam {
    /// First and second moment.
    table: Vec<[f32; 2]>,
    density: Adam,
    colour: Adam,
    steps: i32,
}

impl FieldAdam {
    /// An optimiser without history: β = (0.9, 0.99), ε = 1e-15.
    pub fn new() -> Self {
        let adam = || Adam::new(SETTINGS);
        Self { table: Vec::new(), density: adam(), colour: adam(), steps: 0 }
    }

    /// Number of steps so far.
    pub fn steps(&self) -> i32 {
        self.steps
    }

    /// One step against `gradient` with learning rate `rate` (torch-ngp: 1e-2, decayed), after
    /// which the gradient is zero. An entry whose gradient is not finite keeps its value.
    ///
    /// # Panics
    /// If `gradient` is not of the size of `field`.
    pub fn step(&mut self, field: &mut HashGridField, gradient: &mut FieldGradient, rate: f32) {
        let parameters = &mut field.parameters;
        assert!(gradient.fits(parameters), "a gradient of another field");
        self.steps = self.steps.saturating_add(1);
        self.table.resize(parameters.table.len(), [0.0; 2]);
        let AdamSettings { beta1, beta2, epsilon } = SETTINGS;
        let correct1 = rate / (1.0 - beta1.powi(self.steps));
        let correct2 = 1.0 / (1.0 - beta2.powi(self.steps));
        let rows = gradient.table.par_chunks_mut(CHUNK).zip(self.table.par_chunks_mut(CHUNK));
        parameters.table.par_chunks_mut(CHUNK).zip(rows).for_each(
            |(values, (gradient, moments))| {
                let rows = gradient.chunks_mut(ROW).zip(moments.chunks_mut(ROW));
                for (values, (gradient, moments)) in values.chunks_mut(ROW).zip(rows) {
                    if gradient.iter().fold(true, |zero, g| zero & (*g == 0.0)) {
                        continue;
                    }
                    for ((value, g), [first, second]) in
                        values.iter_mut().zip(gradient).zip(moments)
                    {
                        if *g != 0.0 && g.is_finite() {
                            *first = beta1 * *first + (1.0 - beta1) * *g;
                            *second = beta2 * *second + (1.0 - beta2) * *g * *g;
                            *value -= correct1 * *first / ((*second * correct2).sqrt() + epsilon);
                        }
                        *g = 0.0;
                    }
                }
            },
        );
        self.density.step(&mut parameters.density, &gradient.density, rate);
        self.colour.step(&mut parameters.colour, &gradient.colour, rate);
        gradient.density.fill(0.0);
        gradient.colour.fill(0.0);
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
    fn only_touched_entries_move() {
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
        assert_eq!(once.parameters.table, field.parameters.table);
    }

    #[test]
    fn the_rate_falls_tenfold_over_the_horizon() {
        assert_eq!(decayed_rate(1e-2, 0, 30_000), 1e-2);
        assert!((decayed_rate(1e-2, 30_000, 30_000) - 1e-3).abs() < 1e-8);
    }
}
