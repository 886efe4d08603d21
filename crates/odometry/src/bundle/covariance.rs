//! Covariance of the intrinsics that all observations share: focal length, and distortion or
//! readout.
//!
//! Residuals are not independent: those of one point share its anchor patch, those of one region or
//! picture share model errors such as blur and distortion. So the covariance is the sandwich `H⁻¹ M
//! H⁻¹` (Huber 1967), with `H` the exact curvature of the robust cost and `M` the sum over clusters
//! of the outer products of their gradients (Liang and Zeger 1986). Observations are clustered by
//! point, by region and by picture; the clustering with the largest variance of the focal length is
//! reported.

use super::blocks::Curvature;
use super::normal_equations::{BundleStep, SchurSystem, gradient_along};
use super::picture_region::REGIONS;
use super::sparsity::BlockSparsity;
use super::{Bundle, GLOBALS};

/// Covariance of the logarithm of the focal length and of the two distortion coefficients, or of
/// the readout [frame intervals].
pub(crate) type IntrinsicsCovariance = [[f64; GLOBALS]; GLOBALS];

impl Bundle {
    /// Covariance of the free intrinsics of an adjusted bundle, zero for fixed ones; `None` where
    /// the observations do not determine it.
    pub(crate) fn camera_covariance(&self) -> Option<IntrinsicsCovariance> {
        let sparsity = BlockSparsity::new(self);
        let linear = SchurSystem::new(self, &sparsity, Curvature::Exact);
        let inverse_columns = linear.inverse_columns()?;
        let points = self.landmarks.len();
        let by_point = self.clustered_covariance(&inverse_columns, points, |landmark, _| landmark);
        let regions: Vec<usize> =
            (0..points).map(|landmark| self.picture_region(landmark)).collect();
        let by_region =
            self.clustered_covariance(&inverse_columns, REGIONS, |landmark, _| regions[landmark]);
        let by_picture =
            self.clustered_covariance(&inverse_columns, self.poses.len(), |_, pose| pose);
        let all = [by_point, by_region, by_picture].into_iter();
        let worst = all.max_by(|a, b| a[0][0].total_cmp(&b[0][0]))?;
        let is_sound = worst.iter().flatten().all(|v| v.is_finite()) && worst[0][0] > 0.0;
        is_sound.then_some(worst)
    }

    /// The sandwich covariance, clustered by the index that `cluster` gives a landmark and a pose.
    fn clustered_covariance(
        &self,
        inverse_columns: &[BundleStep],
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
}
