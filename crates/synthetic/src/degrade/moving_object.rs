//! A textured ball that moves before the camera, in colour and in depth.

use super::refuse;
use crate::error::SyntheticError;
use crate::rng::{between, lattice, stream};
use i2slam_dataset::Sequence;
use i2slam_geometry::{Camera, Image, Pose, Rotation, Vec3};
use std::f64::consts::{PI, TAU};

/// Purpose number of the random stream of the path.
const PATH: u64 = 61;
/// Frames whose depth decides how far away the ball is.
const PROBES: usize = 8;
/// Distance of the ball's middle over the depth that most readings exceed.
const NEARNESS: f64 = 0.8;
/// Share of the readings that may be nearer.
const NEAR_QUANTILE: f64 = 0.05;
/// Least distance of the ball's middle, which a depth camera can measure [m].
const MIN_DISTANCE: f64 = 0.5;
/// Time from one side of the picture to the other and back [s].
const PERIOD: f64 = 3.0;
/// Share of the free way to the border that the path takes.
const REACH: f64 = 0.8;
/// The distance swings by this share.
const SWING: f64 = 0.05;
/// Spin [rad/s].
const SPIN: f64 = 0.8;
/// Fields of the texture along a side of the cube around the ball.
const FIELDS: f64 = 8.0;
/// Samples a pixel, each way.
const SAMPLES: usize = 3;

/// A ball whose path is given in the frame of the camera: it covers about one share of the picture
/// all the time, crosses it, and turns about itself.
#[derive(Clone, Debug)]
pub(super) struct MovingObject {
    camera: Camera<f64>,
    radius: f64,
    distance: f64,
    /// Largest distance of the middle from that of the picture [px].
    reach: [f64; 2],
    /// Phases of the path to the right, down and away [rad].
    phases: [f64; 3],
    /// Direction of the spin, unit length.
    axis: Vec3<f64>,
    start: f64,
    texture: u32,
}

impl MovingObject {
    /// A ball over `share` of the pictures of a sequence, in front of nearly everything they show.
    pub(super) fn new(share: f64, sequence: &Sequence, seed: u64) -> Result<Self, SyntheticError> {
        let start = sequence.entries.first().map_or(0.0, |entry| entry.timestamp);
        let distance = (NEARNESS * near_depth(sequence)?).max(MIN_DISTANCE);
        Self::at(share, &sequence.camera, (start, distance), seed)
    }

    fn at(
        share: f64,
        camera: &Camera<f64>,
        (start, distance): (f64, f64),
        seed: u64,
    ) -> Result<Self, SyntheticError> {
        let (width, height) = (camera.width as f64, camera.height as f64);
        let outline = (share * width * height / PI).sqrt();
        let half = 0.5 * width.min(height);
        if !(share > 0.0 && outline <= half) {
            let most = PI * half * half / (width * height);
            let expected = format!("above 0, at most {most:.2}: a ball as high as the picture");
            return refuse("share of the moving object", share, &expected);
        }
        let mut random = stream(seed, PATH, 0);
        let reach = [width, height].map(|side| REACH * (0.5 * side - outline));
        let phases = [(); 3].map(|()| between(&mut random, 0.0, TAU));
        let [x, z] = [(); 2].map(|()| between(&mut random, -0.4, 0.4));
        let axis = Vec3::new(x, 1.0, z);
        Ok(Self {
            camera: *camera,
            radius: distance * (outline / (camera.fx * camera.fy).sqrt()).atan().sin(),
            distance,
            reach,
            phases,
            axis: axis * axis.norm().recip(),
            start,
            texture: random.bits() as u32,
        })
    }

    /// The pose `camera_from_object` at a time [s].
    fn pose(&self, time: f64) -> Pose<f64> {
        let t = time - self.start;
        let wave = |i: usize, period: f64| (TAU * t / period + self.phases[i]).sin();
        let u = 0.5 * self.camera.width as f64 + self.reach[0] * wave(0, PERIOD);
        let v = 0.5 * self.camera.height as f64 + self.reach[1] * wave(1, 0.7 * PERIOD);
        let z = self.distance * (1.0 + SWING * wave(2, 1.3 * PERIOD));
        Pose::new(Rotation::exp(self.axis * (SPIN * t)), self.camera.unproject(u, v, z))
    }

