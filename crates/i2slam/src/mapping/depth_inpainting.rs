//! Inpainting of missing depth, so that every pixel can add to the map. Inpainted depth is never
//! compared with the map.
//!
//! A hole in measured depth mostly lies behind an edge or on a surface that the sensor cannot see
//! (sky, windows, black objects): it takes the farthest of the nearest readings along its row and
//! column, or lies behind everything where no reading is near.
//!
//! Estimated depth is also missing in large parts, on smooth surfaces or after pure rotation: far
//! from any reading it is interpolated smoothly.

use crate::objective::Observation;
use i2slam_geometry::Image;
use i2slam_radiance::Render;
use std::sync::Arc;

/// Distance within which a reading counts as near, as a share of the image's width.
const MAX_GAP: f64 = 0.05;
/// Depth far from any reading, as a multiple of the largest reading.
const BACKGROUND_DEPTH: f32 = 1.25;

/// Least rendered opacity of a pixel at which the map has a surface.
pub(crate) const MIN_SURFACE_OPACITY: f32 = 0.9;

/// Depth at which a frame extends the map [m]: observed, inpainted if `is_filled` (for estimated depth
/// from the surfaces in `render` first), and 0 where nothing was recorded.
pub(super) fn placement_depth(
    observation: &Observation,
    is_filled: bool,
    valid_mask: Option<&Image<bool>>,
    render: Option<&Render>,
) -> Arc<Image<f32>> {
    let mut depth = match (is_filled, observation.is_estimated()) {
        (true, true) => {
            let surfaces = render.map(|r| r.surface(MIN_SURFACE_OPACITY));
            Arc::new(inpaint_estimated(&observation.depth, surfaces.as_ref()))
        }
        (true, false) => Arc::new(inpaint_measured(&observation.depth)),
        (false, _) => Arc::clone(&observation.depth),
    };
    if let Some(valid_mask) = valid_mask {
        let values = Arc::make_mut(&mut depth).data.iter_mut().zip(&valid_mask.data);
        values.filter(|(_, c)| !**c).for_each(|(d, _)| *d = 0.0);
    }
    depth
}

/// Fills all holes of measured depth; all zero without any reading.
fn inpaint_measured(depth: &Image<f32>) -> Image<f32> {
    let farthest = depth.data.iter().copied().fold(0.0, f32::max);
    let mut out = depth.clone();
    for (d, near) in out.data.iter_mut().zip(nearest_readings(depth)) {
        if *d <= 0.0 {
            *d = if near > 0.0 { near } else { BACKGROUND_DEPTH * farthest };
        }
    }
    out
}

/// The farthest of the nearest readings along rows and columns, 0 where none is near.
fn nearest_readings(depth: &Image<f32>) -> Vec<f32> {
    let (width, height) = (depth.width, depth.height);
    let reach = ((width as f64 * MAX_GAP) as usize).max(1);
    let mut nearest = vec![0.0_f32; depth.data.len()];
    for row in 0..height {
        propagate(&depth.data, &mut nearest, (0..width).map(|c| row * width + c), reach);
        propagate(&depth.data, &mut nearest, (0..width).rev().map(|c| row * width + c), reach);
    }
    for column in 0..width {
        propagate(&depth.data, &mut nearest, (0..height).map(|r| r * width + column), reach);
        propagate(&depth.data, &mut nearest, (0..height).rev().map(|r| r * width + column), reach);
    }
    nearest
}

