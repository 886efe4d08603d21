//! The depth residual of a block of samples.

use super::block::{Row, groups};
use super::normal_equations::add_products;
use super::points::Points;
use super::samples::{SampleBlock, Taps};
use super::{FREEDOM, GATE, Geometry, Linearization, NEAR, RELIEF, Sums};
use i2slam_compute::simd::{Lanes, Mask};
use pulp::Simd;

/// Rows of one block on their way through the stages.
pub(super) struct DepthBlock {
    /// The points in the camera at mid-exposure.
    pub(super) points: [Row; 3],
    /// The same in the model's camera; a point on the axis where that is not seen.
    places: [Row; 3],
    taps: Taps,
    corners: [Row; 4],
    relief: Row,
    /// 1 for samples whose surface the model has.
    pub(super) agreeing: Row,
    /// By ρ and φ of the centre.
    jacobian: [Row; 6],
    residual: Row,
}

/// What the lanes of a block sum up to.
struct Tally<S: Simd> {
    cost: Lanes<S>,
    error: Lanes<S>,
    count: Lanes<S>,
}

impl DepthBlock {
    pub(super) fn new() -> Self {
        Self {
            points: [Row::ZERO; 3],
            places: [Row::ZERO; 3],
            taps: Taps::EMPTY,
            corners: [Row::ZERO; 4],
            relief: Row::ZERO,
            agreeing: Row::ZERO,
            jacobian: [Row::ZERO; 6],
            residual: Row::ZERO,
        }
    }

    /// Adds the residuals of `samples`; how many samples lie on the model's surface.
    #[inline(always)]
    pub(super) fn add<S: Simd>(
        &mut self,
        simd: S,
        task: &Linearization<'_>,
        geometry: &Geometry,
        samples: &SampleBlock,
        sums: &mut Sums,
    ) -> usize {
        let camera = &task.observed.camera;
        for group in 0..groups::<S>() {
            self.place(simd, task, geometry, samples, group);
        }
        self.taps.split(camera);
        task.model.surface.gather(&self.taps, &mut self.corners, &mut self.relief);
        let zero = Lanes::zero(simd);
        let mut tally = Tally { cost: zero, error: zero, count: zero };
        for group in 0..groups::<S>() {
            self.compare(simd, task, geometry, samples, group, &mut tally);
        }
        let count = tally.count.reduce_sum() as usize;
        sums.equations.cost += f64::from(tally.cost.reduce_sum());
        sums.equations.count += count;
        sums.errors.depth += f64::from(tally.error.reduce_sum());
        sums.errors.depth_count += count;
        sums.agreeing += count;
        if task.derivatives && count > 0 {
            let [a, b, c, d, e, f] = &self.jacobian;
            let rows = [a, b, c, d, e, f, &self.residual];
            add_products(simd, &rows, &[0, 1, 2, 3, 4, 5], &mut sums.equations);
        }
        count
    }

    /// Where the samples of a group lie in the model's picture.
    #[inline(always)]
    fn place<S: Simd>(
        &mut self,
        simd: S,
        task: &Linearization<'_>,
        geometry: &Geometry,
        samples: &SampleBlock,
        group: usize,
    ) {
        let read = Points::load_group(simd, &samples.point, group);
        let point = geometry.centre_from_depth.apply_lanes(simd, read);
        let place = geometry.model_from_centre.apply_lanes(simd, point);
        point.store_group(&mut self.points, group);
        let camera = &task.observed.camera;
        let seen = self.taps.place(simd, group, super::project(simd, camera, place), camera)
            & Lanes::splat(simd, NEAR).lt(place.z)
            & Lanes::zero(simd).lt(read.z);
        seen.ones().store_group(&mut self.agreeing, group);
        let place = Points::select(seen, place, super::on_axis(simd));
        place.store_group(&mut self.places, group);
    }

    /// Residual, weight and derivatives of a group.
    #[inline(always)]
    fn compare<S: Simd>(
        &mut self,
        simd: S,
        task: &Linearization<'_>,
        geometry: &Geometry,
        samples: &SampleBlock,
        group: usize,
        tally: &mut Tally<S>,
    ) {
        let number = |value| Lanes::splat(simd, value);
        let place = Points::load_group(simd, &self.places, group);
        let [inverse, by_u, by_v] = self.taps.interpolate(simd, group, &self.corners);
        let relief = Lanes::load_group(simd, &self.relief, group);
        let surface = Mask::load_group(simd, &self.agreeing, group) & number(0.0).le(relief);
        let d = surface.select(inverse, number(1.0)).recip();
        let residual = d - place.z;
        let agrees = surface & residual.abs().le(number(GATE) * place.z);
        agrees.ones().store_group(&mut self.agreeing, group);

        let slope = number(0.0) - d * d;
        let camera = &task.observed.camera;
        let mut by_place = super::by_place(simd, camera, place, (slope * by_u, slope * by_v));
        by_place.z = by_place.z - number(1.0);
        let (spread, variance) = spread_and_variance(simd, task, samples, relief, group);
        let normal = by_place.dot(by_place).sqrt().max(number(1.0));
        let distance = residual / normal;
        let square = distance * distance / variance;
        tally.cost += agrees.keep(super::cost(simd, square));
        tally.error += agrees.keep(distance.abs() / spread);
        tally.count += agrees.ones();
        if !task.derivatives {
            return;
        }
        let weight = number(FREEDOM + 1.0) / ((number(FREEDOM) + square) * variance);
        let root = agrees.keep(weight.sqrt() / normal);
        (residual * root).store_group(&mut self.residual, group);
        let turned = geometry.turn_back(simd, by_place);
        self.store_jacobian(
            simd,
            turned.scaled(root * number(1.0 + task.depth_lead as f32)),
            group,
        );
    }

    /// By ρ and φ, from `row` by the points of a group.
    #[inline(always)]
    fn store_jacobian<S: Simd>(&mut self, simd: S, row: Points<S>, group: usize) {
        let spin = Points::load_group(simd, &self.points, group).cross(row);
        let values = [row, spin].map(Points::to_array);
        for (out, value) in self.jacobian.iter_mut().zip(values.as_flattened()) {
            value.store_group(out, group);
        }
    }
}

/// How depth noise grows with depth, and the variance of a group's residuals: of the noise, and
/// of relief that neither picture resolves.
#[inline(always)]
fn spread_and_variance<S: Simd>(
    simd: S,
    task: &Linearization<'_>,
    samples: &SampleBlock,
    relief: Lanes<S>,
    group: usize,
) -> (Lanes<S>, Lanes<S>) {
    let number = |value| Lanes::splat(simd, value);
    let z = Lanes::load_group(simd, &samples.point[2], group);
    let spread = z * z.max(number(1.0));
    let rough = number(RELIEF) * relief.max(Lanes::load_group(simd, &samples.relief, group));
    let fine = number(task.scales.depth) * spread;
    (spread, fine.mul_add(fine, rough * rough))
}
