//! Faults of depth sensors on a depth picture.

use super::refuse;
use crate::depth_noise::KinectNoise;
use crate::error::SyntheticError;
use crate::rng::{between, stream};
use i2slam_geometry::Image;

/// Purpose number of the random stream of outliers.
const OUTLIERS: u64 = 51;
/// An outlier is off by a factor between these, or by one over it.
const OUTLIER_FACTOR: [f64; 2] = [1.1, 2.0];
/// Half width of the smoothing kernel in standard deviations.
const KERNEL_REACH: f64 = 3.0;

/// Faults of depth, applied in the order of the fields.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthDegradation {
    /// Time by which the stamps of depth are after the moment that it shows [s]; negative: before.
    pub delay: f64,
    /// Noise, steps and holes.
    pub noise: Option<KinectNoise>,
    /// Side of the blocks of pixels that share one reading, the one at their middle [px].
    pub block: usize,
    /// Standard deviation of a Gaussian that averages readings across edges and fills holes [px].
    pub smoothing: f64,
    /// Factor on all readings.
    pub factor: f64,
    /// Shift to the right and down against colour [px]; what comes in from outside has no reading.
    pub shift: [i32; 2],
    /// Share of the readings that are replaced: off by a factor of 1.1 to 2, nearer or farther.
    pub outliers: f64,
}

impl Default for DepthDegradation {
    /// Depth as it is.
    fn default() -> Self {
        Self {
            delay: 0.0,
            noise: None,
            block: 1,
            smoothing: 0.0,
            factor: 1.0,
            shift: [0; 2],
            outliers: 0.0,
        }
    }
}

impl DepthDegradation {
    /// An error for values out of range.
    pub(super) fn validate(&self) -> Result<(), SyntheticError> {
        let sides = self.shift.map(|pixels| f64::from(pixels.unsigned_abs()));
        for (key, value, [low, high], unit) in [
            ("delay of depth", self.delay * 1e3, [-10_000.0, 10_000.0], " ms"),
            ("side of depth blocks", self.block as f64, [1.0, 256.0], " px"),
            ("smoothing of depth", self.smoothing, [0.0, 100.0], " px"),
            ("factor on depth", self.factor, [0.1, 10.0], ""),
            ("share of outliers in depth", self.outliers, [0.0, 1.0], ""),
            ("shift of depth to the right", sides[0], [0.0, 4096.0], " px"),
            ("shift of depth down", sides[1], [0.0, 4096.0], " px"),
        ] {
            if !(low..=high).contains(&value) {
                return refuse(key, value, &format!("{low} to {high}{unit}"));
            }
        }
        self.noise.map_or(Ok(()), |noise| noise.validate())
    }

    /// An error for a shift that leaves nothing of a picture of this size.
    pub(super) fn validate_on(&self, width: usize, height: usize) -> Result<(), SyntheticError> {
        for (key, pixels, size) in [
            ("shift of depth to the right", self.shift[0], width),
            ("shift of depth down", self.shift[1], height),
        ] {
            if pixels.unsigned_abs() as usize >= size {
                return refuse(key, pixels, &format!("less than the picture's {size} px"));
            }
        }
        Ok(())
    }

    /// A degraded copy of a depth picture; its stamp gets the delay.
    pub(super) fn apply(&self, depth: &Image<f32>, seed: u64, frame: usize) -> Image<f32> {
        let mut out = match &self.noise {
            Some(noise) => noise.apply(depth, seed, frame),
            None => depth.clone(),
        };
        if self.block > 1 {
            out = blocks(&out, self.block);
        }
        if self.smoothing > 0.0 {
            out = smoothed(&out, self.smoothing);
        }
        if self.factor != 1.0 {
            out.data.iter_mut().for_each(|z| *z = (f64::from(*z) * self.factor) as f32);
        }
        if self.shift != [0; 2] {
            out = shifted(&out, self.shift);
        }
        if self.outliers > 0.0 {
            self.replace_readings(&mut out, seed, frame);
        }
        out
    }

