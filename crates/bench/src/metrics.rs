//! Metrics of jobs: keys, units, and format.

use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

/// Metrics by their key in `metrics.json` and `eval --json`.
pub(crate) type Metrics = BTreeMap<String, f64>;

/// A metric with key, unit and format.
#[derive(Debug, PartialEq)]
pub(crate) struct Metric {
    pub(crate) key: &'static str,
    pub(crate) label: &'static str,
    pub(crate) unit: &'static str,
    /// Factor from the unit of the file to the one shown.
    pub(crate) factor: f64,
    pub(crate) decimals: usize,
    /// Whether less is better.
    pub(crate) lower: bool,
}

const fn metric(
    key: &'static str,
    label: &'static str,
    (unit, factor): (&'static str, f64),
    decimals: usize,
    lower: bool,
) -> Metric {
    Metric { key, label, unit, factor, decimals, lower }
}

pub(crate) const ATE: Metric = metric("ate_rmse_m", "ATE", ("cm", 100.0), 2, true);
pub(crate) const PSNR: Metric = metric("psnr_sharp_db", "PSNR", ("dB", 1.0), 2, false);
pub(crate) const SSIM: Metric = metric("ssim_sharp", "SSIM", ("", 1.0), 3, false);
pub(crate) const LPIPS: Metric = metric("lpips_sharp", "LPIPS", ("", 1.0), 3, true);
pub(crate) const DEPTH: Metric = metric("depth_l1_m", "Depth L1", ("cm", 100.0), 2, true);
pub(crate) const GAUSSIANS: Metric = metric("gaussians", "Gaussians", ("k", 1e-3), 0, true);
pub(crate) const PINHOLES: Metric = metric("pinholes", "Pinholes", ("%", 100.0), 2, true);
pub(crate) const SEE_THROUGH: Metric = metric("see_through", "See-through", ("%", 100.0), 2, true);
pub(crate) const OFF_SURFACE: Metric =
    metric("off_surface", "Off the surface", ("%", 100.0), 2, true);
pub(crate) const MAPPING: Metric =
    metric("mapping_seconds_per_frame", "Mapping/frame", ("s", 1.0), 3, true);
pub(crate) const TRACKING: Metric =
    metric("tracking_seconds_per_frame", "Tracking/frame", ("s", 1.0), 3, true);
pub(crate) const SECONDS: Metric =
    metric("seconds_per_frame", "Whole run/frame", ("s", 1.0), 3, true);
pub(crate) const MEMORY: Metric = metric("peak_memory_bytes", "Peak memory", ("MB", 1e-6), 0, true);

impl Metric {
    /// Column heading, as `ATE [cm] ↓`.
    pub(crate) fn heading(&self) -> String {
        let arrow = if self.lower { '↓' } else { '↑' };
        match self.unit {
            "" => format!("{} {arrow}", self.label),
            unit => format!("{} [{unit}] {arrow}", self.label),
        }
    }

    /// A value in the unit shown.
    pub(crate) fn text(&self, value: f64) -> String {
        format!("{:.*}", self.digits(value), value * self.factor)
    }

    /// Decimals of a value; lengths below one unit get one more.
    pub(crate) fn digits(&self, value: f64) -> usize {
        let small = self.unit == "cm" && (value * self.factor).abs() < 0.995;
        self.decimals + usize::from(small)
    }
}

/// Metrics that depend on the judged frames.
const PICTURE_METRICS: [&str; 6] =
    ["psnr_sharp_db", "ssim_sharp", "lpips_sharp", "ms_ssim_sharp", "depth_l1_m", "sharp_frames"];

/// All numbers of a flat JSON file.
pub(crate) fn read(file: &Path) -> Option<Metrics> {
    let text = std::fs::read_to_string(file).ok()?;
    let Ok(Value::Object(object)) = serde_json::from_str(&text) else { return None };
    let number = |(key, value): (String, Value)| {
        value.as_f64().filter(|v| v.is_finite()).map(|value| (key, value))
    };
    Some(object.into_iter().filter_map(number).collect())
}

/// File with the metrics that the benchmark measures itself.
pub(crate) const OWN: &str = "own.json";

/// The metrics of a finished job: those of `metrics.json`, completed by `eval.json` and [`OWN`]. Where a
/// protocol chose the frames, metrics of pictures come from `eval.json` alone.
pub(crate) fn of_job(folder: &Path, with_protocol: bool) -> Option<Metrics> {
    let mut metrics = read(&folder.join("result/metrics.json"))?;
    if with_protocol {
        metrics.retain(|key, _| !PICTURE_METRICS.contains(&key.as_str()));
    }
    for file in ["eval.json", OWN] {
        for (key, value) in read(&folder.join(file)).unwrap_or_default() {
            metrics.entry(key).or_insert(value);
        }
    }
    Some(metrics)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_lengths_keep_their_digits() {
        assert_eq!(ATE.text(0.0256), "2.56");
        assert_eq!(ATE.text(0.000_33), "0.033");
        assert_eq!(ATE.text(0.009_96), "1.00");
        assert_eq!(SSIM.text(0.9644), "0.964");
        assert_eq!(ATE.heading(), "ATE [cm] ↓");
    }

    #[test]
    fn a_list_decides_which_pictures_count() {
        let folder = std::env::temp_dir().join(format!("i2slam-metrics-{}", std::process::id()));
        std::fs::create_dir_all(folder.join("result")).expect("a folder");
        let metrics = r#"{"preset": "x", "psnr_sharp_db": 30, "ate_rmse_m": 0.1, "seed": null}"#;
        std::fs::write(folder.join("result/metrics.json"), metrics).expect("room");
        let judged =
            r#"{"psnr_sharp_db": 20, "lpips_sharp": 0.2, "ate_rmse_m": 0.3, "frames": []}"#;
        std::fs::write(folder.join("eval.json"), judged).expect("room");
        let all = of_job(&folder, false).expect("metrics");
        assert_eq!((all["psnr_sharp_db"], all["lpips_sharp"], all["ate_rmse_m"]), (30.0, 0.2, 0.1));
        assert_eq!(all.len(), 3);
        let listed = of_job(&folder, true).expect("metrics");
        assert_eq!((listed["psnr_sharp_db"], listed["ate_rmse_m"]), (20.0, 0.1));
        std::fs::remove_dir_all(&folder).ok();
        assert_eq!(of_job(&folder, false), None);
    }
}
