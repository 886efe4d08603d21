//! Depth as a first-generation Kinect sees it.

use crate::error::SyntheticError;
use crate::rng::{gaussian, stream};
use i2slam_geometry::Image;

/// The model, in order: half-pixel jitter of where depth is read (σ = ½ px, rounded); axial noise
/// of σ = 0.0012 + 0.0019 (z - 0.4)² m (Nguyen et al. 2012); disparity in steps of ⅛ px; holes
/// where depth jumps, below 0.3 m and beyond 5 m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KinectNoise {
    /// Standard deviation of the lateral jitter [px].
    pub lateral: f64,
    /// Axial noise `a + b (z - 0.4)²`: a [m] and b [1/m].
    pub axial: [f64; 2],
    /// Focal length times baseline of the sensor [px m].
    pub disparity_at_one_metre: f64,
    /// Disparity steps a pixel.
    pub steps: f64,
    /// A pixel is at an edge where depth changes by more than this share of it, a pixel.
    pub edge: f64,
    /// Share of edge pixels without a reading.
    pub edge_holes: f64,
    /// Nearest and farthest reading [m].
    pub range: [f64; 2],
}

impl Default for KinectNoise {
    fn default() -> Self {
        Self {
            lateral: 0.5,
            axial: [0.0012, 0.0019],
            disparity_at_one_metre: 580.0 * 0.075,
            steps: 8.0,
            edge: 0.04,
            edge_holes: 0.8,
            range: [0.3, 5.0],
        }
    }
}

impl KinectNoise {
    /// The model with jitter, axial noise and steps `factor` times as large; holes and range stay.
    pub fn times(factor: f64) -> Self {
        let usual = Self::default();
        Self {
            lateral: usual.lateral * factor,
            axial: usual.axial.map(|a| a * factor),
            steps: usual.steps / factor,
            ..usual
        }
    }

    /// An error for numbers that are no noise.
    pub(crate) fn validate(&self) -> Result<(), SyntheticError> {
        let all = [self.lateral, self.axial[0], self.axial[1]];
        if all.iter().all(|value| (0.0..=100.0).contains(value)) && self.steps > 0.0 {
            return Ok(());
        }
        Err(SyntheticError::OutOfRange {
            key: "depth noise".to_owned(),
            value: format!(
                "lateral {}, axial {:?}, steps {}",
                self.lateral, self.axial, self.steps
            ),
            expected: "numbers from 0 to 100, steps above 0".to_owned(),
        })
    }

    /// A noisy copy of true depth [m]; 0 is no reading. The same `seed` and `frame` give the same
    /// numbers.
    pub fn apply(&self, depth: &Image<f32>, seed: u64, frame: usize) -> Image<f32> {
        let mut random = stream(seed, 31, frame as u64);
        let (width, height) = (depth.width, depth.height);
        let mut out = Image::new(width, height, 1);
        let jittered = |at: usize, shift: f64, size: usize| {
            (at as f64 + shift).round_ties_even().clamp(0.0, (size - 1) as f64) as usize
        };
        for row in 0..height {
            for column in 0..width {
                let x = jittered(column, self.lateral * gaussian(&mut random), width);
                let y = jittered(row, self.lateral * gaussian(&mut random), height);
                let (noise, draw) = (gaussian(&mut random), random.uniform());
                let z = f64::from(depth.at(0, x, y));
                let hole = self.is_edge(depth, column, row) && draw < self.edge_holes;
                let reading = self.reading(z, noise);
                if z > self.range[0] && !hole && reading <= self.range[1] {
                    out.data[row * width + column] = reading as f32;
                }
            }
        }
        out
    }

    /// Depth after axial noise and steps of disparity [m].
    fn reading(&self, z: f64, noise: f64) -> f64 {
        let noisy = z + noise * (self.axial[0] + self.axial[1] * (z - 0.4).powi(2));
        let disparity = (self.disparity_at_one_metre / noisy * self.steps).round_ties_even();
        self.disparity_at_one_metre / (disparity / self.steps).max(1e-3)
    }

