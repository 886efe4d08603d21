//! How well a bundle tells what all sights share: focal length, and lens or readout.
//!
//! Residuals are not independent. Those of one point share the look that it is compared with, and
//! those of one region, or of one picture, share what no model has: blur, a lens, edges that are no
//! points. So the covariance is not the inverse of the normal equations but `H⁻¹ M H⁻¹` (Huber
//! 1967), with `H` the curvature of the robust cost itself, which is less than that of the weighted
//! squares that steps are taken by, and `M` the sum over clusters of the outer products of their
//! gradients (Liang & Zeger 1986). Of several ways to form clusters the one that leaves the focal
//! length least certain counts.

use super::normal_equations::{Curvature, SchurSystem, Step, gradient_along};
use super::sparsity::BlockSparsity;
use super::{Bundle, GLOBALS};

/// Regions of the picture, across and down.
const REGIONS: [usize; 2] = [4, 3];

/// Covariance of the logarithm of the focal length and of the two coefficients of the lens, or of
/// the readout [frame intervals].
pub(crate) type IntrinsicsCovariance = [[f64; GLOBALS]; GLOBALS];

impl Bundle {
    /// The covariance of what is unknown of the camera, zero for what is not; `None` where the
    /// sights do not determine it. For a bundle that was adjusted.
    pub(crate) fn camera_covariance(&self) -> Option<IntrinsicsCovariance> {
        let structure = BlockSparsity::new(self);
        let linear = SchurSystem::new(self, &structure, Curvature::Exact);
        let inverse_columns = linear.inverse_columns()?;
        let points = self.landmarks.len();
        let by_point = self.clustered_covariance(&inverse_columns, points, |landmark, _| landmark);
        let regions: Vec<usize> = (0..points).map(|landmark| self.region(landmark)).collect();
        let count = REGIONS[0] * REGIONS[1];
        let by_region =
            self.clustered_covariance(&inverse_columns, count, |landmark, _| regions[landmark]);
        let by_picture =
            self.clustered_covariance(&inverse_columns, self.poses.len(), |_, pose| pose);
        let all = [by_point, by_region, by_picture].into_iter();
        let worst = all.max_by(|a, b| a[0][0].total_cmp(&b[0][0]))?;
        let is_sound = worst.iter().flatten().all(|v| v.is_finite()) && worst[0][0] > 0.0;
        is_sound.then_some(worst)
    }

    /// The covariance where residuals of one cluster belong together; `cluster` of a landmark and a
    /// pose.
    fn clustered_covariance(
        &self,
        inverse_columns: &[Step],
        count: usize,
        cluster: impl Fn(usize, usize) -> usize,
    ) -> IntrinsicsCovariance {
        let mut sums = vec![None::<[f64; GLOBALS]>; count];
        for (landmark, observations) in self.observations.iter().enumerate() {
            for observation in observations {
                let sum = sums[cluster(landmark, observation.pose)].get_or_insert([0.0; GLOBALS]);
                for (sum, response) in sum.iter_mut().zip(inverse_columns) {
                    *sum += gradient_along(self, landmark, observation, response);
                }
            }
        }
        let mut out = [[0.0; GLOBALS]; GLOBALS];
        for sum in sums.iter().flatten() {
            for g in 0..GLOBALS {
                (0..GLOBALS).for_each(|h| out[g][h] += sum[g] * sum[h]);
            }
        }
        let clusters = sums.iter().flatten().count() as f64;
        let few = clusters / (clusters - 1.0);
        out.map(|row| row.map(|v| few * v))
    }

    /// The region in which a landmark is seen first.
    fn region(&self, landmark: usize) -> usize {
        let at = self.observations[landmark].first().map_or([0.0; 2], |observation| observation.at);
        let size = [self.camera.width, self.camera.height];
        let [across, down] = std::array::from_fn(|i| {
            let share = (at[i] / size[i] as f64).clamp(0.0, 1.0);
            ((share * REGIONS[i] as f64) as usize).min(REGIONS[i] - 1)
        });
        down * REGIONS[0] + across
    }
}
