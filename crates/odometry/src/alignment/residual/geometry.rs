//! Rigid transforms, rolling-shutter timing and projection of vectors of points.

use super::Linearization;
use super::level::BlockValues;
use i2slam_compute::simd::{Lanes, Mask};
use i2slam_formation::{ShutterPoses, VirtualCamera};
use i2slam_geometry::{Camera, Mat3, Pose, Tangent, Vec3};
use pulp::Simd;

/// Iterations for the row in which a target shows a point: each divides the error by the height
/// over the motion during the readout, both in pixels.
pub(super) const ROW_ITERATIONS: usize = 2;

/// A virtual camera of the exposure.
pub(super) struct ExposureSample {
    /// To the camera at mid-exposure.
    pub(super) centre_from_camera: Transform,
    pub(super) weight: f32,
    /// Time since mid-exposure [exposures].
    pub(super) time: f32,
}

/// A rigid transform as a matrix.
pub(super) struct Transform {
    pub(super) rotation: Mat3<f32>,
    pub(super) translation: Vec3<f32>,
}

impl Transform {
    pub(super) fn new(pose: Pose<f64>) -> Self {
        let rows = pose.rotation.matrix().rows.map(|r| r.map(|v| v as f32));
        Self { rotation: Mat3 { rows }, translation: pose.translation.cast() }
    }

    #[cfg(test)]
    pub(super) fn apply(&self, point: Vec3<f32>) -> Vec3<f32> {
        self.rotation * point + self.translation
    }

    /// Row `row` of the rotation, in every lane.
    #[inline(always)]
    pub(super) fn row<S: Simd>(&self, simd: S, row: usize) -> Points<S> {
        Points::splat(simd, Vec3::from_array(self.rotation.rows[row]))
    }

    #[inline(always)]
    pub(super) fn transform<S: Simd>(&self, simd: S, points: Points<S>) -> Points<S> {
        let translation = Points::splat(simd, self.translation);
        Points {
            x: self.row(simd, 0).dot(points) + translation.x,
            y: self.row(simd, 1).dot(points) + translation.y,
            z: self.row(simd, 2).dot(points) + translation.z,
        }
    }
}

/// Transforms of one evaluation; "centre" is the camera at mid-exposure.
pub(super) struct Geometry {
    pub(super) target_from_centre: Transform,
    pub(super) exposure: Vec<ExposureSample>,
    pub(super) centre_from_depth: Transform,
    pub(super) rolling: Option<RowTiming>,
    /// Of the target's rows, its motion during the readout as unit of time.
    pub(super) target_rolling: Option<RowTiming>,
}

impl Geometry {
    pub(super) fn new(task: &Linearization<'_>) -> Self {
        let shutter: ShutterPoses<f64> = task.motion.into();
        let cameras = shutter.virtual_cameras(task.cameras, task.quadrature);
        let world_from_centre = task.motion.centre;
        let centre_from_world = world_from_centre.inverse();
        let sample = |camera: &VirtualCamera<f64>| ExposureSample {
            centre_from_camera: Transform::new(centre_from_world * camera.world_from_camera),
            weight: camera.weight as f32,
            time: (camera.u - 0.5) as f32,
        };
        Self {
            target_from_centre: Transform::new(task.target_from_world * world_from_centre),
            exposure: cameras.iter().map(sample).collect(),
            centre_from_depth: Transform::new(centre_from_world * task.world_from_depth),
            target_rolling: task
                .target_rows
                .map(|rows| RowTiming::new(1.0, rows.height, rows.motion)),
            rolling: task
                .rolling_height
                .map(|height| RowTiming::new(task.readout, height, task.motion.velocity)),
        }
    }

    /// Whether image residuals depend on the velocity: with one virtual camera for all rows they do
    /// not.
    pub(super) fn has_velocity(&self) -> bool {
        self.exposure.len() > 1 || self.rolling.is_some()
    }

    /// Rotates derivatives from the target's camera to the camera at mid-exposure.
    #[inline(always)]
    pub(super) fn rotate_to_centre<S: Simd>(&self, simd: S, by_point: Points<S>) -> Points<S> {
        let row = |k| self.target_from_centre.row(simd, k);
        let rest = row(1).mul_add(by_point.y, row(2).scaled(by_point.z));
        row(0).mul_add(by_point.x, rest)
    }
}