    /// Whether depth changes by more than `edge` a pixel, along a row or a column.
    fn is_edge(&self, depth: &Image<f32>, column: usize, row: usize) -> bool {
        let slope = |at: usize, size: usize, value: &dyn Fn(usize) -> f32| -> f64 {
            let (low, high) = (at.saturating_sub(1), (at + 1).min(size - 1));
            let steps = (high - low).max(1) as f64;
            f64::from(value(high) - value(low)).abs() / steps
        };
        let along_row = slope(column, depth.width, &|x| depth.at(0, x, row));
        let along_column = slope(row, depth.height, &|y| depth.at(0, column, y));
        let here = f64::from(depth.at(0, column, row)).max(0.5);
        along_row.max(along_column) > self.edge * here
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wall(z: f32) -> Image<f32> {
        Image { width: 160, height: 120, channels: 1, data: vec![z; 160 * 120] }
    }

    fn spread(image: &Image<f32>) -> (f64, f64) {
        let count = image.data.len() as f64;
        let mean = image.data.iter().map(|&z| f64::from(z)).sum::<f64>() / count;
        let variance = image.data.iter().map(|&z| (f64::from(z) - mean).powi(2)).sum::<f64>();
        (mean, (variance / count).sqrt())
    }

    /// Noise of the model and rounding of disparity, `z² / (8 · 43.5 · √12)`, add in squares.
    #[test]
    fn noise_grows_with_depth_as_the_model_says() {
        for z in [1.0, 2.0, 3.5] {
            let (mean, sigma) = spread(&KinectNoise::default().apply(&wall(z), 5, 0));
            let z = f64::from(z);
            let axial = 0.0012 + 0.0019 * (z - 0.4).powi(2);
            let rounding = z * z / (8.0 * 43.5) / 12.0_f64.sqrt();
            let expected = axial.hypot(rounding);
            assert!((sigma / expected - 1.0).abs() < 0.12, "{z}: {sigma} {expected}");
            assert!((mean - z).abs() < 0.25 * expected, "{z}: {mean}");
        }
    }

    #[test]
    fn three_times_the_noise_spreads_three_times_as_far() {
        let spread_of = |factor: f64| spread(&KinectNoise::times(factor).apply(&wall(2.0), 5, 0)).1;
        let ratio = spread_of(3.0) / spread_of(1.0);
        assert!((ratio - 3.0).abs() < 0.15, "{ratio}");
        assert_eq!(KinectNoise::times(1.0), KinectNoise::default());
    }

    #[test]
    fn readings_are_steps_of_an_eighth_pixel() {
        let noisy = KinectNoise::default().apply(&wall(2.0), 5, 1);
        for &z in &noisy.data {
            let steps = 43.5 * 8.0 / f64::from(z);
            assert!((steps - steps.round()).abs() < 1e-4, "{steps}");
        }
    }

    #[test]
    fn edges_and_far_depth_have_holes() {
        let mut depth = wall(1.5);
        for row in 0..120 {
            depth.data[row * 160 + 80..(row + 1) * 160].fill(3.0);
        }
        let noisy = KinectNoise::default().apply(&depth, 1, 0);
        let holes = |column: usize| {
            (0..120).filter(|&row| noisy.at(0, column, row) == 0.0).count() as f64 / 120.0
        };
        assert!((holes(79) - 0.8).abs() < 0.13 && (holes(80) - 0.8).abs() < 0.13);
        assert_eq!(holes(40) + holes(120), 0.0);
        let nothing = KinectNoise::default();
        assert!(nothing.apply(&wall(6.0), 1, 0).data.iter().all(|&z| z == 0.0));
        assert!(nothing.apply(&wall(0.0), 1, 0).data.iter().all(|&z| z == 0.0));
    }
}
