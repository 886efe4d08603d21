//! Hand-held camera motion as a continuous function of time.

use crate::rng::{between, gaussian, stream};
use crate::scene::DeskPlace;
use crate::spec::{MotionSpec, Spec};
use i2slam_compute::Random;
use i2slam_geometry::{Mat3, Pose, Rotation, Vec3};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Purpose number of the random stream of motion.
const MOTION: u64 = 3;
/// Time between two knots of the splines [s].
const KNOT_INTERVAL: f64 = 0.7;
/// Number of tremor frequencies in each of six directions.
const TREMORS: usize = 9;
/// Distance of a camera before the desk from the wall [m].
const DESK_DISTANCE: f64 = 1.5;

/// Camera motion with a pose at any time.
#[derive(Clone, Debug)]
pub(crate) struct Motion {
    /// Splines over [`KNOT_INTERVAL`]: angle on the loop [rad], radius factor, height [m], yaw off the
    /// middle of the room [rad], pitch [rad], roll [rad]. Before the desk: place along the wall and
    /// distance from it [m], yaw off the wall's normal.
    splines: [Vec<f64>; 6],
    /// Half axes of the loop around the room [m].
    loop_axes: [f64; 2],
    /// The desk, for a camera that stands before it.
    desk: Option<DeskPlace>,
    /// Direction of view to the left of the middle of the room, or of the desk [rad].
    facing: f64,
    turn: Turn,
    /// Amplitude, angular frequency and phase of tremor: x, y, z [m], then rotation [rad].
    tremor: [Vec<[f64; 3]>; 6],
    /// Middle [s], width [s] and rotation vector [rad] of the bursts.
    bursts: Vec<(f64, f64, Vec3<f64>)>,
}

impl Motion {
    /// The motion of a specification in the room with that desk, the same for the same `seed`.
    pub(crate) fn new(spec: &Spec, desk: DeskPlace) -> Self {
        let m = &spec.motion;
        let desk = m.at_desk.then_some(desk);
        let mut random = stream(spec.seed, MOTION, 0);
        let seconds = spec.camera.frames as f64 / spec.camera.frame_rate + 2.0 * KNOT_INTERVAL;
        let knots = (seconds / KNOT_INTERVAL).ceil() as usize + 4;
        let axes = [spec.room.size[0] * 0.27, spec.room.size[1] * 0.27].map(|a| a.max(0.3));
        let step = m.speed * KNOT_INTERVAL / axes[0].hypot(axes[1]) * 2.0_f64.sqrt();
        let start = between(&mut random, 0.0, TAU);
        let turn = if random.below(2) == 0 { 1.0 } else { -1.0 };
        let phase = between(&mut random, 0.0, TAU);
        let mut spline = |middle: &dyn Fn(usize) -> f64, spread: f64| -> Vec<f64> {
            (0..knots).map(|k| middle(k) + spread * gaussian(&mut random)).collect()
        };
        let swing = m.look_around.to_radians();
        let sweep = |k: usize| {
            let turns = (k as f64 - 1.5) * KNOT_INTERVAL / m.sweep_period;
            m.sweep.to_radians() * (TAU * turns + phase).sin()
        };
        let [first, second] = match desk {
            Some(_) => {
                let sway = 0.35 * m.speed * KNOT_INTERVAL;
                [spline(&|_| 0.0, sway), spline(&|_| DESK_DISTANCE, 0.5 * sway)]
            }
            None => {
                [spline(&|k| start + turn * step * k as f64, 0.35 * step), spline(&|_| 1.0, 0.06)]
            }
        };
        let splines = [
            first,
            second,
            spline(&|_| m.height, 0.03),
            spline(&sweep, swing),
            spline(&|_| m.pitch.to_radians(), 0.35 * swing),
            spline(&|_| 0.0, 0.03),
        ];
        let sizes = [m.tremor_position, m.tremor_rotation.to_radians()];
        let tremor = std::array::from_fn(|i| tremor(&mut random, sizes[i / 3], m.tremor_band));
        let bursts = bursts(&mut random, spec, seconds);
        Self {
            splines,
            loop_axes: axes,
            desk,
            facing: m.facing.to_radians(),
            turn: Turn::new(m),
            tremor,
            bursts,
        }
    }

