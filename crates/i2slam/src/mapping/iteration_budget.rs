//! The steps that a keyframe is given, and when they end early.

use crate::config::Config;
use i2slam_compute::CancellationToken;
use std::time::Instant;

/// One round of steps, which may last `mapping.seconds_per_frame`, without limit if that is 0.
pub(super) struct IterationBudget {
    begun: Instant,
    budget: f64,
}

impl IterationBudget {
    /// A round that begins now.
    pub(super) fn begin(config: &Config) -> Self {
        Self { begun: Instant::now(), budget: f64::from(config.mapping.seconds_per_frame) }
    }

    /// Whether the rest is left undone after `steps` of them; the first is always done.
    pub(super) fn is_over(&self, steps: usize, cancellation: &CancellationToken) -> bool {
        let late = self.budget > 0.0 && self.begun.elapsed().as_secs_f64() > self.budget;
        steps > 0 && (late || cancellation.is_cancelled())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_round_ends_with_its_budget_or_by_wish_but_not_before_its_first_step() {
        let mut config = Config::default();
        assert!(!IterationBudget::begin(&config).is_over(1000, &CancellationToken::default()));
        config.mapping.seconds_per_frame = 1e-9;
        let round = IterationBudget::begin(&config);
        std::thread::sleep(std::time::Duration::from_millis(1));
        assert!(
            !round.is_over(0, &CancellationToken::default())
                && round.is_over(1, &CancellationToken::default())
        );
        let cancellation = CancellationToken::when(|| true);
        config.mapping.seconds_per_frame = 0.0;
        assert!(!IterationBudget::begin(&config).is_over(0, &cancellation));
        assert!(IterationBudget::begin(&config).is_over(1, &cancellation));
    }
}
