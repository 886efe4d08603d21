//! The equations of the module, one pixel after another: what the lanes must agree with.

use super::{
    FREEDOM, GATE, Geometry, Linearization, Moment, NEAR, READOUT, RELIEF, Sums, Transform,
    UNKNOWNS,
};
use crate::tracking::alignment::pyramid::{one_surface, relief};
use i2slam_geometry::{Camera, Image, Pose, Tap, Vec3};

/// One evaluation and the relief of its two depth pictures.
struct Pixels<'a> {
    task: &'a Linearization<'a>,
    geometry: Geometry,
    observed_relief: Image<f32>,
    model_relief: Image<f32>,
}

impl Linearization<'_> {
    /// What [`accumulate`](Self::accumulate) computes with a sample at every pixel.
    pub(super) fn accumulate_pixels(&self) -> Sums {
        Pixels {
            task: self,
            geometry: Geometry::new(self),
            observed_relief: relief(&self.observed.depth),
            model_relief: relief(&self.model.depth),
        }
        .accumulate()
    }
}

impl Pixels<'_> {
    fn accumulate(&self) -> Sums {
        let mut sums = Sums::default();
        let observed = self.task.observed;
        let (camera, depth) = (&observed.camera, &observed.depth);
        for row in 0..depth.height {
            for column in 0..depth.width {
                let z = depth.at(0, column, row);
                if z <= 0.0 {
                    continue;
                }
                sums.candidates += 1;
                let (u, v) = Camera::<f32>::pixel_centre(column, row);
                let point = self.geometry.centre_from_depth.apply(camera.unproject(u, v, z));
                let reading = (z, self.observed_relief.at(0, column, row));
                if self.add_depth(point, reading, &mut sums) && self.task.image_weight > 0.0 {
                    self.add_colour(point, &mut sums);
                }
            }
        }
        sums
    }

    /// Adds the depth residual of a point read at depth `z` beside `relief`, given in the camera
    /// at mid-exposure; whether the model has this pixel's surface.
    fn add_depth(&self, point: Vec3<f32>, (z, relief): (f32, f32), sums: &mut Sums) -> bool {
        let (task, geometry) = (self.task, &self.geometry);
        let place = geometry.model_from_centre.apply(point);
        if place.z <= NEAR {
            return false;
        }
        let (u, v) = task.observed.camera.project(place);
        let Some(tap) = task.model.depth.tap(u, v) else { return false };
        let Some((d, d_u, d_v)) = surface(tap, &task.model.depth.data) else { return false };
        let residual = d - place.z;
        if residual.abs() > GATE * place.z {
            return false;
        }
        let mut by_place = self.by_place(place, d_u, d_v);
        by_place.z -= 1.0;
        let row = geometry.model_from_centre.rotation.transpose() * by_place;
        // By the observed depth, not by `place`: a scale that moved with the pose would be
        // lowered by moving away.
        let spread = z * z.max(1.0);
        let rough = tap.values(&self.model_relief.data).into_iter().fold(relief, f32::max);
        let scale = (task.scales.depth * spread).hypot(RELIEF * rough);
        // A residual along the optical axis counts by its distance to the surface.
        let normal = by_place.norm().max(1.0);
        let (weight, cost) = robust(residual / normal, scale);
        // The depth's pose leads the centre by a share of the motion, which the centre ends.
        let row = row * (1.0 + task.depth_lead as f32);
        let rest = Vec3::zero();
        let jacobian = jacobian([row, point.cross(row), rest, rest], [0.0; 4]);
        sums.equations.add(&jacobian, f64::from(residual), f64::from(weight / (normal * normal)));
        sums.equations.cost += cost - f64::from(weight * residual * residual / (normal * normal));
        sums.errors.depth += f64::from(residual.abs() / normal / spread);
        sums.errors.depth_count += 1;
        sums.agreeing += 1;
        true
    }

    /// Adds the three colour residuals of the blurred model, at the pixel position of `point` (in
    /// the camera at mid-exposure).
    fn add_colour(&self, point: Vec3<f32>, sums: &mut Sums) {
        let task = self.task;
        if point.z <= NEAR {
            return;
        }
        let (u, v) = task.observed.camera.project(point);
        let Some(pixel) = task.observed.colour.tap(u, v) else { return };
        let row_place = task.rolling_height.map_or(0.0, |height| v / height as f32 - 0.5);
        let Some(blurred) = self.blurred(point, row_place) else { return };
        for channel in 0..3 {
            let observed = pixel.sample(task.observed.colour.plane(channel)).0;
            self.add_channel(&blurred, channel, observed, sums);
        }
    }

    /// The mean over the exposure; none where a moment does not see the point.
    fn blurred(&self, point: Vec3<f32>, row_place: f32) -> Option<Blurred> {
        let (task, geometry) = (self.task, &self.geometry);
        let mut sum =
            Blurred { radiance: [0.0; 3], by_motion: [[Vec3::zero(); 4]; 3], by_readout: [0.0; 3] };
        let turn_back = geometry.model_from_centre.rotation.transpose();
        for moment in &geometry.moments {
            let (centre_from_camera, offset) = self.at_moment(moment, row_place);
            let seen = centre_from_camera.apply(point);
            let place = geometry.model_from_centre.apply(seen);
            let (u, v) = task.observed.camera.project(place);
            let tap = task.model.radiance.tap(u, v)?;
            for channel in 0..3 {
                let (m, m_u, m_v) = tap.sample(task.model.radiance.plane(channel));
                let by_place = self.by_place(place, m_u, m_v);
                let row = turn_back * by_place * moment.weight;
                let moved = seen - centre_from_camera.translation;
                let spin = moved.cross(row);
                sum.radiance[channel] += moment.weight * m;
                let rows = [row, seen.cross(row), row * offset, spin * offset];
                sum.by_readout[channel] += row_place * row.dot(self.rate(moved));
                sum.by_motion[channel].iter_mut().zip(rows).for_each(|(sum, row)| *sum += row);
            }
        }
        Some(sum)
    }

    /// Adds the residual of one channel against the picture's value.
    fn add_channel(&self, blurred: &Blurred, channel: usize, observed: f32, sums: &mut Sums) {
        let task = self.task;
        let (gain, radiance) = (task.state.tone.gains()[channel], blurred.radiance[channel]);
        let (value, slope, by_log_gain) = match task.curve {
            Some(curve) => {
                let x = gain * radiance;
                let slope = curve.slope(channel, x);
                (curve.evaluate(channel, x), slope * gain, slope * x)
            }
            None => (radiance, 1.0, 0.0),
        };
        let residual = value - observed;
        let mut by_tone = [0.0; 4];
        by_tone[0] = by_log_gain;
        by_tone[1 + channel] = by_log_gain;
        let mut jacobian = jacobian(blurred.by_motion[channel].map(|row| row * slope), by_tone);
        if task.rolling_height.is_some() {
            jacobian[READOUT] = f64::from(blurred.by_readout[channel] * slope);
        }
        let (weight, cost) = robust(residual, task.scales.image);
        let share = f64::from(task.image_weight);
        sums.equations.add(&jacobian, f64::from(residual), share * f64::from(weight));
        sums.equations.cost += share * (cost - f64::from(weight * residual * residual));
        sums.errors.image += f64::from(residual.abs());
        sums.errors.image_count += 1;
    }

    /// Where the camera is at a moment of the exposure of a row, and at what time.
    fn at_moment(&self, moment: &Moment, row_place: f32) -> (Transform, f32) {
        let state = self.task.state;
        let late = if self.task.rolling_height.is_some() { state.readout as f32 } else { 0.0 };
        let time = moment.offset + late * row_place;
        let velocity = state.motion.velocity.scaled(f64::from(time));
        (Transform::new(Pose::identity().retract(velocity)), time)
    }

    /// `ν + ω × x`.
    fn rate(&self, moved: Vec3<f32>) -> Vec3<f32> {
        let velocity = self.task.state.motion.velocity.cast::<f32>();
        velocity.translation + velocity.rotation.cross(moved)
    }

    /// From an image gradient to a gradient by the point in the model's camera.
    fn by_place(&self, place: Vec3<f32>, by_u: f32, by_v: f32) -> Vec3<f32> {
        let camera = &self.task.observed.camera;
        let inverse = 1.0 / place.z;
        let (gx, gy) = (by_u * camera.fx * inverse, by_v * camera.fy * inverse);
        Vec3::new(gx, gy, -(gx * place.x + gy * place.y) * inverse)
    }
}

