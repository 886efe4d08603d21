//! Shares of the picture that moving points take, and the frames over which they last.

use i2slam_compute::median;
use i2slam_geometry::Camera;

/// Cells of the picture, across and down.
pub(crate) const CELLS: [usize; 2] = [8, 6];
/// Points of a cell that is judged, at least.
const MIN_POINTS: usize = 3;
/// Frames on each side of a frame whose median share counts.
const MEDIAN_RADIUS: usize = 4;
/// Share of the picture from which a part counts: on sequences without moving objects the median
/// share over nine frames stays below half of it.
const MIN_SHARE: f64 = 0.1;
/// Frames for which it lasts, at least.
const MIN_FRAMES: usize = 10;

/// Share of the picture that moves on its own, over frames from `first` to `last`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct MovingPart {
    pub(crate) frames: [usize; 2],
    /// Median over the frames, in [0, 1].
    pub(crate) share: f64,
}

/// The cell of a position [px].
pub(crate) fn cell_of(camera: &Camera<f64>, at: [f64; 2]) -> usize {
    let size = [camera.width, camera.height];
    let [column, row] = [0, 1].map(|i| {
        let cell = at[i] / size[i] as f64 * CELLS[i] as f64;
        (cell.max(0.0) as usize).min(CELLS[i] - 1)
    });
    row * CELLS[0] + column
}

/// Share of the cells that the largest connected part takes in which most points move on their own:
/// an object is in one piece, errors of poses are scattered.
pub(crate) fn moving_share(
    camera: &Camera<f64>,
    points: impl Iterator<Item = ([f64; 2], bool)>,
) -> f64 {
    let mut cells = [(0, 0); CELLS[0] * CELLS[1]];
    for (at, is_moving) in points {
        let (points, moving) = &mut cells[cell_of(camera, at)];
        *points += 1;
        *moving += usize::from(is_moving);
    }
    let judged = cells.iter().filter(|(points, _)| *points >= MIN_POINTS).count();
    let moves = |(points, moving): &(usize, usize)| *points >= MIN_POINTS && 2 * moving > *points;
    let moving: Vec<bool> = cells.iter().map(moves).collect();
    largest_part(&moving) as f64 / judged.max(1) as f64
}

/// Number of cells of the largest part that is connected across sides.
fn largest_part(cells: &[bool]) -> usize {
    let mut left = cells.to_vec();
    let mut largest = 0;
    for start in 0..left.len() {
        let (mut open, mut size) = (vec![start], 0);
        while let Some(cell) = open.pop() {
            if !std::mem::take(&mut left[cell]) {
                continue;
            }
            size += 1;
            let (column, row) = (cell % CELLS[0], cell / CELLS[0]);
            open.extend((column > 0).then(|| cell - 1));
            open.extend((column + 1 < CELLS[0]).then_some(cell + 1));
            open.extend((row > 0).then(|| cell - CELLS[0]));
            open.extend((row + 1 < CELLS[1]).then_some(cell + CELLS[0]));
        }
        largest = largest.max(size);
    }
    largest
}

/// Runs of frames around which the median share is large.
pub(crate) fn persistent_parts(shares: &[(usize, f64)]) -> Vec<MovingPart> {
    let around = |place: usize| {
        let end = (place + MEDIAN_RADIUS + 1).min(shares.len());
        let mut near: Vec<f64> = shares[place.saturating_sub(MEDIAN_RADIUS)..end]
            .iter()
            .map(|(_, share)| *share)
            .collect();
        median(&mut near).unwrap_or(0.0)
    };
    let smooth: Vec<(usize, f64)> =
        shares.iter().enumerate().map(|(place, (frame, _))| (*frame, around(place))).collect();
    let runs = smooth.chunk_by(|a, b| (a.1 >= MIN_SHARE) == (b.1 >= MIN_SHARE));
    let part = |run: &[(usize, f64)]| {
        let mut shares: Vec<f64> = run.iter().map(|(_, share)| *share).collect();
        let frames = [run[0].0, run[run.len() - 1].0];
        MovingPart { frames, share: median(&mut shares).unwrap_or(0.0) }
    };
    runs.filter(|run| run[0].1 >= MIN_SHARE && run.len() >= MIN_FRAMES).map(part).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_largest_part_is_connected_across_sides() {
        let cells = |set: &[usize]| (0..48).map(|i| set.contains(&i)).collect::<Vec<_>>();
        assert_eq!(largest_part(&cells(&[])), 0);
        // Cells 7 and 8 are neighbours in the list alone, 0 and 9 across a corner.
        assert_eq!(largest_part(&cells(&[0, 9, 7, 8])), 3);
        assert_eq!(largest_part(&cells(&[10, 11, 19, 27, 26, 40])), 5);
    }

    #[test]
    fn what_lasts_is_told_and_what_flickers_is_not() {
        let found = |share: fn(usize) -> f64| {
            persistent_parts(&(0..60).map(|i| (2 * i, share(i))).collect::<Vec<_>>())
        };
        let lasting = |i: usize| if (20..40).contains(&i) { 0.25 } else { 0.03 };
        let parts = found(lasting);
        assert_eq!(parts, [MovingPart { frames: [40, 78], share: 0.25 }]);
        assert_eq!(found(|i| if i % 4 == 0 { 0.3 } else { 0.04 }), []);
        assert_eq!(found(|i| if (20..24).contains(&i) { 0.3 } else { 0.04 }), []);
        assert_eq!(persistent_parts(&[]), []);
    }
}
