//! An axis of a plot: its range, round ticks and their labels.

/// A range of values with round ticks.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Axis {
    pub(super) low: f64,
    pub(super) high: f64,
    /// Ascending.
    pub(super) ticks: Vec<f64>,
    /// Distance of the ticks; `None` where the axis is logarithmic.
    pub(super) step: Option<f64>,
}

impl Axis {
    /// An axis over the finite `values`, with about `count` ticks. A `tight` one ends at the
    /// values, another one at ticks.
    pub(super) fn over(values: impl Iterator<Item = f64>, count: usize, tight: bool) -> Self {
        let finite = values.filter(|v| v.is_finite());
        let (low, high) =
            finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        let (low, high) = if low > high { (0.0, 1.0) } else { (low, high) };
        let size = low.abs().max(high.abs());
        let is_constant = high - low < (1e-6 * size).max(1e-9);
        let (low, high) = match is_constant {
            true if size < 1e-9 => (0.0, 1.0),
            true => (low - 0.1 * size, high + 0.1 * size),
            false => (low, high),
        };
        Self::between(low, high, count, tight)
    }

    /// An axis from `low` to `high`, `low < high`.
    pub(super) fn between(low: f64, high: f64, count: usize, tight: bool) -> Self {
        let step = round_step((high - low) / count.max(1) as f64);
        let (first, last) = if tight {
            ((low / step).ceil(), (high / step).floor())
        } else {
            ((low / step).floor(), (high / step).ceil())
        };
        let ticks = (first as i64..=last as i64).map(|i| i as f64 * step).collect();
        let (low, high) = if tight { (low, high) } else { (first * step, last * step) };
        Self { low, high, ticks, step: Some(step) }
    }

    /// A logarithmic axis around positive values, with ticks at 1, 2 and 5 times powers of ten.
    pub(super) fn logarithmic(low: f64, high: f64) -> Self {
        let (low, high) = (low / 1.3, high * 1.3);
        let decades = low.log10().floor() as i32..=high.log10().ceil() as i32;
        let ticks = decades.flat_map(|decade| [1.0, 2.0, 5.0].map(|m| m * 10_f64.powi(decade)));
        let ticks = ticks.filter(|tick| (low..=high).contains(tick)).collect();
        Self { low, high, ticks, step: None }
    }

    /// Position of a value, 0 at `low` and 1 at `high`.
    pub(super) fn fraction(&self, value: f64) -> f64 {
        match self.step {
            Some(_) => (value - self.low) / (self.high - self.low),
            None => (value / self.low).ln() / (self.high / self.low).ln(),
        }
    }

    /// A tick's label, with as many digits as the step needs.
    pub(super) fn label(&self, tick: f64) -> String {
        let Some(step) = self.step else {
            return format!("{tick:.*}", (-tick.log10()).ceil().max(0.0) as usize);
        };
        let tick = if tick.abs() < 1e-9 * step { 0.0 } else { tick };
        if step < 1e-4 || tick.abs() >= 1e6 {
            return format!("{tick:.0e}");
        }
        let digits = (-step.log10() - 1e-9).ceil().max(0.0) as usize;
        format!("{tick:.digits$}").replace('-', "\u{2212}")
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
        let labels = |value: f64| {
            let axis = Axis::over([value, value].into_iter(), 4, false);
            axis.ticks.iter().map(|tick| axis.label(*tick)).collect::<Vec<_>>()
        };
        assert_eq!(labels(0.0), ["0.0", "0.5", "1.0"]);
        assert_eq!(labels(1.0), ["0.90", "0.95", "1.00", "1.05", "1.10"]);
    }
}
