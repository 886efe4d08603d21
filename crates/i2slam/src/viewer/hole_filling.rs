//! Filling of what a map leaves open: small holes from their neighbours, large ones with a soft border.
//!
//! A render holds colour times opacity. Each level of a pyramid is the mean of 2 × 2 pixels of the
//! finer one, and shows through it where that is open (Porter and Duff's *over*), from the coarsest on:
//!
//! ```text
//! c ← c + (1 − o) c',   o ← o + (1 − o) o'
//! ```
//!
//! with `c'`, `o'` the coarser level, interpolated. Light thus reaches about [`REACH`] pixels into what
//! was never seen.

use i2slam_geometry::Image;
use i2slam_radiance::Render;

/// Width of the largest hole that is filled [px], a power of two.
const REACH: usize = 16;

/// One level: colour times opacity, and opacity; four planes.
type Level = Image<f32>;

/// Radiance of a render with its holes filled; pixels that are opaque stay as they are.
pub(super) fn filled(render: &Render) -> Image<f32> {
    let Render { radiance, opacity, .. } = render;
    let mut data = radiance.data.clone();
    data.extend_from_slice(&opacity.data);
    let mut levels = vec![Level { data, channels: 4, ..*radiance }];
    for _ in 0..REACH.ilog2() {
        levels.extend(levels.last().map(halved));
    }
    let filled = levels.into_iter().rev().reduce(|coarse, fine| over(fine, &coarse));
    let Some(mut filled) = filled else { return radiance.clone() };
    filled.data.truncate(radiance.data.len());
    Image { channels: 3, ..filled }
}

/// Means of 2 × 2 pixels.
fn halved(fine: &Level) -> Level {
    let (width, height) = (fine.width.div_ceil(2), fine.height.div_ceil(2));
    let mut coarse = Image::new(width, height, fine.channels);
    for channel in 0..fine.channels {
        let plane = coarse.plane_mut(channel);
        for (i, value) in fine.plane(channel).iter().enumerate() {
            plane[i / fine.width / 2 * width + i % fine.width / 2] += 0.25 * value;
        }
    }
    coarse
}

/// A level over the coarser one.
fn over(mut fine: Level, coarse: &Level) -> Level {
    for pixel in 0..fine.pixels() {
        let open = 1.0 - fine.plane(3)[pixel];
        if open <= 0.0 {
            continue;
        }
        let (left, right, u) = neighbours(pixel % fine.width, coarse.width);
        let (above, below, v) = neighbours(pixel / fine.width, coarse.height);
        for channel in 0..4 {
            let along = |row| {
                let value = |column| coarse.at(channel, column, row);
                (1.0 - u) * value(left) + u * value(right)
            };
            fine.plane_mut(channel)[pixel] += open * ((1.0 - v) * along(above) + v * along(below));
        }
    }
    fine
}

/// The two coarse pixels between whose centres that of a fine one lies, and the weight of the second.
fn neighbours(fine: usize, size: usize) -> (usize, usize, f32) {
    let at = (0.5 * fine as f32 - 0.25).clamp(0.0, (size - 1) as f32);
    (at as usize, (at as usize + 1).min(size - 1), at.fract())
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 96;

    /// A red wall with a hole of two pixels, and nothing on the right of column 48.
    fn wall() -> Render {
        let mut render = Render::new(SIDE, SIDE);
        for row in 0..SIDE {
            for column in 0..48 {
                let pixel = row * SIDE + column;
                if !(row == 40 && (20..22).contains(&column)) {
                    render.opacity.data[pixel] = 1.0;
                    render.radiance.plane_mut(0)[pixel] = 3.0;
                }
            }
        }
        render
    }

    #[test]
    fn small_holes_take_the_colour_of_their_neighbours() {
        let render = wall();
        let filled = filled(&render);
        let red = |column: usize, row: usize| filled.at(0, column, row);
        assert_eq!((red(10, 10), red(19, 40)), (3.0, 3.0));
        assert!((red(20, 40) - 3.0).abs() < 0.2, "{}", red(20, 40));
        assert!(filled.plane(1).iter().all(|g| *g == 0.0));
    }

    #[test]
    fn what_was_never_seen_begins_with_a_soft_border() {
        let filled = filled(&wall());
        let row: Vec<f32> = (48..SIDE).map(|column| filled.at(0, column, 70)).collect();
        assert_eq!(row[47], 0.0);
        // No step is larger than a third of the wall.
        assert!(row[0] > 2.0 && row.windows(2).all(|w| (w[0] - w[1]).abs() < 1.0), "{row:?}");
    }

    #[test]
    fn any_size_is_filled() {
        for (width, height) in [(1, 1), (1, 7), (5, 1), (17, 3)] {
            let mut render = Render::new(width, height);
            render.opacity.data[0] = 1.0;
            render.radiance.data[0] = 1.0;
            let filled = filled(&render);
            assert_eq!((filled.width, filled.height, filled.channels), (width, height, 3));
            assert!(filled.data.iter().all(|v| (0.0..=1.0).contains(v)));
        }
    }
}
