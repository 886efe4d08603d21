//! Adam (Kingma and Ba 2015) on flat slices of parameters.

use pulp::Arch;
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
    steps: u32,
    /// Factors of both moments by age.
    corrections: Vec<(f32, f32)>,
}

/// Parameters per parallel task.
const CHUNK: usize = 1 << 14;
/// Age from which the usual moments have no bias left in `f32`: 0.999 to it is 1e-9.
const UNBIASED: u32 = 20_800;

impl AdamSettings {
    /// Steps a block. No branch depends on a number, so that the loop becomes vectors.
    #[inline(always)]
    fn advance(
        self,
        parameters: &mut [f32],
        gradient: &[f32],
        (first, second): (&mut [f32], &mut [f32]),
        factors: &Factors,
    ) {
        let count = parameters.len();
        let (gradient, first) = (&gradient[..count], &mut first[..count]);
        let (second, moves) = (&mut second[..count], &factors.moves[..count]);
        let rates = &factors.rates[..count];
        let (correct1, correct2) = (&factors.first[..count], &factors.second[..count]);
        for i in 0..count {
            let g = if gradient[i].is_finite() { gradient[i] } else { 0.0 };
            let m = self.beta1 * first[i] + (1.0 - self.beta1) * g;
            let v = self.beta2 * second[i] + (1.0 - self.beta2) * g * g;
            let step = rates[i] * m * correct1[i] / ((v * correct2[i]).sqrt() + self.epsilon);
            first[i] = if moves[i] { m } else { first[i] };
            second[i] = if moves[i] { v } else { second[i] };
            parameters[i] = if moves[i] { parameters[i] - step } else { parameters[i] };
        }
    }
}

/// Parameters that are stepped together.
const BLOCK: usize = 192;

/// For each parameter of a block, whether it moves, its learning rate, and what corrects the bias of its moments.
struct Factors {
    moves: [bool; BLOCK],
    rates: [f32; BLOCK],
    first: [f32; BLOCK],
    second: [f32; BLOCK],
}