    /// The pose `world_from_camera` at a time [s] from the first frame's stamp on; the world's z
    /// is up, its origin is the middle of the floor.
    pub(crate) fn world_from_camera(&self, time: f64) -> Pose<f64> {
        let [first, second, height, yaw, pitch, roll] =
            [0, 1, 2, 3, 4, 5].map(|i| spline(&self.splines[i], time / KNOT_INTERVAL + 1.5));
        let (x, y, heading) = match self.desk {
            Some(desk) => {
                let [x, y] = desk.at(first, second);
                (x, y, desk.yaw + FRAC_PI_2)
            }
            None => {
                let x = self.loop_axes[0] * second * first.cos();
                let y = self.loop_axes[1] * second * first.sin();
                (x, y, (-y).atan2(-x))
            }
        };
        let heading = heading + self.facing + yaw - self.turn.angle(time);
        let shake: [f64; 6] = std::array::from_fn(|i| {
            self.tremor[i].iter().map(|[a, w, p]| a * (w * time + p).sin()).sum()
        });
        let mut turned = Vec3::new(shake[3], shake[4], shake[5]);
        for (middle, width, axis) in &self.bursts {
            turned += *axis * (-0.5 * ((time - middle) / width).powi(2)).exp();
        }
        let rotation = look_rotation(heading, pitch, roll) * Rotation::exp(turned);
        let position = Vec3::new(x + shake[0], y + shake[1], height + shake[2]);
        Pose::new(rotation, position)
    }
}

/// A turn away and back, once.
#[derive(Clone, Copy, Debug)]
struct Turn {
    /// The whole angle [rad].
    angle: f64,
    /// Time at which it begins, time of each way, and time between [s].
    start: f64,
    way: f64,
    stay: f64,
}

impl Turn {
    fn new(spec: &MotionSpec) -> Self {
        let angle = spec.turn_away.to_radians();
        Self { angle, start: spec.turn_start, way: spec.turn_time, stay: spec.turn_stay }
    }

    /// The angle at a time [s]: half a cosine there, and half a cosine back [rad].
    fn angle(&self, time: f64) -> f64 {
        let gone = ((time - self.start) / self.way).clamp(0.0, 1.0);
        let back = ((time - self.start - self.way - self.stay) / self.way).clamp(0.0, 1.0);
        0.5 * self.angle * ((PI * back).cos() - (PI * gone).cos())
    }
}

/// Rotation of a camera that looks along `heading` [rad, from x], `pitch` above the horizon, rolled.
pub(crate) fn look_rotation(heading: f64, pitch: f64, roll: f64) -> Rotation<f64> {
    let (sine, cosine) = heading.sin_cos();
    let forward = Vec3::new(cosine * pitch.cos(), sine * pitch.cos(), pitch.sin());
    let right = Vec3::new(sine, -cosine, 0.0);
    let down = forward.cross(right);
    let columns = Mat3 { rows: [right.to_array(), down.to_array(), forward.to_array()] };
    Rotation::from_matrix(&columns.transpose()) * Rotation::exp(Vec3::new(0.0, 0.0, roll))
}

/// A uniform cubic B-spline; `at` counts knots. Beyond its ends the nearest piece goes on.
fn spline(knots: &[f64], at: f64) -> f64 {
    let first = (at.floor() as usize).clamp(1, knots.len() - 3);
    let u = at - first as f64;
    let weights = [
        (1.0 - u).powi(3),
        3.0 * u.powi(3) - 6.0 * u * u + 4.0,
        -3.0 * u.powi(3) + 3.0 * u * u + 3.0 * u + 1.0,
        u.powi(3),
    ];
    (0..4).map(|k| weights[k] * knots[first - 1 + k]).sum::<f64>() / 6.0
}

/// Waves of random phase over a band, falling with frequency; `size` is the standard deviation.
fn tremor(random: &mut Random, size: f64, [low, high]: [f64; 2]) -> Vec<[f64; 3]> {
    let mut waves: Vec<[f64; 3]> = (0..TREMORS)
        .map(|_| {
            let frequency = between(random, low.min(high), low.max(high));
            let amplitude = gaussian(random).abs() / frequency;
            [amplitude, TAU * frequency, between(random, 0.0, TAU)]
        })
        .collect();
    let power: f64 = waves.iter().map(|w| 0.5 * w[0] * w[0]).sum();
    let scale = size / power.sqrt().max(1e-12);
    waves.iter_mut().for_each(|wave| wave[0] *= scale);
    waves
}