/// Along one line, raises `nearest` to the last reading at most `reach` pixels back.
fn propagate(depth: &[f32], nearest: &mut [f32], line: impl Iterator<Item = usize>, reach: usize) {
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

/// Fills all holes of estimated depth: from near readings, rendered `surfaces`, then smoothly.
pub(super) fn inpaint_estimated(depth: &Image<f32>, surfaces: Option<&Image<f32>>) -> Image<f32> {
    let mut known = depth.clone();
    for (pixel, near) in nearest_readings(depth).into_iter().enumerate() {
        if known.data[pixel] <= 0.0 {
            let surface = || surfaces.map_or(0.0, |s| s.data[pixel]);
            known.data[pixel] = if near > 0.0 { near } else { surface() };
        }
    }
    inpaint_smoothly(&known)
}

/// Fills all holes by pull-push interpolation of inverse depth; all zero without any depth.
fn inpaint_smoothly(depth: &Image<f32>) -> Image<f32> {
    let inverse = |d: &f32| if *d > 0.0 { (1.0 / d, 1.0) } else { (0.0, 0.0) };
    let (values, weights) = depth.data.iter().map(inverse).unzip();
    let mut levels = vec![Level { width: depth.width, height: depth.height, values, weights }];
    while let Some(last) = levels.last().filter(|l| l.width > 1 || l.height > 1) {
        levels.push(last.halved());
    }
    let coarse_to_fine = levels.into_iter().rev().reduce(|coarse, mut fine| {
        fine.complete_from(&coarse);
        fine
    });
    let values = coarse_to_fine.map_or_else(Vec::new, |full| full.values);
    let mut out = depth.clone();
    let holes = out.data.iter_mut().zip(&values).filter(|(d, v)| **d <= 0.0 && **v > 0.0);
    holes.for_each(|(d, value)| *d = 1.0 / value);
    out
}

/// One pyramid level: values and their confidences in [0, 1].
struct Level {
    width: usize,
    height: usize,
    values: Vec<f32>,
    weights: Vec<f32>,
}

impl Level {
    /// Half the size: weighted means of 2 × 2 values.
    fn halved(&self) -> Self {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let (mut values, mut weights) = (vec![0.0; width * height], vec![0.0; width * height]);
        for (i, (value, weight)) in self.values.iter().zip(&self.weights).enumerate() {
            let to = i / self.width / 2 * width + i % self.width / 2;
            values[to] += value * weight;
            weights[to] += weight;
        }
        for (value, weight) in values.iter_mut().zip(&mut weights) {
            *value /= weight.max(1.0e-6);
            *weight = weight.min(1.0);
        }
        Self { width, height, values, weights }
    }

    /// Completes uncertain values by bilinear interpolation of the coarser level.
    fn complete_from(&mut self, coarse: &Self) {
        let (last_column, last_row) = (coarse.width - 1, coarse.height - 1);
        for (i, (value, weight)) in self.values.iter_mut().zip(&mut self.weights).enumerate() {
            if *weight >= 1.0 {
                continue;
            }
            let place = |at: usize, last: usize| {
                let x = (0.5 * at as f32 - 0.25).clamp(0.0, last as f32);
                (x as usize, (x as usize + 1).min(last), x.fract())
            };
            let (left, right, u) = place(i % self.width, last_column);
            let (above, below, v) = place(i / self.width, last_row);
            let row = |row: usize| {
                let at = |column: usize| coarse.values[row * coarse.width + column];
                at(left) * (1.0 - u) + at(right) * u
            };
            let guess = row(above) * (1.0 - v) + row(below) * v;
            *value = *value * *weight + guess * (1.0 - *weight);
            *weight = 1.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn estimated_depth_is_inpainted_smoothly() {
        let mut depth = Image::new(40, 30, 1);
        for (pixel, column) in [(5 * 40 + 2, 2), (20 * 40 + 3, 3), (9 * 40 + 37, 37)] {
            depth.data[pixel] = if column < 20 { 1.0 } else { 4.0 };
        }
        let out = inpaint_smoothly(&depth);
        assert!(out.data.iter().all(|d| (1.0..=4.0).contains(d)));
        assert!(out.data[20 * 40 + 3] == 1.0 && out.data[9 * 40 + 37] == 4.0);
        let row = &out.data[12 * 40..13 * 40];
        assert!(row[1] < 1.3 && row[38] > 2.0 && row[20] > row[4] && row[20] < row[36], "{row:?}");
        assert_eq!(inpaint_smoothly(&Image::new(5, 4, 1)).data, vec![0.0; 20]);
    }

    #[test]
    fn holes_take_the_farther_side_and_empty_regions_the_background() {
        let mut depth = Image::new(100, 1, 1);
        depth.data[0] = 1.0;
        depth.data[4] = 2.0;
        let out = inpaint_measured(&depth);
        assert_eq!(out.data[2], 2.0);
        assert_eq!(out.data[60], 2.5);
        assert_eq!(inpaint_measured(&Image::new(4, 4, 1)).data, vec![0.0; 16]);
    }
}
