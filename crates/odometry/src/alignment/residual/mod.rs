//! Residuals of a frame against a re-projected alignment target, and their normal equations.
//!
//! A pixel `p` of the frame with depth `d` is a point `X` in the camera. At time `u` of the
//! exposure it lies at `Y_u = target_from_world T(u) X` in the target's camera, where the target
//! has radiance `M(q_u)` and depth `D(q_u)`, `q_u = π(Y_u)`. The residuals are
//!
//! ```text
//! r_c = CRF(gain_c · Σ_u w_u M_c(q_u)) - Ĉ_c(p)          blurred target against picture
//! r_d = D(q_d) - Y_d.z                                    at the time d of the depth picture
//! ```
//!
//! With `s = u - ½` and velocity `(ν, ω)`, the point lies at `P_u = Exp(s ω) X + s ν` in the camera
//! at mid-exposure. A tangent `(ρ, φ)` of the centre moves it by `ρ + φ × P_u`, a change of the
//! velocity by `s (δν + δω × (P_u - s ν))`, where `J_l(s ω)` is taken as one, so with the row `b =
//! ∇M · ∂π/∂Y · R_target_from_centre` the derivatives are `(b, P × b)` and `s (b, (P - s ν) × b)`.
//!
//! With a rolling shutter the row at `v` is exposed later by `readout (v/H - ½)`, so that `s`
//! differs from sample to sample, and the readout is an unknown with the derivative `(v/H - ½) b ·
//! (ν + ω × (P - s ν))`. Depth is taken at one time. A target whose own rows were read one after
//! another sees a point `Y` of its middle row at `Exp(-s ω) (Y - s ν)`, `s` the time of the row in
//! which it appears.

mod colour;
mod depth;
mod geometry;
mod level;
#[cfg(test)]
mod reference;
#[cfg(test)]
mod tests;

pub use level::is_one_surface;
pub use level::{DepthSamples, FrameLevel, TargetLevel};
pub(super) use level::{depth_noise, depth_spread};

use colour::ColourBlock;
use depth::DepthBlock;
use geometry::Geometry;
use i2slam_compute::simd::Lanes;
use i2slam_compute::{NormalEquations, reduce_in_order};
use i2slam_formation::{CentreVelocity, FrameTone, Quadrature, ResponseCurve};
use i2slam_geometry::{Pose, Tangent};
use level::{BlockValues, SampleBlock, groups};
use pulp::{Arch, Simd, WithSimd};

/// Unknowns: centre (ρ, φ), velocity (ρ, φ), log exposure, log white balance (r, g, b), readout.
pub const UNKNOWNS: usize = 17;
/// Normal equations of one frame.
pub type Equations = NormalEquations<UNKNOWNS>;

/// Degrees of freedom of the t-distribution of residuals (Kerl 2013).
pub const DEGREES_OF_FREEDOM: f32 = 5.0;
/// Standard deviation of depth over the roughness of target or frame: beside edges an interpolated
/// depth lies on no surface, and always errs to the same side.
const ROUGHNESS_SIGMA_RATIO: f32 = 0.5;
/// Depth residual, as a share of the depth, beyond which the target shows another surface.
const MAX_DEPTH_RESIDUAL_RATIO: f32 = 0.08;
/// Distance along the optical axis within which points count as not visible [m].
const MIN_DISTANCE: f32 = 0.05;
/// Index of the velocity among the unknowns.
pub const VELOCITY: usize = 6;
/// Index of the logarithm of the exposure.
pub const EXPOSURE: usize = 12;
/// Index of the logarithms of the white balance, red, green, blue.
pub const WHITE_BALANCE: usize = 13;
/// Index of the readout.
pub const READOUT: usize = 16;
/// Blocks of samples that one parallel task takes.
const BLOCKS_PER_TASK: usize = 8;

/// Scales of the t-distributions of the residuals.
#[derive(Clone, Copy, Debug)]
pub struct RobustScales {
    /// Of depth at 1 m; beyond, the scale grows with the square of the depth [m].
    pub depth: f32,
    /// Of image residuals [picture values].
    pub image: f32,
}