/// Exposure times of the rows under a rolling shutter, and the camera's motion by then.
///
/// The row through image position `v` sees the exposure sample at time `s` at
/// `s + readout (v/H - ½)`, and at time `s` a point `X` of the camera lies at
/// `Exp(s ω) X + s ν` in the camera at mid-exposure of the middle row.
pub(super) struct RowTiming {
    /// [exposures]
    pub(super) readout: f32,
    /// Height of the picture at this level [px].
    pub(super) height: f32,
    /// `ν` [m per exposure] and `ω` [rad per exposure].
    speed: Vec3<f32>,
    spin: Vec3<f32>,
}

impl RowTiming {
    pub(super) fn new(readout: f64, height: f64, velocity: Tangent<f64>) -> Self {
        let (speed, spin) = (velocity.translation.cast(), velocity.rotation.cast());
        Self { readout: readout as f32, height: height as f32, speed, spin }
    }

    /// Relative position of the row at `v`, from the top edge (-½) to the bottom edge (½).
    #[inline(always)]
    pub(super) fn row_position<S: Simd>(&self, simd: S, v: Lanes<S>) -> Lanes<S> {
        v * Lanes::splat(simd, 1.0 / self.height) - Lanes::splat(simd, 0.5)
    }

    /// Time since mid-exposure of the middle row at which the row at `position` sees the exposure
    /// sample at `time` [exposures].
    #[inline(always)]
    pub(super) fn time<S: Simd>(&self, simd: S, position: Lanes<S>, time: f32) -> Lanes<S> {
        position.mul_add(Lanes::splat(simd, self.readout), Lanes::splat(simd, time))
    }

    /// `Exp(s ω) X = X + (sin sθ / θ) ω × X + ((1 - cos sθ) / θ²) ω × (ω × X)` by series, exact to
    /// single precision for turns of less than a radian.
    #[inline(always)]
    pub(super) fn rotated<S: Simd>(&self, simd: S, s: Lanes<S>, point: Points<S>) -> Points<S> {
        let number = |value: f32| Lanes::splat(simd, value);
        let spin = Points::splat(simd, self.spin);
        let angle = s * s * number(self.spin.dot(self.spin));
        let series = |terms: [f32; 4]| {
            let [a, b, c, d] = terms.map(number);
            d.mul_add(angle, c).mul_add(angle, b).mul_add(angle, a)
        };
        let sine = s * series([1.0, -1.0 / 6.0, 1.0 / 120.0, -1.0 / 5040.0]);
        let cosine = s * s * series([0.5, -1.0 / 24.0, 1.0 / 720.0, -1.0 / 40_320.0]);
        let once = spin.cross(point);
        spin.cross(once).mul_add(cosine, once.mul_add(sine, point))
    }

    /// Points of the camera at the time of the middle row, as the camera sees them at the time of
    /// the row in which they appear: `Exp(-s ω) (X - s ν)`, `s` by fixed-point iteration.
    #[inline(always)]
    pub(super) fn seen_by_row<S: Simd>(
        &self,
        simd: S,
        camera: &Camera<f32>,
        point: Points<S>,
    ) -> Points<S> {
        let mut seen = point;
        for _ in 0..ROW_ITERATIONS {
            let (_, v) = project(simd, camera, seen);
            let time = self.row_position(simd, v) * Lanes::splat(simd, self.readout);
            let moved = point.minus(self.translation(simd, time));
            seen = self.rotated(simd, Lanes::zero(simd) - time, moved);
        }
        seen
    }

    /// `s ν`.
    #[inline(always)]
    pub(super) fn translation<S: Simd>(&self, simd: S, s: Lanes<S>) -> Points<S> {
        Points::splat(simd, self.speed).scaled(s)
    }

    /// `ν + ω × Exp(s ω) X`: velocity of the rotated point [m per exposure].
    #[inline(always)]
    pub(super) fn velocity_of<S: Simd>(&self, simd: S, rotated: Points<S>) -> Points<S> {
        let one = Lanes::splat(simd, 1.0);
        Points::splat(simd, self.spin).cross(rotated).mul_add(one, Points::splat(simd, self.speed))
    }
}

