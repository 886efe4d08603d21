//! Depth residuals of a block of samples.

use super::geometry::{Points, by_point, placeholder_point, project};
use super::level::{BilinearTaps, BlockValues, SampleBlock, groups};
use super::{
    DEGREES_OF_FREEDOM, Derivatives, MAX_DEPTH_RESIDUAL_RATIO, MIN_DISTANCE, ROUGHNESS_SIGMA_RATIO,
};
use super::{Kernel, ResidualSums, add_normal_equations, cost_of};
use i2slam_compute::simd::{Lanes, Mask};
use pulp::Simd;

/// Intermediate values of a block.
#[derive(Default)]
pub(super) struct DepthBlock {
    /// The points in the camera at mid-exposure.
    pub(super) points: [BlockValues; 3],
    /// The points in the target's camera; a point on the axis where that does not see them.
    target_points: [BlockValues; 3],
    taps: BilinearTaps,
    corners: [BlockValues; 4],
    roughness: BlockValues,
    /// 1 for samples on the target's surface, 0 for others.
    pub(super) agreeing: BlockValues,
    /// Derivatives by ρ and φ of the centre.
    jacobian: [BlockValues; 6],
    residual: BlockValues,
}

/// Sums over the groups of a block, lane by lane.
struct LaneSums<S: Simd> {
    cost: Lanes<S>,
    error: Lanes<S>,
    count: Lanes<S>,
}

impl DepthBlock {
    /// Adds the residuals of `samples` and returns how many lie on the target's surface; before a
    /// target without one, how many it sees.
    #[inline(always)]
    pub(super) fn add<S: Simd>(
        &mut self,
        kernel: Kernel<'_, S>,
        samples: &SampleBlock,
        sums: &mut ResidualSums,
    ) -> usize {
        let Kernel { simd, task, .. } = kernel;
        let camera = &task.frame.camera;
        for group in 0..groups::<S>() {
            self.project_to_target(kernel, samples, group);
        }
        if !task.target.has_surface {
            let mut seen = Lanes::zero(simd);
            for group in 0..groups::<S>() {
                seen += Lanes::load_group(simd, &self.agreeing, group);
            }
            let count = seen.reduce_sum() as usize;
            sums.agreeing += count;
            return count;
        }
        self.taps.split(camera);
        task.target.surface.gather(&self.taps, &mut self.corners, &mut self.roughness);
        let zero = Lanes::zero(simd);
        let mut lanes = LaneSums { cost: zero, error: zero, count: zero };
        for group in 0..groups::<S>() {
            self.compare(kernel, samples, group, &mut lanes);
        }
        let count = lanes.count.reduce_sum() as usize;
        sums.equations.cost += f64::from(lanes.cost.reduce_sum());
        sums.equations.count += count;
        sums.errors.depth += f64::from(lanes.error.reduce_sum());
        sums.errors.depth_count += count;
        sums.agreeing += count;
        if task.derivatives != Derivatives::None && count > 0 {
            let [a, b, c, d, e, f] = &self.jacobian;
            let rows = [a, b, c, d, e, f, &self.residual];
            add_normal_equations(simd, &rows, &[0, 1, 2, 3, 4, 5], &mut sums.equations);
        }
        count
    }

    /// Stores the image positions of a group's samples in the target.
    #[inline(always)]
    fn project_to_target<S: Simd>(
        &mut self,
        Kernel { simd, task, geometry }: Kernel<'_, S>,
        samples: &SampleBlock,
        group: usize,
    ) {
        let read = Points::load_group(simd, &samples.point, group);
        let point = geometry.centre_from_depth.transform(simd, read);
        let target_point = geometry.target_from_centre.transform(simd, point);
        point.store_group(&mut self.points, group);
        let camera = &task.frame.camera;
        let seen =
            self.taps.store_positions(simd, group, project(simd, camera, target_point), camera)
                & Lanes::splat(simd, MIN_DISTANCE).lt(target_point.z)
                & Lanes::zero(simd).lt(read.z);
        seen.ones().store_group(&mut self.agreeing, group);
        let target_point = Points::select(seen, target_point, placeholder_point(simd));
        target_point.store_group(&mut self.target_points, group);
    }

    /// Residual, weight and derivatives of a group.
    #[inline(always)]
    fn compare<S: Simd>(
        &mut self,
        kernel: Kernel<'_, S>,
        samples: &SampleBlock,
        group: usize,
        lanes: &mut LaneSums<S>,
    ) {
        let Kernel { simd, task, geometry } = kernel;
        let number = |value| Lanes::splat(simd, value);
        let target_point = Points::load_group(simd, &self.target_points, group);
        let [inverse, by_u, by_v] = self.taps.interpolate(simd, group, &self.corners);
        let roughness = Lanes::load_group(simd, &self.roughness, group);
        let surface = Mask::load_group(simd, &self.agreeing, group) & number(0.0).le(roughness);
        let d = surface.select(inverse, number(1.0)).recip();
        let residual = d - target_point.z;
        let agrees = surface & residual.abs().le(number(MAX_DEPTH_RESIDUAL_RATIO) * target_point.z);
        agrees.ones().store_group(&mut self.agreeing, group);

        let slope = number(0.0) - d * d;
        let camera = &task.frame.camera;
        let mut gradient = by_point(simd, camera, target_point, (slope * by_u, slope * by_v));
        gradient.z = gradient.z - number(1.0);
        let (spread, variance) = spread_and_variance(kernel, samples, roughness, group);
        // By the distance to the surface, not along the optical axis.
        let normal = gradient.dot(gradient).sqrt().max(number(1.0));
        let distance = residual / normal;
        let square = distance * distance / variance;
        lanes.cost += agrees.keep(cost_of(simd, square));
        lanes.error += agrees.keep(distance.abs() / spread);
        lanes.count += agrees.ones();
        if task.derivatives == Derivatives::None {
            return;
        }
        let weight =
            number(DEGREES_OF_FREEDOM + 1.0) / ((number(DEGREES_OF_FREEDOM) + square) * variance);
        let root = agrees.keep(weight.sqrt() / normal);
        (residual * root).store_group(&mut self.residual, group);
        let turned = geometry.rotate_to_centre(simd, gradient);
        self.store_jacobian(
            simd,
            turned.scaled(root * number(1.0 + task.depth_offset_ratio as f32)),
            group,
        );
    }

    /// Stores the derivatives by ρ and φ, from the derivative `row` by the points of a group.
    #[inline(always)]
    fn store_jacobian<S: Simd>(&mut self, simd: S, row: Points<S>, group: usize) {
        let spin = Points::load_group(simd, &self.points, group).cross(row);
        let values = [row, spin].map(Points::to_array);
        for (out, value) in self.jacobian.iter_mut().zip(values.as_flattened()) {
            value.store_group(out, group);
        }
    }
}

/// Growth of depth noise with distance, and the variance of a group's residuals from noise and
/// roughness.
#[inline(always)]
fn spread_and_variance<S: Simd>(
    Kernel { simd, task, .. }: Kernel<'_, S>,
    samples: &SampleBlock,
    roughness: Lanes<S>,
    group: usize,
) -> (Lanes<S>, Lanes<S>) {
    let number = |value| Lanes::splat(simd, value);
    let z = Lanes::load_group(simd, &samples.point[2], group);
    let spread = z * z.max(number(1.0));
    let rough = number(ROUGHNESS_SIGMA_RATIO)
        * roughness.max(Lanes::load_group(simd, &samples.roughness, group));
    let fine = number(task.scales.depth) * spread;
    (spread, fine.mul_add(fine, rough * rough))
}