    /// The nearest point of the ball on the ray through an image position, in the camera.
    fn hit(&self, middle: Vec3<f64>, u: f64, v: f64) -> Option<Vec3<f64>> {
        let ray = self.camera.unproject(u, v, 1.0);
        let (a, b) = (ray.dot(ray), ray.dot(middle));
        let root = b * b - a * (middle.dot(middle) - self.radius * self.radius);
        let z = (b - root.max(0.0).sqrt()) / a;
        (root > 0.0 && z > 0.0).then(|| ray * z)
    }

    /// Depth with the ball in it, which hides what is farther and what has no reading.
    pub(super) fn draw_depth(&self, depth: &Image<f32>, time: f64) -> Image<f32> {
        let middle = self.pose(time).translation;
        Image::from_fn(depth.width, depth.height, 1, |_, column, row| {
            let (u, v) = Camera::<f64>::pixel_centre(column, row);
            let behind = depth.at(0, column, row);
            let ball = self.hit(middle, u, v).map(|point| point.z as f32);
            ball.filter(|&z| behind <= 0.0 || z < behind).unwrap_or(behind)
        })
    }

    /// Colour with the ball in it where it is nearer than `depth`, if that is known.
    pub(super) fn draw_colour(
        &self,
        colour: &Image<f32>,
        depth: Option<&Image<f32>>,
        time: f64,
    ) -> Image<f32> {
        let mut out = colour.clone();
        let pose = self.pose(time);
        let object_from_camera = pose.inverse();
        let pixels = colour.pixels();
        for i in 0..pixels {
            let (column, row) = (i % colour.width, i / colour.width);
            let (mut sum, mut seen) = ([0.0; 3], 0);
            for sample in 0..SAMPLES * SAMPLES {
                let place = |at: usize, k: usize| at as f64 + (k as f64 + 0.5) / SAMPLES as f64;
                let (u, v) = (place(column, sample % SAMPLES), place(row, sample / SAMPLES));
                let Some(point) = self.hit(pose.translation, u, v) else { continue };
                let behind = depth.map_or(0.0, |depth| f64::from(depth.data[i]));
                if behind > 0.0 && point.z >= behind {
                    continue;
                }
                let own = self.colour(object_from_camera * point);
                sum = std::array::from_fn(|channel| sum[channel] + own[channel]);
                seen += 1;
            }
            let open = 1.0 - seen as f32 / (SAMPLES * SAMPLES) as f32;
            for (channel, own) in sum.into_iter().enumerate() {
                let value = &mut out.data[channel * pixels + i];
                *value = *value * open + own / (SAMPLES * SAMPLES) as f32;
            }
        }
        out
    }

    /// Picture values at a point of the ball, in its own frame: fields of random colours on the
    /// cube around it.
    fn colour(&self, point: Vec3<f64>) -> [f32; 3] {
        let all = point.to_array();
        let axis = (0..3).max_by(|&a, &b| all[a].abs().total_cmp(&all[b].abs())).unwrap_or(0);
        let face = 2 * axis as u32 + u32::from(all[axis] < 0.0);
        let [i, j] = [(axis + 1) % 3, (axis + 2) % 3]
            .map(|other| ((all[other] / all[axis].abs() + 1.0) * 0.5 * FIELDS) as i32);
        [0, 1, 2].map(|channel| {
            0.08 + 0.84 * lattice(i, j, self.texture.wrapping_add(8 * face + channel))
        })
    }
}

