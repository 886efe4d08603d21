//! What landmarks, poses and the camera bring to the normal equations of a bundle.

use super::linear::Step;
use super::structure::Structure;
use super::{Bundle, CHUNK, GLOBALS, Moves, Sight};
use crate::landmark::Projection;
use crate::robust::{HUBER, huber};
use i2slam_compute::reduce_in_order;
use i2slam_geometry::{Mat3, Vec3};

/// How the cost curves along a change of the residuals.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Curvature {
    /// As weighted squares do, which it lies under everywhere: for steps.
    Bounding,
    /// As it does itself, `w I` and beyond the bend `w (I - r rᵀ/‖r‖²)`: for covariances.
    Own,
}

/// What one landmark brings: `C`, its gradient, and its coupling with every camera that sees it.
pub(super) struct Part {
    pub(super) hessian: [[f64; 3]; 3],
    pub(super) gradient: [f64; 3],
    /// Coupling `E` with every free pose, in the order of the structure.
    pub(super) couplings: Vec<[[f64; 3]; 6]>,
    pub(super) globals: [[f64; 3]; GLOBALS],
}

/// What one pose brings: its block of `U`, its gradient and its coupling with the globals.
#[derive(Clone)]
pub(super) struct PosePart {
    pub(super) hessian: [[f64; 6]; 6],
    pub(super) gradient: [f64; 6],
    pub(super) globals: [[f64; GLOBALS]; 6],
}

/// The same of the unknowns that all sights share.
#[derive(Clone, Copy, Default)]
pub(super) struct GlobalPart {
    pub(super) hessian: [[f64; GLOBALS]; GLOBALS],
    pub(super) gradient: [f64; GLOBALS],
}

/// A residual, weighted, with its derivatives.
struct Weighted {
    projection: Projection,
    moves: Moves,
    residual: [f64; 2],
    weight: f64,
}

impl Part {
    pub(super) fn damped_inverse(&self, damping: f64) -> Mat3<f64> {
        let mut rows = self.hessian;
        (0..3).for_each(|i| rows[i][i] += damping * rows[i][i] + 1e-9);
        inverse(&Mat3 { rows })
    }
}

/// `None` behind the camera.
fn weighted(
    bundle: &Bundle,
    landmark: usize,
    sight: &Sight,
    curvature: Curvature,
) -> Option<Weighted> {
    let pose = &bundle.poses[sight.pose];
    let projection = bundle.landmarks[landmark].project(&bundle.camera, pose)?;
    let seen = sight.freed(bundle.change);
    let residual: [f64; 2] = std::array::from_fn(|i| projection.at[i] - seen[i]);
    let length = residual[0].hypot(residual[1]) / sight.sigma;
    let weight = huber(length).0 / (sight.sigma * sight.sigma);
    let mut out = Weighted { projection, moves: sight.moves, residual, weight };
    if curvature == Curvature::Own && length > HUBER {
        out.keep_across();
    }
    Some(out)
}

/// How far a sight alone pulls along a change of all unknowns: its gradient times that change.
pub(super) fn influence(bundle: &Bundle, landmark: usize, sight: &Sight, step: &Step) -> f64 {
    let bounding = Curvature::Bounding;
    let Some(w) = weighted(bundle, landmark, sight, bounding) else { return 0.0 };
    let product = |row: &[f64], change: &[f64]| -> f64 {
        row.iter().zip(change).map(|(slope, change)| slope * change).sum()
    };
    let along = |i: usize| {
        product(&w.projection.by_pose[i], &step.poses[sight.pose])
            + product(&w.projection.by_landmark[i], &step.landmarks[landmark])
            + product(&w.by_globals(i), &step.globals)
    };
    w.weight * (w.residual[0] * along(0) + w.residual[1] * along(1))
}

