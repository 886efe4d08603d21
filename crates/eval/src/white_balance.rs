//! Agreement of estimated white balance with the true one, up to one white balance for all frames.

use crate::EvalError;
use serde::Serialize;

/// Agreement of the ratios red to green and blue to green, as logarithms to base 2. One white
/// balance between pictures and radiance is not observable: each ratio is compared after its mean
/// over all frames is removed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct WhiteBalanceAgreement {
    /// Root mean square difference over both ratios and all frames \[stops\].
    pub residual_rms_stops: f64,
    /// Root mean square of the true ratios about their means \[stops\]: the error of an estimate
    /// that never changes.
    pub variation_rms_stops: f64,
    /// Number of frames.
    pub frames: usize,
}

/// Compares gains of red, green and blue (linear, above zero) of the same frames.
pub fn white_balance_agreement(
    estimate: &[[f64; 3]],
    truth: &[[f64; 3]],
) -> Result<WhiteBalanceAgreement, EvalError> {
    if estimate.len() != truth.len() {
        let (first, second) = (vec![estimate.len()], vec![truth.len()]);
        return Err(EvalError::ShapeMismatch { what: "lists of white balance", first, second });
    }
    if truth.len() < 2 {
        return Err(EvalError::TooFew { what: "frames", found: truth.len(), needed: 2 });
    }
    let (mut residual, mut variation) = (0.0, 0.0);
    for channel in [0, 2] {
        let found = centred_ratios(estimate, channel, "the estimated white balance")?;
        let known = centred_ratios(truth, channel, "the true white balance")?;
        residual += found.iter().zip(&known).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
        variation += known.iter().map(|b| b * b).sum::<f64>();
    }
    let count = 2.0 * truth.len() as f64;
    Ok(WhiteBalanceAgreement {
        residual_rms_stops: (residual / count).sqrt(),
        variation_rms_stops: (variation / count).sqrt(),
        frames: truth.len(),
    })
}

/// Logarithms of a channel over green, minus their mean \[stops\].
fn centred_ratios(
    gains: &[[f64; 3]],
    channel: usize,
    what: &'static str,
) -> Result<Vec<f64>, EvalError> {
    if gains.iter().flatten().any(|gain| !gain.is_finite()) {
        return Err(EvalError::NotFinite { what });
    }
    if gains.iter().flatten().any(|&gain| gain <= 0.0) {
        return Err(EvalError::NotPositive { what });
    }
    let ratios = gains.iter().map(|gain| (gain[channel] / gain[1]).log2());
    let ratios: Vec<f64> = ratios.collect();
    let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
    Ok(ratios.iter().map(|ratio| ratio - mean).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn constant_gains_are_no_error_and_drift_is_one() {
        let truth = [[0.5, 1.0, 2.0], [1.0, 1.0, 1.0], [2.0, 1.0, 0.5]];
        // Another white balance of the map, and another exposure of every frame.
        let gains = [3.0, 0.5, 7.0];
        let estimate: Vec<[f64; 3]> = truth
            .iter()
            .zip(gains)
            .map(|([r, g, b], gain)| [1.3 * gain * r, gain * g, 0.6 * gain * b])
            .collect();
        let exact = white_balance_agreement(&estimate, &truth).expect("three frames");
        assert!(exact.residual_rms_stops < 1e-12 && exact.frames == 3);
        // Ratios -1, 0, 1 and 1, 0, -1 stops.
        let due = (2.0_f64 / 3.0).sqrt();
        assert!((exact.variation_rms_stops - due).abs() < 1e-12);
        let still = white_balance_agreement(&[[1.0; 3]; 3], &truth).expect("three frames");
        assert!((still.residual_rms_stops - due).abs() < 1e-12);
    }

    #[test]
    fn invalid_input_is_refused() {
        let (of, one) = (white_balance_agreement, [1.0; 3]);
        assert!(matches!(of(&[one], &[one]), Err(EvalError::TooFew { .. })));
        assert!(matches!(of(&[one], &[one; 2]), Err(EvalError::ShapeMismatch { .. })));
        let zero = [[1.0, 0.0, 1.0]; 2];
        assert!(matches!(of(&[one; 2], &zero), Err(EvalError::NotPositive { .. })));
        let nan = [[f64::NAN, 1.0, 1.0]; 2];
        assert!(matches!(of(&nan, &[one; 2]), Err(EvalError::NotFinite { .. })));
    }
}
