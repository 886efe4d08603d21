//! Scatter of adjusted poses under the noise of their observations (a score bootstrap).
//!
//! Noise moves the minimum of the cost by `-H⁻¹ g`, with the smoothed curvature `H` and the gradient
//! `g` that the noise adds. Samples of it are
//!
//! ```text
//! x = -H⁻¹ (Σ_c ε_c g_c + Σ_f s w_f J_fᵀ B_f (u_a + u_b)/√2),   B_f B_fᵀ = Λ_f
//! ```
//!
//! Points (first sum): `g_c` is the gradient of a cluster of observations as their residuals are,
//! times a random sign, so that the samples have the covariance of the sandwich `H⁻¹ (Σ g_c g_cᵀ)
//! H⁻¹` (Huber 1967; Liang and Zeger 1986; Kline and Santos 2012 for the signs). Points that began
//! in one region of one picture are a cluster: they share the blur of their anchors and surfaces.
//!
//! Relative poses (second sum): their residuals tell too little, because two constraints of a frame
//! share the noise of its picture and depth, and no residual shows that. So their claimed
//! information `Λ` is believed, at least, and half the variance comes with each frame `a`, `b`: `u`
//! are standard normal per frame. Where residuals are longer than claimed, `s` scales them.

use super::Bundle;
use super::blocks::Curvature;
use super::normal_equations::SchurSystem;
use super::picture_region::REGIONS;
use super::response::observation_gradients;
use super::sparsity::BlockSparsity;
use i2slam_compute::Random;
use rayon::prelude::*;

/// Samples: a deviation of three coordinates from 64 of them is right within 6 %.
const SAMPLES: usize = 64;

/// Tangents of every pose of a bundle.
type Tangents = Vec<[f64; 6]>;

/// Samples of the error of adjusted poses, relative to the fixed ones.
pub(crate) struct PoseScatter {
    /// Every sample has the tangents (ρ, φ) of all poses, zero for fixed ones.
    pub(crate) samples: Vec<Tangents>,
    /// The Gauss-Newton step that is left to the minimum.
    pub(crate) remaining: Tangents,
}

impl Bundle {
    /// Scatter of the poses of an adjusted bundle, whose image positions err by `noise_scale` times
    /// their deviations; `None` where the observations do not determine them.
    pub(crate) fn pose_scatter(&self, noise_scale: f64) -> Option<PoseScatter> {
        let sparsity = BlockSparsity::new(self);
        let system = SchurSystem::new(self, &sparsity, Curvature::Smoothed);
        let solver = system.solver()?;
        let observations = observation_gradients(self, &sparsity);
        let clusters: Vec<usize> =
            observations.iter().map(|g| self.anchor_region(g.landmark)).collect();
        let factor_scale = self.factor_scale().max(noise_scale);
        let sample = |seed: usize| {
            let mut random = Random::new(seed as u64);
            let regions = self.poses.len() * REGIONS;
            let signs: Vec<f64> = (0..regions).map(|_| sign(&mut random)).collect();
            let mut gradient = system.zero_gradient();
            for (observation, cluster) in observations.iter().zip(&clusters) {
                gradient.add(observation, signs[*cluster] * observation.correction);
            }
            let noise: Tangents =
                self.poses.iter().map(|_| [(); 6].map(|()| normal(&mut random))).collect();
            for factor in self.relative_poses.iter() {
                let [a, b] = [factor.first, factor.second].map(|pose| noise[pose]);
                let both = std::array::from_fn(|i| {
                    factor_scale * std::f64::consts::FRAC_1_SQRT_2 * (a[i] + b[i])
                });
                let moved = factor.noise_gradients(&self.poses, &both);
                gradient.add_to_poses(&sparsity, [factor.first, factor.second], moved);
            }
            system.respond(&solver, &gradient)
        };
        let samples = (0..SAMPLES).into_par_iter().map(sample).collect();
        Some(PoseScatter { samples, remaining: system.respond(&solver, &system.gradient()) })
    }

    /// Length of the errors of relative poses over the claimed one, from the residuals that the poses
    /// leave free: half of their variance, because what comes with a frame shows in none. Zero
    /// without redundant relative poses.
    fn factor_scale(&self) -> f64 {
        let free = self.fixed.iter().filter(|fixed| !**fixed).count();
        let redundant = self.relative_poses.len().saturating_sub(free);
        let cost: f64 = self.relative_poses.iter().map(|f| f.cost(&self.poses)).sum();
        if redundant == 0 { 0.0 } else { (2.0 * cost / (6 * redundant) as f64).sqrt() }
    }

    /// Number of the region and pose in which a landmark was first observed.
    fn anchor_region(&self, landmark: usize) -> usize {
        let pose = self.observations[landmark].first().map_or(0, |first| first.pose);
        pose * REGIONS + self.picture_region(landmark)
    }
}

/// -1 or 1.
fn sign(random: &mut Random) -> f64 {
    if random.bits() >> 63 == 0 { 1.0 } else { -1.0 }
}

/// A standard normal number (Box and Muller 1958).
fn normal(random: &mut Random) -> f64 {
    let (u, v) = (1.0 - random.uniform(), random.uniform());
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}
