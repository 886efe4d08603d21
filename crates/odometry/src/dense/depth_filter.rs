//! Filters of estimated depth: cross-view consistency, and uncertainty at depth edges.

use super::DenseDepth;
use super::inverse_depth::InverseDepthEstimate;
use crate::alignment::is_one_surface;
use i2slam_geometry::{Camera, Image, Pose};
use rayon::prelude::*;

/// Largest difference of consistent inverse depths, in standard deviations of both, ...
const MAX_DEVIATIONS: f32 = 3.0;
/// ... or relative to them, whichever is more.
const MAX_RELATIVE_DIFFERENCE: f32 = 0.03;
/// Views that must agree; one where only one or two see the pixel.
const MIN_AGREEING_VIEWS: usize = 2;

/// Averages inverse depths that enough `others` (with `other_from_keyframe`) confirm by variance. Of
/// photographs, which see each place from all sides, more must confirm one than see through it.
pub(super) fn fuse_consistent(
    camera: &Camera<f64>,
    own: &InverseDepthEstimate,
    others: &[(&InverseDepthEstimate, Pose<f64>)],
    is_unordered: bool,
) -> InverseDepthEstimate {
    let (width, height) = (own.inverse_depth.width, own.inverse_depth.height);
    let mut out = InverseDepthEstimate {
        inverse_depth: Image::new(width, height, 1),
        variance: Image::new(width, height, 1),
    };
    for pixel in 0..width * height {
        let (rho, variance) = (own.inverse_depth.data[pixel], own.variance.data[pixel]);
        if rho <= 0.0 {
            continue;
        }
        let (u, v) = Camera::pixel_centre(pixel % width, pixel / width);
        let point = camera.unproject(u, v, 1.0 / f64::from(rho));
        let (mut seen, mut agree, mut against) = (0, 0, 0);
        let (mut sum, mut weight) = (rho / variance, 1.0 / variance);
        for (other, other_from_own) in others {
            let there = *other_from_own * point;
            let (x, y) = camera.project(there);
            if there.z <= 0.0 || !camera.contains(x, y, 0.0) {
                continue;
            }
            let at = y as usize * width + x as usize;
            let (found, its) = (other.inverse_depth.data[at], other.variance.data[at]);
            if found <= 0.0 {
                continue;
            }
            seen += 1;
            let due = (1.0 / there.z) as f32;
            // The same error of the depth: `dz = -dρ/ρ²` in both.
            let slope = (rho / due).powi(2);
            let its = its * slope * slope;
            let most = (MAX_DEVIATIONS * (variance + its).sqrt() / slope)
                .min(0.1 * due)
                .max(MAX_RELATIVE_DIFFERENCE * due);
            if (found - due).abs() > most {
                against += usize::from(is_unordered && found < due);
                continue;
            }
            agree += 1;
            sum += (rho + (found - due) * slope) / its;
            weight += 1.0 / its;
        }
        if agree >= MIN_AGREEING_VIEWS.min(seen) && agree > against {
            out.inverse_depth.data[pixel] = sum / weight;
            // Neighbours share pictures: their errors are not independent.
            out.variance.data[pixel] = (1 + agree) as f32 / weight;
        }
    }
    out
}

/// Largest difference of consistent readings: in standard deviations of both, and relative to them,
/// for what lies between the pixels of a slanted surface.
const MAX_READING_DEVIATIONS: f32 = 3.0;
const MAX_READING_DIFFERENCE: f32 = 0.005;

/// Largest difference of inverse depths of one surface, with the variance of their difference.
pub(super) fn largest_difference(variance: f32, inverse_depth: f32) -> f32 {
    (MAX_READING_DEVIATIONS * variance.sqrt()).max(MAX_READING_DIFFERENCE * inverse_depth)
}

