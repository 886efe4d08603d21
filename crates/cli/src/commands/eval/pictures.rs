//! Errors of rendered pictures and radiance, by the metrics of each protocol.

use super::estimate::Estimate;
use super::frames::{FrameSelection, shortened};
use super::metric_value::{MetricValue, TableRow};
use super::reference::{Reference, checksum};
use super::{Eval, Protocol};
use crate::console::counted;
use crate::failure::{Failure, failed};
use crate::image_files::{at_size_of, read_depth, read_exr, read_png, stacked};
use crate::progress::Progress;
use i2slam::geometry::Image;
use i2slam_eval::EvalError;
use i2slam_eval::depth::depth_error;
use i2slam_eval::hdr::{Gain, HdrError, hdr_error};
use i2slam_eval::image::{
    lpips, ms_ssim, psnr, psnr_channel_mean, psnr_masked, psnr_monogs, ssim, ssim_padded,
};
use rayon::prelude::*;
use serde_json::{Map, Value, json};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Metrics of all evaluated frames.
pub(super) struct PictureErrors {
    metrics: &'static [Metric],
    /// Frame number, and one value per metric.
    rows: Vec<(usize, Vec<Option<f64>>)>,
    missing: Vec<usize>,
    /// CRC-32 of the true picture of every row.
    pub(super) checksums: Vec<u32>,
    /// Name of the list that selected the frames.
    pub(super) list: Option<String>,
}

/// Measures every selected frame; true lengths are `scale` times those of the estimate.
pub(super) fn evaluate(
    arguments: &Eval,
    (estimate, reference): (&Estimate, &Reference),
    scale: f64,
    chosen: FrameSelection,
) -> Result<PictureErrors, Failure> {
    if arguments.protocol == Protocol::Splatam && matches!(reference, Reference::Folder { .. }) {
        return Err(Failure::usage(
            "--protocol splatam needs true depth: give the dataset as --reference",
        ));
    }
    let metrics = metrics_of(arguments.protocol);
    let progress = Progress::new(chosen.frames.len(), arguments.machine.quiet);
    let done = AtomicUsize::new(0);
    let row = |(frame, render): &(usize, std::path::PathBuf)| {
        let mut pair = pair(estimate, reference, *frame, render)?;
        // Depth was drawn at the estimated pose.
        pair.depth = pair.depth.filter(|_| !arguments.optimise_poses);
        if let Some((drawn, _)) = &mut pair.depth {
            drawn.data.iter_mut().for_each(|depth| *depth *= scale as f32);
        }
        let values = metrics.iter().map(|metric| (metric.measure)(&pair));
        let values: Result<Vec<_>, _> = values.collect();
        let values = values.map_err(|e| failed(render, e))?;
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        progress.step("judging pictures", done, chosen.frames.len());
        Ok(((*frame, values), checksum(&pair.truth)))
    };
    let rows: Result<Vec<_>, Failure> = chosen.frames.par_iter().map(row).collect();
    progress.clear();
    let (rows, checksums) = rows?.into_iter().unzip();
    Ok(PictureErrors { metrics, rows, checksums, missing: chosen.missing, list: chosen.list })
}

fn pair(
    estimate: &Estimate,
    reference: &Reference,
    frame: usize,
    render: &Path,
) -> Result<PicturePair, Failure> {
    let picture = read_png(render)?;
    let truth = reference.load(frame)?;
    let size = (truth.colour.width, truth.colour.height);
    let sizes = || {
        format!(
            "{}x{} pixels, its truth in {} has {}x{}",
            picture.width,
            picture.height,
            reference.path().display(),
            size.0,
            size.1
        )
    };
    // Renders of a run may be smaller than a reference that was made for the recorded size.
    let colour = match estimate {
        Estimate::Result(_) => at_size_of(truth.colour, &picture),
        _ => (size == (picture.width, picture.height)).then_some(truth.colour),
    };
    let colour = colour.ok_or_else(|| failed(render, sizes()))?;
    let valid = truth.depth.as_ref().map(|d| d.data.iter().map(|z| *z > 0.0).collect::<Vec<_>>());
    let valid = valid.filter(|valid| valid.len() == colour.pixels());
    let drawn = estimate.result().map(|r| r.join(format!("renders/depth/{frame:06}.png")));
    let drawn = drawn.filter(|file| file.is_file()).map(|file| read_depth(&file)).transpose()?;
    Ok(PicturePair { picture, truth: colour, depth: drawn.zip(truth.depth), valid })
}

