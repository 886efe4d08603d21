//! Steps of start and end poses.

use super::preconditioner::{as_long, levelled, preconditioner, times};
use crate::config::{KeyframedConfig, Preconditioning};
use crate::mapping::Story;
use crate::objective::ShutterGram;
use i2slam_compute::{Adam, AdamSettings};
use i2slam_formation::{ShutterPoses, ShutterTangent};
use i2slam_geometry::Tangent;
use std::collections::BTreeMap;

/// CamP's constants.
const SETTINGS: AdamSettings = AdamSettings { beta1: 0.9, beta2: 0.99, epsilon: 1e-15 };

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
            Preconditioning::Pose => as_long(&levelled(gram, damping)),
            _ => preconditioner(gram, damping),
        });
    }

    /// One step of a keyframe against `gradient`. Without blur both poses stay one.
    pub(super) fn step(
        &mut self,
        story: &mut Story<'_>,
        frame: usize,
        gradient: &ShutterTangent<f64>,
        rate: f32,
    ) {
        let optimizer = self.of(frame);
        optimizer.steps += 1;
        let shutter = &mut story.frames[frame].shutter;
        if !story.config.formation.blur {
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
}
