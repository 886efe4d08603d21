//! Image residuals of a block of samples, one per channel.

use super::depth::DepthBlock;
use super::geometry::{ExposureSample, Points, by_point, placeholder_point, project};
use super::level::{BLOCK, BilinearTaps, BlockValues, groups};
use super::{
    DEGREES_OF_FREEDOM, Derivatives, Linearization, MIN_DISTANCE, READOUT, ResidualSums,
    WHITE_BALANCE,
};
use super::{Kernel, add_normal_equations, cost_of};
use i2slam_compute::simd::{Lanes, Mask};
use pulp::Simd;

/// Intermediate values of a block.
#[derive(Default)]
pub(super) struct ColourBlock {
    /// 1 for samples that are visible to all virtual cameras, 0 for others.
    seen: BlockValues,
    taps: BilinearTaps,
    /// Per channel: the picture's value, then its derivatives, which are not used.
    pixel: [[BlockValues; 3]; 3],
    /// With a rolling shutter, relative positions of the picture's rows and times of the samples.
    row_position: BlockValues,
    times: BlockValues,
    /// The points in the camera at mid-exposure, moved as seen by one virtual camera, and in the
    /// target's camera.
    points: [BlockValues; 3],
    target_points: [BlockValues; 3],
    /// Per channel: the target's radiance for one virtual camera and its derivatives by `u` and
    /// `v`.
    target: [[BlockValues; 3]; 3],
    channels: [Channel; 3],
}

/// Residual and derivatives of one channel.
#[derive(Default)]
struct Channel {
    /// Of the target, averaged over the exposure.
    radiance: BlockValues,
    /// The predicted picture value, and its derivative by radiance.
    value: BlockValues,
    slope: BlockValues,
    /// By ρ and φ of the centre, by ν and ω of the velocity.
    motion: [BlockValues; 12],
    /// By the logarithm of the gain, and by the readout.
    gain: BlockValues,
    readout: BlockValues,
    residual: BlockValues,
    /// Square root of the weight.
    root: BlockValues,
}

impl ColourBlock {
    /// Adds the residuals of the samples that lie on the target's surface.
    #[inline(always)]
    pub(super) fn add<S: Simd>(
        &mut self,
        kernel: Kernel<'_, S>,
        depth: &DepthBlock,
        sums: &mut ResidualSums,
    ) {
        let Kernel { task, geometry, .. } = kernel;
        for group in 0..groups::<S>() {
            self.project_to_frame(kernel, depth, group);
        }
        self.taps.split(&task.frame.camera);
        task.frame.texels.sample(&self.taps, &mut self.pixel);
        for (index, sample) in geometry.exposure.iter().enumerate() {
            for group in 0..groups::<S>() {
                self.project_to_target(kernel, (sample, depth), group);
            }
            self.taps.split(&task.frame.camera);
            task.target.texels.sample(&self.taps, &mut self.target);
            for group in 0..groups::<S>() {
                self.accumulate(kernel, (sample, index == 0), group);
            }
        }
        for channel in 0..3 {
            self.channels[channel].apply_response(task, channel);
            self.channels[channel].compare(kernel, &self.seen, &self.pixel[channel][0], sums);
            if task.derivatives != Derivatives::None {
                self.channels[channel].add_equations(kernel, channel, sums);
            }
        }
    }

    /// Stores the image positions of a group's samples in the frame.
    #[inline(always)]
    fn project_to_frame<S: Simd>(
        &mut self,
        Kernel { simd, task, geometry }: Kernel<'_, S>,
        depth: &DepthBlock,
        group: usize,
    ) {
        let point = Points::load_group(simd, &depth.points, group);
        let camera = &task.frame.camera;
        let position = project(simd, camera, point);
        let seen = self.taps.store_positions(simd, group, position, camera)
            & Mask::load_group(simd, &depth.agreeing, group)
            & Lanes::splat(simd, MIN_DISTANCE).lt(point.z);
        seen.ones().store_group(&mut self.seen, group);
        if let Some(rolling) = &geometry.rolling {
            // Lanes without a sample have no row: masked, so that they do not spoil sums.
            seen.keep(rolling.row_position(simd, position.1))
                .store_group(&mut self.row_position, group);
        }
    }

    /// Stores the image positions of a group's samples in the target, for one virtual camera.
    #[inline(always)]
    fn project_to_target<S: Simd>(
        &mut self,
        kernel: Kernel<'_, S>,
        (sample, depth): (&ExposureSample, &DepthBlock),
        group: usize,
    ) {
        let Kernel { simd, task, geometry } = kernel;
        let point = Points::load_group(simd, &depth.points, group);
        let seen = self.moved_to_centre(kernel, sample, point, group);
        let target_point = geometry.target_from_centre.transform(simd, seen);
        seen.store_group(&mut self.points, group);
        let camera = &task.frame.camera;
        let target_point = match &geometry.target_rolling {
            Some(rolling) => rolling.seen_by_row(simd, camera, target_point),
            None => target_point,
        };
        let inside =
            self.taps.store_positions(simd, group, project(simd, camera, target_point), camera)
                & Mask::load_group(simd, &self.seen, group);
        inside.ones().store_group(&mut self.seen, group);
        let target_point = Points::select(inside, target_point, placeholder_point(simd));
        target_point.store_group(&mut self.target_points, group);
    }

