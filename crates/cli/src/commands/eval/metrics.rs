//! The numbers of each protocol.

use crate::arguments::Protocol;
use i2slam::geometry::Image;
use i2slam_eval::EvalError;
use i2slam_eval::depth::depth_error;
use i2slam_eval::image::{
    lpips, ms_ssim, psnr, psnr_channel_mean, psnr_masked, psnr_monogs, psnr_splatam, ssim,
    ssim_padded,
};

/// A render and its truth.
pub(super) struct Pair {
    pub(super) picture: Image<f32>,
    pub(super) truth: Image<f32>,
    /// Rendered and true depth [m].
    pub(super) depth: Option<(Image<f32>, Image<f32>)>,
    /// Where the true depth is valid.
    pub(super) valid: Option<Vec<bool>>,
}

/// How one number is measured; `None` where the pair does not allow it.
pub(super) struct Metric {
    pub(super) key: &'static str,
    pub(super) label: &'static str,
    pub(super) unit: &'static str,
    pub(super) decimals: usize,
    pub(super) of: fn(&Pair) -> Result<Option<f64>, EvalError>,
}

const fn metric(
    key: &'static str,
    label: &'static str,
    unit: &'static str,
    of: fn(&Pair) -> Result<Option<f64>, EvalError>,
) -> Metric {
    let decimals = if unit.is_empty() { 4 } else { 2 };
    Metric { key, label, unit, decimals, of }
}

const DEPTH: Metric = Metric {
    key: "depth_l1_m",
    label: "depth L1",
    unit: "m",
    decimals: 4,
    of: |p| match &p.depth {
        Some((estimate, truth)) => measurable(depth_error(estimate, truth).map(|e| e.l1_m)),
        None => Ok(None),
    },
};

/// Of the whole picture.
const WHOLE: &[Metric] = &[
    metric("psnr_sharp_db", "sharp PSNR", "dB", |p| Ok(Some(psnr(&p.picture, &p.truth)?))),
    metric("psnr_channel_mean_db", "PSNR, mean over channels", "dB", |p| {
        Ok(Some(psnr_channel_mean(&p.picture, &p.truth)?))
    }),
    metric("psnr_valid_depth_db", "PSNR where depth is known", "dB", |p| match &p.valid {
        Some(valid) => measurable(psnr_masked(&p.picture, &p.truth, valid)),
        None => Ok(None),
    }),
    metric("ssim_sharp", "sharp SSIM", "", |p| measurable(ssim(&p.picture, &p.truth))),
    metric("ms_ssim_sharp", "MS-SSIM", "", |p| measurable(ms_ssim(&p.picture, &p.truth))),
    metric("lpips_sharp", "LPIPS (AlexNet)", "", |p| measurable(lpips(&p.picture, &p.truth))),
    DEPTH,
];

/// Both pictures black where the true depth is not known; needs [`Pair::valid`].
const SPLATAM: &[Metric] = &[
    metric("psnr_splatam_db", "PSNR as SplaTAM", "dB", |p| match &p.valid {
        Some(valid) => Ok(Some(psnr_splatam(&p.picture, &p.truth, valid)?)),
        None => Ok(None),
    }),
    metric("ms_ssim_splatam", "MS-SSIM as SplaTAM", "", |p| masked(p, ms_ssim)),
    metric("lpips_splatam", "LPIPS as SplaTAM", "", |p| masked(p, lpips)),
    DEPTH,
];

const MONOGS: &[Metric] = &[
    metric("psnr_monogs_db", "PSNR as MonoGS", "dB", |p| {
        measurable(psnr_monogs(&p.picture, &p.truth))
    }),
    metric("ssim_monogs", "SSIM as MonoGS", "", |p| Ok(Some(ssim_padded(&p.picture, &p.truth)?))),
    metric("lpips_monogs", "LPIPS (AlexNet)", "", |p| measurable(lpips(&p.picture, &p.truth))),
];

/// The numbers of a protocol, in the order of the table.
pub(super) fn of(protocol: Protocol) -> &'static [Metric] {
    match protocol {
        Protocol::AllFrames | Protocol::I2slam | Protocol::HeldOut => WHOLE,
        Protocol::Splatam => SPLATAM,
        Protocol::Monogs => MONOGS,
    }
}

/// Pictures too small for a measure, or without a pixel to judge, have no such number.
fn measurable(result: Result<f64, EvalError>) -> Result<Option<f64>, EvalError> {
    match result {
        Ok(value) => Ok(Some(value)),
        Err(EvalError::TooFew { .. }) => Ok(None),
        Err(error) => Err(error),
    }
}

fn masked(
    pair: &Pair,
    measure: fn(&Image<f32>, &Image<f32>) -> Result<f64, EvalError>,
) -> Result<Option<f64>, EvalError> {
    let Some(valid) = &pair.valid else { return Ok(None) };
    let black = |image: &Image<f32>| {
        let mut image = image.clone();
        for channel in 0..image.channels {
            for (value, valid) in image.plane_mut(channel).iter_mut().zip(valid) {
                *value *= f32::from(*valid);
            }
        }
        image
    };
    measurable(measure(&black(&pair.picture), &black(&pair.truth)))
}
