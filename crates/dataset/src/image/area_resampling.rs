//! Area-averaging resampling onto the grid of another camera with the same centre and orientation.

use i2slam_geometry::{Camera, Image};

/// Source pixels along one axis covered by a target pixel, with weights that add up to 1.
#[derive(Clone, Debug, PartialEq)]
struct PixelSpan {
    first: usize,
    weights: Vec<f32>,
    /// Whether the centre of the target pixel lies in the source.
    inside: bool,
}

/// Weights of a separable box filter as wide as a target pixel, or as a source pixel where that is
/// wider (linear interpolation).
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct AreaResampler {
    columns: Vec<PixelSpan>,
    rows: Vec<PixelSpan>,
}

impl AreaResampler {
    /// Maps images of `source` to those of `target`: `u_source = fx_source / fx_target (u_target - cx_target) + cx_source`, `v` alike.
    pub(crate) fn new(source: &Camera<f64>, target: &Camera<f64>) -> Self {
        let columns =
            spans((source.fx, source.cx, source.width), (target.fx, target.cx, target.width));
        let rows =
            spans((source.fy, source.cy, source.height), (target.fy, target.cy, target.height));
        Self { columns, rows }
    }

    /// Resamples an image; beyond the source its edge is repeated.
    pub(crate) fn apply(&self, source: &Image<f32>) -> Image<f32> {
        let mut out = Image::new(self.columns.len(), self.rows.len(), source.channels);
        let mut row_sums = vec![0.0; source.width];
        for channel in 0..source.channels {
            let plane = source.plane(channel);
            let target = out.plane_mut(channel).chunks_exact_mut(self.columns.len());
            for (target, row) in target.zip(&self.rows) {
                row_sums.fill(0.0);
                let lines = plane.chunks_exact(source.width).skip(row.first);
                for (line, weight) in lines.zip(&row.weights) {
                    for (sum, value) in row_sums.iter_mut().zip(line) {
                        *sum += weight * value;
                    }
                }
                for (value, span) in target.iter_mut().zip(&self.columns) {
                    let sums = row_sums[span.first..].iter().zip(&span.weights);
                    *value = sums.map(|(sum, weight)| sum * weight).sum();
                }
            }
        }
        out
    }

    /// 1 plane, true where the source covers the target pixel; `None` if it covers all.
    pub(crate) fn valid_mask(&self) -> Option<Image<bool>> {
        let all = self.rows.iter().chain(&self.columns).all(|span| span.inside);
        let row = |row: &PixelSpan| {
            let inside = row.inside;
            self.columns.iter().map(move |column| column.inside && inside)
        };
        (!all).then(|| Image {
            width: self.columns.len(),
            height: self.rows.len(),
            channels: 1,
            data: self.rows.iter().flat_map(row).collect(),
        })
    }

    /// The widest border of target pixels, over all four sides, with a pixel outside the source.
    pub(crate) fn uncovered_border(&self) -> usize {
        let leading = |spans: &[PixelSpan]| {
            let outside = |span: &&PixelSpan| !span.inside;
            let before = spans.iter().take_while(outside).count();
            before.max(spans.iter().rev().take_while(outside).count())
        };
        leading(&self.columns).max(leading(&self.rows))
    }
}

/// Spans along one axis; `(focal length, principal point, size)` of source and target [px].
fn spans(source: (f64, f64, usize), target: (f64, f64, usize)) -> Vec<PixelSpan> {
    let step = source.0 / target.0;
    let half = 0.5 * step.max(1.0);
    let centre = |i: usize| step * (i as f64 + 0.5 - target.1) + source.1;
    (0..target.2).map(|i| span(centre(i), half, source.2)).collect()
}

/// The pixels of `0..size` in `centre ± half`, moved to the edge where it lies beyond.
fn span(centre: f64, half: f64, size: usize) -> PixelSpan {
    let end = size as f64;
    let inside = (0.0..end).contains(&centre);
    let (from, to) = ((centre - half).max(0.0), (centre + half).min(end));
    if to <= from {
        let first = if centre < 0.0 { 0 } else { size - 1 };
        return PixelSpan { first, weights: vec![1.0], inside };
    }
    let (first, last) = (from as usize, (to.ceil() as usize).min(size));
    let share = |i: usize| (to.min(i as f64 + 1.0) - from.max(i as f64)).max(0.0) / (to - from);
    PixelSpan { first, weights: (first..last).map(|i| share(i) as f32).collect(), inside }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(width: usize, height: usize, f: f64) -> Camera<f64> {
        let (cx, cy) = (0.5 * width as f64, 0.5 * height as f64);
        Camera { width, height, fx: f, fy: f, cx, cy }
    }

    fn ramp(width: usize, height: usize) -> Image<f32> {
        let value = |i: usize| (i % width) as f32 + 10.0 * (i / width) as f32;
        let data = (0..width * height).map(value).collect();
        Image { width, height, channels: 1, data }
    }

    #[test]
    fn a_resized_camera_gives_the_average_over_areas() {
        let (source, picture) = (camera(25, 15, 20.0), ramp(25, 15));
        let map = AreaResampler::new(&source, &source.resized(10, 6));
        let (ours, due) = (map.apply(&picture), picture.resized_by_area(10, 6));
        for (a, b) in ours.data.iter().zip(&due.data) {
            assert!((a - b).abs() < 1e-4, "{a} {b}");
        }
        assert!(map.valid_mask().is_none());
        assert_eq!(map.uncovered_border(), 0);
    }

    #[test]
    fn magnification_interpolates_linearly() {
        let (source, target) = (camera(20, 16, 10.0), camera(10, 8, 12.5));
        let out = AreaResampler::new(&source, &target).apply(&ramp(20, 16));
        for column in 0..10 {
            let u = 0.8 * (column as f64 + 0.5 - 5.0) + 10.0;
            let due = u - 0.5 + 10.0 * (0.8 * (3.0 + 0.5 - 4.0) + 8.0 - 0.5);
            assert!((f64::from(out.at(0, column, 3)) - due).abs() < 1e-4);
        }
    }

    #[test]
    fn pixels_outside_the_source_are_marked() {
        let (source, target) = (camera(20, 16, 20.0), camera(20, 16, 16.0));
        let map = AreaResampler::new(&source, &target);
        let mask = map.valid_mask().expect("not all");
        let columns = (0..20).filter(|&c| mask.at(0, c, 8)).count();
        assert_eq!((columns, map.uncovered_border()), (16, 2));
        let out = map.apply(&ramp(20, 16));
        assert_eq!(out.at(0, 0, 8), out.at(0, 1, 8));
    }
}
