//! A guess of depth where the sensor has none, so that such places can have radiance too.
//!
//! A hole is mostly what lies behind an edge, or a surface that the sensor cannot see (sky,
//! windows, black objects): it takes the farthest of the nearest readings along its row and its
//! column, and a place behind everything where no reading is near. No depth is compared there.

use i2slam_geometry::Image;

/// A reading counts as near within this share of the image's width.
const REACH: f64 = 0.05;
/// Depth of places without any reading near, as a multiple of the largest reading.
const BEHIND: f32 = 1.25;

/// `depth` with every hole filled; all zero if there is no reading at all.
pub(crate) fn filled(depth: &Image<f32>) -> Image<f32> {
    let (width, height) = (depth.width, depth.height);
    let reach = ((width as f64 * REACH) as usize).max(1);
    let farthest = depth.data.iter().copied().fold(0.0, f32::max);
    let mut nearest = vec![0.0_f32; depth.data.len()];
    for row in 0..height {
        spread(&depth.data, &mut nearest, (0..width).map(|c| row * width + c), reach);
        spread(&depth.data, &mut nearest, (0..width).rev().map(|c| row * width + c), reach);
    }
    for column in 0..width {
        spread(&depth.data, &mut nearest, (0..height).map(|r| r * width + column), reach);
        spread(&depth.data, &mut nearest, (0..height).rev().map(|r| r * width + column), reach);
    }
    let mut out = depth.clone();
    for (d, &near) in out.data.iter_mut().zip(&nearest) {
        if *d <= 0.0 {
            *d = if near > 0.0 { near } else { BEHIND * farthest };
        }
    }
    out
}

/// Along one line, raises `nearest` to the last reading at most `reach` pixels back.
fn spread(depth: &[f32], nearest: &mut [f32], line: impl Iterator<Item = usize>, reach: usize) {
    let (mut last, mut age) = (0.0_f32, 0);
    for i in line {
        age += 1;
        if depth[i] > 0.0 {
            (last, age) = (depth[i], 0);
        } else if age <= reach {
            nearest[i] = nearest[i].max(last);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn holes_take_the_farther_side_and_empty_regions_lie_behind() {
        let mut depth = Image::new(100, 1, 1);
        depth.data[0] = 1.0;
        depth.data[4] = 2.0;
        let out = filled(&depth);
        assert_eq!(out.data[2], 2.0);
        assert_eq!(out.data[60], 2.5);
        assert_eq!(filled(&Image::new(4, 4, 1)).data, vec![0.0; 16]);
    }
}
