//! Semi-global aggregation of matching costs along straight paths (Hirschmüller 2008).

use super::plane_sweep::CostVolume;
use i2slam_geometry::Image;
use rayon::prelude::*;

/// Penalty of a change by one label, and of any larger change where the picture has no edge.
const STEP_PENALTY: f32 = 0.04;
const JUMP_PENALTY: f32 = 0.35;
/// Difference of brightness that halves the penalty of a jump.
const EDGE_CONTRAST: f32 = 0.04;

/// Number of path directions.
const PATHS: f32 = 8.0;
/// Column offsets of the paths from one row to the next.
const COLUMN_OFFSETS: [isize; 3] = [0, 1, -1];
/// Costs per task, at least.
const MIN_COSTS_PER_TASK: usize = 8192;

/// Mean over all paths of the least cost of a path that ends at a pixel with a label, less the
/// minimum over labels on the way.
///
/// Paths are computed row by row, so that no direction takes a volume of its own.
pub(super) fn aggregate_costs(volume: &CostVolume, guide: &Image<f32>) -> CostVolume {
    let rows = 0..guide.height;
    let (mut values, upward) = rayon::join(
        || aggregate_across_rows(volume, guide, rows.clone()),
        || aggregate_across_rows(volume, guide, rows.clone().rev()),
    );
    let row = guide.width * volume.labels;
    let sums = values.par_chunks_exact_mut(row).zip(upward.par_chunks_exact(row));
    sums.enumerate().for_each(|(row, (sums, upward))| {
        sums.iter_mut().zip(upward).for_each(|(sum, upward)| *sum += upward);
        aggregate_along_row(volume, guide, row, sums);
        sums.iter_mut().for_each(|sum| *sum /= PATHS);
    });
    CostVolume { values, labels: volume.labels }
}

/// Sum of the three paths into every pixel from the row before it in `rows`.
fn aggregate_across_rows(
    volume: &CostVolume,
    guide: &Image<f32>,
    rows: impl Iterator<Item = usize>,
) -> Vec<f32> {
    let (width, labels) = (guide.width, volume.labels);
    let mut sums = vec![0.0; volume.values.len()];
    // Costs of all paths of a column, one path after another.
    let column = COLUMN_OFFSETS.len() * labels;
    let (mut before, mut here) = (vec![0.0; width * column], vec![0.0; width * column]);
    let columns = MIN_COSTS_PER_TASK.div_ceil(column).max(1);
    let mut last_row = None;
    for row in rows {
        let sums = sums[row * width * labels..][..width * labels].par_chunks_mut(columns * labels);
        let tasks = here.par_chunks_mut(columns * column).zip(sums).enumerate();
        tasks.for_each(|(task, (here, sums))| {
            let each = here.chunks_exact_mut(column).zip(sums.chunks_exact_mut(labels));
            for (i, (costs, sums)) in each.enumerate() {
                let at = task * columns + i;
                let pixel = row * width + at;
                for (k, (from, costs)) in
                    COLUMN_OFFSETS.iter().zip(costs.chunks_exact_mut(labels)).enumerate()
                {
                    let x = at.checked_add_signed(*from).filter(|x| *x < width);
                    let last = last_row.zip(x).map(|(y, x): (usize, usize)| {
                        let jump = jump_penalty(guide, pixel, y * width + x);
                        (&before[x * column + k * labels..][..labels], jump)
                    });
                    advance_path(volume.costs_at(pixel), last, costs);
                    sums.iter_mut().zip(&*costs).for_each(|(sum, cost)| *sum += cost);
                }
            }
        });
        std::mem::swap(&mut before, &mut here);
        last_row = Some(row);
    }
    sums
}

/// Adds the two paths along a row.
fn aggregate_along_row(volume: &CostVolume, guide: &Image<f32>, row: usize, sums: &mut [f32]) {
    let (width, labels) = (guide.width, volume.labels);
    let (mut before, mut here) = (vec![0.0; labels], vec![0.0; labels]);
    let mut along = |columns: &mut dyn Iterator<Item = usize>| {
        let mut last_pixel = None;
        for column in columns {
            let pixel = row * width + column;
            let last = last_pixel.map(|last| (before.as_slice(), jump_penalty(guide, pixel, last)));
            advance_path(volume.costs_at(pixel), last, &mut here);
            let sums = &mut sums[column * labels..][..labels];
            sums.iter_mut().zip(&here).for_each(|(sum, cost)| *sum += cost);
            std::mem::swap(&mut before, &mut here);
            last_pixel = Some(pixel);
        }
    };
    along(&mut (0..width));
    along(&mut (0..width).rev());
}

/// Penalty of a jump between two pixels.
fn jump_penalty(guide: &Image<f32>, here: usize, there: usize) -> f32 {
    let edge = (guide.data[here] - guide.data[there]).abs();
    (JUMP_PENALTY / (1.0 + edge / EDGE_CONTRAST)).max(1.5 * STEP_PENALTY)
}

/// Costs of a path at a pixel, from those at the pixel before and the penalty of a jump.
fn advance_path(own: &[f32], last: Option<(&[f32], f32)>, costs: &mut [f32]) {
    costs.copy_from_slice(own);
    let Some((before, jump)) = last else { return };
    let least = before.iter().copied().fold(f32::INFINITY, f32::min);
    for (label, cost) in costs.iter_mut().enumerate() {
        let lower = if label > 0 { before[label - 1] } else { f32::INFINITY };
        let upper = before.get(label + 1).copied().unwrap_or(f32::INFINITY);
        let best = before[label].min(lower.min(upper) + STEP_PENALTY).min(least + jump);
        *cost += best - least;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::noise;

    /// One path, pixel by pixel.
    fn path(volume: &CostVolume, guide: &Image<f32>, (across, down): (isize, isize)) -> Vec<f32> {
        let (width, height, labels) = (guide.width, guide.height, volume.labels);
        let mut out = volume.values.clone();
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
                let before = out[there * labels..][..labels].to_vec();
                let jump = jump_penalty(guide, here, there);
                advance_path(
                    volume.costs_at(here),
                    Some((&before, jump)),
                    &mut out[here * labels..][..labels],
                );
            }
        }
        out
    }

    /// Rows at a time give the same as whole paths, to the rounding of eight sums.
    #[test]
    fn all_eight_paths_are_summed() {
        let (width, height, labels) = (23, 17, 5);
        let values: Vec<f32> =
            noise(1, width * height * labels).iter().map(|v| 0.5 + 0.5 * *v as f32).collect();
        let data = noise(2, width * height).iter().map(|v| 0.5 + 0.1 * *v as f32).collect();
        let guide = Image { width, height, channels: 1, data };
        let volume = CostVolume { values, labels };
        let steps = [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (1, -1), (-1, 1)];
        let paths = steps.map(|step| path(&volume, &guide, step));
        for (i, found) in aggregate_costs(&volume, &guide).values.iter().enumerate() {
            let due = paths.iter().map(|path| path[i]).sum::<f32>() / 8.0;
            assert!((found - due).abs() < 1e-6, "{i}: {found} {due}");
        }
    }

    /// Labels without support follow their surroundings, up to an edge of the picture.
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
        let volume = aggregate_costs(&CostVolume { values, labels }, &guide);
        for pixel in 0..width * height {
            let costs = volume.costs_at(pixel);
            let best = (0..labels).min_by(|a, b| costs[*a].total_cmp(&costs[*b]));
            let due = if pixel % width < 10 { 1 } else { 4 };
            assert_eq!(best, Some(due), "pixel {pixel}");
        }
    }
}
