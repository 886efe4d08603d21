//! Test-time pose optimisation: where the map fits a given picture best, map and tone fixed.
//!
//! The paper runs it (after BARF) before it grades renders of systems whose pose errors it wants
//! left out. Levenberg-Marquardt on the mean square error of the sharp picture at mid-exposure,
//! on quarter, half and full size. Slopes are central differences of rendered pictures, half a
//! pixel of motion apart from the pose each way: what a pixel's own texture does there decides,
//! not its slope at a point.

use crate::reconstruction::FrameEstimate;
use crate::view::Viewer;
use i2slam_compute::{NormalEquations, median, reduce_in_order};
use i2slam_geometry::{Image, Pose, Tangent};

/// Reductions of the picture, coarse to fine.
const REDUCTIONS: [usize; 3] = [4, 2, 1];
/// Sides below which a reduced picture says too little [px].
const SMALLEST: usize = 24;
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
            if reduction > 1 && size.0.min(size.1) < SMALLEST {
                continue;
            }
            let small_truth = reduced(truth, reduction);
            let pose = self.descend(frame, best.pose, &small_truth, reduction, depth);
            let found = self.candidate(frame, pose, truth);
            if found.error < best.error {
                best = found;
            }
        }
        let Candidate { pose, picture, error } = best;
        OptimisedPose { world_from_camera: pose, picture, error_before, error_after: error }
    }

    /// Levenberg-Marquardt from `pose` on pictures of one size.
    fn descend(
        &mut self,
        frame: &FrameEstimate,
        mut pose: Pose<f64>,
        truth: &Image<f32>,
        reduction: usize,
        depth: f64,
    ) -> Pose<f64> {
        let focal = self.focal_length() / reduction as f64;
        let (turn, shift) = (0.5 / focal, 0.5 * depth / focal);
        let units = [shift, shift, shift, turn, turn, turn];
        let mut seen = reduced(&self.seen_from(frame, pose), reduction);
        let mut damping = 1e-3;
        for _ in 0..STEPS {
            let slopes = self.slopes(frame, pose, reduction, units);
            let equations = equations(&seen, truth, &slopes);
            let Some((next, picture, motion)) =
                self.step(frame, pose, truth, reduction, (&equations, units), &mut damping)
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
        reduction: usize,
        (equations, units): (&NormalEquations<6>, [f64; 6]),
        damping: &mut f64,
    ) -> Option<(Pose<f64>, Image<f32>, f64)> {
        let before = equations.cost / equations.count.max(1) as f64;
        for _ in 0..TRIALS {
            let step = equations.step(*damping)?;
            let next = pose.retract(scaled(step, units));
            let picture = reduced(&self.seen_from(frame, next), reduction);
            if mean_square_error(&picture, truth) < before {
                *damping = (*damping * 0.1).max(1e-6);
                let motion = step.iter().map(|s| s * s).sum::<f64>().sqrt();
                return Some((next, picture, motion));
            }
            *damping *= 30.0;
        }
        None
    }

    /// Change of the picture by one unit of each pose coordinate.
    fn slopes(
        &mut self,
        frame: &FrameEstimate,
        pose: Pose<f64>,
        reduction: usize,
        units: [f64; 6],
    ) -> [Image<f32>; 6] {
        std::array::from_fn(|k| {
            let mut unit = [0.0; 6];
            unit[k] = 1.0;
            let mut at = |sign: f64| {
                let moved = pose.retract(scaled(unit.map(|u| sign * u), units));
                reduced(&self.seen_from(frame, moved), reduction)
            };
            let (mut ahead, behind) = (at(1.0), at(-1.0));
            ahead.data.iter_mut().zip(&behind.data).for_each(|(a, b)| *a = 0.5 * (*a - b));
            ahead
        })
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

fn scaled(step: [f64; 6], units: [f64; 6]) -> Tangent<f64> {
    Tangent::from_array(std::array::from_fn(|i| step[i] * units[i]))
}

fn reduced(picture: &Image<f32>, reduction: usize) -> Image<f32> {
    if reduction == 1 {
        return picture.clone();
    }
    picture.resized_by_area(picture.width / reduction, picture.height / reduction)
}

/// The normal equations of `seen + slopes · step = truth`.
fn equations(
    seen: &Image<f32>,
    truth: &Image<f32>,
    slopes: &[Image<f32>; 6],
) -> NormalEquations<6> {
    let mut all = NormalEquations::default();
    let part = |range: std::ops::Range<usize>| {
        let mut part = NormalEquations::<6>::default();
        for i in range {
            let slope = std::array::from_fn(|k| f64::from(slopes[k].data[i]));
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