    /// Moves a group's points from the virtual camera, at the time of their rows, into the camera
    /// at mid-exposure.
    #[inline(always)]
    fn moved_to_centre<S: Simd>(
        &mut self,
        Kernel { simd, geometry, .. }: Kernel<'_, S>,
        sample: &ExposureSample,
        point: Points<S>,
        group: usize,
    ) -> Points<S> {
        let Some(rolling) = &geometry.rolling else {
            return sample.centre_from_camera.transform(simd, point);
        };
        let time =
            rolling.time(simd, Lanes::load_group(simd, &self.row_position, group), sample.time);
        time.store_group(&mut self.times, group);
        let one = Lanes::splat(simd, 1.0);
        rolling.rotated(simd, time, point).mul_add(one, rolling.translation(simd, time))
    }

    /// Adds radiance and derivatives of one virtual camera.
    #[inline(always)]
    fn accumulate<S: Simd>(
        &mut self,
        kernel: Kernel<'_, S>,
        (sample, first): (&ExposureSample, bool),
        group: usize,
    ) {
        let Kernel { simd, task, geometry } = kernel;
        let number = |value| Lanes::splat(simd, value);
        let weight = number(sample.weight);
        for channel in 0..3 {
            let radiance = Lanes::load_group(simd, &self.target[channel][0], group) * weight;
            add_or_set(radiance, &mut self.channels[channel].radiance, group, first);
        }
        if task.derivatives == Derivatives::None {
            return;
        }
        let target_point = Points::load_group(simd, &self.target_points, group);
        let camera = &task.frame.camera;
        // Derivatives of `(u, v)` by the point, in the axes of the camera at mid-exposure.
        let by =
            |u, v| geometry.rotate_to_centre(simd, by_point(simd, camera, target_point, (u, v)));
        let (along_u, along_v) = (by(weight, number(0.0)), by(number(0.0), weight));
        let points = self.moved_points(kernel, sample, group);
        for channel in 0..3 {
            let by_u = Lanes::load_group(simd, &self.target[channel][1], group);
            let by_v = Lanes::load_group(simd, &self.target[channel][2], group);
            let row = along_u.mul_add(by_u, along_v.scaled(by_v));
            self.channels[channel].add_motion(kernel, row, &points, (group, first));
        }
    }

    /// A group's points at one virtual camera, with the terms of their motion.
    #[inline(always)]
    fn moved_points<S: Simd>(
        &self,
        Kernel { simd, geometry, .. }: Kernel<'_, S>,
        sample: &ExposureSample,
        group: usize,
    ) -> MovedPoints<S> {
        let seen = Points::load_group(simd, &self.points, group);
        let row_position = Lanes::load_group(simd, &self.row_position, group);
        match &geometry.rolling {
            Some(rolling) => {
                let time = Lanes::load_group(simd, &self.times, group);
                let moved = seen.minus(rolling.translation(simd, time));
                MovedPoints { seen, moved, time, row_position }
            }
            None => {
                let translation = Points::splat(simd, sample.centre_from_camera.translation);
                let time = Lanes::splat(simd, sample.time);
                MovedPoints { seen, moved: seen.minus(translation), time, row_position }
            }
        }
    }
}

/// Points of a group at one virtual camera.
struct MovedPoints<S: Simd> {
    /// In the camera at mid-exposure, with and without the camera's translation since then.
    seen: Points<S>,
    moved: Points<S>,
    /// Time since mid-exposure, and the relative position of the picture's row.
    time: Lanes<S>,
    row_position: Lanes<S>,
}

/// Adds to two triples of rows, or sets them for the `first` virtual camera.
#[inline(always)]
fn add_rows<S: Simd>(values: [Points<S>; 2], rows: &mut [BlockValues], group: usize, first: bool) {
    let [row, spin] = values;
    let values = [row.x, row.y, row.z, spin.x, spin.y, spin.z];
    for k in 0..6 {
        add_or_set(values[k], &mut rows[k], group, first);
    }
}

/// Adds `value` to a group, or sets it for the `first` virtual camera.
#[inline(always)]
fn add_or_set<S: Simd>(value: Lanes<S>, row: &mut BlockValues, group: usize, first: bool) {
    let sum = if first { value } else { value + Lanes::load_group(value.simd(), row, group) };
    sum.store_group(row, group);
}