impl Factors {
    #[inline(always)]
    fn new(
        ages: &[u32],
        width: usize,
        corrections: &[(f32, f32)],
        rate: impl Fn(usize) -> f32,
    ) -> Self {
        let (rates, ones) = ([0.0; BLOCK], [1.0; BLOCK]);
        let mut factors = Self { moves: [false; BLOCK], rates, first: ones, second: ones };
        for (element, &age) in ages.iter().enumerate().filter(|(_, age)| **age > 0) {
            let (first, second) = corrections[(age as usize).min(corrections.len() - 1)];
            let rate = rate(element);
            for i in element * width..(element + 1) * width {
                (factors.moves[i], factors.rates[i]) = (true, rate);
                (factors.first[i], factors.second[i]) = (first, second);
            }
        }
        factors
    }
}

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

    /// Changes the coordinates of element number `element`, `N` parameters, by a rotation: the first
    /// moment by `R m`, the second, whose off-diagonal terms are not kept, by `Σ R²ᵢⱼ vⱼ`.
    pub fn rotate<const N: usize>(&mut self, element: usize, rotation: &[[f32; N]; N]) {
        let range = element * N..(element + 1) * N;
        let moments = (self.first.get_mut(range.clone()), self.second.get_mut(range));
        let (Some(first), Some(second)) = moments else { return };
        let (m, v): ([f32; N], [f32; N]) =
            (std::array::from_fn(|i| first[i]), std::array::from_fn(|i| second[i]));
        for (i, row) in rotation.iter().enumerate() {
            first[i] = row.iter().zip(m).map(|(r, m)| r * m).sum();
            second[i] = row.iter().zip(v).map(|(r, v)| r * r * v).sum();
        }
    }

    /// One step against `gradient`, with learning rate `rate`, in the units of the parameters.
    /// Parameters appended since the last step start with zero moments. An entry whose gradient
    /// is not finite counts as zero.
    pub fn step(&mut self, parameters: &mut [f32], gradient: &[f32], rate: f32) {
        self.steps += 1;
        let ages = vec![self.steps; parameters.len()];
        self.step_elements(parameters, gradient, |_| rate, 1, &ages);
    }

    /// One step of the elements, `width` (at most 192) parameters each, whose age is not zero: one
    /// of age `n` takes its `n`-th step, as in an optimiser of its own, with the learning rate that
    /// `rate` gives for its index. Others keep their state.
    pub fn step_elements(
        &mut self,
        parameters: &mut [f32],
        gradient: &[f32],
        rate: impl Fn(usize) -> f32 + Sync,
        width: usize,
        ages: &[u32],
    ) {
        assert_eq!(parameters.len(), gradient.len(), "one gradient per parameter");
        assert_eq!(parameters.len(), width * ages.len(), "one age per element");
        assert!(width <= BLOCK, "at most {BLOCK} parameters per element");
        self.first.resize(parameters.len(), 0.0);
        self.second.resize(parameters.len(), 0.0);
        self.correct_up_to(ages.iter().copied().max().unwrap_or(0));
        let (settings, corrections, arch) = (self.settings, &self.corrections, Arch::new());
        let elements = (CHUNK / width.max(1)).max(1);
        let chunk = elements * width.max(1);
        parameters
            .par_chunks_mut(chunk)
            .zip(gradient.par_chunks(chunk))
            .zip(self.first.par_chunks_mut(chunk).zip(self.second.par_chunks_mut(chunk)))
            .zip(ages.par_chunks(elements))
            .enumerate()
            .for_each(|(task, (((parameters, gradient), (first, second)), ages))| {
                let block_elements = BLOCK / width.max(1);
                let block = block_elements * width.max(1);
                let blocks = parameters.chunks_mut(block).zip(gradient.chunks(block));
                let moments = first.chunks_mut(block).zip(second.chunks_mut(block));
                let ages =
                    (task * elements..).step_by(block_elements).zip(ages.chunks(block_elements));
                for (((parameters, gradient), moments), (start, ages)) in
                    blocks.zip(moments).zip(ages)
                {
                    if ages.iter().all(|age| *age == 0) {
                        continue;
                    }
                    arch.dispatch(|| {
                        let rate = |element| rate(start + element);
                        let factors = Factors::new(ages, width, corrections, rate);
                        settings.advance(parameters, gradient, moments, &factors);
                    });
                }
            });
    }

    /// Extends the corrections of the moments' bias to steps of age `oldest`.
    fn correct_up_to(&mut self, oldest: u32) {
        let AdamSettings { beta1, beta2, .. } = self.settings;
        let correction = |beta: f32, age: u32| 1.0 / (1.0 - beta.powi(age as i32));
        let known = self.corrections.len() as u32;
        let ages = known..(oldest + 1).min(UNBIASED);
        self.corrections.extend(ages.map(|n| (correction(beta1, n), correction(beta2, n))));
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

    /// A quarter turn about the third axis exchanges the first two; elements without history stay so.
    #[test]
    fn moments_turn_with_their_element() {
        let mut adam = Adam::new(AdamSettings::default());
        adam.step(&mut [0.0; 6], &[1.0, 2.0, 3.0, 1.0, 2.0, 3.0], 0.1);
        let (first, second) = (adam.first.clone(), adam.second.clone());
        let turn = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
        adam.rotate(1, &turn);
        adam.rotate(2, &turn);
        assert_eq!(adam.first[..3], first[..3]);
        assert_eq!(adam.first[3..], [-first[4], first[3], first[5]]);
        assert_eq!(adam.second[3..], [second[4], second[3], second[5]]);
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
        together.step_elements(&mut x, &[0.3, 0.1, 9.0, 9.0], |_| 0.1, 2, &[1, 0]);
        assert_eq!(x[2..], [5.0, 6.0]);
        for (age, g) in [(1, [0.5, -0.2]), (2, [0.1, 0.4])] {
            together.step_elements(&mut x, &[7.0, 7.0, g[0], g[1]], |_| 0.1, 2, &[0, age]);
            alone.step(&mut y, &g, 0.1);
        }
        assert!((x[2] - y[0]).abs() < 1e-6 && (x[3] - y[1]).abs() < 1e-6);
        assert!((x[0] - 0.9).abs() < 1e-5);
    }

    /// Over several blocks and tasks: a first step is as long as the rate of its element.
    #[test]
    fn every_element_has_its_own_rate() {
        let count = 2 * CHUNK / 3 + 5;
        let (mut x, gradient) = (vec![0.0; 3 * count], vec![0.5; 3 * count]);
        let rate = |element: usize| element as f32;
        let mut adam = Adam::new(AdamSettings::default());
        adam.step_elements(&mut x, &gradient, rate, 3, &vec![1; count]);
        for (i, x) in x.iter().enumerate() {
            assert!((x / rate(i / 3).max(1.0) + (i / 3).min(1) as f32).abs() < 1e-5, "{i} {x}");
        }
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
