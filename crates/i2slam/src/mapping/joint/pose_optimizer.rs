//! Optimisation of start and end poses with camera preconditioning (CamP, Park et al. 2023) on
//! photometric errors.

use crate::config::Preconditioning;
use crate::mapping::MappingContext;
use crate::objective::ShutterHessian;
use i2slam_compute::{Adam, AdamSettings};
use i2slam_formation::{ShutterPoses, ShutterTangent};
use i2slam_geometry::{Tangent, symmetric_eigen_of};
use std::collections::BTreeMap;

/// Adam settings of CamP.
const SETTINGS: AdamSettings = AdamSettings { beta1: 0.9, beta2: 0.99, epsilon: 1e-15 };
/// Share of the diagonal of JᵀJ that is added to it (CamP).
const DAMPING: f32 = 0.1;
/// Least damping of a diagonal entry (CamP).
const MIN_DAMPING: f64 = 1e-8;

/// Pose optimisers of all keyframes, by frame.
#[derive(Default)]
pub(super) struct PoseOptimizers(BTreeMap<usize, PoseOptimizer>);

struct PoseOptimizer {
    adam: Adam,
    preconditioner: Option<ShutterHessian>,
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

    /// Whether to compute the preconditioner of a keyframe: every `interval` steps, and before that
    /// whenever its steps have doubled, because the renders of an untrained field change fast.
    pub(super) fn is_preconditioner_due(&mut self, frame: usize, interval: usize) -> bool {
        let optimizer = self.of(frame);
        let steps = optimizer.steps;
        let early = steps < interval && steps.is_power_of_two();
        optimizer.preconditioner.is_none() || early || steps.is_multiple_of(interval)
    }

    /// Sets the preconditioner of a keyframe from its normal matrix `JᵀJ`.
    pub(super) fn precondition(
        &mut self,
        frame: usize,
        normal_matrix: &ShutterHessian,
        coordinates: Preconditioning,
    ) {
        let damping = f64::from(DAMPING);
        self.of(frame).preconditioner = Some(match coordinates {
            Preconditioning::Pose => {
                norm_preserving(&block_damped_preconditioner(normal_matrix, damping))
            }
            _ => preconditioner(normal_matrix, damping),
        });
    }

    /// One step on the poses of a keyframe; without blur on both alike.
    pub(super) fn step(
        &mut self,
        context: &mut MappingContext<'_>,
        frame: usize,
        gradient: &ShutterTangent<f64>,
        rate: f32,
    ) {
        let optimizer = self.of(frame);
        optimizer.steps += 1;
        let keeps_middle = context.config.parameters.frames.keeps_middle;
        let shutter = &mut context.frames[frame].shutter;
        if !context.config.formation.blur {
            if keeps_middle {
                return;
            }
            let both = gradient.start.plus(gradient.end).to_array();
            let step = optimizer.adam_step(both, rate);
            *shutter = ShutterPoses::still(shutter.start.retract(Tangent::from_array(step)));
            return;
        }
        let gradient = gradient.to_array();
        let step = match optimizer.preconditioner {
            Some(p) => multiply(&p, optimizer.adam_step(multiply(&p, gradient), rate)),
            None => optimizer.adam_step(gradient, rate),
        };
        let next = shutter.retract(&ShutterTangent::from_array(step));
        if next.is_finite() {
            let middle = shutter.middle();
            *shutter = if keeps_middle { next.with_middle(middle) } else { next };
        }
    }
}

impl PoseOptimizer {
    fn adam_step<const N: usize>(&mut self, gradient: [f64; N], rate: f32) -> [f64; N] {
        let mut step = [0.0; N];
        self.adam.step(&mut step, &gradient.map(|g| g as f32), rate);
        step.map(f64::from)
    }
}

/// `P = (JᵀJ + diag(max(1e-8, r diag(JᵀJ))))^(-1/2)` with `r` = `damping`: in the coordinates `z` of
/// `ξ = P z` the picture changes equally and independently.
fn preconditioner(hessian: &ShutterHessian, damping: f64) -> ShutterHessian {
    inverse_root(hessian, |i| (damping * hessian[i][i]).max(MIN_DAMPING))
}

/// [`preconditioner`] with the damping of a coordinate at least that of the mean translation or
/// rotation, so that weakly observed coordinates get no long steps and do not shorten the others.
fn block_damped_preconditioner(hessian: &ShutterHessian, damping: f64) -> ShutterHessian {
    let rotates = |i: usize| i % 6 >= 3;
    let mean = |kind: bool| {
        (0..12).filter(|&i| rotates(i) == kind).map(|i| hessian[i][i]).sum::<f64>() / 6.0
    };
    let means = [mean(false), mean(true)];
    let least = |i: usize| means[usize::from(rotates(i))];
    inverse_root(hessian, |i| (damping * hessian[i][i].max(least(i))).max(MIN_DAMPING))
}

