//! Test-time pose optimisation: where the map fits a given picture best, map and tone fixed.
//!
//! The paper runs it (after BARF) before it grades renders of systems whose pose errors it wants
//! left out. Levenberg-Marquardt on the mean square error of the sharp picture at mid-exposure,
//! on quarter, half and full size, each rendered at that size. Slopes are those of the picture
//! over one pixel each way, times the motion of every pixel's point by the map's depth, so that a
//! step needs one render, not the twelve of central differences.

use super::Viewer;
use crate::reconstruction::FrameEstimate;
use i2slam_compute::{NormalEquations, median, reduce_in_order};
use i2slam_geometry::{Camera, Image, Pose, Tangent, Vec3};

/// Reductions of the picture, coarse to fine.
const REDUCTIONS: [usize; 3] = [4, 2, 1];
/// Sides below which a reduced picture says too little [px].
const MIN_SIDE: usize = 24;
/// Most steps on each size.
const STEPS: usize = 4;
/// Most dampings tried for a step.
const TRIALS: usize = 3;
/// A smaller step ends a size [half pixels of it].
const SETTLED: f64 = 0.04;
/// Values summed at once.
const CHUNK: usize = 4096;

/// What test-time optimisation found.
#[derive(Clone, Debug)]
pub struct OptimisedPose {
    /// World-from-camera at mid-exposure.
    pub world_from_camera: Pose<f64>,
    /// The sharp picture from there, cut to `[0, 1]`.
    pub picture: Image<f32>,
    /// Mean square error of the picture at the frame's own pose.
    pub error_before: f64,
    /// The same at the optimised pose; never larger.
    pub error_after: f64,
}

/// A pose and what is seen from it.
struct Candidate {
    pose: Pose<f64>,
    picture: Image<f32>,
    error: f64,
}

impl Viewer<'_> {
    /// The pose near the frame's at which its sharp picture has the least mean square error
    /// against `truth`, a picture of the renders' size; map, exposure, white balance and response
    /// stay. The frame's own pose if none is better.
    pub fn optimise_pose(&mut self, frame: &FrameEstimate, truth: &Image<f32>) -> OptimisedPose {
        let mut best = self.candidate(frame, frame.middle(), truth);
        let error_before = best.error;
        let depth = self.typical_depth(frame);
        for reduction in REDUCTIONS {
            let size = (truth.width / reduction, truth.height / reduction);
            if reduction > 1 && size.0.min(size.1) < MIN_SIDE {
                continue;
            }
            let pose = if reduction == 1 {
                self.descend(frame, best.pose, truth, depth)
            } else {
                let small_truth = truth.resized_by_area(size.0, size.1);
                self.resized(size).descend(frame, best.pose, &small_truth, depth)
            };
            let found = self.candidate(frame, pose, truth);
            if found.error < best.error {
                best = found;
            }
        }
        let Candidate { pose, picture, error } = best;
        OptimisedPose { world_from_camera: pose, picture, error_before, error_after: error }
    }

    /// Levenberg-Marquardt from `pose` on pictures of the viewer's size.
    fn descend(
        &mut self,
        frame: &FrameEstimate,
        mut pose: Pose<f64>,
        truth: &Image<f32>,
        depth: f64,
    ) -> Pose<f64> {
        let focal = self.focal_length();
        let (turn, shift) = (0.5 / focal, 0.5 * depth / focal);
        let units = [shift, shift, shift, turn, turn, turn];
        let mut seen = self.seen_from(frame, pose);
        let motions = self.motions(pose, units, depth);
        let mut damping = 1e-3;
        for _ in 0..STEPS {
            let equations = equations(&seen, truth, &motions);
            let Some((next, picture, motion)) =
                self.step(frame, pose, truth, (&equations, units), &mut damping)
            else {
                break;
            };
            (pose, seen) = (next, picture);
            if motion < SETTLED {
                break;
            }
        }
        pose
    }

    /// The first damped step that lowers the error: pose, picture, motion in `units`.
    fn step(
        &mut self,
        frame: &FrameEstimate,
        pose: Pose<f64>,
        truth: &Image<f32>,
        (equations, units): (&NormalEquations<6>, [f64; 6]),
        damping: &mut f64,
    ) -> Option<(Pose<f64>, Image<f32>, f64)> {
        let before = equations.cost / equations.count.max(1) as f64;
        for _ in 0..TRIALS {
            let step = equations.step(*damping)?;
            let next = pose.retract(scaled(step, units));
            let picture = self.seen_from(frame, next);
            if mean_square_error(&picture, truth) < before {
                *damping = (*damping * 0.1).max(1e-6);
                let motion = step.iter().map(|s| s * s).sum::<f64>().sqrt();
                return Some((next, picture, motion));
            }
            *damping *= 30.0;
        }
        None
    }

    /// Motion of every pixel's point over the picture, by one unit of each pose coordinate. Where
    /// the map has no depth, `typical` stands in.
    fn motions(&mut self, pose: Pose<f64>, units: [f64; 6], typical: f64) -> Vec<[[f32; 2]; 6]> {
        let (depth, camera) = (self.depth(pose), self.camera);
        let motion = |i: usize| {
            let (u, v) = Camera::<f64>::pixel_centre(i % depth.width, i / depth.width);
            let z = if depth.data[i] > 0.0 { f64::from(depth.data[i]) } else { typical };
            motions_of(&camera, camera.unproject(u, v, z), units)
        };
        (0..depth.pixels()).map(motion).collect()
    }

    fn candidate(
        &mut self,
        frame: &FrameEstimate,
        pose: Pose<f64>,
        truth: &Image<f32>,
    ) -> Candidate {
        let picture = self.seen_from(frame, pose);
        let error = mean_square_error(&picture, truth);
        Candidate { pose, picture, error }
    }

    /// Median depth of what the frame sees [m].
    fn typical_depth(&mut self, frame: &FrameEstimate) -> f64 {
        let depth = self.depth(frame.middle());
        let known = depth.data.iter().filter(|z| **z > 0.0);
        median(&mut known.map(|z| f64::from(*z)).collect::<Vec<_>>()).unwrap_or(1.0)
    }
}