impl PictureErrors {
    /// Evaluated frames.
    pub(super) fn frames(&self) -> Vec<usize> {
        self.rows.iter().map(|(frame, _)| *frame).collect()
    }

    /// Mean of every metric over the frames where it is finite.
    pub(super) fn metric_values(&self) -> Vec<MetricValue> {
        let column = |i: usize| {
            let values = self.rows.iter().filter_map(move |(_, row)| row[i]);
            let finite: Vec<f64> = values.filter(|v| v.is_finite()).collect();
            (!finite.is_empty()).then(|| finite.iter().sum::<f64>() / finite.len() as f64)
        };
        let figure = |(i, m): (usize, &Metric)| MetricValue {
            key: m.key,
            label: m.label,
            unit: m.unit,
            decimals: m.decimals,
            value: column(i),
        };
        self.metrics.iter().enumerate().map(figure).collect()
    }

    /// Number of renders equal to the true picture: their PSNR is infinite and in no mean.
    fn equal(&self) -> usize {
        self.rows.iter().filter(|(_, row)| row[0] == Some(f64::INFINITY)).count()
    }

    /// Table rows of all measurable metrics.
    pub(super) fn rows(&self) -> Vec<TableRow> {
        let list = self.list.as_ref().map(|list| format!(", list {list}")).unwrap_or_default();
        let count = self.rows.len().to_string();
        let mut rows =
            vec![TableRow { name: "frames evaluated".to_owned(), number: count, rest: list }];
        let known = self.metric_values().into_iter().filter(|figure| figure.value.is_some());
        rows.extend(known.map(|figure| figure.row()));
        rows
    }

    /// Notes and warnings that qualify the table.
    pub(super) fn remarks(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        if !self.missing.is_empty() {
            let (count, names) = (self.missing.len(), shortened(&self.missing));
            let count = counted(count, "frame");
            remarks.push(format!("warning: {count} without a render not evaluated ({names})"));
        }
        if self.equal() > 0 {
            let words = match self.equal() {
                1 => "1 render equals its".to_owned(),
                count => format!("{count} renders equal their"),
            };
            remarks.push(format!("note: {words} truth, in no mean of PSNR"));
        }
        remarks
    }

    pub(super) fn json(&self) -> Map<String, Value> {
        let mut object: Map<String, Value> =
            self.metric_values().iter().map(MetricValue::json).collect();
        object.insert("sharp_frames".to_owned(), self.rows.len().into());
        object.insert("list".to_owned(), json!(self.list));
        object.insert("equal_frames".to_owned(), self.equal().into());
        object.insert("missing_frames".to_owned(), json!(self.missing));
        let frame = |(index, row): &(usize, Vec<Option<f64>>)| {
            let values = self.metrics.iter().zip(row).map(|(m, v)| (m.key.to_owned(), json!(v)));
            let mut frame: Map<String, Value> = values.collect();
            frame.insert("index".to_owned(), (*index).into());
            Value::Object(frame)
        };
        let frames = self.rows.iter().map(frame).collect();
        object.insert("frames".to_owned(), Value::Array(frames));
        object
    }
}

/// A render and its truth.
pub(super) struct PicturePair {
    pub(super) picture: Image<f32>,
    pub(super) truth: Image<f32>,
    /// Rendered and true depth [m].
    pub(super) depth: Option<(Image<f32>, Image<f32>)>,
    /// Pixels with a true depth.
    pub(super) valid: Option<Vec<bool>>,
}

/// A metric; `None` for a pair on which it is not defined.
pub(super) struct Metric {
    pub(super) key: &'static str,
    pub(super) label: &'static str,
    pub(super) unit: &'static str,
    pub(super) decimals: usize,
    pub(super) measure: fn(&PicturePair) -> Result<Option<f64>, EvalError>,
}

const fn metric(
    key: &'static str,
    label: &'static str,
    unit: &'static str,
    measure: fn(&PicturePair) -> Result<Option<f64>, EvalError>,
) -> Metric {
    let decimals = if unit.is_empty() { 4 } else { 2 };
    Metric { key, label, unit, decimals, measure }
}

