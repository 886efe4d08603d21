//! Semi-global aggregation: costs along straight paths from all sides, with a price on changes of the
//! label (Hirschmüller 2008).

use super::sweep::Volume;
use i2slam_geometry::Image;
use rayon::prelude::*;

/// Price of a change by one label, and of any larger one where the picture has no edge.
const STEP: f32 = 0.04;
const JUMP: f32 = 0.35;
/// Difference of brightness that halves the price of a jump.
const EDGE: f32 = 0.04;

/// Directions of paths (columns, rows).
const PATHS: [(isize, isize); 8] =
    [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (1, -1), (-1, 1)];

/// Mean over all paths of the least cost of a path that ends at a pixel with a label, less the least
/// of all labels on the way.
pub(super) fn aggregated(volume: &Volume, guide: &Image<f32>) -> Volume {
    let paths: Vec<Vec<f32>> = PATHS.par_iter().map(|step| path(volume, guide, *step)).collect();
    let mut values = vec![0.0; volume.values.len()];
    for costs in &paths {
        values.iter_mut().zip(costs).for_each(|(sum, cost)| *sum += cost / PATHS.len() as f32);
    }
    Volume { values, labels: volume.labels }
}

fn path(volume: &Volume, guide: &Image<f32>, (across, down): (isize, isize)) -> Vec<f32> {
    let (width, height, labels) = (guide.width, guide.height, volume.labels);
    let mut out = volume.values.clone();
    let mut before = vec![0.0; labels];
    for r in 0..height {
        let row = if down < 0 { height - 1 - r } else { r };
        for c in 0..width {
            let column = if across < 0 { width - 1 - c } else { c };
            let last = (column.checked_add_signed(-across), row.checked_add_signed(-down));
            let (Some(x), Some(y)) = last else { continue };
            if x >= width || y >= height {
                continue;
            }
            let (here, there) = (row * width + column, y * width + x);
            let edge = (guide.data[here] - guide.data[there]).abs();
            let jump = (JUMP / (1.0 + edge / EDGE)).max(1.5 * STEP);
            before.copy_from_slice(&out[there * labels..(there + 1) * labels]);
            let least = before.iter().copied().fold(f32::INFINITY, f32::min);
            let costs = &mut out[here * labels..(here + 1) * labels];
            for (label, cost) in costs.iter_mut().enumerate() {
                let lower = if label > 0 { before[label - 1] } else { f32::INFINITY };
                let upper = before.get(label + 1).copied().unwrap_or(f32::INFINITY);
                let best = before[label].min(lower.min(upper) + STEP).min(least + jump);
                *cost += best - least;
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Labels without support take those of their surroundings, up to an edge of the picture.
    #[test]
    fn flat_regions_are_filled_from_their_sides() {
        let (width, height, labels) = (20, 12, 6);
        let mut guide = Image::new(width, height, 1);
        let mut values = vec![0.5; width * height * labels];
        for pixel in 0..width * height {
            let column = pixel % width;
            let label = if column < 10 { 1 } else { 4 };
            guide.data[pixel] = if column < 10 { 0.2 } else { 0.8 };
            if !(6..14).contains(&column) {
                values[pixel * labels + label] = 0.0;
            }
        }
        let volume = aggregated(&Volume { values, labels }, &guide);
        for pixel in 0..width * height {
            let costs = volume.of(pixel);
            let best = (0..labels).min_by(|a, b| costs[*a].total_cmp(&costs[*b]));
            let due = if pixel % width < 10 { 1 } else { 4 };
            assert_eq!(best, Some(due), "pixel {pixel}");
        }
    }
}
