//! Readings that pictures contradict: where a surface reflects or lets through, neighbours show what
//! lies behind it.
//!
//! Two views that have read the same surface show the same there, unless it is a mirror, polished, or
//! a pane. The evidence against a reading is the logarithm of the ratio of matching costs by readings
//! and by swept depth, where the two differ; costs are proportional to the variance of what a match
//! leaves. The better the match by swept depth, the more it counts: between blurred or clipped pictures
//! a sweep takes the least of many poor matches. Windows that a neighbour does not see in full say
//! nothing: beside edges a sweep finds the nearer surface.

use super::depth_filter::{largest_difference, other_reading, square_filter};
use super::inverse_depth::{InverseDepthEstimate, MIN_COST};
use super::plane_sweep::{MatchingWindow, PlaneSweep, write_window_means};
use i2slam_geometry::{Camera, Pose};
use rayon::prelude::*;

/// Windows whose costs are compared: large ones, as no filter averages their noise.
pub(super) const WINDOW: MatchingWindow = MatchingWindow { half: 3, noise_variance: 5e-5 };
/// Half the sides of the squares that evidence is averaged over [px]: the smallest with enough decides.
const HALF_SQUARES: [usize; 3] = [8, 16, 32];
/// Share of the pixels of a square that must tell something.
const MIN_SUPPORT: f32 = 0.1;
/// Ratio of costs by which readings must be worse than swept depth, where they differ, to outweigh as
/// many that agree with it.
const MIN_COST_RATIO: f32 = 1.5;
/// Power of the correlation by swept depth that evidence against a reading is weighted with: half at a
/// cost of 0.11, a tenth at 0.32 (docs/experiments/depth.md).
const CORRELATION_POWER: i32 = 6;

/// Evidence against the reading of every pixel, above 0 where it is contradicted. `confirmed` tells for
/// each neighbour of `sweep` which readings it has read as well.
pub(super) fn evidence_against(
    sweep: &PlaneSweep<'_>,
    readings: &InverseDepthEstimate,
    swept: &InverseDepthEstimate,
    confirmed: &[Vec<bool>],
) -> Vec<f32> {
    let size = (readings.inverse_depth.width, readings.inverse_depth.height);
    let count = readings.inverse_depth.data.len();
    let costs = CostComparison::new(sweep, (readings, swept), confirmed);
    let (mut single, mut tells) = (vec![0.0; count], vec![0.0; count]);
    for (pixel, (single, tells)) in single.iter_mut().zip(&mut tells).enumerate() {
        let Some([read, swept_cost]) = costs.at(pixel) else { continue };
        *tells = 1.0;
        *single = match agree(readings, swept, pixel) {
            true => -MIN_COST_RATIO.ln(),
            false => evidence_of_costs(read, swept_cost),
        };
    }
    let (mut rows, mut means, mut support) = (Vec::new(), Vec::new(), Vec::new());
    let (mut out, mut decided) = (vec![0.0; count], vec![false; count]);
    for half in HALF_SQUARES {
        write_window_means(&single, size, half, &mut rows, &mut means);
        write_window_means(&tells, size, half, &mut rows, &mut support);
        for pixel in (0..count).filter(|pixel| support[*pixel] >= MIN_SUPPORT) {
            if !std::mem::replace(&mut decided[pixel], true) {
                out[pixel] = means[pixel] / support[pixel];
            }
        }
    }
    out
}

/// `ln(C_r / C_s) · (1 − C_s)⁶` of the matching costs, 0 to 1, by reading and by swept depth.
fn evidence_of_costs(by_reading: f32, by_sweep: f32) -> f32 {
    let [read, swept] = [by_reading, by_sweep].map(|cost| cost.max(MIN_COST));
    (read / swept).ln() * (1.0 - swept).powi(CORRELATION_POWER)
}