const DEPTH: Metric = Metric {
    key: "depth_l1_m",
    label: "depth L1",
    unit: "m",
    decimals: 4,
    measure: |p| match &p.depth {
        Some((estimate, truth)) => measurable(depth_error(estimate, truth).map(|e| e.l1_m)),
        None => Ok(None),
    },
};

/// Metrics of whole pictures.
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

/// Metrics of SplaTAM: both pictures are black where there is no true depth, which counts as
/// perfect. Needs [`PicturePair::valid`].
const SPLATAM: &[Metric] = &[
    metric("psnr_splatam_db", "PSNR as SplaTAM", "dB", |p| masked(p, psnr_channel_mean)),
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

/// Metrics of a protocol, in the order of the table.
fn metrics_of(protocol: Protocol) -> &'static [Metric] {
    match protocol {
        Protocol::AllFrames | Protocol::I2slam | Protocol::HeldOut => WHOLE,
        Protocol::Splatam => SPLATAM,
        Protocol::Monogs => MONOGS,
    }
}

/// Turns "too few pixels" into `None`.
fn measurable(result: Result<f64, EvalError>) -> Result<Option<f64>, EvalError> {
    match result {
        Ok(value) => Ok(Some(value)),
        Err(EvalError::TooFew { .. }) => Ok(None),
        Err(error) => Err(error),
    }
}

fn masked(
    pair: &PicturePair,
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

/// Largest number of frames for radiance, as all are held in memory; of more, every n-th is used.
const MAX_RADIANCE_FRAMES: usize = 100;

/// Radiance errors after one common gain; empty if there is no radiance to compare. Missing
/// renders are reported with the pictures.
pub(super) fn evaluate_radiance(
    estimate: &Estimate,
    reference: &Reference,
    chosen: &FrameSelection,
) -> Result<Vec<MetricValue>, Failure> {
    let renders = estimate.renders("hdr", "exr")?;
    let listed =
        |frame: &usize| chosen.frames.is_empty() || chosen.frames.iter().any(|(f, _)| f == frame);
    let pairs: Vec<_> = renders
        .iter()
        .filter(|(frame, _)| listed(frame))
        .filter_map(|(frame, render)| Some((render, reference.radiance(*frame)?)))
        .collect();
    let mut frames: [Vec<Image<f32>>; 2] = [Vec::new(), Vec::new()];
    for (render, truth) in pairs.iter().step_by(pairs.len().div_ceil(MAX_RADIANCE_FRAMES).max(1)) {
        let drawn = read_exr(render)?;
        let known = at_size_of(read_exr(truth)?, &drawn);
        let known = known.ok_or_else(|| failed(render, "has another size than its truth"))?;
        if frames[0].first().is_some_and(|first| first.width != drawn.width) {
            return Err(failed(render, "has another width than the frames before"));
        }
        frames[0].push(drawn);
        frames[1].push(known);
    }
    if frames[0].is_empty() {
        return Ok(Vec::new());
    }
    let count = frames[0].len();
    let [drawn, known] = frames.map(|frames| stacked(&frames));
    let common = hdr_error(Gain::Common, &drawn, &known)?;
    let each = hdr_error(Gain::PerChannel, &drawn, &known)?;
    Ok(radiance_values(&common, &each, count))
}

fn radiance_values(common: &HdrError, each: &HdrError, frames: usize) -> Vec<MetricValue> {
    let figure = |key, label, unit, decimals, value| MetricValue {
        key,
        label,
        unit,
        decimals,
        value: Some(value),
    };
    let db = |key, label, value| figure(key, label, "dB", 2, value);
    let (log2, mu_law) = ("log2 PSNR, gain per channel", "mu-law, gain per channel");
    vec![
        figure("hdr_frames", "radiance: frames evaluated", "", 0, frames as f64),
        figure("hdr_log2_rmse_stops", "log2 radiance RMSE", "stops", 3, common.log2_rmse_stops),
        db("hdr_log2_psnr_db", "log2 radiance PSNR", common.log2_psnr_db),
        db("hdr_mu_law_psnr_db", "mu-law PSNR", common.mu_law_psnr_db),
        db("hdr_log2_psnr_channel_gains_db", log2, each.log2_psnr_db),
        db("hdr_mu_law_psnr_channel_gains_db", mu_law, each.mu_law_psnr_db),
    ]
}
