//! Ranges and ticks of a plot's axis.

/// A range of values with round ticks.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// Value at its beginning.
    pub low: f64,
    /// Value at its end.
    pub high: f64,
    /// Values to be labelled, ascending.
    pub ticks: Vec<f64>,
    step: f64,
}

impl Axis {
    /// An axis over the finite `values`, with about `count` ticks; `tight` ends at the values,
    /// otherwise at the next tick.
    pub fn over(values: impl Iterator<Item = f64>, count: usize, tight: bool) -> Self {
        let finite = values.filter(|v| v.is_finite());
        let (low, high) =
            finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        let (low, high) = if low > high { (0.0, 1.0) } else { (low, high) };
        let smallest = (low.abs().max(high.abs()) * 1e-6).max(1e-9);
        let (low, high) =
            if high - low < smallest { (low - smallest, high + smallest) } else { (low, high) };
        Self::between(low, high, count, tight)
    }

    /// An axis from `low` to `high`, `low < high`.
    pub fn between(low: f64, high: f64, count: usize, tight: bool) -> Self {
        let step = round_step((high - low) / count.max(1) as f64);
        let (first, last) = if tight {
            ((low / step).ceil(), (high / step).floor())
        } else {
            ((low / step).floor(), (high / step).ceil())
        };
        let ticks: Vec<f64> = (first as i64..=last as i64).map(|i| i as f64 * step).collect();
        match (tight, ticks.first(), ticks.last()) {
            (false, Some(&low), Some(&high)) => Self { low, high, ticks, step },
            _ => Self { low, high, ticks, step },
        }
    }

    /// Where a value lies, 0 at `low` and 1 at `high`.
    pub fn share(&self, value: f64) -> f64 {
        (value - self.low) / (self.high - self.low)
    }

    /// A tick's label, with as many digits as the step needs.
    pub fn label(&self, value: f64) -> String {
        let value = if value.abs() < 1e-9 * self.step { 0.0 } else { value };
        if self.step < 1e-4 || value.abs() >= 1e6 {
            return format!("{value:.0e}");
        }
        let digits = (-self.step.log10() - 1e-9).ceil().max(0.0) as usize;
        format!("{value:.digits$}").replace('-', "\u{2212}")
    }
}

/// The smallest of 1, 2 and 5 times a power of ten that is at least `raw`.
fn round_step(raw: f64) -> f64 {
    let power = 10.0_f64.powf(raw.log10().floor());
    let factor = raw / power;
    let round = [1.0, 2.0, 5.0, 10.0].into_iter().find(|&r| factor <= r + 1e-9).unwrap_or(10.0);
    round * power
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_cover_the_values() {
        let axis = Axis::over([0.03, 0.97].into_iter(), 5, false);
        assert_eq!((axis.low, axis.high), (0.0, 1.0));
        assert_eq!(axis.label(axis.ticks[1]), "0.2");
        let tight = Axis::over([3.0, 104.0].into_iter(), 5, true);
        assert_eq!((tight.low, tight.high), (3.0, 104.0));
        assert_eq!(tight.ticks.first(), Some(&50.0));
    }

    #[test]
    fn constants_nothing_and_nan_still_make_an_axis() {
        for values in [vec![], vec![2.0, 2.0], vec![f64::NAN], vec![0.0], vec![1e-300]] {
            let axis = Axis::over(values.into_iter(), 4, false);
            assert!(axis.low < axis.high && axis.ticks.len() >= 2, "{axis:?}");
        }
    }
}
