//! Test-time pose optimisation: the pose at which fixed map and tone fit a given picture best.
//!
//! The paper runs it (after BARF) to exclude pose errors from the evaluation of renders.
//! Levenberg-Marquardt on the mean square error of the sharp picture at mid-exposure, at quarter,
//! half and full size. The Jacobian is the image gradient times the image motion of every pixel at
//! the map's depth, so that a step needs one render instead of twelve for central differences.

use super::Viewer;
use crate::reconstruction::FrameEstimate;
use i2slam_compute::{NormalEquations, median, reduce_in_order};
use i2slam_geometry::{Camera, Image, Pose, Tangent, Vec3};

/// Reduction factors of the picture, coarse to fine.
const REDUCTIONS: [usize; 3] = [4, 2, 1];
/// Least side of a reduced picture [px]: smaller ones have too little detail.
const MIN_SIDE: usize = 24;
/// Most steps per size.
const MAX_STEPS: usize = 4;
/// Most damping values tried per step.
const MAX_TRIALS: usize = 3;
/// Step length that ends the optimisation of a size [half pixels].
const CONVERGED_STEP: f64 = 0.04;
/// Values per partial sum.
const CHUNK: usize = 4096;

/// Result of test-time pose optimisation.
#[derive(Clone, Debug)]
pub struct OptimisedPose {
    /// World-from-camera at mid-exposure.
    pub world_from_camera: Pose<f64>,
    /// The sharp picture at that pose, clamped to `[0, 1]`.
    pub picture: Image<f32>,
    /// Mean square error of the picture at the frame's own pose.
    pub error_before: f64,
    /// Mean square error at the optimised pose; never larger.
    pub error_after: f64,
}

struct Candidate {
    pose: Pose<f64>,
    picture: Image<f32>,
    error: f64,
}

