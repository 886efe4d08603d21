//! Summaries of lists of numbers.

use crate::EvalError;
use serde::Serialize;

/// Summary of a list of errors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Root of the mean square, `sqrt(Σ x² / n)`.
    pub rmse: f64,
    /// Arithmetic mean `μ`.
    pub mean: f64,
    /// Median; of an even count the mean of the two middle values.
    pub median: f64,
    /// Standard deviation of the list itself, `sqrt(Σ (x - μ)² / n)` (the convention of evo).
    pub std: f64,
    /// Smallest value.
    pub min: f64,
    /// Largest value.
    pub max: f64,
    /// Number of values.
    pub count: usize,
}

impl Summary {
    /// The summary of `values`; an empty list and values that are not finite are refused.
    pub fn of(values: &[f64]) -> Result<Self, EvalError> {
        check(values)?;
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let square = values.iter().map(|v| v * v).sum::<f64>() / n;
        let variance = values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / n;
        Ok(Self {
            rmse: square.sqrt(),
            mean,
            median: percentile(values, 50.0)?,
            std: variance.sqrt(),
            min: values.iter().copied().fold(f64::INFINITY, f64::min),
            max: values.iter().copied().fold(f64::NEG_INFINITY, f64::max),
            count: values.len(),
        })
    }
}

/// The `percent`-th percentile, `percent` in `[0, 100]` (clamped), interpolated linearly between
/// the order statistics at position `percent/100 · (n - 1)` (numpy's default).
pub fn percentile(values: &[f64], percent: f64) -> Result<f64, EvalError> {
    check(values)?;
    if percent.is_nan() {
        return Err(EvalError::NotFinite { what: "the percentile" });
    }
    let position = percent.clamp(0.0, 100.0) / 100.0 * (values.len() - 1) as f64;
    let (below, fraction) = (position.floor() as usize, position.fract());
    let mut work = values.to_vec();
    let (_, &mut low, above) = work.select_nth_unstable_by(below, f64::total_cmp);
    let high = above.iter().copied().fold(f64::INFINITY, f64::min);
    Ok(if fraction > 0.0 { low + fraction * (high - low) } else { low })
}

fn check(values: &[f64]) -> Result<(), EvalError> {
    if values.is_empty() {
        return Err(EvalError::TooFew { what: "values", found: 0, needed: 1 });
    }
    if values.iter().any(|v| !v.is_finite()) {
        return Err(EvalError::NotFinite { what: "values" });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn summary_by_hand() {
        let s = Summary::of(&[1.0, 2.0, 3.0, 6.0]).unwrap();
        assert_eq!((s.mean, s.median, s.min, s.max, s.count), (3.0, 2.5, 1.0, 6.0, 4));
        assert!((s.std - 3.5_f64.sqrt()).abs() < 1e-15);
        assert!((s.rmse - 12.5_f64.sqrt()).abs() < 1e-15);
    }

    #[test]
    fn percentile_interpolates() {
        let values = [4.0, 1.0, 3.0, 2.0];
        assert_eq!(percentile(&values, 0.0).unwrap(), 1.0);
        assert_eq!(percentile(&values, 100.0).unwrap(), 4.0);
        assert!((percentile(&values, 90.0).unwrap() - 3.7).abs() < 1e-12);
    }

    #[test]
    fn empty_and_poisoned_lists_are_refused() {
        assert!(matches!(Summary::of(&[]), Err(EvalError::TooFew { .. })));
        assert!(matches!(Summary::of(&[1.0, f64::NAN]), Err(EvalError::NotFinite { .. })));
        assert!(matches!(percentile(&[1.0], f64::NAN), Err(EvalError::NotFinite { .. })));
    }
}