/// Averages the inverse depths of a sensor with the readings of `others` (with
/// `other_from_keyframe`) by variance, interpolated where they show one surface. A reading that all
/// others contradict is left out; one that no other sees stays where pixels around it agree.
pub(super) fn fuse_readings(
    camera: &Camera<f64>,
    own: &InverseDepthEstimate,
    others: &[(&InverseDepthEstimate, Pose<f64>)],
) -> InverseDepthEstimate {
    let mut out = own.clone();
    let InverseDepthEstimate { inverse_depth, variance } = &mut out;
    let pixels = inverse_depth.data.par_iter_mut().zip(&mut variance.data).enumerate();
    let known = pixels.filter(|(_, (rho, _))| **rho > 0.0);
    known.for_each(|(pixel, (rho, variance))| {
        (*rho, *variance) = fused_reading(camera, own, others, pixel);
    });
    out
}

/// Inverse depth and variance of a pixel that has a reading; the first is 0 if it is left out.
fn fused_reading(
    camera: &Camera<f64>,
    own: &InverseDepthEstimate,
    others: &[(&InverseDepthEstimate, Pose<f64>)],
    pixel: usize,
) -> (f32, f32) {
    let (rho, variance) = (own.inverse_depth.data[pixel], own.variance.data[pixel]);
    let (mut seen, mut agree) = (0, 0);
    let (mut sum, mut weight) = (rho / variance, 1.0 / variance);
    for (other, other_from_own) in others {
        let Some(found) = other_reading(camera, own, pixel, other, other_from_own) else {
            continue;
        };
        seen += 1;
        if found.agrees {
            agree += 1;
            sum += found.inverse_depth / found.variance;
            weight += 1.0 / found.variance;
        }
    }
    let is_contradicted = agree == 0 && (seen > 1 || !is_supported(own, pixel));
    (if is_contradicted { 0.0 } else { sum / weight }, 1.0 / weight)
}

/// The reading of another view where it sees the surface of a pixel, as an inverse depth of the pixel.
pub(super) struct OtherReading {
    inverse_depth: f32,
    variance: f32,
    /// True if both views have read the same surface.
    pub(super) agrees: bool,
    /// Nearest pixel of the other view.
    pub(super) pixel: usize,
}

/// Reading of another view (with `other_from_own`) at the surface of a pixel with a reading; `None` where
/// it sees none, or an edge.
pub(super) fn other_reading(
    camera: &Camera<f64>,
    own: &InverseDepthEstimate,
    pixel: usize,
    other: &InverseDepthEstimate,
    other_from_own: &Pose<f64>,
) -> Option<OtherReading> {
    let width = own.inverse_depth.width;
    let (rho, variance) = (own.inverse_depth.data[pixel], own.variance.data[pixel]);
    let (u, v) = Camera::pixel_centre(pixel % width, pixel / width);
    let there = *other_from_own * camera.unproject(u, v, 1.0 / f64::from(rho));
    let (x, y) = (there.z > 0.0).then(|| camera.project(there))?;
    let tap = other.inverse_depth.tap(x as f32, y as f32)?;
    let values = tap.values(&other.inverse_depth.data);
    if !is_one_surface(values) {
        return None;
    }
    let (found, due) = (tap.interpolate(values).0, (1.0 / there.z) as f32);
    // The same error of the depth: `dz = -dρ/ρ²` in both.
    let slope = (rho / due).powi(2);
    let its = tap.interpolate(tap.values(&other.variance.data)).0 * slope * slope;
    let most = largest_difference((variance + its) / (slope * slope), due);
    Some(OtherReading {
        inverse_depth: rho + (found - due) * slope,
        variance: its,
        pixel: y as usize * width + x as usize,
        agrees: (found - due).abs() <= most,
    })
}

/// True for each pixel whose reading another view (with `other_from_own`) confirms.
pub(super) fn confirmed_readings(
    camera: &Camera<f64>,
    own: &InverseDepthEstimate,
    other: &InverseDepthEstimate,
    other_from_own: &Pose<f64>,
) -> Vec<bool> {
    let is_confirmed = |pixel: usize| {
        own.inverse_depth.data[pixel] > 0.0
            && other_reading(camera, own, pixel, other, other_from_own).is_some_and(|o| o.agrees)
    };
    (0..own.inverse_depth.data.len()).into_par_iter().map(is_confirmed).collect()
}

