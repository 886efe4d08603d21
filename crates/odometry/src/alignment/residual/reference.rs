//! Reference lane of the residuals: one pixel after another, readable beside the equations.

use super::geometry::{ExposureSample, Geometry, ROW_ITERATIONS, Transform};
use super::level::{is_one_surface, roughness};
use super::{DEGREES_OF_FREEDOM, Linearization, MAX_DEPTH_RESIDUAL_RATIO, MIN_DISTANCE, READOUT};
use super::{ROUGHNESS_SIGMA_RATIO, ResidualSums, UNKNOWNS};
use i2slam_geometry::{Camera, Image, Pose, Tap, Vec3};

/// One evaluation, with the roughness of its two depth pictures.
struct Pixels<'a> {
    task: &'a Linearization<'a>,
    geometry: Geometry,
    frame_roughness: Image<f32>,
    target_roughness: Image<f32>,
}

impl Linearization<'_> {
    /// [`accumulate`](Self::accumulate) with a sample at every pixel.
    pub(super) fn accumulate_pixels(&self) -> ResidualSums {
        Pixels {
            task: self,
            geometry: Geometry::new(self),
            frame_roughness: roughness(&self.frame.depth),
            target_roughness: roughness(&self.target.depth),
        }
        .accumulate()
    }
}

impl Pixels<'_> {
    fn accumulate(&self) -> ResidualSums {
        let mut sums = ResidualSums::default();
        let (camera, depth) = (&self.task.frame.camera, &self.task.frame.depth);
        for row in 0..depth.height {
            for column in 0..depth.width {
                let z = depth.at(0, column, row);
                if z <= 0.0 {
                    continue;
                }
                sums.candidates += 1;
                let (u, v) = Camera::<f32>::pixel_centre(column, row);
                let point = self.geometry.centre_from_depth.apply(camera.unproject(u, v, z));
                let reading = (z, self.frame_roughness.at(0, column, row));
                if self.add_depth(point, reading, &mut sums) && self.task.image_weight > 0.0 {
                    self.add_colour(point, &mut sums);
                }
            }
        }
        sums
    }

    /// Adds the depth residual of a pixel with depth `z` and `roughness`, whose point is given in
    /// the camera at mid-exposure. Returns whether the point lies on the target's surface.
    fn add_depth(
        &self,
        point: Vec3<f32>,
        (z, roughness): (f32, f32),
        sums: &mut ResidualSums,
    ) -> bool {
        let (task, geometry) = (self.task, &self.geometry);
        let target_point = geometry.target_from_centre.apply(point);
        if target_point.z <= MIN_DISTANCE {
            return false;
        }
        let (u, v) = task.frame.camera.project(target_point);
        if !task.target.has_surface {
            let is_seen = task.target.radiance.tap(u, v).is_some();
            sums.agreeing += usize::from(is_seen);
            return is_seen;
        }
        let Some(tap) = task.target.depth.tap(u, v) else { return false };
        let Some((d, d_u, d_v)) = depth_at(tap, &task.target.depth.data) else { return false };
        let residual = d - target_point.z;
        if residual.abs() > MAX_DEPTH_RESIDUAL_RATIO * target_point.z {
            return false;
        }
        let mut gradient = self.by_point(target_point, d_u, d_v);
        gradient.z -= 1.0;
        let row = geometry.target_from_centre.rotation.transpose() * gradient;
        // From the measured depth, not the re-projected one: a scale that depends on the pose would
        // be lowered by moving away.
        let spread = z * z.max(1.0);
        let rough = tap.values(&self.target_roughness.data).into_iter().fold(roughness, f32::max);
        let scale = (task.scales.depth * spread).hypot(ROUGHNESS_SIGMA_RATIO * rough);
        // Distance to the surface in place of the residual along the optical axis.
        let normal = gradient.norm().max(1.0);
        let (weight, cost) = robust(residual / normal, scale);
        // The depth picture's pose moves with the centre, and farther by the ratio.
        let row = row * (1.0 + task.depth_offset_ratio as f32);
        let rest = Vec3::zero();
        let jacobian = jacobian([row, point.cross(row), rest, rest], [0.0; 4]);
        sums.equations.add(&jacobian, f64::from(residual), f64::from(weight / (normal * normal)));
        sums.equations.cost += cost - f64::from(weight * residual * residual / (normal * normal));
        sums.errors.depth += f64::from(residual.abs() / normal / spread);
        sums.errors.depth_count += 1;
        sums.agreeing += 1;
        true
    }

    /// Adds the image residuals of the three channels at the projection of `point` (in the camera
    /// at mid-exposure).
    fn add_colour(&self, point: Vec3<f32>, sums: &mut ResidualSums) {
        let task = self.task;
        if point.z <= MIN_DISTANCE {
            return;
        }
        let (u, v) = task.frame.camera.project(point);
        let Some(pixel) = task.frame.colour.tap(u, v) else { return };
        let row_position = task.rolling_height.map_or(0.0, |height| v / height as f32 - 0.5);
        let Some(blurred) = self.average(point, row_position) else { return };
        for channel in 0..3 {
            let observed = pixel.sample(task.frame.colour.plane(channel)).0;
            self.add_channel(&blurred, channel, observed, sums);
        }
    }

    /// The average over the exposure; `None` where a virtual camera does not see the point.
    fn average(&self, point: Vec3<f32>, row_position: f32) -> Option<Blurred> {
        let (task, geometry) = (self.task, &self.geometry);
        let mut sum =
            Blurred { radiance: [0.0; 3], by_motion: [[Vec3::zero(); 4]; 3], by_readout: [0.0; 3] };
        let rotate_to_centre = geometry.target_from_centre.rotation.transpose();
        for sample in &geometry.exposure {
            let (centre_from_camera, time) = self.camera_of_row(sample, row_position);
            let seen = centre_from_camera.apply(point);
            let target_point = self.seen_by_row(geometry.target_from_centre.apply(seen));
            let (u, v) = task.frame.camera.project(target_point);
            let tap = task.target.radiance.tap(u, v)?;
            for channel in 0..3 {
                let (m, m_u, m_v) = tap.sample(task.target.radiance.plane(channel));
                let gradient = self.by_point(target_point, m_u, m_v);
                let row = rotate_to_centre * gradient * sample.weight;
                let rotated = seen - centre_from_camera.translation;
                let spin = rotated.cross(row);
                sum.radiance[channel] += sample.weight * m;
                let rows = [row, seen.cross(row), row * time, spin * time];
                sum.by_readout[channel] += row_position * row.dot(self.velocity_of(rotated));
                sum.by_motion[channel].iter_mut().zip(rows).for_each(|(sum, row)| *sum += row);
            }
        }
        Some(sum)
    }

    /// Adds the residual of one channel against the picture value `observed`.
    fn add_channel(
        &self,
        blurred: &Blurred,
        channel: usize,
        observed: f32,
        sums: &mut ResidualSums,
    ) {
        let task = self.task;
        let (gain, radiance) = (task.tone.gains()[channel], blurred.radiance[channel]);
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

    /// Pose of a virtual camera at the time of a row, and that time [exposures].
    fn camera_of_row(&self, sample: &ExposureSample, row_position: f32) -> (Transform, f32) {
        let task = self.task;
        let readout = if task.rolling_height.is_some() { task.readout as f32 } else { 0.0 };
        let time = sample.time + readout * row_position;
        let velocity = task.motion.velocity.scaled(f64::from(time));
        (Transform::new(Pose::identity().retract(velocity)), time)
    }

    /// A point of the target's camera as the row sees it in which it appears.
    fn seen_by_row(&self, point: Vec3<f32>) -> Vec3<f32> {
        let Some(rows) = self.task.target_rows else { return point };
        (0..ROW_ITERATIONS).fold(point, |seen, _| {
            let row_position = self.task.frame.camera.project(seen).1 / rows.height as f32 - 0.5;
            let motion = rows.motion.scaled(f64::from(row_position));
            Transform::new(Pose::identity().retract(motion).inverse()).apply(point)
        })
    }

    /// `ν + ω × x`.
    fn velocity_of(&self, rotated: Vec3<f32>) -> Vec3<f32> {
        let velocity = self.task.motion.velocity.cast::<f32>();
        velocity.translation + velocity.rotation.cross(rotated)
    }

    /// Chain rule through the projection: from derivatives by `(u, v)` to derivatives by the point.
    fn by_point(&self, target_point: Vec3<f32>, by_u: f32, by_v: f32) -> Vec3<f32> {
        let camera = &self.task.frame.camera;
        let inverse = 1.0 / target_point.z;
        let (gx, gy) = (by_u * camera.fx * inverse, by_v * camera.fy * inverse);
        Vec3::new(gx, gy, -(gx * target_point.x + gy * target_point.y) * inverse)
    }
}

