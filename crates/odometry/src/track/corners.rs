//! Corner detection (Shi and Tomasi 1994), at most one corner per cell of the picture.

use i2slam_geometry::Image;

/// Half the side of the window over which gradients are summed [px].
const WINDOW: usize = 3;
/// Smaller eigenvalue of a corner, as a ratio of the largest one in the picture.
const MIN_RELATIVE_STRENGTH: f32 = 0.002;
/// Smaller eigenvalue of a corner, per pixel of the window [brightness²/px²]; below it is noise.
const MIN_STRENGTH: f32 = 2e-5;

/// Detects corners: image positions of the strongest of every cell of `cell x cell` pixels, none in
/// a cell that holds a position of `taken`, none nearer than `border` to the edge.
pub(crate) fn detect_corners(
    image: &Image<f32>,
    cell: usize,
    border: usize,
    taken: &[[f32; 2]],
) -> Vec<[f32; 2]> {
    let strength = smaller_eigenvalues(image);
    let best = strength.data.iter().fold(0.0_f32, |m, v| m.max(*v));
    let least = (best * MIN_RELATIVE_STRENGTH).max(MIN_STRENGTH);
    let (columns, rows) = (image.width.div_ceil(cell), image.height.div_ceil(cell));
    let mut occupied = vec![false; columns * rows];
    for at in taken {
        let (c, r) = ((at[0].max(0.0) as usize) / cell, (at[1].max(0.0) as usize) / cell);
        if c < columns && r < rows {
            occupied[r * columns + c] = true;
        }
    }
    let mut found = Vec::new();
    for index in (0..columns * rows).filter(|i| !occupied[*i]) {
        let (c0, r0) = (index % columns * cell, index / columns * cell);
        if let Some(at) = strongest_corner(&strength, (c0, r0), cell, border, least) {
            let apart =
                |other: &[f32; 2]| (at[0] - other[0]).hypot(at[1] - other[1]) >= 0.6 * cell as f32;
            if taken.iter().chain(&found).all(apart) {
                found.push(at);
            }
        }
    }
    found
}

/// The strongest local maximum of a cell.
fn strongest_corner(
    strength: &Image<f32>,
    (c0, r0): (usize, usize),
    cell: usize,
    border: usize,
    least: f32,
) -> Option<[f32; 2]> {
    let (width, height) = (strength.width, strength.height);
    let border = border.max(1);
    let mut best = None;
    let mut most = least;
    for row in r0.max(border)..(r0 + cell).min(height.saturating_sub(border)) {
        for column in c0.max(border)..(c0 + cell).min(width.saturating_sub(border)) {
            let value = strength.data[row * width + column];
            if value > most && is_peak(strength, column, row) {
                (best, most) = (Some([column as f32 + 0.5, row as f32 + 0.5]), value);
            }
        }
    }
    best
}

fn is_peak(strength: &Image<f32>, column: usize, row: usize) -> bool {
    let value = strength.at(0, column, row);
    (row - 1..=row + 1).all(|r| (column - 1..=column + 1).all(|c| strength.at(0, c, r) <= value))
}

/// Smaller eigenvalue of the window mean of `∇I ∇Iᵀ` for every pixel.
fn smaller_eigenvalues(image: &Image<f32>) -> Image<f32> {
    let (w, h) = (image.width, image.height);
    let mut products = Image::new(w, h, 3);
    for row in 1..h.saturating_sub(1) {
        for column in 1..w.saturating_sub(1) {
            let i = row * w + column;
            let gx = 0.5 * (image.data[i + 1] - image.data[i - 1]);
            let gy = 0.5 * (image.data[i + w] - image.data[i - w]);
            for (channel, value) in [gx * gx, gx * gy, gy * gy].into_iter().enumerate() {
                products.data[channel * w * h + i] = value;
            }
        }
    }
    let sums: [Vec<f32>; 3] = std::array::from_fn(|c| box_means(products.plane(c), w, h));
    let mut out = Image::new(w, h, 1);
    for (i, value) in out.data.iter_mut().enumerate() {
        let [a, b, c] = [sums[0][i], sums[1][i], sums[2][i]];
        *value = 0.5 * (a + c) - (0.25 * (a - c) * (a - c) + b * b).sqrt();
    }
    out
}

/// Means over windows, cut at the border.
fn box_means(plane: &[f32], w: usize, h: usize) -> Vec<f32> {
    let norm = 1.0 / ((2 * WINDOW + 1) * (2 * WINDOW + 1)) as f32;
    let mut rows = vec![0.0; w * h];
    for r in 0..h {
        for c in 0..w {
            let (a, b) = (c.saturating_sub(WINDOW), (c + WINDOW + 1).min(w));
            rows[r * w + c] = plane[r * w + a..r * w + b].iter().sum();
        }
    }
    let mut out = vec![0.0; w * h];
    for r in 0..h {
        for k in r.saturating_sub(WINDOW)..(r + WINDOW + 1).min(h) {
            for c in 0..w {
                out[r * w + c] += norm * rows[k * w + c];
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square() -> Image<f32> {
        let inside = |column, row| (20..44).contains(&column) && (16..32).contains(&row);
        Image::from_fn(64, 48, 1, |_, column, row| f32::from(inside(column, row)))
    }

    #[test]
    fn the_corners_of_a_square_are_found_and_its_edges_are_not() {
        let found = detect_corners(&square(), 12, 4, &[]);
        assert_eq!(found.len(), 4, "{found:?}");
        for corner in [[20.0, 16.0], [44.0, 16.0], [20.0, 32.0], [44.0, 32.0]] {
            let near = |f: &[f32; 2]| (f[0] - corner[0]).hypot(f[1] - corner[1]) < 4.5;
            assert_eq!(found.iter().filter(|f| near(f)).count(), 1, "{corner:?}");
        }
    }

    #[test]
    fn a_cell_that_is_taken_stays_alone_and_a_flat_picture_has_none() {
        assert_eq!(detect_corners(&square(), 12, 4, &[[20.5, 16.5]]).len(), 3);
        assert!(detect_corners(&Image::new(64, 48, 1), 12, 4, &[]).is_empty());
    }
}