    /// Replaces readings by chance.
    fn replace_readings(&self, depth: &mut Image<f32>, seed: u64, frame: usize) {
        let mut random = stream(seed, OUTLIERS, frame as u64);
        let [low, high] = OUTLIER_FACTOR.map(f64::ln);
        for z in &mut depth.data {
            let (draw, side) = (random.uniform(), random.below(2));
            let factor = between(&mut random, low, high).exp();
            if draw < self.outliers {
                *z *= if side == 0 { factor as f32 } else { factor.recip() as f32 };
            }
        }
    }
}

/// Every block of `side` x `side` pixels with the reading at its middle.
fn blocks(depth: &Image<f32>, side: usize) -> Image<f32> {
    let middle = |at: usize, size: usize| (at / side * side + side / 2).min(size - 1);
    Image::from_fn(depth.width, depth.height, 1, |_, column, row| {
        depth.at(0, middle(column, depth.width), middle(row, depth.height))
    })
}

/// The picture moved to the right and down.
fn shifted(depth: &Image<f32>, [right, down]: [i32; 2]) -> Image<f32> {
    let from = |at: usize, by: i32, size: usize| {
        let source = at as i64 - i64::from(by);
        usize::try_from(source).ok().filter(|&source| source < size)
    };
    Image::from_fn(depth.width, depth.height, 1, |_, column, row| {
        let source = from(column, right, depth.width).zip(from(row, down, depth.height));
        source.map_or(0.0, |(x, y)| depth.at(0, x, y))
    })
}

/// `Σ G z / Σ G` over the readings around every pixel, none where there is no reading in reach.
fn smoothed(depth: &Image<f32>, sigma: f64) -> Image<f32> {
    let weight = |distance: usize| (-0.5 * (distance as f64 / sigma).powi(2)).exp();
    let kernel: Vec<f64> = (0..=(KERNEL_REACH * sigma).ceil() as usize).map(weight).collect();
    let (width, height) = (depth.width, depth.height);
    // A plane of weighted sums and one of weights, along rows and then along columns.
    let is_reading = |z: f32| f64::from(u8::from(z > 0.0));
    let sums: Vec<f64> = depth.data.iter().map(|&z| f64::from(z)).collect();
    let weights: Vec<f64> = depth.data.iter().map(|&z| is_reading(z)).collect();
    let [sums, weights] = [sums, weights].map(|plane| {
        let rows = convolved(&plane, &kernel, width, 1, |i| (i % width, i));
        convolved(&rows, &kernel, height, width, |i| (i / width, i))
    });
    let data = sums
        .iter()
        .zip(&weights)
        .map(|(&sum, &weight)| if weight > 1e-12 { (sum / weight) as f32 } else { 0.0 });
    Image { width, height, channels: 1, data: data.collect() }
}