/// The target's radiance averaged over an exposure and its derivatives, per channel.
struct Blurred {
    radiance: [f32; 3],
    /// By ρ and φ of the centre, ν and ω of the velocity.
    by_motion: [[Vec3<f32>; 4]; 3],
    by_readout: [f32; 3],
}

/// Weight of a residual under a t-distribution, and its cost `(ν + 1) ln(1 + r²/ν)`.
fn robust(residual: f32, scale: f32) -> (f32, f64) {
    let normalised = residual / scale;
    let square = normalised * normalised;
    let weight = (DEGREES_OF_FREEDOM + 1.0) / (DEGREES_OF_FREEDOM + square) / (scale * scale);
    (weight, f64::from((DEGREES_OF_FREEDOM + 1.0) * (square / DEGREES_OF_FREEDOM).ln_1p()))
}

/// One row of derivatives: by ρ and φ of the centre, ν and ω of the velocity, and the tone.
fn jacobian(by_motion: [Vec3<f32>; 4], by_tone: [f32; 4]) -> [f64; UNKNOWNS] {
    let mut all = [0.0; UNKNOWNS];
    let by_motion = by_motion.map(Vec3::to_array);
    for (i, value) in by_motion.iter().flatten().chain(&by_tone).enumerate() {
        all[i] = f64::from(*value);
    }
    all
}

/// Depth and its derivatives at a tap whose four pixels lie on one surface, from interpolated
/// inverse depth.
fn depth_at(tap: Tap<f32>, depths: &[f32]) -> Option<(f32, f32, f32)> {
    let values = tap.values(depths);
    if !is_one_surface(values) {
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
    let (d, by_u, by_v) = depth_at(tap, &[row[0], row[1], row[0], row[1]]).expect("a surface");
    let analytic = -0.01 * depth(1.2).powi(2);
    assert!((d - depth(1.2)).abs() < 1e-6 && (by_u - analytic).abs() < 1e-5 && by_v == 0.0);
}