/// Adjacent readings that must agree with one that no other view confirms: spikes stand alone.
const MIN_AGREEING_NEIGHBOURS: usize = 3;

/// Whether at least [`MIN_AGREEING_NEIGHBOURS`] of the eight adjacent readings lie on the surface of
/// a pixel's reading.
fn is_supported(own: &InverseDepthEstimate, pixel: usize) -> bool {
    let (width, height) = (own.inverse_depth.width, own.inverse_depth.height);
    let (column, row) = (pixel % width, pixel / width);
    let (rho, variance) = (own.inverse_depth.data[pixel], own.variance.data[pixel]);
    let columns = column.saturating_sub(1)..(column + 2).min(width);
    let around = (row.saturating_sub(1)..(row + 2).min(height))
        .flat_map(|y| columns.clone().map(move |x| y * width + x));
    let agrees = |at: &usize| {
        let (other, its) = (own.inverse_depth.data[*at], own.variance.data[*at]);
        let most = MAX_READING_DEVIATIONS * (variance + its).sqrt();
        other > 0.0 && (other - rho).abs() <= most.max(MIN_EDGE_STEP * rho)
    };
    around.filter(|at| *at != pixel).filter(agrees).count() >= MIN_AGREEING_NEIGHBOURS
}

/// Relative difference of depths at an edge.
const MIN_EDGE_STEP: f32 = 0.1;
/// Standard deviation at an edge over its step: the other surface is three deviations away.
const STEP_DEVIATION_RATIO: f32 = 1.0 / 3.0;

/// Inflates the variance within `reach` pixels of a depth edge along rows and columns: a window
/// across two surfaces may have matched either.
pub(super) fn inflate_variance_at_edges(found: &mut DenseDepth, reach: usize) {
    let (width, height) = (found.depth.width, found.depth.height);
    let depth = &found.depth.data;
    let most = square_filter(depth, (width, height), reach, f32::max);
    let least = square_filter(depth, (width, height), reach, |a, b| match (a > 0.0, b > 0.0) {
        (true, true) => a.min(b),
        _ => a.max(b),
    });
    for (pixel, variance) in found.variance.data.iter_mut().enumerate() {
        let here = depth[pixel];
        let step = (most[pixel] - here).max(here - least[pixel]);
        if here > 0.0 && step > MIN_EDGE_STEP * least[pixel] {
            *variance += (STEP_DEVIATION_RATIO * step).powi(2);
        }
    }
}

