//! Errors of linear radiance, which is known up to one gain (exposure x radiance is observed).
//!
//! The gain is removed as the *median* of `truth / estimate` over pixels and channels, robust to
//! unmapped pixels and lamps. One common gain leaves a wrong white balance visible;
//! [`Gain::PerChannel`] removes it, for systems whose white balance is free.

use crate::EvalError;
use crate::image::check_shapes;
use crate::statistics::percentile;
use i2slam_geometry::Image;
use serde::Serialize;

/// Stops below white where the logarithm is cut off; also the peak of the logarithmic PSNR.
pub const LOG_RANGE_STOPS: f64 = 16.0;
/// Compression `μ` of the μ-law.
pub const MU: f64 = 5000.0;
/// Percentile of the true radiance that defines white.
pub const WHITE_PERCENTILE: f64 = 99.0;

/// Unobservable gain that is removed before radiance is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Gain {
    /// One gain for all channels.
    Common,
    /// One gain for each channel.
    PerChannel,
}

/// Errors of a radiance picture after the gain.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HdrError {
    /// The gains `g` that were multiplied onto the estimate: one, or one for each channel.
    pub gains: Vec<f64>,
    /// Root mean square of `log2 max(g L̂, ε) - log2 max(L, ε)` [stops], where `ε` lies
    /// [`LOG_RANGE_STOPS`] below white.
    pub log2_rmse_stops: f64,
    /// PSNR of log2 radiance [dB], `20 log10(LOG_RANGE_STOPS / log2_rmse_stops)`.
    pub log2_psnr_db: f64,
    /// PSNR [dB], peak 1, of `T(L) = ln(1 + μ tanh(L / white)) / ln(1 + μ)` with `μ = 5000`
    /// (Kalantari & Ramamoorthi 2017, eq. 4; division by the true picture's 99th percentile and
    /// tanh as in the NTIRE 2021 HDR challenge, Pérez-Pellitero et al. 2021).
    pub mu_law_psnr_db: f64,
    /// White level: the 99th percentile of the true samples.
    pub white: f64,
    /// Number of samples: pixels times channels.
    pub samples: usize,
}

/// Compares linear radiance after one gain, or one for each channel; below zero counts as 0.
pub fn hdr_error(
    gain: Gain,
    estimate: &Image<f32>,
    truth: &Image<f32>,
) -> Result<HdrError, EvalError> {
    check_shapes(estimate, truth)?;
    let (estimated, due) = rayon::join(
        || samples(estimate, "the estimated radiance"),
        || samples(truth, "the true radiance"),
    );
    let (mut estimated, due) = (estimated?, due?);
    let white = percentile(&due, WHITE_PERCENTILE)?;
    if white <= 0.0 {
        return Err(EvalError::NotPositive { what: "the 99th percentile of the true radiance" });
    }
    let together = match gain {
        Gain::Common => due.len(),
        Gain::PerChannel => due.len() / truth.channels,
    };
    let gains = remove_gains(&mut estimated, &due, together)?;
    let floor = white * (-LOG_RANGE_STOPS).exp2();
    let stops = |l: f64| l.max(floor).log2();
    let shown = |l: f64| (MU * (l / white).tanh()).ln_1p() / MU.ln_1p();
    let (of_stops, of_shown) = rayon::join(
        || mean_square(&estimated, &due, stops),
        || mean_square(&estimated, &due, shown),
    );
    let log2_rmse_stops = of_stops.sqrt();
    Ok(HdrError {
        gains,
        log2_rmse_stops,
        log2_psnr_db: 20.0 * (LOG_RANGE_STOPS / log2_rmse_stops).log10(),
        mu_law_psnr_db: -10.0 * of_shown.log10(),
        white,
        samples: due.len(),
    })
}

fn samples(image: &Image<f32>, what: &'static str) -> Result<Vec<f64>, EvalError> {
    if image.data.iter().any(|v| !v.is_finite()) {
        return Err(EvalError::NotFinite { what });
    }
    Ok(image.data.iter().map(|&v| f64::from(v).max(0.0)).collect())
}

/// Multiplies the samples by a gain for each run of `together`; gives the gains.
fn remove_gains(
    estimate: &mut [f64],
    truth: &[f64],
    together: usize,
) -> Result<Vec<f64>, EvalError> {
    let runs = estimate.chunks_mut(together).zip(truth.chunks(together));
    runs.map(|(estimate, truth)| {
        let gain = median_ratio(estimate, truth)?;
        estimate.iter_mut().for_each(|v| *v *= gain);
        Ok(gain)
    })
    .collect()
}