impl Channel {
    /// Adds the derivatives by motion and readout for one virtual camera, from the derivative `row`
    /// by the points.
    #[inline(always)]
    fn add_motion<S: Simd>(
        &mut self,
        Kernel { simd, task, geometry }: Kernel<'_, S>,
        row: Points<S>,
        points: &MovedPoints<S>,
        (group, first): (usize, bool),
    ) {
        let (centre, velocity) = self.motion.split_at_mut(6);
        add_rows([row, points.seen.cross(row)], centre, group, first);
        if task.derivatives != Derivatives::All {
            return;
        }
        if let Some(rolling) = &geometry.rolling {
            let by_readout = points.row_position * row.dot(rolling.velocity_of(simd, points.moved));
            add_or_set(by_readout, &mut self.readout, group, first);
        }
        if geometry.has_velocity() {
            let row = row.scaled(points.time);
            add_rows([row, points.moved.cross(row)], velocity, group, first);
        }
    }

    /// Applies exposure, white balance and response to the radiance.
    #[inline(always)]
    fn apply_response(&mut self, task: &Linearization<'_>, channel: usize) {
        let Some(curve) = task.curve else {
            self.value = self.radiance;
            self.slope.0.fill(1.0);
            return;
        };
        let gain = task.tone.gains()[channel];
        for i in 0..BLOCK {
            let x = gain * self.radiance.0[i];
            let (value, slope) = curve.evaluate_with_slope(channel, x);
            (self.value.0[i], self.slope.0[i]) = (value, slope * gain);
        }
    }

    /// Residuals against the picture values `pixel`, with the square roots of their weights.
    #[inline(always)]
    fn compare<S: Simd>(
        &mut self,
        Kernel { simd, task, .. }: Kernel<'_, S>,
        seen: &BlockValues,
        pixel: &BlockValues,
        sums: &mut ResidualSums,
    ) {
        let number = |value| Lanes::splat(simd, value);
        let share = task.image_weight;
        let precision = 1.0 / (task.scales.image * task.scales.image);
        let (mut cost, mut error, mut count) = (number(0.0), number(0.0), number(0.0));
        for group in 0..groups::<S>() {
            let seen = Mask::load_group(simd, seen, group);
            let value = Lanes::load_group(simd, &self.value, group);
            let residual = value - Lanes::load_group(simd, pixel, group);
            let square = residual * residual * number(precision);
            cost += seen.keep(cost_of(simd, square));
            error += seen.keep(residual.abs());
            count += seen.ones();
            let weight = number((DEGREES_OF_FREEDOM + 1.0) * precision * share);
            let root = (weight / (number(DEGREES_OF_FREEDOM) + square)).sqrt();
            seen.keep(root).store_group(&mut self.root, group);
            residual.store_group(&mut self.residual, group);
        }
        let count = count.reduce_sum() as usize;
        sums.equations.cost += f64::from(share) * f64::from(cost.reduce_sum());
        sums.equations.count += count;
        sums.errors.image += f64::from(error.reduce_sum());
        sums.errors.image_count += count;
    }

    /// Adds the normal equations of channel `channel`.
    #[inline(always)]
    fn add_equations<S: Simd>(
        &mut self,
        Kernel { simd, task, geometry }: Kernel<'_, S>,
        channel: usize,
        sums: &mut ResidualSums,
    ) {
        let is_all = task.derivatives == Derivatives::All;
        let motions = if is_all && geometry.has_velocity() { 12 } else { 6 };
        let has_readout = is_all && geometry.rolling.is_some();
        let toned = Lanes::splat(simd, if task.curve.is_some() { 1.0 } else { 0.0 });
        for group in 0..groups::<S>() {
            let root = Lanes::load_group(simd, &self.root, group);
            let slope = Lanes::load_group(simd, &self.slope, group) * root;
            for row in &mut self.motion[..motions] {
                (Lanes::load_group(simd, row, group) * slope).store_group(row, group);
            }
            let radiance = Lanes::load_group(simd, &self.radiance, group);
            (radiance * slope * toned).store_group(&mut self.gain, group);
            if has_readout {
                (Lanes::load_group(simd, &self.readout, group) * slope)
                    .store_group(&mut self.readout, group);
            }
            (Lanes::load_group(simd, &self.residual, group) * root)
                .store_group(&mut self.residual, group);
        }
        let mut rows = [&self.residual; 15];
        let mut unknowns = [READOUT; 14];
        for k in 0..motions {
            (rows[k], unknowns[k]) = (&self.motion[k], k);
        }
        (rows[motions], unknowns[motions]) = (&self.gain, WHITE_BALANCE + channel);
        let mut count = motions + 1;
        if has_readout {
            rows[count] = &self.readout;
            count += 1;
        }
        let (rows, unknowns) = (&rows[..count + 1], &unknowns[..count]);
        add_normal_equations(simd, rows, unknowns, &mut sums.equations);
    }
}