/// The model's radiance over an exposure and its derivatives, per channel.
struct Blurred {
    radiance: [f32; 3],
    /// By ρ and φ of the centre, by ν and ω of the velocity.
    by_motion: [[Vec3<f32>; 4]; 3],
    by_readout: [f32; 3],
}

/// Weight of a residual under a t-distribution, and its cost `(ν + 1) ln(1 + r²/ν)`.
fn robust(residual: f32, scale: f32) -> (f32, f64) {
    let normalised = residual / scale;
    let square = normalised * normalised;
    let weight = (FREEDOM + 1.0) / (FREEDOM + square) / (scale * scale);
    (weight, f64::from((FREEDOM + 1.0) * (square / FREEDOM).ln_1p()))
}

/// By ρ and φ of the centre, ν and ω of the velocity, and the tone.
fn jacobian(by_motion: [Vec3<f32>; 4], by_tone: [f32; 4]) -> [f64; UNKNOWNS] {
    let mut all = [0.0; UNKNOWNS];
    let by_motion = by_motion.map(Vec3::to_array);
    for (i, value) in by_motion.iter().flatten().chain(&by_tone).enumerate() {
        all[i] = f64::from(*value);
    }
    all
}

/// Depth and its derivatives at a tap whose four pixels lie on one surface.
///
/// The inverse of depth is what is interpolated: it is linear over the picture of a plane, so a
/// floor seen at a grazing angle comes out without the bias that linear depth has there.
fn surface(tap: Tap<f32>, depths: &[f32]) -> Option<(f32, f32, f32)> {
    let values = tap.values(depths);
    if !one_surface(values) {
        return None;
    }
    let (inverse, by_u, by_v) = tap.interpolate(values.map(|d| 1.0 / d));
    let depth = 1.0 / inverse;
    let slope = -depth * depth;
    Some((depth, slope * by_u, slope * by_v))
}

#[test]
fn a_grazing_plane_is_interpolated_without_bias() {
    let depth = |u: f32| 1.0 / (0.3 + 0.01 * u);
    let row = [depth(0.5), depth(1.5)];
    let tap = Tap::new(2, 2, 1.2, 0.9).expect("inside");
    let (d, by_u, by_v) = surface(tap, &[row[0], row[1], row[0], row[1]]).expect("a surface");
    let analytic = -0.01 * depth(1.2).powi(2);
    assert!((d - depth(1.2)).abs() < 1e-6 && (by_u - analytic).abs() < 1e-5 && by_v == 0.0);
}
