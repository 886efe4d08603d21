//! Dense alignment of a frame to a reference by Levenberg-Marquardt, coarse to fine.

use super::block_covariance::{BlockSums, FREE};
use super::residual::{
    AbsoluteErrors, Derivatives, Equations, Linearization, ResidualSums, RobustScales,
};
use super::residual::{TargetRows, UNKNOWNS, WHITE_BALANCE};
use super::view::{DenseView, ExposureMotion, response};
use i2slam_compute::median;
use i2slam_formation::{CentreVelocity, FrameTone, Quadrature, ResponseCurve};
use i2slam_geometry::{Pose, Tangent};

/// Least share of the frame's depth that must lie on the reference's surface.
const MIN_OVERLAP: f64 = 0.25;
/// Robust scales of the first iteration.
const INITIAL_SCALES: RobustScales = RobustScales { depth: 0.02, image: 0.08 };
/// Smallest scale of depth residuals [m at 1 m], and of image residuals: half a step of 8 bits.
const MIN_SCALES: RobustScales = RobustScales { depth: 3e-5, image: 0.002 };
/// Standard deviation of a normal distribution over its mean absolute value.
const SIGMA_PER_MEAN: f32 = 1.25;
/// Step length at which a level ends [px at that level].
const MIN_STEP_PX: f64 = 0.01;
/// Length of the step that is left at the end beyond which there is no constraint [deviations].
const MAX_REMAINING_STEP: f64 = 1.0;
/// Times that the weight of the picture is taken from the scatter between tiles.
const WEIGHT_ROUNDS: usize = 2;
/// Largest number of steps of one minimisation.
const MAX_STEPS: usize = 10;
/// Damping of the first step, and that at which a level ends.
const DAMPING: f64 = 1e-5;
const MAX_DAMPING: f64 = 1.0;
/// Blur that one virtual camera stands for [px], and most virtual cameras.
const BLUR_PER_CAMERA: f64 = 1.5;
const MAX_CAMERAS: usize = 9;
/// Bounds of the weight of pictures against depth.
const IMAGE_WEIGHTS: [f64; 2] = [1e-3, 1e3];

/// Relative pose of two frames with its uncertainty.
#[derive(Clone, Debug)]
pub struct DenseConstraint {
    /// Pose of the frame in the reference's camera, both at mid-exposure of the middle row.
    pub reference_from_frame: Pose<f64>,
    /// Inverse covariance of the tangent (ρ, φ) of [`Pose::retract`] at that pose [1/m², 1/(m rad),
    /// 1/rad²].
    pub information: [[f64; 6]; 6],
    /// Share of the sampled depth that lies on the other picture's surface.
    pub overlap: f64,
    /// Logarithms of the frame's gains over the reference's, R, G, B.
    pub log_gains: [f32; 3],
    /// Scale of the residuals of depth [m at 1 m, growing with the square of the depth beyond] and
    /// picture.
    pub scales: RobustScales,
    /// Weight of the picture's residuals, each over its scale, against those of depth.
    pub image_weight: f64,
}

/// Aligns `frame` to `reference` by picture and depth, from the pose `start` (both
/// `reference_from_frame`). At least one of the two needs depth; where one is without, they are
/// compared by picture alone.
///
/// Unknowns are the pose and the gains. Residuals are those of the module: the reference, blurred
/// as the frame is beyond its own blur, against the frame. Depth and picture weigh by the scatter
/// of their gradients between tiles of the picture, and so does the result: residuals of
/// neighbouring pixels err together, so that the Hessian alone would claim far too much (see
/// `block_covariance`).
///
/// `None` where too little overlaps, too few tiles have residuals, or the steps do not settle.
pub fn align(
    reference: DenseView<'_>,
    frame: DenseView<'_>,
    start: Pose<f64>,
) -> Option<DenseConstraint> {
    match frame.pictures.has_depth {
        true => align_by_depth_of_frame(reference, frame, start),
        false if !reference.pictures.has_depth => None,
        false => align_by_depth_of_frame(frame, reference, start.inverse()).map(|c| c.inverse()),
    }
}

