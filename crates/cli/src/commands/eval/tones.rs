//! Errors of exposure and white balance against `exposure.csv` of the dataset.

use super::estimate::{Estimate, RunFrame};
use super::metric_value::MetricValue;
use super::reference::Reference;
use crate::exposure_table::TrueTone;
use crate::failure::Failure;
use i2slam_eval::exposure::exposure_agreement;
use i2slam_eval::white_balance::white_balance_agreement;

/// Compares exposures and white balance of `frames.csv` with those of the dataset; nothing where one
/// of them is not known. Figures that constant values leave undefined are missing.
pub(super) fn evaluate(
    estimate: &Estimate,
    reference: &Reference,
) -> Result<Vec<MetricValue>, Failure> {
    let Reference::Dataset { truth, .. } = reference else { return Ok(Vec::new()) };
    let frames = estimate.run_frames()?.unwrap_or_default();
    Ok(values(&frames, &truth.tones))
}

fn values(frames: &[RunFrame], truth: &[TrueTone]) -> Vec<MetricValue> {
    let pairs = frames.iter().filter_map(|frame| {
        let known = truth.iter().find(|tone| tone.frame == frame.index)?;
        Some((frame.exposure?, frame.white_balance?, known))
    });
    let pairs: Vec<_> = pairs.collect();
    if pairs.is_empty() {
        return Vec::new();
    }
    let (found, due): (Vec<f64>, Vec<f64>) =
        pairs.iter().map(|(exposure, _, known)| (*exposure, known.exposure)).unzip();
    let exposure = exposure_agreement(&found, &due).ok();
    let figure =
        |key, label, unit, decimals, value| MetricValue { key, label, unit, decimals, value };
    let mut all = vec![
        figure("exposure_frames", "exposure: frames evaluated", "", 0, Some(pairs.len() as f64)),
        figure(
            "log_exposure_correlation",
            "log exposure correlation",
            "",
            4,
            exposure.map(|e| e.pearson),
        ),
        figure("log_exposure_slope", "log exposure slope", "", 4, exposure.map(|e| e.slope)),
        figure(
            "log_exposure_residual_stops",
            "log exposure RMSE",
            "stops",
            3,
            exposure.map(|e| e.residual_rms_stops),
        ),
    ];
    let balances =
        pairs.iter().filter_map(|(_, gains, known)| Some((*gains, known.white_balance?)));
    let (found, due): (Vec<[f64; 3]>, Vec<[f64; 3]>) = balances.unzip();
    if let Ok(balance) = white_balance_agreement(&found, &due) {
        let (error, variation) = (balance.residual_rms_stops, balance.variation_rms_stops);
        let names = ("white_balance_residual_stops", "white balance RMSE");
        all.push(figure(names.0, names.1, "stops", 3, Some(error)));
        let names = ("white_balance_variation_stops", "true white balance about its mean");
        all.push(figure(names.0, names.1, "stops", 3, Some(variation)));
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(index: usize, exposure: f64, white_balance: [f64; 3]) -> RunFrame {
        let (exposure, white_balance) = (Some(exposure), Some(white_balance));
        RunFrame { index, exposure, white_balance, ..RunFrame::default() }
    }

    fn tone(frame: usize, exposure: f64, white_balance: [f64; 3]) -> TrueTone {
        TrueTone { frame, exposure, white_balance: Some(white_balance) }
    }

    #[test]
    fn frames_are_compared_by_their_numbers() {
        let frames =
            [frame(4, 1.0, [1.0; 3]), frame(2, 3.0, [2.0, 1.0, 1.0]), frame(9, 5.0, [1.0; 3])];
        let truth = [tone(2, 1.5, [2.0, 1.0, 1.0]), tone(4, 0.5, [1.0; 3])];
        let found = values(&frames, &truth);
        let of = |key: &str| found.iter().find(|v| v.key == key).and_then(|v| v.value);
        assert_eq!(of("exposure_frames"), Some(2.0));
        assert!(of("log_exposure_residual_stops").is_some_and(|v| v < 1e-9), "{found:?}");
        assert!(of("white_balance_residual_stops").is_some_and(|v| v < 1e-9), "{found:?}");
        assert!(of("white_balance_variation_stops").is_some_and(|v| v > 0.3), "{found:?}");
        assert!(values(&frames, &[]).is_empty());
    }

    #[test]
    fn a_constant_exposure_has_no_correlation() {
        let frames = [frame(0, 1.0, [1.0; 3]), frame(1, 1.0, [1.0; 3])];
        let truth = [tone(0, 2.0, [1.0; 3]), tone(1, 1.0, [1.0; 3])];
        let found = values(&frames, &truth);
        let of = |key: &str| found.iter().find(|v| v.key == key).expect("a row").value;
        assert_eq!(of("log_exposure_correlation"), None);
        assert_eq!(of("white_balance_residual_stops"), Some(0.0));
    }
}
