//! Steps of start and end poses.

use crate::config::{KeyframedConfig, Preconditioning};
use crate::mapping::MappingContext;
use crate::objective::ShutterGram;
use i2slam_compute::{Adam, AdamSettings};
use i2slam_formation::{ShutterPoses, ShutterTangent};
use i2slam_geometry::{Tangent, symmetric_eigen_of};
use std::collections::BTreeMap;

/// CamP's constants.
const SETTINGS: AdamSettings = AdamSettings { beta1: 0.9, beta2: 0.99, epsilon: 1e-15 };
/// Least that is added to the diagonal.
const MIN_PRECONDITIONER: f64 = 1e-8;

/// Optimiser state of all keyframes.
#[derive(Default)]
pub(super) struct PoseOptimizers(BTreeMap<usize, PoseOptimizer>);

struct PoseOptimizer {
    adam: Adam,
    preconditioner: Option<ShutterGram>,
    steps: usize,
}

impl PoseOptimizers {
    fn of(&mut self, frame: usize) -> &mut PoseOptimizer {
        self.0.entry(frame).or_insert_with(|| PoseOptimizer {
            adam: Adam::new(SETTINGS),
            preconditioner: None,
            steps: 0,
        })
    }

    /// Whether the preconditioner of a keyframe is due again: every `interval` steps, and before
    /// that whenever its steps have doubled, because what an untrained field shows changes fast.
    pub(super) fn is_due(&mut self, frame: usize, interval: usize) -> bool {
        let optimizer = self.of(frame);
        let steps = optimizer.steps;
        let early = steps < interval && steps.is_power_of_two();
        optimizer.preconditioner.is_none() || early || steps.is_multiple_of(interval)
    }

    /// Steps a keyframe from now on in the coordinates that its `JᵀJ` asks for.
    pub(super) fn precondition(
        &mut self,
        frame: usize,
        gram: &ShutterGram,
        settings: &KeyframedConfig,
    ) {
        let damping = f64::from(settings.preconditioning_damping);
        self.of(frame).preconditioner = Some(match settings.preconditioning {
            Preconditioning::Pose => norm_preserving(&block_damped_preconditioner(gram, damping)),
            _ => preconditioner(gram, damping),
        });
    }

    /// One step of a keyframe against `gradient`. Without blur both poses stay one.
    pub(super) fn step(
        &mut self,
        context: &mut MappingContext<'_>,
        frame: usize,
        gradient: &ShutterTangent<f64>,
        rate: f32,
    ) {
        let optimizer = self.of(frame);
        optimizer.steps += 1;
        let shutter = &mut context.frames[frame].shutter;
        if !context.config.formation.blur {
            let both = gradient.start.plus(gradient.end).to_array();
            let step = optimizer.descend(both, rate);
            *shutter = ShutterPoses::still(shutter.start.retract(Tangent::from_array(step)));
            return;
        }
        let gradient = gradient.to_array();
        let step = match optimizer.preconditioner {
            Some(p) => times(&p, optimizer.descend(times(&p, gradient), rate)),
            None => optimizer.descend(gradient, rate),
        };
        let next = shutter.retract(&ShutterTangent::from_array(step));
        if next.is_finite() {
            *shutter = next;
        }
    }
}

impl PoseOptimizer {
    fn descend<const N: usize>(&mut self, gradient: [f64; N], rate: f32) -> [f64; N] {
        let mut step = [0.0; N];
        self.adam.step(&mut step, &gradient.map(|g| g as f32), rate);
        step.map(f64::from)
    }
}

/// `P = (JᵀJ + diag(max(1e-8, r diag(JᵀJ))))^(-1/2)`, `r` being `damping`: with `ξ = P z`, every
/// coordinate of `z` changes the picture alike, and none changes what another does.
fn preconditioner(gram: &ShutterGram, damping: f64) -> ShutterGram {
    inverse_root(gram, |i| (damping * gram[i][i]).max(MIN_PRECONDITIONER))
}

/// The same with the damping of a coordinate never less than that of the mean translation or
/// rotation: one that the picture hardly shows is not stepped far on what little it says, and
/// takes nothing from the length of steps along those that it shows.
fn block_damped_preconditioner(gram: &ShutterGram, damping: f64) -> ShutterGram {
    let rotates = |i: usize| i % 6 >= 3;
    let mean =
        |kind: bool| (0..12).filter(|&i| rotates(i) == kind).map(|i| gram[i][i]).sum::<f64>() / 6.0;
    let means = [mean(false), mean(true)];
    let least = |i: usize| means[usize::from(rotates(i))];
    inverse_root(gram, |i| (damping * gram[i][i].max(least(i))).max(MIN_PRECONDITIONER))
}