fn bursts(random: &mut Random, spec: &Spec, seconds: f64) -> Vec<(f64, f64, Vec3<f64>)> {
    let m = &spec.motion;
    let angle = m.burst_angle.to_radians();
    let mut time = 0.0;
    let mut bursts = Vec::new();
    if m.bursts == 0.0 {
        return bursts;
    }
    loop {
        time += between(random, 0.4, 1.6) / m.bursts;
        if time > seconds {
            return bursts;
        }
        // Mostly about the vertical axis, as a hand turns.
        let side = if random.below(2) == 0 { 1.0 } else { -1.0 };
        let mut draw = |size: f64| size * between(random, -1.0, 1.0);
        let axis = Vec3::new(draw(0.5), side * (0.8 + draw(0.3)), draw(0.25));
        let width = m.burst_time * (1.0 + draw(0.3));
        bursts.push((time, width, axis * angle));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DESK: DeskPlace = DeskPlace { x: 0.6, y: 2.3, yaw: 0.0 };

    #[test]
    fn the_camera_turns_away_from_the_desk_and_back() {
        let mut spec = Spec { seed: 4, ..Spec::default() };
        spec.motion.at_desk = true;
        (spec.motion.turn_away, spec.motion.turn_start) = (70.0, 1.0);
        (spec.motion.sweep, spec.motion.look_around, spec.motion.bursts) = (0.0, 2.0, 0.0);
        let motion = Motion::new(&spec, DESK);
        let forward = |time: f64| {
            let pose = motion.world_from_camera(time);
            (pose.translation, pose * Vec3::new(0.0, 0.0, 1.0) - pose.translation)
        };
        for time in [0.0, 0.9, 3.0, 4.0] {
            let (place, view) = forward(time);
            assert!((place.x - 0.6).abs() < 0.35 && (place.y - 0.8).abs() < 0.3, "{place:?}");
            assert!(view.x.atan2(view.y).to_degrees().abs() < 8.0, "at the wall: {view:?}");
        }
        // To the right of a view along y is x.
        for time in [1.8, 2.0, 2.15] {
            let view = forward(time).1;
            assert!((view.x.atan2(view.y).to_degrees() - 70.0).abs() < 8.0, "{time}: {view:?}");
        }
        let middle = forward(1.4).1;
        assert!((middle.x.atan2(middle.y).to_degrees() - 35.0).abs() < 8.0, "{middle:?}");
    }

    #[test]
    fn a_round_trip_comes_back_after_it_saw_the_other_side() {
        for seed in 0..6 {
            let spec = Spec { seed, ..Spec::shipped("round-trip").expect("a specification") };
            let motion = Motion::new(&spec, DESK);
            let end = spec.camera.frames as f64 / spec.camera.frame_rate;
            let start = motion.world_from_camera(0.0);
            let away = |time: f64| {
                let step = start.local(motion.world_from_camera(time));
                (step.translation.norm(), step.rotation.norm().to_degrees())
            };
            // Looking outwards: nothing stays in view all the way.
            let view = start * Vec3::new(0.0, 0.0, 1.0) - start.translation;
            assert!(view.x * start.translation.x + view.y * start.translation.y > 0.0);
            let middle = away(0.45 * end);
            assert!(middle.0 > 1.5 && middle.1 > 100.0, "seed {seed}: {middle:?}");
            let back = (0..60).map(|i| away(end * (0.8 + 0.2 * f64::from(i) / 60.0)));
            let nearest = back.min_by(|a, b| a.0.total_cmp(&b.0)).expect("times");
            assert!(nearest.0 < 0.4 && nearest.1 < 20.0, "seed {seed}: {nearest:?}");
        }
    }

    #[test]
    fn motion_is_smooth_and_stays_in_the_room() {
        let spec = Spec { seed: 4, ..Spec::default() };
        let motion = Motion::new(&spec, DESK);
        let dt = 1e-3;
        let mut path = 0.0;
        for i in 0..2700 {
            let (a, b) = (
                motion.world_from_camera(i as f64 * dt),
                motion.world_from_camera((i + 1) as f64 * dt),
            );
            let step = a.local(b);
            path += step.translation.norm();
            assert!(step.translation.norm() < 3e-3 && step.rotation.norm() < 6e-3, "{i} {step:?}");
            let p = a.translation;
            assert!(p.x.abs() < 2.4 && p.y.abs() < 2.0 && p.z > 1.0 && p.z < 1.8, "{p:?}");
        }
        assert!(path > 0.5 && path < 4.0, "{path}");
    }

    #[test]
    fn the_camera_is_upright_and_looks_along_its_heading() {
        let pose = Pose::new(look_rotation(0.7, -0.2, 0.0), Vec3::zero());
        let forward = pose * Vec3::new(0.0, 0.0, 1.0);
        assert!((forward.y.atan2(forward.x) - 0.7).abs() < 1e-9);
        assert!((forward.z - (-0.2_f64).sin()).abs() < 1e-9);
        assert!((pose * Vec3::new(1.0, 0.0, 0.0)).z.abs() < 1e-9, "level");
        assert!((pose * Vec3::new(0.0, 1.0, 0.0)).z < -0.9, "down is down");
    }

    #[test]
    fn without_tremor_bursts_and_speed_the_camera_only_looks_around() {
        let mut spec = Spec::default();
        spec.motion.tremor_position = 0.0;
        spec.motion.tremor_rotation = 0.0;
        spec.motion.bursts = 0.0;
        spec.motion.speed = 0.0;
        let motion = Motion::new(&spec, DESK);
        let turned = motion.world_from_camera(0.0).local(motion.world_from_camera(1.0));
        assert!(turned.rotation.norm() > 0.02 && turned.rotation.norm() < 2.0);
    }
}