fn align_by_depth_of_frame(
    reference: DenseView<'_>,
    frame: DenseView<'_>,
    start: Pose<f64>,
) -> Option<DenseConstraint> {
    let alignment = Alignment::new(reference, frame);
    let mut state = State { pose: start, tone: FrameTone::default(), scales: INITIAL_SCALES };
    let mut weight = 1.0;
    for level in (0..frame.pictures.frames.len()).rev() {
        let errors = alignment.errors(level, &state);
        update_scales(&mut state.scales, &errors);
        // The finest level follows below, depth and picture weighed.
        if level > 0 {
            alignment.levenberg_marquardt(level, weight, &mut state)?;
        }
    }
    let mut end = None;
    for _ in 0..WEIGHT_ROUNDS {
        let (blocks, errors) = alignment.blocks(weight, &state);
        weight = blocks.image_weight(weight, IMAGE_WEIGHTS);
        update_scales(&mut state.scales, &errors);
        end = Some(alignment.levenberg_marquardt(0, weight, &mut state)?);
    }
    let sums = end.filter(|sums| sums.overlap() >= MIN_OVERLAP)?;
    let information = alignment.blocks(weight, &state).0.information()?;
    // Noisy depth has kinks at every pixel, so that steps need not become short; what is left of
    // the way must be within the deviation.
    let step = free_equations(&sums.equations).step(0.0)?;
    if mahalanobis(&information, &step) > MAX_REMAINING_STEP {
        return None;
    }
    Some(DenseConstraint {
        reference_from_frame: state.pose,
        information,
        overlap: sums.overlap(),
        log_gains: state.tone.log_white_balance,
        scales: state.scales,
        image_weight: weight,
    })
}

impl DenseConstraint {
    /// The constraint with reference and frame exchanged.
    ///
    /// With `T' = T⁻¹`, a tangent `(ρ', φ')` of `T'` is the tangent `ρ = -R' (ρ' + φ' × t)`,
    /// `φ = -R' φ'` of `T = (R, t)`.
    fn inverse(&self) -> Self {
        let (pose, inverse) = (self.reference_from_frame, self.reference_from_frame.inverse());
        let columns: [[f64; 6]; 6] = std::array::from_fn(|i| {
            let unit = Tangent::from_array(std::array::from_fn(|k| if k == i { 1.0 } else { 0.0 }));
            let moved = unit.translation + unit.rotation.cross(pose.translation);
            Tangent {
                translation: inverse.rotation.rotate(moved) * -1.0,
                rotation: inverse.rotation.rotate(unit.rotation) * -1.0,
            }
            .to_array()
        });
        let product = |a: usize, b: usize| {
            let row = |i: usize| dot(&self.information[i], &columns[b]);
            (0..6).map(|i| columns[a][i] * row(i)).sum()
        };
        let information = std::array::from_fn(|a| std::array::from_fn(|b| product(a, b)));
        let log_gains = self.log_gains.map(|gain| -gain);
        Self { reference_from_frame: inverse, information, log_gains, ..self.clone() }
    }
}

/// Two views, and what all evaluations share.
struct Alignment<'a> {
    reference: DenseView<'a>,
    frame: DenseView<'a>,
    curve: ResponseCurve<f32>,
    /// Pixels per metre and per radian, which measure tangents in pixels.
    pixels_per_unit: [f64; 6],
}

/// The unknowns, and the scales of the residuals.
#[derive(Clone, Copy, Debug)]
struct State {
    pose: Pose<f64>,
    tone: FrameTone<f32>,
    scales: RobustScales,
}

impl<'a> Alignment<'a> {
    fn new(reference: DenseView<'a>, frame: DenseView<'a>) -> Self {
        let pixels_per_unit = pixels_per_unit(&frame);
        Self { reference, frame, curve: response(), pixels_per_unit }
    }

    /// Absolute residuals on one level.
    fn errors(&self, level: usize, state: &State) -> AbsoluteErrors {
        self.linearization(level, 1.0, state, Derivatives::None).accumulate().errors
    }

