//! Where one row of a virtual camera samples the fine grid.

use super::views::View;
use i2slam_geometry::Camera;

/// The samples of one row: indices and fractions, and the directions they came from.
#[derive(Clone, Debug, Default)]
pub(super) struct RowTaps {
    /// Upper left texel of each tap.
    pub(super) index: Vec<u32>,
    /// Fractions to the right and down.
    pub(super) across: Vec<f32>,
    pub(super) down: Vec<f32>,
    /// Normalised directions, see [`View::direction`].
    pub(super) a: Vec<f32>,
    pub(super) b: Vec<f32>,
    /// 2 (samples per pixel) where the tap moves with its position, 0 where it is held at an edge.
    pub(super) free_x: Vec<f32>,
    pub(super) free_y: Vec<f32>,
}

impl RowTaps {
    pub(super) fn resize(&mut self, width: usize) {
        self.index.resize(width, 0);
        for row in [
            &mut self.across,
            &mut self.down,
            &mut self.a,
            &mut self.b,
            &mut self.free_x,
            &mut self.free_y,
        ] {
            row.resize(width, 0.0);
        }
    }

    /// Fills the row at height `y` [px] of `view`, which sees the given inverse depths. Positions
    /// outside the image are held at its edge. Returns the first and last fine row touched.
    #[inline(always)]
    pub(super) fn fill(
        &mut self,
        camera: &Camera<f32>,
        view: &View<f32>,
        y: f32,
        inverse_depths: &[f32],
    ) -> (u32, u32) {
        let n = inverse_depths.len();
        let stride = 2 * camera.width as u32;
        let most_x = (2 * camera.width - 2) as f32;
        let most_y = (2 * camera.height - 2) as f32;
        let (index, across, down) =
            (&mut self.index[..n], &mut self.across[..n], &mut self.down[..n]);
        let (a, b) = (&mut self.a[..n], &mut self.b[..n]);
        let (free_x, free_y) = (&mut self.free_x[..n], &mut self.free_y[..n]);
        let (mut first, mut last) = (u32::MAX, 0);
        for i in 0..n {
            (a[i], b[i]) = view.direction(i as f32 + 0.5, y);
            let (x, y) = view.line(camera, (a[i], b[i])).at(inverse_depths[i]);
            let (x, y) = (2.0 * x - 1.0, 2.0 * y - 1.0);
            free_x[i] = if x >= 0.0 && x <= most_x { 2.0 } else { 0.0 };
            free_y[i] = if y >= 0.0 && y <= most_y { 2.0 } else { 0.0 };
            let (x, y) = (x.max(0.0).min(most_x), y.max(0.0).min(most_y));
            let (column, row) = (x as i32, y as i32);
            across[i] = x - column as f32;
            down[i] = y - row as f32;
            let row = row as u32;
            index[i] = row * stride + column as u32;
            first = first.min(row);
            last = last.max(row);
        }
        (first, last)
    }
}