impl Viewer<'_> {
    /// Optimises the frame's pose for the least mean square error of its sharp picture to `truth`, a
    /// picture of the renders' size. Map and tone stay. Returns the frame's pose if none is better.
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
                self.minimize(frame, best.pose, truth, depth)
            } else {
                let small_truth = truth.resized_by_area(size.0, size.1);
                self.resized(size).minimize(frame, best.pose, &small_truth, depth)
            };
            let refined = self.candidate(frame, pose, truth);
            if refined.error < best.error {
                best = refined;
            }
        }
        let Candidate { pose, picture, error } = best;
        OptimisedPose { world_from_camera: pose, picture, error_before, error_after: error }
    }

    /// Levenberg-Marquardt from `pose` on pictures of the viewer's size.
    fn minimize(
        &mut self,
        frame: &FrameEstimate,
        mut pose: Pose<f64>,
        truth: &Image<f32>,
        depth: f64,
    ) -> Pose<f64> {
        let focal = self.focal_length();
        let (turn, shift) = (0.5 / focal, 0.5 * depth / focal);
        let units = [shift, shift, shift, turn, turn, turn];
        let mut render = self.sharp_clamped(frame, pose);
        let motions = self.image_motions(pose, units, depth);
        let mut damping = 1e-3;
        for _ in 0..MAX_STEPS {
            let equations = equations(&render, truth, &motions);
            let Some((next, picture, motion)) =
                self.step(frame, pose, truth, (&equations, units), &mut damping)
            else {
                break;
            };
            (pose, render) = (next, picture);
            if motion < CONVERGED_STEP {
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
        for _ in 0..MAX_TRIALS {
            let step = equations.step(*damping)?;
            let next = pose.retract(scaled(step, units));
            let picture = self.sharp_clamped(frame, next);
            if mean_square_error(&picture, truth) < before {
                *damping = (*damping * 0.1).max(1e-6);
                let motion = step.iter().map(|s| s * s).sum::<f64>().sqrt();
                return Some((next, picture, motion));
            }
            *damping *= 30.0;
        }
        None
    }

    /// Image motion of every pixel per unit of each pose coordinate; at `typical` depth if unknown.
    fn image_motions(
        &mut self,
        pose: Pose<f64>,
        units: [f64; 6],
        typical: f64,
    ) -> Vec<[[f32; 2]; 6]> {
        let (depth, camera) = (self.depth(pose), self.camera);
        let motion = |i: usize| {
            let (u, v) = Camera::<f64>::pixel_centre(i % depth.width, i / depth.width);
            let z = if depth.data[i] > 0.0 { f64::from(depth.data[i]) } else { typical };
            image_motion(&camera, camera.unproject(u, v, z), units)
        };
        (0..depth.pixels()).map(motion).collect()
    }

    fn candidate(
        &mut self,
        frame: &FrameEstimate,
        pose: Pose<f64>,
        truth: &Image<f32>,
    ) -> Candidate {
        let picture = self.sharp_clamped(frame, pose);
        let error = mean_square_error(&picture, truth);
        Candidate { pose, picture, error }
    }

    /// Median depth of the frame [m].
    fn typical_depth(&mut self, frame: &FrameEstimate) -> f64 {
        let depth = self.depth(frame.middle());
        let known = depth.data.iter().filter(|z| **z > 0.0);
        median(&mut known.map(|z| f64::from(*z)).collect::<Vec<_>>()).unwrap_or(1.0)
    }
}

/// Image motion `J_π (-ρ - φ × P)` of a point in the camera per unit of each pose coordinate [px].
fn image_motion(camera: &Camera<f64>, p: Vec3<f64>, units: [f64; 6]) -> [[f32; 2]; 6] {
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

/// Image gradient along row and column by central differences [1/px].
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

/// Normal equations of `render + J step = truth` with `J = -∇I · motion`.
fn equations(
    render: &Image<f32>,
    truth: &Image<f32>,
    motions: &[[[f32; 2]; 6]],
) -> NormalEquations<6> {
    let mut all = NormalEquations::default();
    let pixels = render.pixels();
    let part = |range: std::ops::Range<usize>| {
        let mut part = NormalEquations::<6>::default();
        for i in range {
            let (channel, pixel) = (i / pixels, i % pixels);
            let [across, down] = gradient(render, channel, pixel);
            let jacobian = motions[pixel].map(|m| -f64::from(across * m[0] + down * m[1]));
            part.add(&jacobian, f64::from(render.data[i] - truth.data[i]), 1.0);
        }
        part
    };
    reduce_in_order(render.data.len(), CHUNK, part, |part| all.merge(&part));
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
pub(crate) mod tests {
    use super::*;
    use crate::config::Config;
    use crate::reconstruction::{Map, Reconstruction, UnitOfLength};
    use i2slam_check::noise;
    use i2slam_formation::{CameraResponse, NodeSpacing, StartCurve, Vignetting};
    use i2slam_geometry::Camera;
    use i2slam_radiance::gaussian::{ColourActivation, Gaussian, GaussianMap, Shape};

    /// Gaussians at depths of 1.5 to 2.5 m with colours of their own.
    pub(crate) fn room() -> Reconstruction {
        let mut map = GaussianMap::new(Shape::Isotropic, ColourActivation::Exponential);
        let random: Vec<f32> = noise(3, 2500 * 5).iter().map(|&v| v as f32).collect();
        for (i, n) in random.chunks_exact(5).enumerate() {
            let (x, y) = ((i % 50) as f32 / 25.0 - 1.0, (i / 50) as f32 / 25.0 - 1.0);
            map.push(Gaussian {
                mean: [1.6 * x, 1.6 * y, 2.0 + 0.5 * n[0]],
                log_scale: [-3.2; 3],
                rotation: [1.0, 0.0, 0.0, 0.0],
                opacity_logit: 3.0,
                colour: [-1.0 + n[1], -1.0 + n[2], -1.0 + n[3]],
            });
        }
        Reconstruction {
            config: Config::default(),
            camera: Camera { width: 96, height: 72, fx: 90.0, fy: 90.0, cx: 48.0, cy: 36.0 },
            online_trajectory: Vec::new(),
            frames: Vec::new(),
            map: Map::Gaussians(map),
            responses: vec![CameraResponse::new(3, StartCurve::Srgb, NodeSpacing::Uniform)],
            vignetting: Vignetting::default(),
            rolling_shutter_readout: 0.0,
            unit_of_length: UnitOfLength::Metre,
        }
    }

    fn moved(step: [f64; 6]) -> Pose<f64> {
        Pose::identity().retract(Tangent::from_array(step))
    }

    fn psnr(error: f64) -> f64 {
        -10.0 * error.log10()
    }

    #[test]
    fn a_disturbed_pose_is_recovered() {
        let room = room();
        let mut viewer = room.viewer();
        let true_pose = moved([0.02, -0.03, 0.01, 0.01, 0.02, -0.01]);
        let truth = viewer.sharp_clamped(&room.virtual_frame(0, true_pose), true_pose);
        // Two pixels of rotation, one and a half of translation.
        let wrong = true_pose.retract(Tangent::from_array([0.03, -0.02, 0.02, -0.015, 0.02, 0.01]));
        let frame = room.virtual_frame(0, wrong);
        let found = viewer.optimise_pose(&frame, &truth);
        assert!(psnr(found.error_after) > psnr(found.error_before) + 20.0);
        let left = true_pose.local(found.world_from_camera);
        assert!(left.translation.norm() < 1e-3 && left.rotation.norm() < 5e-4, "{left:?}");
        assert_eq!(found.picture, viewer.sharp_clamped(&frame, found.world_from_camera));
    }

    #[test]
    fn image_motions_agree_with_differences() {
        let camera = Camera { width: 96, height: 72, fx: 90.0, fy: 85.0, cx: 48.0, cy: 36.0 };
        let (point, units) = (Vec3::new(0.4, -0.3, 1.7), [0.02, 0.02, 0.02, 0.01, 0.01, 0.01]);
        let motions = image_motion(&camera, point, units);
        for (k, motion) in motions.iter().enumerate() {
            let seen = |size: f64| {
                let mut step = [0.0; 6];
                step[k] = size * units[k];
                camera.project(moved(step).inverse() * point)
            };
            let ((ua, va), (ub, vb)) = (seen(1e-4), seen(-1e-4));
            for (ours, due) in motion.iter().zip([ua - ub, va - vb]) {
                let due = due / 2e-4;
                assert!(
                    (f64::from(*ours) - due).abs() < 1e-5 * due.abs().max(1.0),
                    "{k}: {ours} {due}"
                );
            }
        }
    }

    #[test]
    fn an_optimal_pose_stays() {
        let room = room();
        let mut viewer = room.viewer();
        let frame = room.virtual_frame(0, moved([0.01, 0.0, 0.02, 0.0, 0.01, 0.0]));
        let truth = viewer.sharp_clamped(&frame, frame.middle());
        let found = viewer.optimise_pose(&frame, &truth);
        assert_eq!((found.error_before, found.error_after), (0.0, 0.0));
        assert_eq!(found.world_from_camera, frame.middle());
    }

    #[test]
    fn an_unrelated_picture_never_increases_the_error() {
        let room = room();
        let mut viewer = room.viewer();
        let frame = room.virtual_frame(0, Pose::identity());
        for seed in 0..3 {
            let mut other = viewer.sharp_clamped(&frame, Pose::identity());
            let random = noise(11 + seed, other.data.len());
            other.data.iter_mut().zip(random).for_each(|(v, n)| *v = 0.5 + 0.5 * n as f32);
            let found = viewer.optimise_pose(&frame, &other);
            assert!(found.error_after <= found.error_before);
            assert!(found.world_from_camera.is_finite());
        }
    }
}
