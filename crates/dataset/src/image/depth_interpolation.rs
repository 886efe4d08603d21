//! Depth between the centres of recorded pixels: each of them is a piece of a plane.
//!
//! Inverse depth of a plane is linear in the picture. The slope of a pixel along rows, and along columns, is the
//! lesser one of those to its two neighbours, and none where these differ in sign or one was not recorded (the
//! limiter minmod; Roe 1986, *Characteristic-based schemes for the Euler equations*). So a pixel beside an edge
//! has the slope of its own surface, and no surface is invented between two. Estimated depth of other programs,
//! which is smooth and on a coarser grid, is interpolated bilinearly ([`import`](crate::import)).

use i2slam_geometry::Image;

/// Depth at an offset from the centre of a recorded pixel, up to half a pixel [px recorded]; 0 where nothing was
/// recorded.
pub(super) fn depth_near(depth: &Image<f32>, pixel: usize, [right, down]: [f32; 2]) -> f32 {
    let z = depth.data[pixel];
    if z == 0.0 {
        return 0.0;
    }
    let (column, row) = (pixel % depth.width, pixel / depth.width);
    let slope = |at: usize, count: usize, step: usize| {
        if at == 0 || at + 1 == count {
            return 0.0;
        }
        let (before, after) = (depth.data[pixel - step], depth.data[pixel + step]);
        if before == 0.0 || after == 0.0 {
            return 0.0;
        }
        minmod(z.recip() - before.recip(), after.recip() - z.recip())
    };
    let (by_column, by_row) =
        (slope(column, depth.width, 1), slope(row, depth.height, depth.width));
    (z.recip() + by_column * right + by_row * down).recip()
}

/// The lesser one of two slopes; 0 where they differ in sign.
fn minmod(a: f32, b: f32) -> f32 {
    if a * b <= 0.0 {
        0.0
    } else if a.abs() < b.abs() {
        a
    } else {
        b
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Depth from inverse depth.
    fn planes(inverse: impl Fn(f32, f32) -> f32) -> Image<f32> {
        let at = |i: usize| inverse((i % 40) as f32, (i / 40) as f32).recip();
        Image { width: 40, height: 30, channels: 1, data: (0..40 * 30).map(at).collect() }
    }

    #[test]
    fn a_plane_is_exact_between_pixels() {
        let inverse = |u: f32, v: f32| 0.4 + 0.01 * u - 0.005 * v;
        let depth = planes(inverse);
        for [right, down] in [[0.3, -0.4], [-0.5, 0.5], [0.0, 0.2]] {
            let found = depth_near(&depth, 12 * 40 + 17, [right, down]);
            assert!((found - inverse(17.0 + right, 12.0 + down).recip()).abs() < 1e-5);
        }
    }

    #[test]
    fn nothing_is_invented_between_two_surfaces() {
        let (near, far) = (|u: f32| 1.0 - 0.01 * u, |u: f32| 0.5 - 0.01 * u);
        let depth = planes(|u, _| if u < 20.0 { near(u) } else { far(u) });
        for (column, side) in [(19, near as fn(f32) -> f32), (20, far)] {
            for right in [-0.5, 0.0, 0.5] {
                let found = depth_near(&depth, 12 * 40 + column, [right, 0.0]);
                assert!((found - side(column as f32 + right).recip()).abs() < 1e-5, "{found}");
            }
        }
    }

    #[test]
    fn holes_stay_and_do_not_reach_their_neighbours() {
        let mut depth = planes(|u, _| 0.4 + 0.01 * u);
        depth.data[12 * 40 + 17] = 0.0;
        assert_eq!(depth_near(&depth, 12 * 40 + 17, [0.3, 0.3]), 0.0);
        let beside = 12 * 40 + 18;
        assert_eq!(depth_near(&depth, beside, [0.4, 0.0]), depth.data[beside]);
    }
}
