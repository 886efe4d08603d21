//! The three colour residuals of a block of samples.

use super::block::{BLOCK, Row, groups};
use super::depth::DepthBlock;
use super::normal_equations::add_products;
use super::points::Points;
use super::samples::Taps;
use super::{BALANCE, FREEDOM, Geometry, Linearization, Moment, NEAR, READOUT, Sums};
use i2slam_compute::simd::{Lanes, Mask};
use pulp::Simd;

/// Rows of one block on their way through the stages.
pub(super) struct ColourBlock {
    /// 1 for samples that all moments of the exposure see.
    seen: Row,
    taps: Taps,
    /// Per channel: the picture's value; the rest is not used.
    pixel: [[Row; 3]; 3],
    /// Place of the picture's row, and the points' times, where rows are exposed in turn.
    row_place: Row,
    times: Row,
    /// The points in the camera at a moment, and in the model's.
    points: [Row; 3],
    places: [Row; 3],
    /// Per channel: the model's radiance at a moment and its derivatives by `u` and `v`.
    model: [[Row; 3]; 3],
    channels: [Channel; 3],
}

#[derive(Clone, Copy)]
struct Channel {
    /// Of the blurred model.
    radiance: Row,
    /// The picture value that it stands for, and its slope by radiance.
    value: Row,
    slope: Row,
    /// By ρ and φ of the centre, by ν and ω of the velocity.
    motion: [Row; 12],
    /// By the logarithm of the gain, and by the readout.
    gain: Row,
    readout: Row,
    residual: Row,
    /// Root of the weight.
    root: Row,
}

impl Channel {
    const ZERO: Self = Self {
        radiance: Row::ZERO,
        value: Row::ZERO,
        slope: Row::ZERO,
        motion: [Row::ZERO; 12],
        gain: Row::ZERO,
        readout: Row::ZERO,
        residual: Row::ZERO,
        root: Row::ZERO,
    };
}

impl ColourBlock {
    pub(super) fn new() -> Self {
        Self {
            seen: Row::ZERO,
            taps: Taps::EMPTY,
            pixel: [[Row::ZERO; 3]; 3],
            row_place: Row::ZERO,
            times: Row::ZERO,
            points: [Row::ZERO; 3],
            places: [Row::ZERO; 3],
            model: [[Row::ZERO; 3]; 3],
            channels: [Channel::ZERO; 3],
        }
    }

    /// Adds the residuals of the samples that lie on the model's surface.
    #[inline(always)]
    pub(super) fn add<S: Simd>(
        &mut self,
        simd: S,
        task: &Linearization<'_>,
        geometry: &Geometry,
        depth: &DepthBlock,
        sums: &mut Sums,
    ) {
        for group in 0..groups::<S>() {
            self.read(simd, task, geometry, depth, group);
        }
        self.taps.split(&task.observed.camera);
        task.observed.texels.sample(&self.taps, &mut self.pixel);
        for (index, moment) in geometry.moments.iter().enumerate() {
            for group in 0..groups::<S>() {
                self.place(simd, task, geometry, (moment, depth), group);
            }
            self.taps.split(&task.observed.camera);
            task.model.texels.sample(&self.taps, &mut self.model);
            for group in 0..groups::<S>() {
                self.blur(simd, task, geometry, (moment, index == 0), group);
            }
        }
        for channel in 0..3 {
            self.channels[channel].expose(task, channel);
            self.channels[channel].compare(simd, task, &self.seen, &self.pixel[channel][0], sums);
            if task.derivatives {
                self.channels[channel].add_equations(simd, task, geometry, channel, sums);
            }
        }
    }

    /// Where the picture shows the samples of a group.
    #[inline(always)]
    fn read<S: Simd>(
        &mut self,
        simd: S,
        task: &Linearization<'_>,
        geometry: &Geometry,
        depth: &DepthBlock,
        group: usize,
    ) {
        let point = Points::load_group(simd, &depth.points, group);
        let camera = &task.observed.camera;
        let position = super::project(simd, camera, point);
        let seen = self.taps.place(simd, group, position, camera)
            & Mask::load_group(simd, &depth.agreeing, group)
            & Lanes::splat(simd, NEAR).lt(point.z);
        seen.ones().store_group(&mut self.seen, group);
        if let Some(rolling) = &geometry.rolling {
            // Lanes without a sample have no row, and must not spoil sums.
            seen.keep(rolling.place(simd, position.1)).store_group(&mut self.row_place, group);
        }
    }

