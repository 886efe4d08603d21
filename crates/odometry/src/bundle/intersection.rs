//! Intersection: all landmarks, with all poses held, after each step of an adjustment (embedded point
//! iterations: Jeong et al. 2012, *Pushing the envelope of modern methods for bundle adjustment*).
//!
//! A step of the joint normal equations is straight in poses and landmarks. Where parallax is small, the inverse
//! depth that is best for moved poses is no linear function of them; at the linear one residuals are longer,
//! good steps seem to raise the cost, and the iteration becomes slow far from the minimum. Variable projection
//! converges from farther away for the same reason (Hong et al. 2016, *Projective bundle adjustment from
//! arbitrary initialization using the variable projection method*).

use super::Bundle;
use super::blocks::{Curvature, weighted_residual};
use crate::multiview::landmark::Landmark;
use crate::multiview::triangulation::minimize_landmark;
use i2slam_compute::NormalEquations;
use pulp::Arch;
use rayon::prelude::*;

/// Steps of every landmark.
const STEPS: usize = 3;

impl Bundle {
    /// Moves every landmark to the least cost for the poses, in a few steps.
    pub(super) fn intersect_landmarks(&mut self) {
        let (landmarks, arch) = (0..self.landmarks.len(), Arch::new());
        let intersect = |i: usize| arch.dispatch(|| self.intersect(i));
        self.landmarks = landmarks.into_par_iter().map(intersect).collect();
    }

    #[inline(always)]
    fn intersect(&self, index: usize) -> Landmark {
        let start = self.landmarks[index];
        let equations = |landmark: &Landmark| Some(self.landmark_equations(index, landmark));
        minimize_landmark(start, STEPS, equations).unwrap_or(start)
    }

    /// Sums over the observations of a landmark, at another place of it.
    #[inline(always)]
    fn landmark_equations(&self, index: usize, landmark: &Landmark) -> NormalEquations<3> {
        let (mut sum, mut cost) = (NormalEquations::default(), 0.0);
        for observation in &self.observations[index] {
            let weighted = weighted_residual(self, landmark, observation, Curvature::Majorizing);
            let Some(w) = weighted else {
                cost += observation.cost_behind_camera();
                continue;
            };
            for i in 0..w.rows {
                sum.add(&w.projection.by_landmark[i], w.residual[i], w.weights[i]);
            }
            cost += w.cost;
        }
        sum.cost = cost;
        sum
    }
}

#[cfg(test)]
mod tests {
    use crate::fixtures::{camera, state};
    use i2slam_geometry::{Pose, Rotation, Tangent, Vec3};

    /// A camera that hardly moves at first, and then walks.
    fn pose(frame: usize) -> Pose<f64> {
        let s = frame as f64;
        let x = 0.001 * s + 0.02 * (s - 18.0).max(0.0);
        Pose::new(Rotation::exp(Vec3::new(0.0, 0.01 * s, 0.0)), Vec3::new(x, 0.0, 0.002 * s))
    }

    /// The first cameras are moved, and turned so that the middle of the scene stays in the picture where it was.
    #[test]
    fn a_path_that_is_torn_closes() {
        let observe = |point: Vec3<f64>, frame: usize, n: &[f64]| {
            let (u, v) = camera().project(pose(frame).inverse() * point);
            Some([u + 0.1 * n[0], v + 0.1 * n[1]])
        };
        let mut torn = state((50, 8, 4), [150.0, 110.0], pose, observe);
        let step = |poses: &[Option<Pose<f64>>]| {
            let [a, b] = [17, 18].map(|frame| poses[frame].expect("posed").translation);
            (b - a).norm()
        };
        let due = step(&torn.poses);
        for known in torn.poses[..18].iter_mut().flatten() {
            *known = known.retract(Tangent::from_array([0.05, 0.0, 0.0, 0.0, 0.02, 0.0]));
        }
        torn.landmarks.fill(None);
        torn.triangulate_missing();
        assert!(step(&torn.poses) > 0.04);
        torn.adjust(&(0..50).collect::<Vec<_>>(), false, 20);
        let found = step(&torn.poses);
        assert!((found - due).abs() < 1e-3, "{found} for {due}");
    }
}
