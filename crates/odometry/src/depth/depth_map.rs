//! Depth pictures as they are kept, and their readings between pixels.

use i2slam_geometry::Image;

/// Largest step between neighbouring readings of one surface, over the smaller of them.
const MAX_SURFACE_STEP: f32 = 0.05;
/// Longer side up to which depth pictures are kept whole [px].
const MAX_SIDE: usize = 480;

/// A depth picture of the size of its colour picture.
#[derive(Clone, Copy, Debug)]
pub struct DepthPicture<'a> {
    /// Depth along the optical axis [m], one plane; 0 where there is no reading.
    pub depth: &'a Image<f32>,
    /// Timestamp [s].
    pub timestamp: f64,
}

/// Inverse depths of a frame.
#[derive(Clone, Debug)]
pub(crate) struct DepthMap {
    /// Inverse depth [1/m], 0 where there is no reading.
    inverse: Image<f32>,
    /// Pixels of the picture from one reading to the next.
    step: usize,
    /// [s]
    pub(crate) timestamp: f64,
}

impl DepthMap {
    /// Keeps every reading, or of a large picture every second or third: no average over edges.
    pub(crate) fn new(picture: &DepthPicture<'_>) -> Self {
        let depth = picture.depth;
        let step = depth.width.max(depth.height).div_ceil(MAX_SIDE).max(1);
        let inverse =
            Image::from_fn(depth.width / step, depth.height / step, 1, |_, column, row| {
                let z = depth.at(0, step * column + step / 2, step * row + step / 2);
                if z > 0.0 && z.is_finite() { z.recip() } else { 0.0 }
            });
        Self { inverse, step, timestamp: picture.timestamp }
    }

    /// Inverse depth at a position of the picture [px], interpolated between four readings of one
    /// surface; `None` without.
    pub(crate) fn inverse_at(&self, at: [f64; 2]) -> Option<f64> {
        let (step, half) = (self.step as f64, (self.step / 2) as f64 + 0.5);
        let [x, y] = at.map(|v| (v - half) / step);
        let inside = x >= 0.0 && y >= 0.0;
        let (column, row) = (x.floor() as usize, y.floor() as usize);
        if !inside || column + 1 >= self.inverse.width || row + 1 >= self.inverse.height {
            return None;
        }
        let reading = |c: usize, r: usize| self.inverse.at(0, column + c, row + r);
        let all = [reading(0, 0), reading(1, 0), reading(0, 1), reading(1, 1)];
        let (least, most) =
            all.iter().fold((f32::INFINITY, 0.0_f32), |(a, b), v| (a.min(*v), b.max(*v)));
        if least <= 0.0 || most - least > MAX_SURFACE_STEP * least {
            return None;
        }
        let (u, v) = (x - x.floor(), y - y.floor());
        let [a, b, c, d] = all.map(f64::from);
        Some((1.0 - v) * ((1.0 - u) * a + u * b) + v * ((1.0 - u) * c + u * d))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Inverse depth is linear in the picture on a plane: interpolation is exact, at any size.
    #[test]
    fn a_plane_is_read_exactly_and_an_edge_not_at_all() {
        for width in [320_usize, 640, 1280] {
            let plane = |u: f64, v: f64| 0.4 + 1e-4 * u - 2e-4 * v;
            let depth = Image::from_fn(width, 240, 1, |_, c, r| {
                let near = if c >= 200 { 3.0 } else { 1.0 };
                (1.0 / (near * plane(c as f64 + 0.5, r as f64 + 0.5))) as f32
            });
            let map = DepthMap::new(&DepthPicture { depth: &depth, timestamp: 0.0 });
            let found = map.inverse_at([50.3, 70.9]).expect("a surface");
            assert!((found - plane(50.3, 70.9)).abs() < 1e-6, "{width}: {found}");
            assert_eq!(map.inverse_at([200.0, 70.9]), None);
            assert_eq!(map.inverse_at([-1.0, 3.0]), None);
            assert_eq!(map.inverse_at([width as f64, 3.0]), None);
        }
    }
}