/// A symmetric kernel along lines of `size` values that lie `stride` apart; `place` tells the
/// place on its line of an index.
fn convolved(
    plane: &[f64],
    kernel: &[f64],
    size: usize,
    stride: usize,
    place: impl Fn(usize) -> (usize, usize),
) -> Vec<f64> {
    let value = |i: usize| {
        let (at, index) = place(i);
        let before = (1..kernel.len().min(at + 1)).map(|k| kernel[k] * plane[index - k * stride]);
        let after = (1..kernel.len().min(size - at)).map(|k| kernel[k] * plane[index + k * stride]);
        kernel[0] * plane[index] + before.sum::<f64>() + after.sum::<f64>()
    };
    (0..plane.len()).map(value).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A slope with a step in the middle and a hole.
    fn slope() -> Image<f32> {
        let mut depth = Image::from_fn(40, 30, 1, |_, column, row| {
            let far = if column < 20 { 1.0 } else { 2.0 };
            far + 0.01 * row as f32
        });
        depth.data[10 * 40 + 5] = 0.0;
        depth
    }

    fn with(change: impl Fn(&mut DepthDegradation)) -> DepthDegradation {
        let mut what = DepthDegradation::default();
        change(&mut what);
        what
    }

    #[test]
    fn depth_as_it_is_stays() {
        assert_eq!(DepthDegradation::default().apply(&slope(), 1, 0), slope());
    }

    #[test]
    fn a_shift_moves_readings_and_leaves_a_border_without() {
        let moved = with(|what| what.shift = [8, -3]).apply(&slope(), 1, 0);
        for (column, row) in [(8, 0), (30, 20), (39, 26), (13, 7)] {
            assert_eq!(moved.at(0, column, row), slope().at(0, column - 8, row + 3));
        }
        assert_eq!(moved.at(0, 7, 10) + moved.at(0, 20, 27), 0.0);
    }

    #[test]
    fn a_factor_leaves_holes_alone() {
        let scaled = with(|what| what.factor = 1.03).apply(&slope(), 1, 0);
        assert!((scaled.at(0, 30, 10) / slope().at(0, 30, 10) - 1.03).abs() < 1e-6);
        assert_eq!(scaled.at(0, 5, 10), 0.0);
    }

    #[test]
    fn half_resolution_repeats_every_second_reading() {
        let coarse = with(|what| what.block = 2).apply(&slope(), 1, 0);
        for (column, row) in [(4, 4), (5, 4), (4, 5), (5, 5)] {
            assert_eq!(coarse.at(0, column, row), slope().at(0, 5, 5));
        }
        let odd = Image::from_fn(3, 3, 1, |_, column, row| (1 + column + 3 * row) as f32);
        assert_eq!(blocks(&odd, 2).data, [5.0, 5.0, 6.0, 5.0, 5.0, 6.0, 8.0, 8.0, 9.0]);
    }

    #[test]
    fn smoothing_fills_holes_and_goes_across_edges() {
        let soft = with(|what| what.smoothing = 2.0).apply(&slope(), 1, 0);
        assert!((soft.at(0, 5, 10) - 1.1).abs() < 1e-3, "{}", soft.at(0, 5, 10));
        let edge = 0.5 * (soft.at(0, 19, 15) + soft.at(0, 20, 15));
        assert!((edge - 1.65).abs() < 0.01, "{edge}");
        assert!((soft.at(0, 19, 15) - 1.15).abs() > 0.2, "no mixture at the edge");
        // An edge after a Gaussian is the normal distribution: 1 % of the step 4.65 px away.
        assert!((soft.at(0, 14, 15) - 1.15).abs() < 0.01);
        let nothing = Image::<f32>::new(8, 8, 1);
        assert_eq!(smoothed(&nothing, 3.0), nothing);
    }

    #[test]
    fn outliers_are_as_many_as_asked_for_and_gross() {
        let wall = Image { width: 200, height: 100, channels: 1, data: vec![2.0; 20_000] };
        let bad = with(|what| what.outliers = 0.2).apply(&wall, 4, 7);
        let wrong: Vec<f32> = bad.data.iter().copied().filter(|&z| z != 2.0).collect();
        let share = wrong.len() as f64 / 20_000.0;
        assert!((share - 0.2).abs() < 0.012, "{share}");
        assert!(wrong.iter().all(|&z| (1.0..=4.0).contains(&z) && !(1.82..2.19).contains(&z)));
        let near = wrong.iter().filter(|&&z| z < 2.0).count() as f64 / wrong.len() as f64;
        assert!((near - 0.5).abs() < 0.05, "{near}");
        assert!(bad != with(|what| what.outliers = 0.2).apply(&wall, 4, 8), "frames differ");
    }

    #[test]
    fn values_that_cannot_be_meant_are_named() {
        let message = |change: &dyn Fn(&mut DepthDegradation)| {
            let what = with(change);
            what.validate().and_then(|()| what.validate_on(40, 30)).expect_err("bad").to_string()
        };
        assert!(message(&|w| w.outliers = 1.5).contains("share of outliers in depth = 1.5"));
        assert!(message(&|w| w.delay = f64::NAN).contains("delay of depth"));
        assert!(message(&|w| w.block = 0).contains("1 to 256 px"));
        assert!(message(&|w| w.factor = 0.0).contains("0.1 to 10"));
        assert!(message(&|w| w.smoothing = -1.0).contains("0 to 100 px"));
        assert!(message(&|w| w.shift = [40, 0]).contains("less than the picture's 40 px"));
        assert!(message(&|w| w.noise = Some(KinectNoise::times(-1.0))).contains("depth noise"));
        assert!(with(|w| w.shift = [-39, 29]).validate_on(40, 30).is_ok());
    }
}