/// All sights of a landmark; `cameras` are those of free poses.
pub(super) fn part(
    bundle: &Bundle,
    landmark: usize,
    cameras: &[(u32, u32)],
    curvature: Curvature,
) -> Part {
    let sights = bundle.sights[landmark].iter();
    let all: Vec<Option<Weighted>> =
        sights.map(|s| weighted(bundle, landmark, s, curvature)).collect();
    let (mut hessian, mut gradient, mut globals) = ([[0.0; 3]; 3], [0.0; 3], [[0.0; 3]; GLOBALS]);
    for w in all.iter().flatten() {
        for i in 0..2 {
            let row = &w.projection.by_landmark[i];
            for a in 0..3 {
                gradient[a] += w.weight * row[a] * w.residual[i];
                (0..3).for_each(|b| hessian[a][b] += w.weight * row[a] * row[b]);
                for (global, slope) in globals.iter_mut().zip(w.by_globals(i)) {
                    global[a] += w.weight * slope * row[a];
                }
            }
        }
    }
    let coupling = |(_, sight): &(u32, u32)| {
        let Some(w) = &all[*sight as usize] else { return [[0.0; 3]; 6] };
        let entry = |a: usize, b: usize| -> f64 {
            (0..2).map(|i| w.projection.by_pose[i][a] * w.projection.by_landmark[i][b]).sum()
        };
        std::array::from_fn(|a| std::array::from_fn(|b| w.weight * entry(a, b)))
    };
    Part { hessian, gradient, couplings: cameras.iter().map(coupling).collect(), globals }
}

/// All sights by the pose of a block.
pub(super) fn pose_part(
    bundle: &Bundle,
    structure: &Structure,
    block: usize,
    curvature: Curvature,
) -> PosePart {
    let mut out =
        PosePart { hessian: [[0.0; 6]; 6], gradient: [0.0; 6], globals: [[0.0; GLOBALS]; 6] };
    for (landmark, k) in &structure.seen[block] {
        let landmark = *landmark as usize;
        let sight = &bundle.sights[landmark][structure.cameras[landmark][*k as usize].1 as usize];
        let Some(w) = weighted(bundle, landmark, sight, curvature) else { continue };
        for i in 0..2 {
            let row = &w.projection.by_pose[i];
            for a in 0..6 {
                let slope = w.weight * row[a];
                (0..6).for_each(|b| out.hessian[a][b] += slope * row[b]);
                out.gradient[a] += slope * w.residual[i];
                for (sum, global) in out.globals[a].iter_mut().zip(w.by_globals(i)) {
                    *sum += slope * global;
                }
            }
        }
    }
    out
}

pub(super) fn global_part(bundle: &Bundle, curvature: Curvature) -> GlobalPart {
    let task = |range: std::ops::Range<usize>| {
        let mut sum = GlobalPart::default();
        for (landmark, sight) in range.flat_map(|l| bundle.sights[l].iter().map(move |s| (l, s))) {
            let Some(w) = weighted(bundle, landmark, sight, curvature) else { continue };
            for i in 0..2 {
                let row = w.by_globals(i);
                for g in 0..GLOBALS {
                    sum.gradient[g] += w.weight * row[g] * w.residual[i];
                    (0..GLOBALS).for_each(|h| sum.hessian[g][h] += w.weight * row[g] * row[h]);
                }
            }
        }
        sum
    };
    let mut out = GlobalPart::default();
    reduce_in_order(bundle.landmarks.len(), CHUNK, task, |sum| {
        for g in 0..GLOBALS {
            out.gradient[g] += sum.gradient[g];
            (0..GLOBALS).for_each(|h| out.hessian[g][h] += sum.hessian[g][h]);
        }
    });
    out
}

impl Weighted {
    /// Leaves of the derivatives what is across the residual: along it the cost grows straight.
    fn keep_across(&mut self) {
        let length = self.residual[0].hypot(self.residual[1]);
        let across = [-self.residual[1] / length, self.residual[0] / length];
        let keep = |[x, y]: [&mut f64; 2]| {
            let slope = across[0] * *x + across[1] * *y;
            (*x, *y) = (across[0] * slope, across[1] * slope);
        };
        let [x, y] = &mut self.projection.by_pose;
        x.iter_mut().zip(y).for_each(|(x, y)| keep([x, y]));
        let [x, y] = &mut self.projection.by_landmark;
        x.iter_mut().zip(y).for_each(|(x, y)| keep([x, y]));
        keep(self.projection.by_focal.each_mut());
        self.moves.iter_mut().for_each(|by| keep(by.each_mut()));
    }

    /// Derivatives by the unknowns that all sights share.
    fn by_globals(&self, axis: usize) -> [f64; GLOBALS] {
        [self.projection.by_focal[axis], -self.moves[0][axis], -self.moves[1][axis]]
    }
}

/// The inverse of a symmetric positive definite matrix, by its cofactors.
fn inverse(m: &Mat3<f64>) -> Mat3<f64> {
    let [a, b, c] = m.rows.map(Vec3::from_array);
    let columns = [b.cross(c), c.cross(a), a.cross(b)];
    let determinant = a.dot(columns[0]);
    Mat3 { rows: columns.map(Vec3::to_array) }.transpose().scaled(1.0 / determinant)
}
