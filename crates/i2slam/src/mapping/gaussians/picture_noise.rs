//! Noise of a picture by channel and brightness.
//!
//! The noise of a sensor depends on the light, and a response stretches it in the dark and presses it
//! together near white: within one picture it varies by a factor of five. It is read off squares of two by
//! two pixels, in which an affine function leaves
//!
//! ```text
//! e = (a - b - c + d) / 2     of     a b
//!                                    c d
//! ```
//!
//! with the deviation of the noise. Squares are grouped by brightness, and the lower quartile of |e| tells
//! the noise of a group, because some of its squares show texture. Noise falls with brightness after a
//! response with the slope of a gamma curve: a group with more than a darker one shows texture nearly
//! everywhere, and takes the value of that one.

use i2slam_geometry::Image;

/// Groups of equally many squares, by brightness.
const GROUPS: usize = 16;
/// Ratio of the lower quartile of the absolute value of a normal variable to its standard deviation.
const QUARTILE_OVER_DEVIATION: f32 = 0.318_6;
/// Distance from black and white within which a value is clipped: one step of eight bits.
const CLIPPED: f32 = 1.0 / 255.0;
/// Entries of a table over values from 0 to 1.
const ENTRIES: usize = 256;

/// Standard deviation of the noise of each channel, by value.
pub(super) struct PictureNoise {
    tables: [[f32; ENTRIES]; 3],
}

impl PictureNoise {
    /// Of a picture of three channels, with values from 0 to 1.
    pub(super) fn new(picture: &Image<f32>) -> Self {
        let table = |c| interpolated(&noise_by_brightness(picture.plane(c), picture.width));
        Self { tables: std::array::from_fn(table) }
    }

    /// Standard deviation of a channel at a value.
    pub(super) fn deviation(&self, channel: usize, value: f32) -> f32 {
        let last = (ENTRIES - 1) as f32;
        self.tables[channel][(value * last).round().clamp(0.0, last) as usize]
    }
}

/// A value, and the standard deviation of the noise there.
type Knot = [f32; 2];

/// Noise of a channel at the middle of each group of squares, dark ones first.
fn noise_by_brightness(plane: &[f32], width: usize) -> Vec<Knot> {
    let mut squares = squares(plane, width);
    squares.sort_by(|a, b| a.mean.total_cmp(&b.mean));
    let mut least = f32::INFINITY;
    let knot = |group: &[Square]| {
        let mut rest: Vec<f32> = group.iter().map(|square| square.rest).collect();
        let (_, quartile, _) = rest.select_nth_unstable_by(group.len() / 4, f32::total_cmp);
        least = least.min(*quartile / QUARTILE_OVER_DEVIATION);
        [group[group.len() / 2].mean, least]
    };
    squares.chunks(squares.len().div_ceil(GROUPS).max(1)).map(knot).collect()
}

/// Two by two pixels.
struct Square {
    mean: f32,
    /// Magnitude of what is not affine.
    rest: f32,
}

/// The squares of a channel without a clipped pixel.
fn squares(plane: &[f32], width: usize) -> Vec<Square> {
    let square = |[above, below]: [&[f32]; 2]| {
        let pixels = [above[0], above[1], below[0], below[1]];
        let is_clipped = |value: &f32| *value <= CLIPPED || *value >= 1.0 - CLIPPED;
        let [a, b, c, d] = pixels;
        let found = Square { mean: 0.25 * (a + b + c + d), rest: 0.5 * (a - b - c + d).abs() };
        (!pixels.iter().any(is_clipped)).then_some(found)
    };
    let of_rows = |rows: &[f32]| -> Vec<Square> {
        let (above, below) = rows.split_at(width);
        let pairs = above.chunks_exact(2).zip(below.chunks_exact(2));
        pairs.filter_map(|(above, below)| square([above, below])).collect()
    };
    plane.chunks_exact(2 * width).flat_map(of_rows).collect()
}

/// The table through some knots, constant beyond the first and the last; zero without any.
fn interpolated(knots: &[Knot]) -> [f32; ENTRIES] {
    std::array::from_fn(|entry| {
        let value = entry as f32 / (ENTRIES - 1) as f32;
        let after = knots.partition_point(|[at, _]| *at <= value);
        let before = after.checked_sub(1).and_then(|place| knots.get(place));
        match (before, knots.get(after)) {
            (Some([a, from]), Some([b, to])) => from + (to - from) * (value - a) / (b - a),
            (Some([_, only]), None) | (None, Some([_, only])) => *only,
            (None, None) => 0.0,
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 128;

    /// A ramp from 0.1 to 0.9 downwards with such a deviation at a value, the same in all channels;
    /// chequered by 0.1 where that is asked for.
    fn picture(deviation: impl Fn(f32) -> f32, is_chequered: impl Fn(f32) -> bool) -> Image<f32> {
        let mut picture = Image::new(SIDE, SIDE, 3);
        let random = i2slam_check::noise(3, 3 * SIDE * SIDE);
        for (i, pixel) in picture.data.iter_mut().enumerate() {
            let (x, y) = (i % SIDE, i / SIDE % SIDE);
            let value = 0.1 + 0.8 * y as f32 / (SIDE - 1) as f32;
            let check = if is_chequered(value) && (x + y) % 2 == 0 { 0.1 } else { 0.0 };
            // Of deviation 1.
            let random = 3.0_f32.sqrt() * random[i] as f32;
            *pixel = value + deviation(value) * random + check;
        }
        picture
    }

    #[test]
    fn noise_follows_brightness() {
        let deviation = |value: f32| 0.03 - 0.025 * value;
        let noise = PictureNoise::new(&picture(deviation, |_| false));
        for value in [0.15, 0.3, 0.5, 0.7, 0.85] {
            for channel in 0..3 {
                let ratio = noise.deviation(channel, value) / deviation(value);
                assert!((ratio - 1.0).abs() < 0.2, "{channel} at {value}: {ratio}");
            }
        }
    }

    #[test]
    fn texture_brighter_than_something_plain_is_no_noise() {
        let noise = PictureNoise::new(&picture(|_| 0.004, |value| value > 0.5));
        assert!(noise.deviation(0, 0.7) < 0.006, "{}", noise.deviation(0, 0.7));
    }

    /// Black bars beside a noisy picture, as old films have, and a picture that shows nothing.
    #[test]
    fn clipped_pixels_tell_nothing() {
        let mut barred = picture(|_| 0.02, |_| false);
        for c in 0..3 {
            barred.plane_mut(c)[..SIDE * SIDE / 4].fill(0.0);
        }
        assert!(PictureNoise::new(&barred).deviation(1, 0.6) > 0.015);
        let white = Image { data: vec![1.0; 12], ..Image::new(2, 2, 3) };
        assert_eq!(PictureNoise::new(&white).deviation(2, 0.5), 0.0);
    }
}