/// `exp(median(ln truth - ln estimate))` over samples above zero on both sides.
fn median_ratio(estimate: &[f64], truth: &[f64]) -> Result<f64, EvalError> {
    let both = estimate.iter().zip(truth).filter(|&(&e, &t)| e > 0.0 && t > 0.0);
    let ratios: Vec<f64> = both.map(|(e, t)| t.ln() - e.ln()).collect();
    if ratios.is_empty() {
        return Err(EvalError::NotPositive { what: "the estimated radiance" });
    }
    Ok(percentile(&ratios, 50.0)?.exp())
}

/// Mean of `(f(estimate) - f(truth))²`.
fn mean_square(estimate: &[f64], truth: &[f64], f: impl Fn(f64) -> f64) -> f64 {
    let square = |(&e, &t): (&f64, &f64)| (f(e) - f(t)).powi(2);
    estimate.iter().zip(truth).map(square).sum::<f64>() / truth.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn radiance(seed: u64) -> Image<f32> {
        let data = i2slam_check::noise(seed, 300);
        let data = data.iter().map(|v| (4.0 * v).exp2() as f32).collect();
        Image { width: 10, height: 10, channels: 3, data }
    }

    fn scaled(image: &Image<f32>, gain: impl Fn(usize) -> f32) -> Image<f32> {
        let data = image.data.iter().enumerate().map(|(i, v)| v * gain(i)).collect();
        Image { data, ..image.clone() }
    }

    #[test]
    fn a_global_gain_is_no_error() {
        let truth = radiance(1);
        let e = hdr_error(Gain::Common, &scaled(&truth, |_| 0.125), &truth).unwrap();
        assert!((e.gains[0] - 8.0).abs() < 1e-12 && e.gains.len() == 1);
        assert!(e.log2_psnr_db > 200.0 && e.mu_law_psnr_db > 200.0, "{e:?}");
    }

    #[test]
    fn half_a_stop_on_some_pixels_by_hand() {
        let truth = radiance(2);
        let e =
            hdr_error(Gain::Common, &scaled(&truth, |i| if i < 75 { 2.0 } else { 1.0 }), &truth);
        let e = e.unwrap();
        assert_eq!(e.gains, [1.0]);
        assert!((e.log2_rmse_stops - 0.5).abs() < 1e-12);
        assert!((e.log2_psnr_db - 20.0 * 32.0_f64.log10()).abs() < 1e-9);
    }

    #[test]
    fn mu_law_by_hand() {
        let image = |v: [f32; 3]| Image { width: 3, height: 1, channels: 1, data: v.to_vec() };
        let e = hdr_error(Gain::Common, &image([1.0, 1.0, 0.5]), &image([1.0; 3])).unwrap();
        let shown = |l: f64| (1.0 + 5000.0 * l.tanh()).ln() / 5001.0_f64.ln();
        let expected = -10.0 * ((shown(1.0) - shown(0.5)).powi(2) / 3.0).log10();
        assert!((e.mu_law_psnr_db - expected).abs() < 1e-9);
    }

    #[test]
    fn a_wrong_white_balance_is_an_error_unless_forgiven() {
        let truth = radiance(3);
        let tinted = scaled(&truth, |i| if i < 100 { 2.0 } else { 1.0 });
        assert!(hdr_error(Gain::Common, &tinted, &truth).unwrap().log2_rmse_stops > 0.5);
        let each = hdr_error(Gain::PerChannel, &tinted, &truth).unwrap();
        assert!((each.gains[0] - 0.5).abs() < 1e-12 && each.gains[1..] == [1.0, 1.0]);
        assert!(each.log2_rmse_stops < 1e-12);
    }

    #[test]
    fn unseen_pixels_cost_but_do_not_move_the_gain() {
        let truth = radiance(4);
        let holes = scaled(&truth, |i| if i % 100 < 20 { 0.0 } else { 1.0 });
        let e = hdr_error(Gain::Common, &holes, &truth).unwrap();
        assert_eq!(e.gains, [1.0]);
        assert!(e.log2_rmse_stops > 1.0);
    }

    #[test]
    fn invalid_input_is_refused() {
        let truth = radiance(5);
        let dark = scaled(&truth, |_| 0.0);
        let positive = |r| matches!(r, Err(EvalError::NotPositive { .. }));
        assert!(positive(hdr_error(Gain::Common, &dark, &truth)));
        assert!(positive(hdr_error(Gain::Common, &truth, &dark)));
        let poisoned = hdr_error(Gain::Common, &scaled(&truth, |_| f32::NAN), &truth);
        assert!(matches!(poisoned, Err(EvalError::NotFinite { .. })));
        let short = hdr_error(Gain::Common, &Image::new(3, 1, 3), &truth);
        assert!(matches!(short, Err(EvalError::ShapeMismatch { .. })));
    }
}