/// A point or direction for each lane.
#[derive(Clone, Copy)]
pub(super) struct Points<S: Simd> {
    pub(super) x: Lanes<S>,
    pub(super) y: Lanes<S>,
    pub(super) z: Lanes<S>,
}

impl<S: Simd> Points<S> {
    #[inline(always)]
    pub(super) fn splat(simd: S, point: Vec3<f32>) -> Self {
        Self {
            x: Lanes::splat(simd, point.x),
            y: Lanes::splat(simd, point.y),
            z: Lanes::splat(simd, point.z),
        }
    }

    #[inline(always)]
    pub(super) fn load_group(simd: S, rows: &[BlockValues; 3], group: usize) -> Self {
        Self {
            x: Lanes::load_group(simd, &rows[0], group),
            y: Lanes::load_group(simd, &rows[1], group),
            z: Lanes::load_group(simd, &rows[2], group),
        }
    }

    #[inline(always)]
    pub(super) fn store_group(self, rows: &mut [BlockValues; 3], group: usize) {
        self.x.store_group(&mut rows[0], group);
        self.y.store_group(&mut rows[1], group);
        self.z.store_group(&mut rows[2], group);
    }

    #[inline(always)]
    pub(super) fn to_array(self) -> [Lanes<S>; 3] {
        [self.x, self.y, self.z]
    }

    #[inline(always)]
    pub(super) fn scaled(self, factor: Lanes<S>) -> Self {
        Self { x: self.x * factor, y: self.y * factor, z: self.z * factor }
    }

    /// `self · factor + other`.
    #[inline(always)]
    pub(super) fn mul_add(self, factor: Lanes<S>, other: Self) -> Self {
        Self {
            x: self.x.mul_add(factor, other.x),
            y: self.y.mul_add(factor, other.y),
            z: self.z.mul_add(factor, other.z),
        }
    }

    #[inline(always)]
    pub(super) fn minus(self, other: Self) -> Self {
        Self { x: self.x - other.x, y: self.y - other.y, z: self.z - other.z }
    }

    #[inline(always)]
    pub(super) fn dot(self, other: Self) -> Lanes<S> {
        self.x.mul_add(other.x, self.y.mul_add(other.y, self.z * other.z))
    }

    #[inline(always)]
    pub(super) fn cross(self, other: Self) -> Self {
        Self {
            x: self.y * other.z - self.z * other.y,
            y: self.z * other.x - self.x * other.z,
            z: self.x * other.y - self.y * other.x,
        }
    }

    #[inline(always)]
    pub(super) fn select(mask: Mask<S>, yes: Self, no: Self) -> Self {
        Self {
            x: mask.select(yes.x, no.x),
            y: mask.select(yes.y, no.y),
            z: mask.select(yes.z, no.z),
        }
    }
}

/// Image position of each lane's point.
#[inline(always)]
pub(super) fn project<S: Simd>(
    simd: S,
    camera: &Camera<f32>,
    point: Points<S>,
) -> (Lanes<S>, Lanes<S>) {
    let number = |value| Lanes::splat(simd, value);
    let u = number(camera.fx) * point.x / point.z + number(camera.cx);
    let v = number(camera.fy) * point.y / point.z + number(camera.cy);
    (u, v)
}

/// A point on the optical axis, for lanes that do not count: it keeps their arithmetic finite.
#[inline(always)]
pub(super) fn placeholder_point<S: Simd>(simd: S) -> Points<S> {
    Points::splat(simd, Vec3::new(0.0, 0.0, 1.0))
}

/// Chain rule through the projection: from derivatives by `(u, v)` to derivatives by the point.
#[inline(always)]
pub(super) fn by_point<S: Simd>(
    simd: S,
    camera: &Camera<f32>,
    point: Points<S>,
    (by_u, by_v): (Lanes<S>, Lanes<S>),
) -> Points<S> {
    let inverse = point.z.recip();
    let x = by_u * Lanes::splat(simd, camera.fx) * inverse;
    let y = by_v * Lanes::splat(simd, camera.fy) * inverse;
    let z = (Lanes::zero(simd) - x.mul_add(point.x, y * point.y)) * inverse;
    Points { x, y, z }
}
