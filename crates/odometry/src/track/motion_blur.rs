//! Motion blur in tracking: of two pictures of a point, the sharper is blurred like the other.
//!
//! A sharp patch matches a smear of itself anywhere between its ends, and the apparent middle of a
//! smeared edge moves with its contrast. Seen with equal blur both are found in the middle of the
//! exposure. A picture that moves by `m` per frame interval is blurred by a box of length `s m`,
//! with the share `s` of the interval in which the shutter is open. Boxes of lengths `a < b` along
//! one direction differ by about one of length `√(b² - a²)`, whose variance is the difference.
//!
//! The share is read off the pictures: of [`SHARES`], that with which anchors correlate best.

use crate::track::pyramid::Pyramid;
use i2slam_geometry::Image;
use rayon::prelude::*;

/// Open shares of the frame interval that are compared.
pub(crate) const SHARES: [f32; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];
/// Length of a box below which pictures count as equally sharp [px].
const MIN_LENGTH: f32 = 2.0;
/// Share of what earlier frames told about the shutter that is kept per frame: exposure drifts.
const MEMORY: f64 = 0.9;
/// Two pictures brought to equal blur.
#[derive(Clone, Debug)]
pub(crate) enum EqualBlur {
    /// They are equally sharp already.
    AsTheyAre,
    /// The first one, blurred.
    First(Pyramid),
    /// The second one, blurred.
    Second(Pyramid),
}

impl EqualBlur {
    /// Blurs the sharper of two pictures, each given with the vector of its blur [px].
    pub(crate) fn new(first: (&Pyramid, [f32; 2]), second: (&Pyramid, [f32; 2])) -> Self {
        let [before, after] = [first.1, second.1].map(|[x, y]| x.hypot(y));
        let length = (after * after - before * before).abs().sqrt();
        if length < MIN_LENGTH {
            return Self::AsTheyAre;
        }
        match after > before {
            true => Self::First(blurred(first.0, second.1.map(|v| v * length / after))),
            false => Self::Second(blurred(second.0, first.1.map(|v| v * length / before))),
        }
    }
}

/// Share of the frame interval in which the shutter is open, from correlations.
#[derive(Clone, Debug, Default)]
pub(crate) struct ShutterShare {
    /// Gain in correlation with each of [`SHARES`] over that with the first.
    gains: [f64; SHARES.len()],
}

impl ShutterShare {
    /// Adds the mean correlations of one frame's points with each of [`SHARES`].
    pub(crate) fn add(&mut self, correlations: [f64; SHARES.len()]) {
        for (gain, correlation) in self.gains.iter_mut().zip(correlations) {
            *gain = MEMORY * *gain + correlation - correlations[0];
        }
    }

    /// The most likely share: the vertex of a parabola through the largest gain and its neighbours.
    pub(crate) fn value(&self) -> f32 {
        let most = self.gains.iter().fold(f64::NEG_INFINITY, |most, gain| most.max(*gain));
        let best = self.gains.iter().position(|gain| *gain >= most).unwrap_or(0);
        if best == 0 || best + 1 == SHARES.len() {
            return SHARES[best];
        }
        let [left, middle, right] = [best - 1, best, best + 1].map(|i| self.gains[i]);
        let bend = left - 2.0 * middle + right;
        let off = if bend < 0.0 { 0.5 * (left - right) / bend } else { 0.0 };
        SHARES[best] + off as f32 * (SHARES[1] - SHARES[0])
    }
}

/// A picture averaged in linear light over a movement by `by` [px] around where it is. The camera's
/// response is not known here: light is taken to be the square of picture values, about as sRGB
/// encodes it.
fn blurred(pyramid: &Pyramid, by: [f32; 2]) -> Pyramid {
    let image = pyramid.finest();
    let taps = by[0].hypot(by[1]).ceil().max(2.0) as usize;
    let margin = taps / 2 + 2;
    let padded = padded_linear(image, margin);
    let width = image.width + 2 * margin;
    let mut out = Image::<f32>::new(image.width, image.height, 1);
    out.data.par_chunks_mut(image.width).enumerate().for_each(|(row, line)| {
        for tap in 0..taps {
            let share = (tap as f32 + 0.5) / taps as f32 - 0.5;
            let [x, y] = by.map(|v| share * v + margin as f32);
            let (u, v) = (x.fract(), y.fract());
            let upper = &padded[(row + y as usize) * width + x as usize..];
            let lower = &upper[width..];
            let weights = [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v]
                .map(|weight| weight / taps as f32);
            for (i, sum) in line.iter_mut().enumerate() {
                *sum += weights[0] * upper[i]
                    + weights[1] * upper[i + 1]
                    + weights[2] * lower[i]
                    + weights[3] * lower[i + 1];
            }
        }
        line.iter_mut().for_each(|value| *value = value.sqrt());
    });
    Pyramid::new(&out)
}

