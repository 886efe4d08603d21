//! Early end of the optimisation steps that a frame is allowed.

use crate::config::Config;
use i2slam_compute::CancellationToken;
use std::time::Instant;

/// Time for the steps of one frame: `mapping.seconds_per_frame`, unlimited if that is 0.
pub(super) struct IterationBudget {
    start: Instant,
    /// [s]
    limit: f64,
}

impl IterationBudget {
    /// A budget that starts now.
    pub(super) fn start(config: &Config) -> Self {
        Self { start: Instant::now(), limit: f64::from(config.mapping.seconds_per_frame) }
    }

    /// Whether to stop after `steps` steps, for time or cancellation; never before the first.
    pub(super) fn is_exhausted(&self, steps: usize, cancellation: &CancellationToken) -> bool {
        let late = self.limit > 0.0 && self.start.elapsed().as_secs_f64() > self.limit;
        steps > 0 && (late || cancellation.is_cancelled())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_and_cancellation_exhaust_a_budget_after_its_first_step() {
        let mut config = Config::default();
        let (none, cancelled) = (CancellationToken::default(), CancellationToken::when(|| true));
        let unlimited = IterationBudget::start(&config);
        assert!(!unlimited.is_exhausted(1000, &none));
        assert!(!unlimited.is_exhausted(0, &cancelled) && unlimited.is_exhausted(1, &cancelled));
        config.mapping.seconds_per_frame = 1e-9;
        let budget = IterationBudget::start(&config);
        std::thread::sleep(std::time::Duration::from_millis(1));
        assert!(!budget.is_exhausted(0, &none) && budget.is_exhausted(1, &none));
    }
}
