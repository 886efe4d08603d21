//! Merging of similar neighbouring Gaussians, to keep a map within its capacity.

use super::density_control::logit;
use i2slam_geometry::{Mat3, Rotation, Vec3, symmetric_eigen};
use i2slam_radiance::gaussian::{Gaussian, GaussianMap, Shape};
use rayon::slice::ParallelSliceMut;
use std::ops::{Range, RangeInclusive};

/// Edge of the cells in which Gaussians are merged [standard deviations]: holds about four of the
/// Gaussians that cover a surface at one per pixel.
const CELL_EDGE: f32 = 2.0;
/// Most passes of merging; each about doubles the width of what it merges.
const MAX_PASSES: usize = 12;
/// Growth of the cells per pass, to reach neighbours of another size.
const CELL_GROWTH: f32 = 1.2;
/// Least variance of an axis, as a share of the largest: rounding error of a flat ellipsoid.
const MIN_VARIANCE_RATIO: f64 = 1e-12;

/// Merges the groups of least contrast first, down to the lower end of `size`; the newest beyond
/// its upper end are not kept. Returns the mask of those to keep; merged ones replace their first.
pub(super) fn merge(map: &mut GaussianMap, size: RangeInclusive<usize>) -> Vec<bool> {
    let mut keep = vec![true; map.len()];
    let mut left = map.len();
    for pass in 0..MAX_PASSES {
        if left <= *size.start() {
            break;
        }
        let cells = cells(map, &keep, CELL_EDGE * CELL_GROWTH.powi(pass as i32));
        let mut groups = groups(map, &cells);
        if groups.is_empty() {
            break;
        }
        groups.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.start.cmp(&b.1.start)));
        for (_, members) in groups {
            if left <= *size.start() {
                break;
            }
            let members = &cells[members];
            left -= members.len() - 1;
            set(map, members[0].1 as usize, merge_gaussians(map, members));
            members[1..].iter().for_each(|&(_, index)| keep[index as usize] = false);
        }
    }
    let surplus = left.saturating_sub(*size.end());
    keep.iter_mut().rev().filter(|kept| **kept).take(surplus).for_each(|kept| *kept = false);
    keep
}

fn set(map: &mut GaussianMap, index: usize, gaussian: Gaussian<f32>) {
    map.means[index] = gaussian.mean;
    map.log_scales[index] = gaussian.log_scale;
    map.rotations[index] = gaussian.rotation;
    map.opacity_logits[index] = gaussian.opacity_logit;
    map.colours[index] = gaussian.colour;
}

/// Cell key and index of a Gaussian.
type Member = (u64, u32);

/// The kept Gaussians, sorted by cell.
fn cells(map: &GaussianMap, keep: &[bool], edge: f32) -> Vec<Member> {
    let kept = keep.iter().enumerate().filter(|(_, keep)| **keep);
    let mut cells: Vec<Member> = kept.map(|(i, _)| (cell_key(map, i, edge), i as u32)).collect();
    cells.par_sort_unstable();
    cells
}

/// Cell of a Gaussian: position on a grid of its size class, a factor of two wide.
fn cell_key(map: &GaussianMap, index: usize, edge: f32) -> u64 {
    let size = (0.5 * log_area(map, index) / std::f32::consts::LN_2).round();
    let part = |v: f32, bits: u32| (v.floor() as i64 as u64) & ((1 << bits) - 1);
    let edge = edge * size.exp2();
    let place = map.means[index].iter().fold(0, |key, v| key << 18 | part(v / edge, 18));
    place << 10 | part(size, 10)
}

/// Colour contrast and range of every cell with two or more Gaussians.
fn groups(map: &GaussianMap, cells: &[Member]) -> Vec<(f32, Range<usize>)> {
    let mut groups = Vec::new();
    let mut start = 0;
    for members in cells.chunk_by(|a, b| a.0 == b.0) {
        let end = start + members.len();
        if members.len() > 1 {
            groups.push((contrast(map, members), start..end));
        }
        start = end;
    }
    groups
}

/// Weighted variance of the colours of a group.
fn contrast(map: &GaussianMap, members: &[Member]) -> f32 {
    let mean = average(map, members, |i| map.colours[i]);
    average(map, members, |i| squared_differences(map.colours[i], mean)).iter().sum()
}