    /// Minimises on one level by steps until they are short; one that raises the cost is rejected
    /// and damped a hundredfold. `None` without any residual.
    fn levenberg_marquardt(
        &self,
        level: usize,
        weight: f64,
        state: &mut State,
    ) -> Option<ResidualSums> {
        let converged = MIN_STEP_PX * f64::from(1 << level);
        let mut damping = DAMPING;
        let mut here = self.evaluate(level, weight, state);
        for _ in 0..MAX_STEPS {
            let step = free_equations(&here.equations).step(damping)?;
            let length = self.length_in_pixels(&step);
            let next = state.retract(&step);
            let there = self.evaluate(level, weight, &next);
            let is_lower = there.mean_cost() <= here.mean_cost() * (1.0 + 1e-6);
            if !is_lower || there.equations.count == 0 {
                damping *= 100.0;
                if length < converged || damping > MAX_DAMPING {
                    break;
                }
                continue;
            }
            (*state, here) = (next, there);
            damping = (damping * 0.1).max(1e-9);
            if length < converged {
                break;
            }
        }
        (here.equations.count > 0).then_some(here)
    }

    fn evaluate(&self, level: usize, weight: f64, state: &State) -> ResidualSums {
        self.linearization(level, weight, state, Derivatives::PoseAndTone).accumulate()
    }

    fn linearization(
        &self,
        level: usize,
        weight: f64,
        state: &State,
        derivatives: Derivatives,
    ) -> Linearization<'_> {
        let (cameras, motion, readout) = self.exposure(level);
        let target_rows = |motion| TargetRows { motion, height: self.height(level) };
        Linearization {
            target: &self.reference.pictures.targets[level],
            frame: &self.frame.pictures.frames[level],
            target_from_world: Pose::identity(),
            motion: CentreVelocity { centre: state.pose, velocity: motion },
            readout,
            tone: state.tone,
            curve: Some(&self.curve),
            cameras,
            target_rows: self.reference.row_motion().map(target_rows),
            rolling_height: self.frame.row_motion().map(|_| self.height(level)),
            quadrature: Quadrature::Midpoints,
            world_from_depth: state.pose,
            depth_offset_ratio: 0.0,
            scales: state.scales,
            image_weight: weight as f32,
            derivatives,
        }
    }

    /// Height of the picture at a level [px], an odd last row included.
    fn height(&self, level: usize) -> f64 {
        self.frame.pictures.camera.height as f64 / f64::from(1_u32 << level)
    }

    /// Virtual cameras at a level, the motion between the first and the last moment that they stand
    /// for, and the readout in that time.
    fn exposure(&self, level: usize) -> (usize, Tangent<f64>, f64) {
        let blur = self.excess_blur();
        let length = self.length_in_pixels(&blur.to_array()) / f64::from(1 << level);
        let cameras = ((length / BLUR_PER_CAMERA).ceil() as usize).clamp(1, MAX_CAMERAS);
        let ExposureMotion { velocity, readout, .. } = self.frame.motion;
        if cameras > 1 {
            // The readout in units of the time in which the camera moves by the excess blur.
            let moved = velocity.to_array().map(|v| v * v).iter().sum::<f64>().sqrt();
            let excess = blur.to_array().map(|v| v * v).iter().sum::<f64>().sqrt();
            return (cameras, blur, readout * moved / excess);
        }
        // One camera for all moments: the motion matters to rows alone.
        (1, velocity.scaled(readout), if readout == 0.0 { 0.0 } else { 1.0 })
    }

    /// The frame's motion during its exposure, as much of it as the reference's own blur does not
    /// have: along the motion variances of streaks subtract, `b² - (b · b'/|b|)²`.
    fn excess_blur(&self) -> Tangent<f64> {
        let blur = |view: &DenseView<'_>| view.motion.velocity.scaled(view.motion.exposure);
        let (own, other) = (blur(&self.frame), blur(&self.reference));
        let (a, b) = (self.in_pixels(&own.to_array()), self.in_pixels(&other.to_array()));
        let square = dot(&a, &a);
        if square == 0.0 {
            return Tangent::zero();
        }
        own.scaled((1.0 - (dot(&a, &b) / square).powi(2)).max(0.0).sqrt())
    }

    fn in_pixels(&self, tangent: &[f64]) -> [f64; 6] {
        std::array::from_fn(|i| tangent[i] * self.pixels_per_unit[i])
    }

    /// Length of a tangent, whose six numbers come first [px].
    fn length_in_pixels(&self, tangent: &[f64]) -> f64 {
        let pixels = self.in_pixels(tangent);
        dot(&pixels, &pixels).sqrt()
    }

    /// Sums of depth and picture by tile of the finest level, and the absolute residuals of all.
    fn blocks(&self, weight: f64, state: &State) -> (BlockSums, AbsoluteErrors) {
        let all = self.linearization(0, weight, state, Derivatives::PoseAndTone);
        let sums = self.frame.pictures.tiles.iter().map(|tile| all.accumulate_kinds_over(tile));
        let sums: Vec<[ResidualSums; 2]> = sums.collect();
        let mut total = ResidualSums::default();
        sums.iter().flatten().for_each(|sums| total.merge(sums));
        let equations = sums.into_iter().map(|kinds| kinds.map(|sums| sums.equations));
        (BlockSums::new(equations), total.errors)
    }
}

