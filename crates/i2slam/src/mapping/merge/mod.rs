//! Making room in a full map: neighbours that look alike become one Gaussian.

mod cells;
mod united;

use cells::{cells, groups};
use i2slam_radiance::gaussian::{Gaussian, GaussianMap};
use std::ops::RangeInclusive;
use united::united;

/// Edge of the cells in which Gaussians are merged, in their standard deviations: about four of
/// those that cover a surface at one a pixel.
const CELL: f32 = 2.0;
/// Rounds of merging; each makes what it merges about twice as wide.
const ROUNDS: usize = 12;
/// Growth of the cells from round to round, to reach neighbours of another size.
const GROWTH: f32 = 1.2;

/// Merges until the lower end of `size` is reached, the most alike first, or until nothing shares
/// a cell; what is then beyond its upper end is dropped, the newest first. Returns which stay; a
/// merged Gaussian takes the place of the first of its group.
pub(super) fn merge(map: &mut GaussianMap, size: RangeInclusive<usize>) -> Vec<bool> {
    let mut keep = vec![true; map.len()];
    let mut left = map.len();
    for round in 0..ROUNDS {
        if left <= *size.start() {
            break;
        }
        let cells = cells(map, &keep, CELL * GROWTH.powi(round as i32));
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
            set(map, members[0].1 as usize, united(map, members));
            members[1..].iter().for_each(|&(_, index)| keep[index as usize] = false);
        }
    }
    let surplus = left.saturating_sub(*size.end());
    keep.iter_mut().rev().filter(|kept| **kept).take(surplus).for_each(|kept| *kept = false);
    map.retain(&keep);
    keep
}

fn set(map: &mut GaussianMap, index: usize, gaussian: Gaussian<f32>) {
    map.means[index] = gaussian.mean;
    map.log_scales[index] = gaussian.log_scale;
    map.rotations[index] = gaussian.rotation;
    map.opacity_logits[index] = gaussian.opacity_logit;
    map.colours[index] = gaussian.colour;
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_radiance::gaussian::{ColourActivation, Shape};

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

    #[test]
    fn what_looks_alike_is_merged_first() {
        let mut map = wall();
        let keep = merge(&mut map, SIDE * SIDE * 3 / 4..=SIDE * SIDE);
        assert!(map.len() <= SIDE * SIDE * 3 / 4 && map.len() > SIDE * SIDE / 2);
        assert_eq!(keep.iter().filter(|k| **k).count(), map.len());
        for (index, keep) in keep.iter().enumerate() {
            assert!(*keep || index % SIDE < SIDE / 2, "texture at {index} was merged");
        }
    }

    #[test]
    fn area_and_light_stay() {
        let whole = wall();
        let mut map = wall();
        merge(&mut map, SIDE * SIDE / 4..=SIDE * SIDE);
        assert!(map.len() <= SIDE * SIDE / 4);
        let area =
            |m: &GaussianMap| -> f32 { m.log_scales.iter().map(|s| (2.0 * s[0]).exp()).sum() };
        let ratio = area(&map) / area(&whole);
        assert!((0.6..1.1).contains(&ratio), "area times {ratio}");
        let light = |m: &GaussianMap| -> f32 {
            let each = m.colours.iter().zip(&m.log_scales);
            each.map(|(c, s)| c[0] * (2.0 * s[0]).exp()).sum::<f32>() / area(m)
        };
        assert!((light(&map) - light(&whole)).abs() < 0.1, "{} {}", light(&map), light(&whole));
    }

    #[test]
    fn of_scattered_ones_the_oldest_stay() {
        let mut map = wall();
        map.means.iter_mut().for_each(|mean| *mean = mean.map(|v| 100.0 * v));
        assert_eq!(merge(&mut map, 10..=SIDE * SIDE), vec![true; SIDE * SIDE]);
        let keep = merge(&mut map, 10..=100);
        assert!(keep.iter().enumerate().all(|(index, keep)| *keep == (index < 100)));
    }
}