/// One Gaussian for several: means of position, colour and opacity. Its area lies halfway between
/// the members' spread, which would leave gaps, and the sum of their areas, which would smear.
fn merge_gaussians(map: &GaussianMap, members: &[Member]) -> Gaussian<f32> {
    let mean = average(map, members, |i| map.means[i]);
    let opacity = average(map, members, |i| [opacity(map, i); 3])[0].clamp(1e-4, 1.0 - 1e-4);
    let (log_scale, rotation) = match map.shape {
        Shape::Isotropic => {
            (merge_isotropic(map, members, mean), map.rotations[members[0].1 as usize])
        }
        Shape::Anisotropic => merge_anisotropic(map, members, mean),
    };
    Gaussian {
        mean,
        log_scale,
        rotation,
        opacity_logit: logit(opacity),
        colour: average(map, members, |i| map.colours[i]),
    }
}

/// Log standard deviations of a ball on a surface.
fn merge_isotropic(map: &GaussianMap, members: &[Member], mean: [f32; 3]) -> [f32; 3] {
    let spread =
        average(map, members, |i| squared_differences(map.means[i], mean)).iter().sum::<f32>();
    let own = average(map, members, |i| map.log_scales[i].map(|s| (2.0 * s).exp()));
    own.map(|own| {
        let together = own * members.len() as f32;
        0.5 * (0.5 * (own + 0.5 * spread + together)).ln()
    })
}

/// Log standard deviations, largest first, and rotation of the members' covariance around `mean`.
/// Only the two large axes grow: discs of a wall become a disc of that wall.
fn merge_anisotropic(
    map: &GaussianMap,
    members: &[Member],
    mean: [f32; 3],
) -> ([f32; 3], [f32; 4]) {
    let mean = Vec3::from_array(mean).cast::<f64>();
    let (mut sum, mut area, mut total) = (Mat3::<f64>::zero(), 0.0, 0.0);
    for index in members.iter().map(|&(_, index)| index as usize) {
        let weight = f64::from(weight(map, index));
        let offset = Vec3::from_array(map.means[index]).cast::<f64>() - mean;
        sum = sum + (covariance(map, index) + Mat3::outer(offset, offset)).scaled(weight);
        area += weight * f64::from(log_area(map, index)).exp();
        total += weight;
    }
    let total = total.max(f64::MIN_POSITIVE);
    let (variances, axes) = symmetric_eigen(&sum.scaled(total.recip()));
    let largest = variances.x.max(f64::MIN_POSITIVE);
    let [first, second, third] = variances.to_array().map(|v| v.max(MIN_VARIANCE_RATIO * largest));
    let spread = (first * second).sqrt();
    let together = area / total * members.len() as f64;
    let growth = 0.5 * (1.0 + together / spread);
    let log_scale = [first * growth, second * growth, third].map(|v| (0.5 * v.ln()) as f32);
    let Rotation { w, v } = Rotation::from_matrix(&axes);
    (log_scale, [w, v.x, v.y, v.z].map(|q| q as f32))
}

/// `R S² Rᵀ` of a Gaussian.
fn covariance(map: &GaussianMap, index: usize) -> Mat3<f64> {
    let [w, x, y, z] = map.rotations[index].map(f64::from);
    let axes = Rotation::from_wxyz(w, x, y, z).unwrap_or_else(Rotation::identity).matrix();
    let variances = map.log_scales[index].map(|s| (2.0 * f64::from(s)).exp());
    axes * Mat3::diagonal(Vec3::from_array(variances)) * axes.transpose()
}

/// Mean of a triple over members, weighted by opacity times area.
fn average(map: &GaussianMap, members: &[Member], value: impl Fn(usize) -> [f32; 3]) -> [f32; 3] {
    let (mut sum, mut total) = ([0.0; 3], 0.0);
    for &(_, index) in members {
        let index = index as usize;
        let weight = weight(map, index);
        let value = value(index);
        (0..3).for_each(|k| sum[k] += weight * value[k]);
        total += weight;
    }
    sum.map(|s| s / total.max(f32::MIN_POSITIVE))
}

