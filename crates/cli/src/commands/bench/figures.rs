//! Figures of cells, and how they are shown.

use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

/// Figures by their key in `metrics.json` and `eval --json`.
pub(super) type Figures = BTreeMap<String, f64>;

/// A figure of the tables.
#[derive(Debug, PartialEq)]
pub(super) struct Figure {
    pub(super) key: &'static str,
    pub(super) label: &'static str,
    pub(super) unit: &'static str,
    /// From the unit of the file to the one shown.
    pub(super) factor: f64,
    pub(super) decimals: usize,
    /// Whether less is better.
    pub(super) lower: bool,
}

const fn figure(
    key: &'static str,
    label: &'static str,
    (unit, factor): (&'static str, f64),
    decimals: usize,
    lower: bool,
) -> Figure {
    Figure { key, label, unit, factor, decimals, lower }
}

pub(super) const ATE: Figure = figure("ate_rmse_m", "ATE", ("cm", 100.0), 2, true);
pub(super) const PSNR: Figure = figure("psnr_sharp_db", "PSNR", ("dB", 1.0), 2, false);
pub(super) const SSIM: Figure = figure("ssim_sharp", "SSIM", ("", 1.0), 3, false);
pub(super) const LPIPS: Figure = figure("lpips_sharp", "LPIPS", ("", 1.0), 3, true);
pub(super) const DEPTH: Figure = figure("depth_l1_m", "Depth L1", ("cm", 100.0), 2, true);
pub(super) const MAPPING: Figure =
    figure("mapping_seconds_per_frame", "Mapping/frame", ("s", 1.0), 3, true);
pub(super) const TRACKING: Figure =
    figure("tracking_seconds_per_frame", "Tracking/frame", ("s", 1.0), 3, true);
pub(super) const SECONDS: Figure =
    figure("seconds_per_frame", "Whole run/frame", ("s", 1.0), 3, true);
pub(super) const MEMORY: Figure = figure("peak_memory_bytes", "Peak memory", ("MB", 1e-6), 0, true);

impl Figure {
    /// `ATE [cm] ↓`.
    pub(super) fn heading(&self) -> String {
        let arrow = if self.lower { '↓' } else { '↑' };
        match self.unit {
            "" => format!("{} {arrow}", self.label),
            unit => format!("{} [{unit}] {arrow}", self.label),
        }
    }

    /// A value in the unit shown; lengths below one unit get a digit more.
    pub(super) fn text(&self, value: f64) -> String {
        format!("{:.*}", self.digits(value), value * self.factor)
    }

    /// Decimals that a value is shown with.
    pub(super) fn digits(&self, value: f64) -> usize {
        let small = self.unit == "cm" && (value * self.factor).abs() < 0.995;
        self.decimals + usize::from(small)
    }
}

/// What a list of frames decides: never the same figure over other frames.
const OF_PICTURES: [&str; 6] =
    ["psnr_sharp_db", "ssim_sharp", "lpips_sharp", "ms_ssim_sharp", "depth_l1_m", "sharp_frames"];

/// All numbers of a flat JSON file.
pub(super) fn read(file: &Path) -> Option<Figures> {
    let text = std::fs::read_to_string(file).ok()?;
    let Ok(Value::Object(object)) = serde_json::from_str(&text) else { return None };
    let number = |(key, value): (String, Value)| {
        value.as_f64().filter(|v| v.is_finite()).map(|value| (key, value))
    };
    Some(object.into_iter().filter_map(number).collect())
}

/// The figures of a finished cell: those of its `metrics.json`, and from `eval.json` what that
/// does not have. With a list of frames, figures of pictures come from `eval.json` alone.
pub(super) fn of_cell(folder: &Path, listed: bool) -> Option<Figures> {
    let mut figures = read(&folder.join("result/metrics.json"))?;
    if listed {
        figures.retain(|key, _| !OF_PICTURES.contains(&key.as_str()));
    }
    for (key, value) in read(&folder.join("eval.json")).unwrap_or_default() {
        figures.entry(key).or_insert(value);
    }
    Some(figures)
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
        let folder = std::env::temp_dir().join(format!("i2slam-figures-{}", std::process::id()));
        std::fs::create_dir_all(folder.join("result")).expect("a folder");
        let metrics = r#"{"preset": "x", "psnr_sharp_db": 30, "ate_rmse_m": 0.1, "seed": null}"#;
        std::fs::write(folder.join("result/metrics.json"), metrics).expect("room");
        let judged =
            r#"{"psnr_sharp_db": 20, "lpips_sharp": 0.2, "ate_rmse_m": 0.3, "frames": []}"#;
        std::fs::write(folder.join("eval.json"), judged).expect("room");
        let all = of_cell(&folder, false).expect("figures");
        assert_eq!((all["psnr_sharp_db"], all["lpips_sharp"], all["ate_rmse_m"]), (30.0, 0.2, 0.1));
        assert_eq!(all.len(), 3);
        let listed = of_cell(&folder, true).expect("figures");
        assert_eq!((listed["psnr_sharp_db"], listed["ate_rmse_m"]), (20.0, 0.1));
        std::fs::remove_dir_all(&folder).ok();
        assert_eq!(of_cell(&folder, false), None);
    }
}
