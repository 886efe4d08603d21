//! Resection: the pose of one frame, with landmarks and all other poses held.

use super::blocks::{Curvature, pose_block, relative_pose_blocks};
use super::sparsity::BlockSparsity;
use super::{Bundle, MAX_DAMPING, MIN_RELATIVE_DECREASE};
use i2slam_compute::NormalEquations;
use i2slam_geometry::Tangent;

impl Bundle {
    /// Adjusts the only free pose to the cost of [`adjust`](Self::adjust), in up to `steps` steps.
    pub(crate) fn adjust_free_pose(&mut self, steps: usize) {
        let sparsity = BlockSparsity::new(self);
        let Some(place) = sparsity.poses.first().copied() else { return };
        let (mut cost, mut damping) = (self.cost(), 1e-4);
        let mut equations = self.pose_equations(&sparsity);
        for _ in 0..steps {
            let Some(step) = equations.step(damping) else { break };
            let before = self.poses[place];
            self.poses[place] = before.retract(Tangent::from_array(step));
            let next = self.cost();
            if next < cost {
                let gained = cost - next;
                (cost, damping) = (next, damping * 0.2);
                if gained < MIN_RELATIVE_DECREASE * cost {
                    break;
                }
                equations = self.pose_equations(&sparsity);
            } else {
                self.poses[place] = before;
                damping *= 8.0;
                if damping > MAX_DAMPING {
                    break;
                }
            }
        }
    }

    /// Normal equations of the first free pose alone.
    fn pose_equations(&self, sparsity: &BlockSparsity) -> NormalEquations<6> {
        let mut blocks = [pose_block(self, sparsity, 0, Curvature::Majorizing)];
        relative_pose_blocks(self, sparsity, &mut blocks);
        let [block] = blocks;
        NormalEquations {
            hessian: block.hessian,
            gradient: block.gradient,
            ..NormalEquations::default()
        }
    }
}