/// Adds the evidence against readings of another view (with `other_from_own`) to that of pixels that
/// have read the same surface.
pub(super) fn add_evidence_of(
    camera: &Camera<f64>,
    own: &InverseDepthEstimate,
    (other, other_from_own): (&InverseDepthEstimate, Pose<f64>),
    evidence: &[f32],
    total: &mut [f32],
) {
    let known = total.par_iter_mut().enumerate();
    let known = known.filter(|(pixel, _)| own.inverse_depth.data[*pixel] > 0.0);
    known.for_each(|(pixel, total)| {
        let there = other_reading(camera, own, pixel, other, &other_from_own);
        *total += there.filter(|there| there.agrees).map_or(0.0, |there| evidence[there.pixel]);
    });
}

/// Matching costs by readings and by swept depth, in neighbours that have read the same surface.
struct CostComparison<'a> {
    swept: &'a InverseDepthEstimate,
    /// For each neighbour.
    costs: Vec<[Vec<f32>; 2]>,
    /// 1 where all pixels of a window are confirmed, 0 elsewhere, for each neighbour.
    whole_windows: Vec<Vec<f32>>,
}

impl<'a> CostComparison<'a> {
    fn new(
        sweep: &PlaneSweep<'_>,
        (readings, swept): (&InverseDepthEstimate, &'a InverseDepthEstimate),
        confirmed: &[Vec<bool>],
    ) -> Self {
        let size = (readings.inverse_depth.width, readings.inverse_depth.height);
        let read = &readings.inverse_depth.data;
        let or_read = |(swept, read): (&f32, &f32)| if *swept > 0.0 { *swept } else { *read };
        let completed: Vec<f32> = swept.inverse_depth.data.iter().zip(read).map(or_read).collect();
        let (by_readings, by_sweep) =
            (sweep.neighbour_costs(read), sweep.neighbour_costs(&completed));
        let whole_windows = |seen: &Vec<bool>| {
            let seen: Vec<f32> = seen.iter().map(|is| f32::from(u8::from(*is))).collect();
            square_filter(&seen, size, WINDOW.half, f32::min)
        };
        Self {
            swept,
            costs: by_readings.into_iter().zip(by_sweep).map(|(a, b)| [a, b]).collect(),
            whole_windows: confirmed.iter().map(whole_windows).collect(),
        }
    }

    /// Mean costs by reading and by swept depth of a pixel; `None` where no neighbour tells.
    fn at(&self, pixel: usize) -> Option<[f32; 2]> {
        let (mut sums, mut views) = ([0.0; 2], 0.0);
        for (costs, whole) in self.costs.iter().zip(&self.whole_windows) {
            let both = [costs[0][pixel], costs[1][pixel]];
            if whole[pixel] > 0.0 && both.iter().all(|cost| *cost <= 1.0) {
                sums.iter_mut().zip(both).for_each(|(sum, cost)| *sum += cost);
                views += 1.0;
            }
        }
        (views > 0.0 && self.swept.is_known(pixel)).then(|| sums.map(|sum| sum / views))
    }
}

/// True if reading and swept depth of a pixel are of one surface.
pub(super) fn agree(
    readings: &InverseDepthEstimate,
    swept: &InverseDepthEstimate,
    pixel: usize,
) -> bool {
    let [a, b] = [readings, swept].map(|e| (e.inverse_depth.data[pixel], e.variance.data[pixel]));
    (a.0 - b.0).abs() <= largest_difference(a.1 + b.1, a.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poor_matches_say_less_than_good_ones() {
        // The ratio of costs is two in all three; pictures correlate by 0.95, 0.8 and 0.5.
        let [good, fair, poor] =
            [[0.1, 0.05], [0.4, 0.2], [1.0, 0.5]].map(|[r, s]| evidence_of_costs(r, s));
        assert!((good - 2.0_f32.ln() * 0.95_f32.powi(6)).abs() < 1e-6);
        assert!(fair < 0.4 * good && poor < 0.03 * good && poor > 0.0, "{good} {fair} {poor}");
    }

    #[test]
    fn costs_of_rounding_are_equal() {
        assert_eq!(evidence_of_costs(0.5 * MIN_COST, 0.0), 0.0);
        assert!(evidence_of_costs(0.2, 0.0).is_finite());
        assert_eq!(evidence_of_costs(1.0, 1.0), 0.0);
    }
}