/// Motion over the picture of a point before the camera, `J_π (-ρ - φ × P)`, by one unit of each
/// pose coordinate [px].
fn motions_of(camera: &Camera<f64>, p: Vec3<f64>, units: [f64; 6]) -> [[f32; 2]; 6] {
    let over_z = p.z.recip();
    std::array::from_fn(|k| {
        let mut one = [0.0; 6];
        one[k] = units[k];
        let Tangent { translation, rotation } = Tangent::from_array(one);
        let d = -(translation + rotation.cross(p));
        let (x, y) = (d.x - p.x * over_z * d.z, d.y - p.y * over_z * d.z);
        [(camera.fx * over_z * x) as f32, (camera.fy * over_z * y) as f32]
    })
}

/// Slope of a plane along row and column, by central differences [1/px].
fn gradient(picture: &Image<f32>, channel: usize, pixel: usize) -> [f32; 2] {
    let (plane, width) = (picture.plane(channel), picture.width);
    let (column, row) = (pixel % width, pixel / width);
    let between = |last: usize, i: usize| (i.saturating_sub(1), (i + 1).min(last));
    let ((left, right), (up, down)) =
        (between(width - 1, column), between(picture.height - 1, row));
    let at = |column: usize, row: usize| plane[row * width + column];
    let over = |difference: f32, steps: usize| difference / steps.max(1) as f32;
    [
        over(at(right, row) - at(left, row), right - left),
        over(at(column, down) - at(column, up), down - up),
    ]
}

fn scaled(step: [f64; 6], units: [f64; 6]) -> Tangent<f64> {
    Tangent::from_array(std::array::from_fn(|i| step[i] * units[i]))
}

/// The normal equations of `seen + slopes · step = truth`: a pixel takes the value that comes to
/// it, so that its slope is `-∇I · motion`.
fn equations(
    seen: &Image<f32>,
    truth: &Image<f32>,
    motions: &[[[f32; 2]; 6]],
) -> NormalEquations<6> {
    let mut all = NormalEquations::default();
    let pixels = seen.pixels();
    let part = |range: std::ops::Range<usize>| {
        let mut part = NormalEquations::<6>::default();
        for i in range {
            let (channel, pixel) = (i / pixels, i % pixels);
            let [across, down] = gradient(seen, channel, pixel);
            let slope = motions[pixel].map(|m| -f64::from(across * m[0] + down * m[1]));
            part.add(&slope, f64::from(seen.data[i] - truth.data[i]), 1.0);
        }
        part
    };
    reduce_in_order(seen.data.len(), CHUNK, part, |part| all.merge(&part));
    all
}

fn mean_square_error(picture: &Image<f32>, truth: &Image<f32>) -> f64 {
    let (mut sum, count) = (0.0, picture.data.len());
    let part = |range: std::ops::Range<usize>| {
        let pairs = picture.data[range.clone()].iter().zip(&truth.data[range]);
        pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>()
    };
    reduce_in_order(count, CHUNK, part, |part| sum += part);
    sum / count.max(1) as f64
}

#[cfg(test)]
pub(crate) mod tests;