    /// Where the model's picture shows them at one moment.
    #[inline(always)]
    fn place<S: Simd>(
        &mut self,
        simd: S,
        task: &Linearization<'_>,
        geometry: &Geometry,
        (moment, depth): (&Moment, &DepthBlock),
        group: usize,
    ) {
        let point = Points::load_group(simd, &depth.points, group);
        let seen = self.at_moment(simd, geometry, moment, point, group);
        let place = geometry.model_from_centre.apply_lanes(simd, seen);
        seen.store_group(&mut self.points, group);
        let camera = &task.observed.camera;
        let inside = self.taps.place(simd, group, super::project(simd, camera, place), camera)
            & Mask::load_group(simd, &self.seen, group);
        inside.ones().store_group(&mut self.seen, group);
        let place = Points::select(inside, place, super::on_axis(simd));
        place.store_group(&mut self.places, group);
    }

    /// A group's points in the camera at mid-exposure, from that at one moment of their rows.
    #[inline(always)]
    fn at_moment<S: Simd>(
        &mut self,
        simd: S,
        geometry: &Geometry,
        moment: &Moment,
        point: Points<S>,
        group: usize,
    ) -> Points<S> {
        let Some(rolling) = &geometry.rolling else {
            return moment.centre_from_camera.apply_lanes(simd, point);
        };
        let time =
            rolling.time(simd, Lanes::load_group(simd, &self.row_place, group), moment.offset);
        time.store_group(&mut self.times, group);
        let one = Lanes::splat(simd, 1.0);
        rolling.turned(simd, time, point).mul_add(one, rolling.moved(simd, time))
    }

    /// Adds what one moment contributes to radiance and derivatives.
    #[inline(always)]
    fn blur<S: Simd>(
        &mut self,
        simd: S,
        task: &Linearization<'_>,
        geometry: &Geometry,
        (moment, first): (&Moment, bool),
        group: usize,
    ) {
        let number = |value| Lanes::splat(simd, value);
        let weight = number(moment.weight);
        for channel in 0..3 {
            let radiance = Lanes::load_group(simd, &self.model[channel][0], group) * weight;
            accumulate(radiance, &mut self.channels[channel].radiance, group, first);
        }
        if !task.derivatives {
            return;
        }
        let place = Points::load_group(simd, &self.places, group);
        let camera = &task.observed.camera;
        // The derivatives of `(u, v)` by the point, turned back into the camera.
        let by = |u, v| geometry.turn_back(simd, super::by_place(simd, camera, place, (u, v)));
        let (along_u, along_v) = (by(weight, number(0.0)), by(number(0.0), weight));
        let points = self.carried(simd, geometry, moment, group);
        for channel in 0..3 {
            let by_u = Lanes::load_group(simd, &self.model[channel][1], group);
            let by_v = Lanes::load_group(simd, &self.model[channel][2], group);
            let row = along_u.mul_add(by_u, along_v.scaled(by_v));
            self.channels[channel].add_motion(simd, geometry, row, &points, (group, first));
        }
    }

    /// How the camera's motion up to one moment carries a group's points.
    #[inline(always)]
    fn carried<S: Simd>(
        &self,
        simd: S,
        geometry: &Geometry,
        moment: &Moment,
        group: usize,
    ) -> Carried<S> {
        let seen = Points::load_group(simd, &self.points, group);
        let row_place = Lanes::load_group(simd, &self.row_place, group);
        match &geometry.rolling {
            Some(rolling) => {
                let time = Lanes::load_group(simd, &self.times, group);
                let moved = seen.minus(rolling.moved(simd, time));
                Carried { seen, moved, time, row_place }
            }
            None => {
                let translation = Points::splat(simd, moment.centre_from_camera.translation);
                let time = Lanes::splat(simd, moment.offset);
                Carried { seen, moved: seen.minus(translation), time, row_place }
            }
        }
    }
}

/// Points of a group at one moment.
struct Carried<S: Simd> {
    /// In the camera at mid-exposure, and the same without the camera's translation.
    seen: Points<S>,
    moved: Points<S>,
    /// Time from mid-exposure, and the place of the picture's row.
    time: Lanes<S>,
    row_place: Lanes<S>,
}

