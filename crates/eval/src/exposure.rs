//! Agreement of estimated exposures with the true ones, up to a common gain.

use crate::EvalError;
use serde::Serialize;

/// Agreement of log exposures `y = ln ê` with the true `x = ln e`, independent of a constant offset:
/// one gain between exposures and radiance is not observable.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ExposureAgreement {
    /// Pearson correlation `σ_xy / (σ_x σ_y)`, in `[-1, 1]`.
    pub pearson: f64,
    /// Slope of the least squares line of `y` over `x`, `σ_xy / σ_x²`; 1 is right, less means
    /// that changes of exposure were explained by something else.
    pub slope: f64,
    /// Root mean square of `(y - x)` about its mean, in powers of two [stops].
    pub residual_rms_stops: f64,
    /// Number of frames.
    pub frames: usize,
}

/// Compares exposures (linear, above zero) of the same frames; constant ones are refused.
pub fn exposure_agreement(estimate: &[f64], truth: &[f64]) -> Result<ExposureAgreement, EvalError> {
    if estimate.len() != truth.len() {
        let (first, second) = (vec![estimate.len()], vec![truth.len()]);
        return Err(EvalError::ShapeMismatch { what: "lists of exposures", first, second });
    }
    if truth.len() < 2 {
        return Err(EvalError::TooFew { what: "frames", found: truth.len(), needed: 2 });
    }
    let x = centred_logarithms(truth, "the true exposures")?;
    let y = centred_logarithms(estimate, "the estimated exposures")?;
    let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
    let (xx, yy, xy) = (dot(&x, &x), dot(&y, &y), dot(&x, &y));
    let residual: f64 = x.iter().zip(&y).map(|(x, y)| (y - x).powi(2)).sum();
    Ok(ExposureAgreement {
        pearson: (xy / (xx.sqrt() * yy.sqrt())).clamp(-1.0, 1.0),
        slope: xy / xx,
        residual_rms_stops: (residual / x.len() as f64).sqrt() / std::f64::consts::LN_2,
        frames: x.len(),
    })
}

/// `ln v` minus its mean.
fn centred_logarithms(values: &[f64], what: &'static str) -> Result<Vec<f64>, EvalError> {
    if values.iter().any(|v| !v.is_finite()) {
        return Err(EvalError::NotFinite { what });
    }
    if values.iter().any(|&v| v <= 0.0) {
        return Err(EvalError::NotPositive { what });
    }
    let logs: Vec<f64> = values.iter().map(|v| v.ln()).collect();
    let mean = logs.iter().sum::<f64>() / logs.len() as f64;
    let centred: Vec<f64> = logs.iter().map(|l| l - mean).collect();
    if centred.iter().all(|c| c.abs() < 1e-12) {
        return Err(EvalError::Coincident { what });
    }
    Ok(centred)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A gain is no error, and a power shows in the slope only.
    #[test]
    fn powers_of_the_truth_by_hand() {
        let truth = [0.25, 0.5, 1.0, 2.0];
        for (gain, power) in [(7.0, 1.0_f64), (1.0, 0.5), (1.0, -1.0)] {
            let a = exposure_agreement(&truth.map(|e: f64| gain * e.powf(power)), &truth).unwrap();
            assert!((a.pearson - power.signum()).abs() < 1e-12);
            assert!((a.slope - power).abs() < 1e-12);
            let residual = (1.0 - power).abs() * 1.25_f64.sqrt();
            assert!((a.residual_rms_stops - residual).abs() < 1e-12);
        }
    }

    #[test]
    fn invalid_input_is_refused() {
        let of = exposure_agreement;
        assert!(matches!(of(&[1.0, 1.0], &[1.0, 2.0]), Err(EvalError::Coincident { .. })));
        assert!(matches!(of(&[1.0, 0.0], &[1.0, 2.0]), Err(EvalError::NotPositive { .. })));
        assert!(matches!(of(&[1.0, f64::NAN], &[1.0, 2.0]), Err(EvalError::NotFinite { .. })));
        assert!(matches!(of(&[1.0], &[1.0, 2.0]), Err(EvalError::ShapeMismatch { .. })));
        assert!(matches!(of(&[], &[]), Err(EvalError::TooFew { .. })));
    }
}
