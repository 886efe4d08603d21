//! Photographs around an object, each with a motion of its own.

use crate::motion::look_rotation;
use crate::rng::{between, stream};
use crate::scene::STILL_LIFE_MIDDLE;
use crate::spec::Spec;
use i2slam_compute::Random;
use i2slam_geometry::{Pose, Rotation, Vec3};
use std::f64::consts::TAU;

/// Purpose number of the random stream of photographs.
const STILLS: u64 = 4;
/// Heights of the rings of photographs above the object [rad].
const ELEVATIONS: [f64; 3] = [0.22, 0.52, 0.86];
/// Width of the pictures in which the length of the blur is given [px].
const BLUR_WIDTH: f64 = 640.0;

/// A photograph: its pose in the middle of the exposure, and velocity in the camera's own frame.
#[derive(Clone, Copy, Debug)]
struct Photograph {
    world_from_camera: Pose<f64>,
    /// [m/s]
    velocity: Vec3<f64>,
    /// [rad/s]
    turn: Vec3<f64>,
}

/// Photographs in rings around the object, evenly spaced in time.
#[derive(Clone, Debug)]
pub(crate) struct Stills {
    interval: f64,
    photographs: Vec<Photograph>,
}

impl Stills {
    /// The photographs of a specification, the same for the same `seed`.
    pub(crate) fn new(spec: &Spec, focal_length: f64) -> Self {
        let mut random = stream(spec.seed, STILLS, 0);
        let photographs = (0..spec.camera.frames).map(|i| {
            let (world_from_camera, distance) = place(spec, i, &mut random);
            let (velocity, turn) = motion(spec, (i, distance / focal_length), &mut random);
            Photograph { world_from_camera, velocity, turn: turn * focal_length.recip() }
        });
        Self { interval: spec.camera.frame_rate.recip(), photographs: photographs.collect() }
    }

    /// The pose `world_from_camera` at a time [s]: that of the photograph whose time is nearest,
    /// moved on.
    pub(crate) fn world_from_camera(&self, time: f64) -> Pose<f64> {
        let last = self.photographs.len() - 1;
        let nearest = ((time / self.interval).round().max(0.0) as usize).min(last);
        let Photograph { world_from_camera: pose, velocity, turn } = self.photographs[nearest];
        let since = time - nearest as f64 * self.interval;
        Pose::new(
            pose.rotation * Rotation::exp(turn * since),
            pose.translation + pose.rotation.rotate(velocity * since),
        )
    }
}

/// Pose of photograph `i`, which looks at about the object, and its distance from it [m].
fn place(spec: &Spec, i: usize, random: &mut Random) -> (Pose<f64>, f64) {
    let a_ring = spec.camera.frames.div_ceil(ELEVATIONS.len()).max(1);
    let (ring, step) = (i / a_ring, i % a_ring);
    let mut draw = |low: f64, high: f64| between(random, low, high);
    let azimuth = TAU * (step as f64 + ring as f64 / 3.0 + draw(-0.12, 0.12)) / a_ring as f64;
    let elevation = ELEVATIONS[ring] + draw(-0.06, 0.06);
    let [near, far] = spec.stills.distance;
    let distance = draw(near.min(far), near.max(far));
    let aim = STILL_LIFE_MIDDLE.map(|v| v + draw(-0.03, 0.03));
    let out = Vec3::new(
        azimuth.cos() * elevation.cos(),
        azimuth.sin() * elevation.cos(),
        elevation.sin(),
    );
    let position = Vec3::from_array(aim) + out * distance;
    let heading = (-out.y).atan2(-out.x);
    (Pose::new(look_rotation(heading, -elevation, draw(-0.05, 0.05)), position), distance)
}

/// Velocity [m/s] and rate of turning [rad/s times the focal length in px] of photograph `i`, at a
/// distance of which a pixel shows `pixel` metres: both move the picture the same way.
fn motion(spec: &Spec, (i, pixel): (usize, f64), random: &mut Random) -> (Vec3<f64>, Vec3<f64>) {
    let mut draw = |low: f64, high: f64| between(random, low, high);
    let [least, most] = spec.stills.blur;
    let length = draw(least.min(most), least.max(most)) * spec.camera.width as f64 / BLUR_WIDTH;
    let (sine, cosine) = draw(0.0, TAU).sin_cos();
    let (turned, roll) = (draw(0.6, 0.95), draw(-0.3, 0.3));
    let share = 0.5 * (spec.exposure.shutter_minimum + spec.exposure.shutter_maximum);
    let is_sharp = spec.stills.sharp_every > 0 && i.is_multiple_of(spec.stills.sharp_every);
    if is_sharp || share == 0.0 {
        return (Vec3::zero(), Vec3::zero());
    }
    let rate = length * spec.camera.frame_rate / share;
    let velocity = Vec3::new(cosine, sine, 0.0) * ((1.0 - turned) * rate * pixel);
    (velocity, Vec3::new(-sine, cosine, roll) * (turned * rate))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spec() -> Spec {
        Spec { seed: 3, ..Spec::shipped("stills").expect("a specification") }
    }

    #[test]
    fn photographs_look_at_the_object_from_all_sides() {
        let (spec, middle) = (spec(), Vec3::from_array(STILL_LIFE_MIDDLE));
        let stills = Stills::new(&spec, 600.0);
        let mut sides = [0; 4];
        for i in 0..spec.camera.frames {
            let pose = stills.world_from_camera(i as f64 / spec.camera.frame_rate);
            let seen = pose.inverse() * middle;
            assert!(seen.z > 0.6 && seen.x.hypot(seen.y) < 0.08 * seen.z, "{i}: {seen:?}");
            let off = pose.translation - middle;
            sides[usize::from(off.x > 0.0) + 2 * usize::from(off.y > 0.0)] += 1;
        }
        assert!(sides.iter().all(|&n| n >= 5), "{sides:?}");
    }

    #[test]
    fn the_object_moves_by_the_length_of_the_blur_and_not_in_every_seventh() {
        let (spec, middle) = (spec(), Vec3::from_array(STILL_LIFE_MIDDLE));
        let focal_length = 600.0;
        let stills = Stills::new(&spec, focal_length);
        let share = 0.5 * (spec.exposure.shutter_minimum + spec.exposure.shutter_maximum);
        for i in 0..spec.camera.frames {
            let place = |u: f64| {
                let time = (i as f64 + u * share) / spec.camera.frame_rate;
                let seen = stills.world_from_camera(time).inverse() * middle;
                [focal_length * seen.x / seen.z, focal_length * seen.y / seen.z]
            };
            let ([xa, ya], [xb, yb]) = (place(-0.5), place(0.5));
            let length = (xa - xb).hypot(ya - yb);
            match i % 7 {
                0 => assert!(length < 1e-9, "{i}: {length}"),
                _ => assert!((4.5..22.0).contains(&length), "{i}: {length}"),
            }
        }
    }
}