/// Adds to two triples of rows, or sets them.
#[inline(always)]
fn add_rows<S: Simd>(values: [Points<S>; 2], rows: &mut [Row], group: usize, first: bool) {
    let [row, spin] = values;
    let values = [row.x, row.y, row.z, spin.x, spin.y, spin.z];
    for k in 0..6 {
        accumulate(values[k], &mut rows[k], group, first);
    }
}

#[inline(always)]
fn accumulate<S: Simd>(value: Lanes<S>, row: &mut Row, group: usize, first: bool) {
    let sum = if first { value } else { value + Lanes::load_group(value.simd(), row, group) };
    sum.store_group(row, group);
}

impl Channel {
    /// Adds the derivatives of one moment by motion and readout, from `row` by the points.
    #[inline(always)]
    fn add_motion<S: Simd>(
        &mut self,
        simd: S,
        geometry: &Geometry,
        row: Points<S>,
        points: &Carried<S>,
        (group, first): (usize, bool),
    ) {
        let (centre, velocity) = self.motion.split_at_mut(6);
        add_rows([row, points.seen.cross(row)], centre, group, first);
        if let Some(rolling) = &geometry.rolling {
            let by_readout = points.row_place * row.dot(rolling.rate(simd, points.moved));
            accumulate(by_readout, &mut self.readout, group, first);
        }
        if geometry.has_velocity() {
            let row = row.scaled(points.time);
            add_rows([row, points.moved.cross(row)], velocity, group, first);
        }
    }

    /// From radiance to picture values, and their slope by radiance.
    #[inline(always)]
    fn expose(&mut self, task: &Linearization<'_>, channel: usize) {
        let Some(curve) = task.curve else {
            self.value = self.radiance;
            self.slope.0.fill(1.0);
            return;
        };
        let gain = task.state.tone.gains()[channel];
        for i in 0..BLOCK {
            let x = gain * self.radiance.0[i];
            self.value.0[i] = curve.evaluate(channel, x);
            self.slope.0[i] = curve.slope(channel, x) * gain;
        }
    }

    /// Residuals against the picture values `pixel`, and the roots of their weights.
    #[inline(always)]
    fn compare<S: Simd>(
        &mut self,
        simd: S,
        task: &Linearization<'_>,
        seen: &Row,
        pixel: &Row,
        sums: &mut Sums,
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
            cost += seen.keep(super::cost(simd, square));
            error += seen.keep(residual.abs());
            count += seen.ones();
            let weight = number((FREEDOM + 1.0) * precision * share);
            let root = (weight / (number(FREEDOM) + square)).sqrt();
            seen.keep(root).store_group(&mut self.root, group);
            residual.store_group(&mut self.residual, group);
        }
        let count = count.reduce_sum() as usize;
        sums.equations.cost += f64::from(share) * f64::from(cost.reduce_sum());
        sums.equations.count += count;
        sums.errors.image += f64::from(error.reduce_sum());
        sums.errors.image_count += count;
    }

    /// Adds the normal equations of channel number `channel`.
    #[inline(always)]
    fn add_equations<S: Simd>(
        &mut self,
        simd: S,
        task: &Linearization<'_>,
        geometry: &Geometry,
        channel: usize,
        sums: &mut Sums,
    ) {
        let motions = if geometry.has_velocity() { 12 } else { 6 };
        let toned = Lanes::splat(simd, if task.curve.is_some() { 1.0 } else { 0.0 });
        for group in 0..groups::<S>() {
            let root = Lanes::load_group(simd, &self.root, group);
            let slope = Lanes::load_group(simd, &self.slope, group) * root;
            for row in &mut self.motion[..motions] {
                (Lanes::load_group(simd, row, group) * slope).store_group(row, group);
            }
            let radiance = Lanes::load_group(simd, &self.radiance, group);
            (radiance * slope * toned).store_group(&mut self.gain, group);
            if geometry.rolling.is_some() {
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
        (rows[motions], unknowns[motions]) = (&self.gain, BALANCE + channel);
        let mut count = motions + 1;
        if geometry.rolling.is_some() {
            rows[count] = &self.readout;
            count += 1;
        }
        let (rows, unknowns) = (&rows[..count + 1], &unknowns[..count]);
        add_products(simd, rows, unknowns, &mut sums.equations);
    }
}