/// Depth that most of the readings of a sequence exceed [m].
fn near_depth(sequence: &Sequence) -> Result<f64, SyntheticError> {
    let step = sequence.len().div_ceil(PROBES).max(1);
    let mut nearest = f64::INFINITY;
    for frame in (0..sequence.len()).step_by(step) {
        let frame = sequence.load(frame)?;
        let depth = frame.depth_image().map_or(&[][..], |depth| &depth.data);
        let mut readings: Vec<f32> = depth.iter().copied().filter(|&z| z > 0.0).collect();
        readings.sort_by(f32::total_cmp);
        let at = (NEAR_QUANTILE * readings.len() as f64) as usize;
        nearest = readings.get(at).map_or(nearest, |&z| nearest.min(f64::from(z)));
    }
    Ok(if nearest.is_finite() { nearest } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Camera<f64> =
        Camera { width: 160, height: 120, fx: 130.0, fy: 130.0, cx: 80.0, cy: 60.0 };

    fn ball(share: f64) -> MovingObject {
        MovingObject::at(share, &CAMERA, (10.0, 1.2), 3).expect("a ball")
    }

    fn scene() -> (Image<f32>, Image<f32>) {
        (
            Image::new(160, 120, 3),
            Image { channels: 1, data: vec![3.0; 160 * 120], ..Image::new(160, 120, 1) },
        )
    }

    #[test]
    fn the_ball_covers_its_share_all_the_time_and_crosses_the_picture() {
        for share in [0.05, 0.2, 0.4] {
            let ball = ball(share);
            let mut columns = Vec::new();
            for step in 0..30 {
                let time = 10.0 + 0.1 * f64::from(step);
                let depth = ball.draw_depth(&scene().1, time);
                let on: Vec<usize> = (0..depth.pixels()).filter(|&i| depth.data[i] < 3.0).collect();
                let found = on.len() as f64 / depth.pixels() as f64;
                assert!((found / share - 1.0).abs() < 0.25, "{share}: {found} at {time}");
                columns.push(on.iter().map(|i| i % 160).sum::<usize>() / on.len());
            }
            let way = columns.iter().max().expect("some") - columns.iter().min().expect("some");
            let free = 160.0 - 2.0 * (share * 160.0 * 120.0 / PI).sqrt();
            assert!(way as f64 > 0.6 * free, "{share}: {way} of {free}");
        }
    }

    /// A point of the ball has one colour wherever the motion carries it, and depth is its own.
    #[test]
    fn colour_and_depth_follow_one_motion() {
        let ball = ball(0.3);
        let (black, wall) = scene();
        let frames = [10.0, 10.2].map(|time| {
            let colour = ball.draw_colour(&black, Some(&wall), time);
            (ball.pose(time), colour, ball.draw_depth(&wall, time))
        });
        let [(first, colour, depth), (second, later, later_depth)] = &frames;
        let (mut same, mut other, mut compared) = (0, 0, 0);
        for i in (0..depth.pixels()).filter(|&i| depth.data[i] < 3.0) {
            let (u, v) = Camera::<f64>::pixel_centre(i % 160, i / 160);
            let point = CAMERA.unproject(u, v, f64::from(depth.data[i]));
            let moved = *second * (first.inverse() * point);
            let (x, y) = CAMERA.project(moved);
            let seen = later_depth.at(0, x as usize, y as usize);
            if (f64::from(seen) - moved.z).abs() > 0.01 {
                continue;
            }
            compared += 1;
            let differs = |j: usize| (colour.data[i] - later.data[j]).abs() > 0.05;
            same += usize::from(!differs(y as usize * 160 + x as usize));
            other += usize::from(!differs(i));
        }
        assert!(compared > 3000, "{compared}");
        assert!(same as f64 > 0.7 * compared as f64, "{same} of {compared}");
        assert!((other as f64) < 0.4 * compared as f64, "{other} of {compared}: it moves");
    }

    #[test]
    fn what_is_nearer_hides_the_ball() {
        let (black, mut near) = scene();
        near.data.fill(0.2);
        assert_eq!(ball(0.2).draw_depth(&near, 11.0), near);
        assert_eq!(ball(0.2).draw_colour(&black, Some(&near), 11.0), black);
        near.data.fill(0.0);
        assert!(ball(0.2).draw_depth(&near, 11.0) != near, "no reading hides nothing");
    }

    #[test]
    fn a_share_that_no_ball_covers_is_refused() {
        for share in [0.0, -0.1, 0.7, f64::NAN] {
            let error = MovingObject::at(share, &CAMERA, (0.0, 1.0), 1).expect_err("no ball");
            assert!(error.to_string().contains("at most 0.59"), "{error}");
        }
    }
}