/// Inputs of one evaluation of the residuals.
pub struct Linearization<'a> {
    /// The target, at the same level.
    pub target: &'a TargetLevel,
    /// The frame.
    pub frame: &'a FrameLevel,
    /// Camera-from-world pose of the target.
    pub target_from_world: Pose<f64>,
    /// World-from-camera pose at mid-exposure, and the motion during the exposure.
    pub motion: CentreVelocity<f64>,
    /// Rolling-shutter readout from the first to the last row [exposures].
    pub readout: f64,
    /// Exposure and white balance.
    pub tone: FrameTone<f32>,
    /// Camera response; without one, radiance is compared with picture values.
    pub curve: Option<&'a ResponseCurve<f32>>,
    /// Virtual cameras of the exposure.
    pub cameras: usize,
    /// Rows of the target's picture, where they were read one after another.
    pub target_rows: Option<TargetRows>,
    /// Height of the picture at this level [px], an odd last row included; `None` for a global
    /// shutter.
    pub rolling_height: Option<f64>,
    /// Moments of the exposure at which virtual cameras stand.
    pub quadrature: Quadrature,
    /// World-from-camera pose at the time of the depth picture.
    pub world_from_depth: Pose<f64>,
    /// Motion from mid-exposure to the depth picture over the motion since the last frame.
    pub depth_offset_ratio: f64,
    /// Scales of the residuals.
    pub scales: RobustScales,
    /// Weight of image residuals against depth residuals.
    pub image_weight: f32,
    /// The derivatives that are computed beside cost and errors.
    pub derivatives: Derivatives,
}

/// Derivatives that enter the normal equations; rows and columns of the others stay zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Derivatives {
    /// None: cost and errors alone.
    None,
    /// By the pose at mid-exposure and the tone.
    PoseAndTone,
    /// By all unknowns.
    All,
}

/// Rolling shutter of a target.
#[derive(Clone, Copy, Debug)]
pub struct TargetRows {
    /// Motion of the target's camera from its first row to its last.
    pub motion: Tangent<f64>,
    /// Height of the picture at this level [px], an odd last row included.
    pub height: f64,
}

/// Sums of absolute residuals, unweighted.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AbsoluteErrors {
    /// Depth residuals, divided by the growth of depth noise with distance [m at 1 m].
    pub depth: f64,
    /// Number of depth residuals.
    pub depth_count: usize,
    /// Image residuals [picture values].
    pub image: f64,
    /// Number of image residuals.
    pub image_count: usize,
}

/// Normal equations of the residuals, their absolute sums and the overlap.
#[derive(Clone, Debug, Default)]
pub struct ResidualSums {
    /// Only cost and number of residuals where no derivatives were asked for.
    pub equations: Equations,
    /// Absolute sums.
    pub errors: AbsoluteErrors,
    /// Sampled pixels with depth, visible in the target or not.
    pub candidates: usize,
    /// Those that lie on the target's surface.
    pub agreeing: usize,
}

impl ResidualSums {
    /// Adds the sums of another part.
    pub fn merge(&mut self, other: &Self) {
        self.equations.merge(&other.equations);
        self.errors.depth += other.errors.depth;
        self.errors.depth_count += other.errors.depth_count;
        self.errors.image += other.errors.image;
        self.errors.image_count += other.errors.image_count;
        self.candidates += other.candidates;
        self.agreeing += other.agreeing;
    }

    /// Mean negative log-likelihood of the residuals, the cost that steps minimise.
    pub fn mean_cost(&self) -> f64 {
        self.equations.cost / (self.equations.count.max(1) as f64)
    }

    /// Share of the frame's depth pixels that lie on the target's surface.
    pub fn overlap(&self) -> f64 {
        self.agreeing as f64 / self.candidates.max(1) as f64
    }
}

impl Linearization<'_> {
    /// Sums residuals and derivatives over the frame, in an order that does not depend on threads.
    pub fn accumulate(&self) -> ResidualSums {
        self.accumulate_over(&self.frame.samples)
    }

    /// [`accumulate`](Self::accumulate) over some samples of the frame.
    pub fn accumulate_over(&self, samples: &DepthSamples) -> ResidualSums {
        let [mut total, colour] = self.accumulate_kinds_over(samples);
        total.merge(&colour);
        total
    }

    /// [`accumulate_over`](Self::accumulate_over), the depth residuals apart from those of colour.
    pub fn accumulate_kinds_over(&self, samples: &DepthSamples) -> [ResidualSums; 2] {
        let geometry = Geometry::new(self);
        let arch = Arch::new();
        let mut total = [ResidualSums::default(), ResidualSums::default()];
        total[0].candidates = samples.count;
        reduce_in_order(
            samples.blocks.len(),
            BLOCKS_PER_TASK,
            |blocks| {
                arch.dispatch(Blocks {
                    task: self,
                    geometry: &geometry,
                    blocks: &samples.blocks[blocks],
                })
            },
            |parts| total.iter_mut().zip(&parts).for_each(|(sum, part)| sum.merge(part)),
        );
        add_exposure(&mut total[1].equations);
        total
    }
}