/// Opacity times area.
fn weight(map: &GaussianMap, index: usize) -> f32 {
    opacity(map, index) * log_area(map, index).exp()
}

/// Natural logarithm of the product of the two largest standard deviations [ln m²].
fn log_area(map: &GaussianMap, index: usize) -> f32 {
    let [a, b, c] = map.log_scales[index];
    match map.shape {
        Shape::Isotropic => 2.0 * a,
        Shape::Anisotropic => (a + b).max(b + c).max(c + a),
    }
}

fn opacity(map: &GaussianMap, index: usize) -> f32 {
    1.0 / (1.0 + (-map.opacity_logits[index]).exp())
}

fn squared_differences(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|k| (a[k] - b[k]).powi(2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_radiance::gaussian::ColourActivation;

    const SIDE: usize = 40;

    /// A wall of one Gaussian a centimetre, plain on its left half, chequered on its right.
    fn wall() -> GaussianMap {
        let mut map = GaussianMap::new(Shape::Isotropic, ColourActivation::Exponential);
        for (row, column) in (0..SIDE).flat_map(|row| (0..SIDE).map(move |c| (row, c))) {
            let chequered = column >= SIDE / 2 && (row + column) % 2 == 0;
            map.push(Gaussian {
                mean: [0.01 * column as f32 + 0.005, 0.01 * row as f32 + 0.005, 2.0],
                log_scale: [0.01_f32.ln(); 3],
                rotation: [1.0, 0.0, 0.0, 0.0],
                opacity_logit: 1.0,
                colour: [if chequered { -2.0 } else { 0.0 }; 3],
            });
        }
        map
    }

    fn area(map: &GaussianMap) -> f32 {
        (0..map.len()).map(|i| log_area(map, i).exp()).sum()
    }

    fn merge_and_remove(map: &mut GaussianMap, size: RangeInclusive<usize>) -> Vec<bool> {
        let keep = merge(map, size);
        map.retain(&keep);
        keep
    }

    #[test]
    fn similar_gaussians_are_merged_first() {
        let mut map = wall();
        let keep = merge_and_remove(&mut map, SIDE * SIDE * 3 / 4..=SIDE * SIDE);
        assert!(map.len() <= SIDE * SIDE * 3 / 4 && map.len() > SIDE * SIDE / 2);
        assert_eq!(keep.iter().filter(|k| **k).count(), map.len());
        for (index, keep) in keep.iter().enumerate() {
            assert!(*keep || index % SIDE < SIDE / 2, "texture at {index} was merged");
        }
    }

    #[test]
    fn merging_keeps_area_and_brightness() {
        let whole = wall();
        let mut map = wall();
        merge_and_remove(&mut map, SIDE * SIDE / 4..=SIDE * SIDE);
        assert!(map.len() <= SIDE * SIDE / 4);
        let ratio = area(&map) / area(&whole);
        assert!((0.6..1.1).contains(&ratio), "area times {ratio}");
        let light = |m: &GaussianMap| -> f32 {
            let each = m.colours.iter().zip(&m.log_scales);
            each.map(|(c, s)| c[0] * (2.0 * s[0]).exp()).sum::<f32>() / area(m)
        };
        assert!((light(&map) - light(&whole)).abs() < 0.1, "{} {}", light(&map), light(&whole));
    }

    #[test]
    fn the_newest_scattered_gaussians_are_dropped() {
        let mut map = wall();
        map.means.iter_mut().for_each(|mean| *mean = mean.map(|v| 100.0 * v));
        assert_eq!(merge(&mut map, 10..=SIDE * SIDE), vec![true; SIDE * SIDE]);
        let keep = merge(&mut map, 10..=100);
        assert!(keep.iter().enumerate().all(|(index, keep)| *keep == (index < 100)));
    }

    const WIDE: f32 = 0.01;
    const THIN: f32 = 0.001;

    fn turn() -> Rotation<f64> {
        Rotation::exp(Vec3::new(0.5, -0.7, 0.2))
    }

    fn disc(mean: Vec3<f64>, deviations: [f32; 3], axes: Rotation<f64>) -> Gaussian<f32> {
        Gaussian {
            mean: mean.cast().to_array(),
            log_scale: deviations.map(f32::ln),
            rotation: [axes.w, axes.v.x, axes.v.y, axes.v.z].map(|q| q as f32),
            opacity_logit: 1.0,
            colour: [0.0; 3],
        }
    }

    /// A tilted wall of one disc a centimetre, with its thin axis stored first, second or third.
    fn discs() -> GaussianMap {
        let mut map = GaussianMap::new(Shape::Anisotropic, ColourActivation::Exponential);
        for index in 0..SIDE * SIDE {
            let place = [index % SIDE, index / SIDE].map(|k| 0.01 * k as f64);
            let spun = turn() * Rotation::exp(Vec3::new(0.0, 0.0, index as f64));
            let quarter = 0.5 * std::f64::consts::PI;
            let (deviations, swap) = match index % 3 {
                0 => ([WIDE, WIDE, THIN], Vec3::zero()),
                1 => ([WIDE, THIN, WIDE], Vec3::new(quarter, 0.0, 0.0)),
                _ => ([THIN, WIDE, WIDE], Vec3::new(0.0, quarter, 0.0)),
            };
            let mean = turn().rotate(Vec3::new(place[0], place[1], 2.0));
            map.push(disc(mean, deviations, spun * Rotation::exp(swap)));
        }
        map
    }

    #[test]
    fn merged_discs_of_a_wall_lie_in_the_wall() {
        let whole = discs();
        let mut map = discs();
        merge_and_remove(&mut map, SIDE * SIDE / 4..=SIDE * SIDE);
        assert!(map.len() <= SIDE * SIDE / 4, "{}", map.len());
        let normal = turn().rotate(Vec3::new(0.0, 0.0, 1.0));
        for index in 0..map.len() {
            let across = normal.dot(covariance(&map, index) * normal).sqrt();
            assert!((across / f64::from(THIN) - 1.0).abs() < 0.02, "{index}: {across} m thick");
            let height = normal.dot(Vec3::from_array(map.means[index]).cast()) - 2.0;
            assert!(height.abs() < 1e-5, "{index}: {height} m off the wall");
        }
        let ratio = area(&map) / area(&whole);
        assert!((0.5..1.1).contains(&ratio), "area times {ratio}");
    }

    #[test]
    fn the_area_of_a_pair_lies_between_spread_and_sum() {
        let mut map = GaussianMap::new(Shape::Anisotropic, ColourActivation::Linear);
        for side in [-1.0, 1.0] {
            let mean = turn().rotate(Vec3::new(0.02 * side, 0.0, 0.0));
            map.push(disc(mean, [0.02, 0.02, THIN], turn()));
        }
        let one = merge_gaussians(&map, &[(0, 0), (0, 1)]);
        // Variances 2 and 1 times 0.02², and twice the area of one: halfway in area.
        let growth = 0.5 * (1.0 + 2.0 / 2.0_f32.sqrt());
        let expected = [2.0 * growth, growth].map(|v| 0.02 * v.sqrt()).map(f32::ln);
        for (found, wanted) in one.log_scale.into_iter().zip([expected[0], expected[1], THIN.ln()])
        {
            assert!((found - wanted).abs() < 1e-4, "{found} {wanted}");
        }
        let [w, x, y, z] = one.rotation.map(f64::from);
        let axes = Rotation::from_wxyz(w, x, y, z).expect("of unit length");
        let long = axes.rotate(Vec3::new(1.0, 0.0, 0.0));
        assert!(long.dot(turn().rotate(Vec3::new(1.0, 0.0, 0.0))).abs() > 0.9999);
    }

    #[test]
    fn isotropic_ellipsoids_merge_as_balls() {
        let mut map = GaussianMap::new(Shape::Anisotropic, ColourActivation::Linear);
        for place in [[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]] {
            let mean = Vec3::new(0.01 * place[0], 0.01 * place[1], 0.0);
            map.push(disc(mean, [0.02; 3], Rotation::identity()));
        }
        let members = [(0, 0), (0, 1), (0, 2), (0, 3)];
        let round = merge_gaussians(&map, &members);
        map.shape = Shape::Isotropic;
        let ball = merge_gaussians(&map, &members);
        for k in 0..2 {
            assert!((round.log_scale[k] - ball.log_scale[k]).abs() < 1e-5);
        }
    }
}