/// Linear values of a picture with its border repeated over a margin.
fn padded_linear(image: &Image<f32>, margin: usize) -> Vec<f32> {
    let inside = |i: usize, size: usize| i.saturating_sub(margin).min(size - 1);
    let (width, height) = (image.width + 2 * margin, image.height + 2 * margin);
    let mut out = vec![0.0; width * height];
    out.par_chunks_mut(width).enumerate().for_each(|(row, line)| {
        let from = &image.data[inside(row, image.height) * image.width..][..image.width];
        let linear: Vec<f32> = from.iter().map(|value| value * value).collect();
        for (column, value) in line.iter_mut().enumerate() {
            *value = linear[inside(column, image.width)];
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::track::patch::AffineWarp;
    use crate::track::point_search::AnchorPatch;
    use i2slam_check::noise;

    /// Bright and dark spots, averaged in linear light over a movement by `by` around (`x`, 0).
    fn spots(x: f32, by: f32) -> Pyramid {
        let n = noise(5, 3 * 120);
        let value = |column: f32, row: f32| -> f32 {
            let spot = |s: &[f64]| {
                let (dx, dy) =
                    (column - 60.0 - 70.0 * s[0] as f32, row - 40.0 - 45.0 * s[1] as f32);
                s[2] as f32 * (-(dx * dx + dy * dy) / 5.0).exp()
            };
            0.3 + 0.28 * n.chunks_exact(3).map(spot).sum::<f32>()
        };
        let taps = 24;
        Pyramid::new(&Image::from_fn(120, 80, 1, |_, column, row| {
            let at = |tap: usize| x + by * ((tap as f32 + 0.5) / taps as f32 - 0.5);
            let light = |tap: usize| value(column as f32 - at(tap), row as f32).max(0.0).powi(2);
            ((0..taps).map(light).sum::<f32>() / taps as f32).sqrt()
        }))
    }

    /// Root mean square error of points of the first picture in the second, which has moved by 3 px.
    fn error(first: &Pyramid, second: &Pyramid) -> f32 {
        let points = [[30.0, 30.0], [45.0, 50.0], [60.0, 25.0], [75.0, 45.0], [85.0, 35.0]];
        let square = |at: [f32; 2]| {
            let anchor = AnchorPatch::new(first, at).expect("textured");
            let start = AffineWarp::translation([at[0] + 3.0, at[1]]);
            let found = anchor.align(second, start, 1);
            let off = |c: [f32; 2]| (c[0] - at[0] - 3.0).powi(2) + (c[1] - at[1]).powi(2);
            found.map_or(25.0, |found| off(found.warp.centre))
        };
        (points.map(square).iter().sum::<f32>() / points.len() as f32).sqrt()
    }

    #[test]
    fn a_blurred_point_is_found_in_the_middle_of_the_exposure() {
        // Two boxes differ by a box only roughly.
        for (first, second, most) in [(0.0, 10.0, 0.15), (10.0, 0.0, 0.15), (6.0, 12.0, 0.6)] {
            let (a, b) = (spots(0.0, first), spots(3.0, second));
            let equal = EqualBlur::new((&a, [first, 0.0]), (&b, [second, 0.0]));
            let found = match &equal {
                EqualBlur::First(a) => error(a, &b),
                EqualBlur::Second(b) => error(&a, b),
                EqualBlur::AsTheyAre => f32::INFINITY,
            };
            let unequal = error(&a, &b);
            assert!(found < most && found < 0.3 * unequal, "{first} {second}: {found} {unequal}");
        }
    }

    #[test]
    fn the_share_is_where_correlation_is_largest() {
        let mut shutter = ShutterShare::default();
        assert_eq!(shutter.value(), 0.0);
        for _ in 0..3 {
            shutter.add(SHARES.map(|s| 0.9 - f64::from((s - 0.6) * (s - 0.6))));
        }
        assert!((shutter.value() - 0.6).abs() < 1e-5, "{}", shutter.value());
        for _ in 0..40 {
            shutter.add(SHARES.map(|s| 0.9 - 0.1 * f64::from(s)));
        }
        assert_eq!(shutter.value(), 0.0);
    }
}