/// The sums over some blocks of samples, for any instruction set.
struct Blocks<'a> {
    task: &'a Linearization<'a>,
    geometry: &'a Geometry,
    blocks: &'a [SampleBlock],
}

impl WithSimd for Blocks<'_> {
    /// Of depth and of colour.
    type Output = [ResidualSums; 2];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> [ResidualSums; 2] {
        let Self { task, geometry, blocks } = self;
        let mut sums = [ResidualSums::default(), ResidualSums::default()];
        let kernel = Kernel { simd, task, geometry };
        let (mut depth, mut colour) = (DepthBlock::default(), ColourBlock::default());
        for samples in blocks {
            let agreeing = depth.add(kernel, samples, &mut sums[0]);
            if agreeing > 0 && task.image_weight > 0.0 {
                colour.add(kernel, &depth, &mut sums[1]);
            }
        }
        sums
    }
}

/// Common inputs of the functions that process a block.
#[derive(Clone, Copy)]
struct Kernel<'a, S> {
    simd: S,
    task: &'a Linearization<'a>,
    geometry: &'a Geometry,
}

/// Fills in row and column of the exposure: its derivative is the sum of those by the gains of the
/// three channels, and no residual depends on the gain of two channels.
fn add_exposure(equations: &mut Equations) {
    for c in WHITE_BALANCE..READOUT {
        equations.hessian[EXPOSURE][READOUT] += equations.hessian[c][READOUT];
        for a in 0..EXPOSURE {
            equations.hessian[a][EXPOSURE] += equations.hessian[a][c];
        }
        equations.hessian[EXPOSURE][c] = equations.hessian[c][c];
        equations.hessian[EXPOSURE][EXPOSURE] += equations.hessian[c][c];
        equations.gradient[EXPOSURE] += equations.gradient[c];
    }
}

/// Cost `(ν + 1) ln(1 + r²/ν)` of a residual under a t-distribution, from the square `r²` of the
/// residual over its scale.
#[inline(always)]
fn cost_of<S: Simd>(simd: S, square: Lanes<S>) -> Lanes<S> {
    let number = |value| Lanes::splat(simd, value);
    number(DEGREES_OF_FREEDOM + 1.0)
        * square.mul_add(number(1.0 / DEGREES_OF_FREEDOM), number(1.0)).ln()
}

/// Products that are summed in one pass over a block.
const PRODUCTS: usize = 4;

/// Adds `jᵀ j` and `jᵀ r` of a block to the normal equations. `rows` are the derivatives `j` by
/// `unknowns` (in increasing order), then the residuals `r`, all times the root of their weights.
#[inline(always)]
fn add_normal_equations<S: Simd>(
    simd: S,
    rows: &[&BlockValues],
    unknowns: &[usize],
    equations: &mut Equations,
) {
    let Some(last) = rows.len().checked_sub(1) else { return };
    for (i, &a) in unknowns.iter().enumerate() {
        for j in (i..=last).step_by(PRODUCTS) {
            let sums = products(simd, rows[i], &[0, 1, 2, 3].map(|k| rows[(j + k).min(last)]));
            for (k, &sum) in sums.iter().enumerate().take(last + 1 - j) {
                match unknowns.get(j + k) {
                    Some(&b) => equations.hessian[a][b] += f64::from(sum),
                    None => equations.gradient[a] += f64::from(sum),
                }
            }
        }
    }
}

/// Sums over the block of `row` times each of `others`.
#[inline(always)]
fn products<S: Simd>(
    simd: S,
    row: &BlockValues,
    others: &[&BlockValues; PRODUCTS],
) -> [f32; PRODUCTS] {
    let mut sums = [Lanes::zero(simd); PRODUCTS];
    for group in 0..groups::<S>() {
        let value = Lanes::load_group(simd, row, group);
        for k in 0..PRODUCTS {
            sums[k] = value.mul_add(Lanes::load_group(simd, others[k], group), sums[k]);
        }
    }
    let mut totals = [0.0; PRODUCTS];
    for k in 0..PRODUCTS {
        totals[k] = sums[k].reduce_sum();
    }
    totals
}