/// The inverse square root of a matrix to whose diagonal something is added.
fn inverse_root(gram: &ShutterGram, added: impl Fn(usize) -> f64) -> ShutterGram {
    let mut damped = *gram;
    for (i, row) in damped.iter_mut().enumerate() {
        row[i] += added(i);
    }
    let (values, v) = symmetric_eigen_of(&damped);
    let roots = values.map(|value| value.max(MIN_PRECONDITIONER).sqrt().recip());
    std::array::from_fn(|r| {
        std::array::from_fn(|c| (0..12).map(|k| v[r][k] * roots[k] * v[c][k]).sum())
    })
}

/// A multiple of `P` that leaves the length of vectors as it is, in the root mean square over all
/// directions.
fn norm_preserving(matrix: &ShutterGram) -> ShutterGram {
    let squares: f64 = matrix.iter().flatten().map(|v| v * v).sum();
    let factor = (12.0 / squares.max(MIN_PRECONDITIONER)).sqrt();
    matrix.map(|row| row.map(|v| factor * v))
}

/// The product with a vector; the matrix is symmetric.
fn times(matrix: &ShutterGram, vector: [f64; 12]) -> [f64; 12] {
    matrix.map(|row| row.iter().zip(vector).map(|(a, b)| a * b).sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_preconditioner_is_renewed_soon_and_then_now_and_again() {
        let mut poses = PoseOptimizers::default();
        assert!(poses.is_due(3, 100));
        poses.of(3).preconditioner = Some([[0.0; 12]; 12]);
        let mut due = |steps: usize| {
            poses.of(3).steps = steps;
            poses.is_due(3, 100)
        };
        let steps: Vec<usize> = (1..=310).filter(|&n| due(n)).collect();
        assert_eq!(steps, [1, 2, 4, 8, 16, 32, 64, 100, 200, 300]);
    }

    fn gram() -> ShutterGram {
        let rows: Vec<[f64; 12]> = (0..40)
            .map(|n| {
                std::array::from_fn(|i| ((1 + n * (i + 2)) as f64 * 0.37).sin() * (1 + i) as f64)
            })
            .collect();
        std::array::from_fn(|r| std::array::from_fn(|c| rows.iter().map(|j| j[r] * j[c]).sum()))
    }

    #[test]
    fn the_jacobian_of_preconditioned_coordinates_is_orthonormal() {
        let gram = gram();
        let p = preconditioner(&gram, 1e-12);
        for c in 0..12 {
            let unit = std::array::from_fn(|i| f64::from(u8::from(i == c)));
            let back = times(&p, times(&gram, times(&p, unit)));
            for (r, value) in back.into_iter().enumerate() {
                assert!((value - unit[r]).abs() < 1e-6, "{r} {c}: {value}");
            }
        }
    }

    #[test]
    fn a_step_keeps_its_length() {
        let p = preconditioner(&gram(), 0.1);
        let [once, scaled] =
            [norm_preserving(&p), norm_preserving(&p.map(|row| row.map(|v| 7.0 * v)))];
        let unit = |c: usize| std::array::from_fn(|i| f64::from(u8::from(i == c)));
        let squares = (0..12).flat_map(|c| times(&once, unit(c))).map(|v| v * v).sum::<f64>();
        assert!((squares - 12.0).abs() < 1e-9, "{squares}");
        let apart = once.iter().flatten().zip(scaled.iter().flatten()).map(|(a, b)| (a - b).abs());
        assert!(apart.fold(0.0, f64::max) < 1e-9);
    }

    #[test]
    fn what_no_pixel_sees_takes_nothing_from_the_rest() {
        let mut gram = gram();
        let before = norm_preserving(&block_damped_preconditioner(&gram, 0.1));
        for i in 0..12 {
            (gram[i][5], gram[5][i]) = (0.0, 0.0);
        }
        let blind = norm_preserving(&block_damped_preconditioner(&gram, 0.1));
        let plain = norm_preserving(&preconditioner(&gram, 0.1));
        let others =
            |p: &ShutterGram| (0..12).filter(|&i| i != 5).map(|i| p[i][i]).fold(f64::MAX, f64::min);
        assert!(others(&blind) > 0.3 * others(&before), "{} {}", others(&blind), others(&before));
        assert!(others(&plain) < 0.01 * others(&before), "{}", others(&plain));
        assert!(blind[5][5] < 4.0, "{}", blind[5][5]);
    }

    #[test]
    fn what_no_pixel_sees_is_stepped_no_farther_than_damping_says() {
        let mut gram = gram();
        for i in 0..12 {
            (gram[i][5], gram[5][i]) = (0.0, 0.0);
        }
        let p = preconditioner(&gram, 0.1);
        assert!((p[5][5] - MIN_PRECONDITIONER.sqrt().recip()).abs() < 1e-3);
        assert!(p.iter().flatten().all(|v| v.is_finite()));
    }
}