/// Reduces squares of `2 reach + 1` pixels a side by `pick`.
pub(super) fn square_filter(
    values: &[f32],
    (width, height): (usize, usize),
    reach: usize,
    pick: impl Fn(f32, f32) -> f32,
) -> Vec<f32> {
    let line = |values: &[f32], pixel: usize, (at, length): (usize, usize), stride: usize| {
        let first = pixel - at.min(reach) * stride;
        let count = at.min(reach) + 1 + reach.min(length - 1 - at);
        (0..count).map(|i| values[first + i * stride]).fold(values[pixel], &pick)
    };
    let rows: Vec<f32> =
        (0..values.len()).map(|p| line(values, p, (p % width, width), 1)).collect();
    (0..rows.len()).map(|p| line(&rows, p, (p / width, height), width)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_geometry::{Rotation, Vec3};

    fn flat(inverse_depth: f32, variance: f32) -> InverseDepthEstimate {
        let image = |value: f32| Image { width: 9, height: 9, channels: 1, data: vec![value; 81] };
        InverseDepthEstimate { inverse_depth: image(inverse_depth), variance: image(variance) }
    }

    /// A plane of depth 2, also estimated 0.004 too far by a camera 0.8 nearer to it.
    fn seen_from_nearer() -> InverseDepthEstimate {
        let camera = Camera { width: 9, height: 9, fx: 9.0, fy: 9.0, cx: 4.5, cy: 4.5 };
        let (own, other) = (flat(1.0 / 2.0, 1e-4), flat(1.0 / 1.204, 9e-4));
        let forward = Pose::new(Rotation::identity(), Vec3::new(0.0, 0.0, -0.8));
        fuse_consistent(&camera, &own, &[(&other, forward)], false)
    }

    /// Estimates are weighted by the variance of the depth, `z⁴` times that of its inverse.
    #[test]
    fn a_camera_that_moved_forward_counts_by_its_depth() {
        let found = seen_from_nearer();
        let (own, other) = (1e-4 * 2_f64.powi(4), 9e-4 * 1.2_f64.powi(4));
        let depth = 2.0 + 0.004 * own / (own + other);
        let variance = 2.0 / (1.0 / own + 1.0 / other) / 2_f64.powi(4);
        let middle = 4 * 9 + 4;
        let off = 1.0 / f64::from(found.inverse_depth.data[middle]) - depth;
        assert!(off.abs() < 2e-5, "{off}");
        let ratio = f64::from(found.variance.data[middle]) / variance;
        assert!((ratio - 1.0).abs() < 1e-4, "{ratio}");
    }

    /// Two views confirm a depth, two others see what lies behind it.
    #[test]
    fn photographs_that_see_through_a_depth_outvote_it() {
        let camera = Camera { width: 9, height: 9, fx: 9.0, fy: 9.0, cx: 4.5, cy: 4.5 };
        let (own, behind) = (flat(0.5, 1e-4), flat(0.25, 1e-4));
        let middle = 4 * 9 + 4;
        let fused = |others: &[&InverseDepthEstimate], is_unordered| {
            let others: Vec<_> = others.iter().map(|other| (*other, Pose::identity())).collect();
            fuse_consistent(&camera, &own, &others, is_unordered).inverse_depth.data[middle]
        };
        let even = [&own, &own, &behind, &behind];
        assert_eq!(fused(&even, true), 0.0);
        assert!((fused(&even, false) - 0.5).abs() < 1e-5);
        assert!((fused(&even[..3], true) - 0.5).abs() < 1e-5);
        let nearer = flat(1.0, 1e-4);
        assert!((fused(&[&own, &own, &nearer, &nearer], true) - 0.5).abs() < 1e-5);
    }

    /// A spike that no other view sees is left out, a surface is not.
    #[test]
    fn a_reading_alone_in_its_surroundings_is_left_out() {
        let camera = Camera { width: 9, height: 9, fx: 9.0, fy: 9.0, cx: 4.5, cy: 4.5 };
        let mut own = flat(0.5, 1e-6);
        let middle = 4 * 9 + 4;
        own.inverse_depth.data[middle] = 50.0;
        let found = fuse_readings(&camera, &own, &[]).inverse_depth.data;
        assert_eq!(found[middle], 0.0);
        let others = (0..81).filter(|pixel| *pixel != middle);
        assert!(others.into_iter().all(|pixel| (found[pixel] - 0.5).abs() < 1e-6));
    }

    /// A near half beside a far one, an unknown column, and a slope of one in a hundred.
    fn halves() -> DenseDepth {
        let depth = Image::from_fn(20, 12, 1, |_, column, row| {
            let far = if column < 10 { 1.0 } else { 2.5 };
            if column == 3 { 0.0 } else { far + 0.01 * row as f32 }
        });
        let variance = Image { data: vec![1e-4; 240], ..depth.clone() };
        DenseDepth { depth, variance, contradicted: None }
    }

    #[test]
    fn both_sides_of_an_edge_are_doubtful_up_to_the_other_surface() {
        let mut found = halves();
        inflate_variance_at_edges(&mut found, 3);
        for (pixel, variance) in found.variance.data.iter().enumerate() {
            let beside = (7..13).contains(&(pixel % 20));
            let reach = 3.0 * variance.sqrt();
            assert_eq!(beside, *variance > 1e-4, "{pixel}");
            assert!(!beside || (1.5..1.55).contains(&reach), "{pixel}: {reach}");
        }
    }

    #[test]
    fn unknown_depth_and_slopes_are_no_edges() {
        let mut found = halves();
        found.depth.data.iter_mut().filter(|d| **d > 2.0).for_each(|d| *d = 0.0);
        inflate_variance_at_edges(&mut found, 3);
        assert!(found.variance.data.iter().all(|v| *v == 1e-4));
    }
}
