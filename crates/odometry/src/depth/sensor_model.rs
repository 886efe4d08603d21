//! Model of a depth sensor, read off the residuals of its readings.

use i2slam_compute::{SIGMA_PER_MEDIAN, median};

/// Relative deviation of a reading before any was compared.
const INITIAL_DEVIATION: f64 = 0.03;
/// Readings per node of the deviation, at least, and most nodes.
const MIN_READINGS: usize = 100;
const MAX_NODES: usize = 8;
/// Least relative deviation: readings are stored in single precision.
const MIN_DEVIATION: f64 = 1e-5;

/// Standard deviation of inverse depth by inverse depth, and registration to the colour picture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DepthModel {
    /// Inverse depth and deviation [1/m], in order; empty before readings were compared.
    nodes: Vec<[f64; 2]>,
    /// Position in the depth picture of what the colour picture shows at the origin [px].
    pub shift: [f64; 2],
    /// Time from a depth picture's timestamp to when it was taken [s].
    pub delay: f64,
}

impl DepthModel {
    /// Standard deviation of an inverse depth [1/m].
    pub fn sigma(&self, inverse: f64) -> f64 {
        let (Some(first), Some(last)) = (self.nodes.first(), self.nodes.last()) else {
            return INITIAL_DEVIATION * inverse;
        };
        let next = self.nodes.partition_point(|node| node[0] < inverse);
        if next == 0 {
            return first[1];
        }
        let Some([x1, y1]) = self.nodes.get(next) else { return last[1] };
        let [x0, y0] = self.nodes[next - 1];
        y0 + (y1 - y0) * (inverse - x0) / (x1 - x0).max(f64::MIN_POSITIVE)
    }

    /// Sets the deviation from inverse depths and their residuals: the median absolute residual of
    /// equally many readings each. Too few change nothing.
    pub(crate) fn fit_deviation(&mut self, mut residuals: Vec<[f64; 2]>) {
        let count = (residuals.len() / MIN_READINGS).min(MAX_NODES);
        if count == 0 {
            return;
        }
        residuals.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let node = |part: &[[f64; 2]]| {
            let inverse = part[part.len() / 2][0];
            let mut sizes: Vec<f64> = part.iter().map(|[_, r]| r.abs()).collect();
            let usual = median(&mut sizes).unwrap_or(0.0);
            [inverse, (SIGMA_PER_MEDIAN * usual).max(MIN_DEVIATION * inverse)]
        };
        self.nodes = residuals.chunks(residuals.len().div_ceil(count)).map(node).collect();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::noise;

    /// Deviations that grow with inverse depth are found beside a tenth of gross outliers.
    #[test]
    fn the_deviation_is_read_off_the_residuals() {
        let truth = |inverse: f64| 0.002 + 0.01 * inverse;
        let reading = |seed: u64| {
            let n = noise(seed, 13);
            let inverse = 0.3 + 0.25 * (1.0 + n[0]);
            // The sum of twelve uniform numbers in [-1, 1] has a variance of four.
            let normal = 0.5 * n[1..].iter().sum::<f64>();
            let off = if seed.is_multiple_of(10) { 1.0 } else { truth(inverse) * normal };
            [inverse, off]
        };
        let mut model = DepthModel::default();
        assert!((model.sigma(0.5) - 0.5 * INITIAL_DEVIATION).abs() < 1e-12);
        model.fit_deviation((0..40_000).map(reading).collect());
        for inverse in [0.35, 0.5, 0.7] {
            let ratio = model.sigma(inverse) / truth(inverse);
            assert!((0.85..1.4).contains(&ratio), "{inverse}: {ratio}");
        }
    }
}