impl State {
    fn retract(&self, step: &[f64; UNKNOWNS]) -> Self {
        let mut next = *self;
        next.pose = self.pose.retract(Tangent::from_array(std::array::from_fn(|i| step[i])));
        for (channel, gain) in next.tone.log_white_balance.iter_mut().enumerate() {
            *gain += step[WHITE_BALANCE + channel] as f32;
        }
        next
    }
}

impl DenseView<'_> {
    /// Motion from the first row to the last; `None` for a global shutter or a camera at rest.
    fn row_motion(&self) -> Option<Tangent<f64>> {
        let motion = self.motion.velocity.scaled(self.motion.readout);
        motion.to_array().iter().any(|&v| v != 0.0).then_some(motion)
    }
}

/// `√(sᵀ Λ s)` of the first six numbers of a step.
fn mahalanobis(information: &[[f64; 6]; 6], step: &[f64; UNKNOWNS]) -> f64 {
    let first: [f64; 6] = std::array::from_fn(|i| step[i]);
    dot(&information.map(|row| dot(&row, &first)), &first).sqrt()
}

fn dot(a: &[f64; 6], b: &[f64; 6]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Image motion [px] per metre and per radian of camera motion, at the median depth.
fn pixels_per_unit(frame: &DenseView<'_>) -> [f64; 6] {
    let depth = &frame.pictures.frames[0].depth;
    let mut depths: Vec<f32> = depth.data.iter().copied().step_by(7).filter(|&d| d > 0.0).collect();
    let depth = median(&mut depths).map_or(1.0, f64::from);
    let focal = frame.pictures.camera.fx;
    let metre = focal / depth;
    [metre, metre, metre, focal, focal, focal]
}

/// Scales from the mean absolute residuals, no lower than their floors.
fn update_scales(scales: &mut RobustScales, errors: &AbsoluteErrors) {
    let scale = |sum: f64, count: usize| SIGMA_PER_MEAN * (sum / count as f64) as f32;
    if errors.depth_count > 0 {
        scales.depth = scale(errors.depth, errors.depth_count).max(MIN_SCALES.depth);
    }
    if errors.image_count > 0 {
        scales.image = scale(errors.image, errors.image_count).max(MIN_SCALES.image);
    }
}

/// The equations with all unknowns but pose and gains fixed, and gains that nothing shows.
fn free_equations(equations: &Equations) -> Equations {
    let mut free = equations.clone();
    for i in (0..UNKNOWNS).filter(|i| !FREE.contains(i) || equations.hessian[*i][*i] == 0.0) {
        (0..UNKNOWNS).for_each(|a| free.hessian[a.min(i)][a.max(i)] = 0.0);
        (free.hessian[i][i], free.gradient[i]) = (1.0, 0.0);
    }
    free
}