/// Inverse square root of a matrix with `added` diagonal.
fn inverse_root(hessian: &ShutterHessian, added: impl Fn(usize) -> f64) -> ShutterHessian {
    let mut damped = *hessian;
    for (i, row) in damped.iter_mut().enumerate() {
        row[i] += added(i);
    }
    let (values, v) = symmetric_eigen_of(&damped);
    let roots = values.map(|value| value.max(MIN_DAMPING).sqrt().recip());
    std::array::from_fn(|r| {
        std::array::from_fn(|c| (0..12).map(|k| v[r][k] * roots[k] * v[c][k]).sum())
    })
}

/// `P` scaled to keep the root mean square length of vectors over all directions.
fn norm_preserving(matrix: &ShutterHessian) -> ShutterHessian {
    let squares: f64 = matrix.iter().flatten().map(|v| v * v).sum();
    let factor = (12.0 / squares.max(MIN_DAMPING)).sqrt();
    matrix.map(|row| row.map(|v| factor * v))
}

fn multiply(matrix: &ShutterHessian, vector: [f64; 12]) -> [f64; 12] {
    matrix.map(|row| row.iter().zip(vector).map(|(a, b)| a * b).sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn preconditioners_are_due_at_doubled_steps_and_then_at_intervals() {
        let mut poses = PoseOptimizers::default();
        assert!(poses.is_preconditioner_due(3, 100));
        poses.of(3).preconditioner = Some([[0.0; 12]; 12]);
        let mut due = |steps: usize| {
            poses.of(3).steps = steps;
            poses.is_preconditioner_due(3, 100)
        };
        let steps: Vec<usize> = (1..=310).filter(|&n| due(n)).collect();
        assert_eq!(steps, [1, 2, 4, 8, 16, 32, 64, 100, 200, 300]);
    }

    fn hessian() -> ShutterHessian {
        let rows: Vec<[f64; 12]> = (0..40)
            .map(|n| {
                std::array::from_fn(|i| ((1 + n * (i + 2)) as f64 * 0.37).sin() * (1 + i) as f64)
            })
            .collect();
        std::array::from_fn(|r| std::array::from_fn(|c| rows.iter().map(|j| j[r] * j[c]).sum()))
    }

    #[test]
    fn the_jacobian_of_preconditioned_coordinates_is_orthonormal() {
        let hessian = hessian();
        let p = preconditioner(&hessian, 1e-12);
        for c in 0..12 {
            let unit = std::array::from_fn(|i| f64::from(u8::from(i == c)));
            let back = multiply(&p, multiply(&hessian, multiply(&p, unit)));
            for (r, value) in back.into_iter().enumerate() {
                assert!((value - unit[r]).abs() < 1e-6, "{r} {c}: {value}");
            }
        }
    }

    #[test]
    fn a_step_keeps_its_length() {
        let p = preconditioner(&hessian(), 0.1);
        let [once, scaled] =
            [norm_preserving(&p), norm_preserving(&p.map(|row| row.map(|v| 7.0 * v)))];
        let unit = |c: usize| std::array::from_fn(|i| f64::from(u8::from(i == c)));
        let squares = (0..12).flat_map(|c| multiply(&once, unit(c))).map(|v| v * v).sum::<f64>();
        assert!((squares - 12.0).abs() < 1e-9, "{squares}");
        let apart = once.iter().flatten().zip(scaled.iter().flatten()).map(|(a, b)| (a - b).abs());
        assert!(apart.fold(0.0, f64::max) < 1e-9);
    }

    #[test]
    fn an_unobserved_coordinate_does_not_shorten_the_others() {
        let mut hessian = hessian();
        let before = norm_preserving(&block_damped_preconditioner(&hessian, 0.1));
        for i in 0..12 {
            (hessian[i][5], hessian[5][i]) = (0.0, 0.0);
        }
        let blind = norm_preserving(&block_damped_preconditioner(&hessian, 0.1));
        let plain = norm_preserving(&preconditioner(&hessian, 0.1));
        let others = |p: &ShutterHessian| {
            (0..12).filter(|&i| i != 5).map(|i| p[i][i]).fold(f64::MAX, f64::min)
        };
        assert!(others(&blind) > 0.3 * others(&before), "{} {}", others(&blind), others(&before));
        assert!(others(&plain) < 0.01 * others(&before), "{}", others(&plain));
        assert!(blind[5][5] < 4.0, "{}", blind[5][5]);
    }

    #[test]
    fn damping_bounds_the_step_of_an_unobserved_coordinate() {
        let mut hessian = hessian();
        for i in 0..12 {
            (hessian[i][5], hessian[5][i]) = (0.0, 0.0);
        }
        let p = preconditioner(&hessian, 0.1);
        assert!((p[5][5] - MIN_DAMPING.sqrt().recip()).abs() < 1e-3);
        assert!(p.iter().flatten().all(|v| v.is_finite()));
    }
}
