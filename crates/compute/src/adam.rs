//! Adam (Kingma and Ba 2015) on flat slices of parameters.

use rayon::prelude::*;

/// Constants of Adam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdamSettings {
    /// Decay of the first moment.
    pub beta1: f32,
    /// Decay of the second moment.
    pub beta2: f32,
    /// Added to the root of the second moment.
    pub epsilon: f32,
}

impl Default for AdamSettings {
    fn default() -> Self {
        Self { beta1: 0.9, beta2: 0.999, epsilon: 1e-8 }
    }
}

/// Moments of a group of parameters that share their step count.
#[derive(Clone, Debug, Default)]
pub struct Adam {
    settings: AdamSettings,
    first: Vec<f32>,
    second: Vec<f32>,
    steps: i32,
}

/// Parameters per parallel task.
const CHUNK: usize = 1 << 14;

impl Adam {
    /// An optimiser without history.
    pub fn new(settings: AdamSettings) -> Self {
        Self { settings, ..Self::default() }
    }

    /// Forget the history.
    pub fn reset(&mut self) {
        self.first.clear();
        self.second.clear();
        self.steps = 0;
    }

    /// One step against `gradient`, with learning rate `rate`, in the units of the parameters.
    /// Parameters appended since the last step start with zero moments. An entry whose gradient
    /// is not finite keeps its value.
    pub fn step(&mut self, parameters: &mut [f32], gradient: &[f32], rate: f32) {
        assert_eq!(parameters.len(), gradient.len(), "one gradient per parameter");
        self.first.resize(parameters.len(), 0.0);
        self.second.resize(parameters.len(), 0.0);
        self.steps += 1;
        let AdamSettings { beta1, beta2, epsilon } = self.settings;
        let correct1 = 1.0 / (1.0 - beta1.powi(self.steps));
        let correct2 = 1.0 / (1.0 - beta2.powi(self.steps));
        parameters
            .par_chunks_mut(CHUNK)
            .zip(gradient.par_chunks(CHUNK))
            .zip(self.first.par_chunks_mut(CHUNK).zip(self.second.par_chunks_mut(CHUNK)))
            .for_each(|((parameters, gradient), (first, second))| {
                for i in 0..parameters.len() {
                    let g = if gradient[i].is_finite() { gradient[i] } else { 0.0 };
                    first[i] = beta1 * first[i] + (1.0 - beta1) * g;
                    second[i] = beta2 * second[i] + (1.0 - beta2) * g * g;
                    let scale = (second[i] * correct2).sqrt() + epsilon;
                    parameters[i] -= rate * first[i] * correct1 / scale;
                }
            });
    }

    /// One step of the elements, `width` parameters each, whose age is not zero: an element of age
    /// `n` takes its `n`-th step, so its moments are corrected as those of an optimiser of its
    /// own. All others keep parameters and moments.
    pub fn step_elements(
        &mut self,
        parameters: &mut [f32],
        gradient: &[f32],
        rate: f32,
        width: usize,
        ages: &[u32],
    ) {
        assert_eq!(parameters.len(), gradient.len(), "one gradient per parameter");
        assert_eq!(parameters.len(), width * ages.len(), "one age per element");
        self.first.resize(parameters.len(), 0.0);
        self.second.resize(parameters.len(), 0.0);
        let AdamSettings { beta1, beta2, epsilon } = self.settings;
        let oldest = ages.iter().copied().max().unwrap_or(0);
        let correction = |beta: f32, age: u32| 1.0 / (1.0 - beta.powi(age as i32));
        let corrections: Vec<(f32, f32)> =
            (0..=oldest).map(|age| (correction(beta1, age), correction(beta2, age))).collect();
        let chunk = CHUNK / width * width;
        parameters
            .par_chunks_mut(chunk)
            .zip(gradient.par_chunks(chunk))
            .zip(self.first.par_chunks_mut(chunk).zip(self.second.par_chunks_mut(chunk)))
            .zip(ages.par_chunks(chunk / width))
            .for_each(|(((parameters, gradient), (first, second)), ages)| {
                let moving = ages.iter().enumerate().filter(|(_, age)| **age > 0);
                for (element, &age) in moving {
                    let (correct1, correct2) = corrections[age as usize];
                    for i in element * width..(element + 1) * width {
                        let g = if gradient[i].is_finite() { gradient[i] } else { 0.0 };
                        first[i] = beta1 * first[i] + (1.0 - beta1) * g;
                        second[i] = beta2 * second[i] + (1.0 - beta2) * g * g;
                        let scale = (second[i] * correct2).sqrt() + epsilon;
                        parameters[i] -= rate * first[i] * correct1 / scale;
                    }
                }
            });
    }

    /// Drop the moments of removed elements of `width` parameters each.
    pub fn retain(&mut self, keep: &[bool], width: usize) {
        for moments in [&mut self.first, &mut self.second] {
            moments.resize(keep.len() * width, 0.0);
            let mut index = 0;
            moments.retain(|_| {
                index += 1;
                keep[(index - 1) / width]
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_step_has_the_length_of_the_rate() {
        let mut x = [1.0, -2.0];
        Adam::new(AdamSettings::default()).step(&mut x, &[0.3, -40.0], 0.1);
        assert!((x[0] - 0.9).abs() < 1e-5 && (x[1] + 1.9).abs() < 1e-5);
    }

    #[test]
    fn finds_the_minimum_of_a_bowl() {
        let mut x = [3.0, -4.0];
        let mut adam = Adam::new(AdamSettings::default());
        for _ in 0..800 {
            let gradient = [2.0 * (x[0] - 1.0), 20.0 * (x[1] - 2.0)];
            adam.step(&mut x, &gradient, 0.05);
        }
        assert!((x[0] - 1.0).abs() < 1e-2 && (x[1] - 2.0).abs() < 1e-2);
    }

    #[test]
    fn a_poisoned_gradient_changes_nothing() {
        let mut x = [1.0];
        Adam::new(AdamSettings::default()).step(&mut x, &[f32::NAN], 0.1);
        assert_eq!(x, [1.0]);
    }

    #[test]
    fn elements_step_as_if_each_had_its_own_optimiser() {
        let settings = AdamSettings::default();
        let (mut together, mut alone) = (Adam::new(settings), Adam::new(settings));
        let (mut x, mut y) = ([1.0, 2.0, 5.0, 6.0], [5.0, 6.0]);
        together.step_elements(&mut x, &[0.3, 0.1, 9.0, 9.0], 0.1, 2, &[1, 0]);
        assert_eq!(x[2..], [5.0, 6.0]);
        for (age, g) in [(1, [0.5, -0.2]), (2, [0.1, 0.4])] {
            together.step_elements(&mut x, &[7.0, 7.0, g[0], g[1]], 0.1, 2, &[0, age]);
            alone.step(&mut y, &g, 0.1);
        }
        assert!((x[2] - y[0]).abs() < 1e-6 && (x[3] - y[1]).abs() < 1e-6);
        assert!((x[0] - 0.9).abs() < 1e-5);
    }

    #[test]
    fn retain_drops_the_moments_of_removed_elements() {
        let mut adam = Adam::new(AdamSettings::default());
        let mut x = [0.0; 4];
        adam.step(&mut x, &[1.0, 2.0, 3.0, 4.0], 0.1);
        adam.retain(&[false, true], 2);
        assert_eq!(adam.first.len(), 2);
        assert!((adam.first[0] - 0.3).abs() < 1e-6);
    }
}
