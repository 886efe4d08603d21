//! The first screen of the report: one sentence and the main figures.

use super::Report;
use crate::html::escape;
use crate::numbers::{significant, thousands};
use crate::{Metrics, UnitOfLength, depth_registration_line, rolling_shutter_line};
use std::fmt::Write;

/// A sentence that sums up the run.
pub(super) fn lead(report: &Report<'_>) -> String {
    let metrics = report.metrics;
    let end = match metrics.complete {
        true => "",
        false => " The run was ended early: its map is not refined, or some frames are missing.",
    };
    let unit = match (metrics.unit_of_length, metrics.depth_scale_assumed) {
        (UnitOfLength::Metre, None) => String::new(),
        (UnitOfLength::Metre, Some(scale)) => format!(
            " Lengths hold if {scale} in the depth pictures is one metre, which was assumed: \
             <code>--depth-scale</code> gives it."
        ),
        (UnitOfLength::Keyframes, _) => {
            " Unit of length and world are those of the keyframes given; \
             where lengths are given in metres below, read: in that unit, but for errors against \
             ground truth."
                .into()
        }
        (UnitOfLength::Unknown, _) => " Unit of length: unknown, because pictures alone do not \
             tell the scale; where lengths are given in metres below, read: in that unit, but for \
             errors against ground truth."
            .into(),
    };
    format!(
        "{}{} Preset <code>{}</code>, seed {}.{end}{unit}",
        degradation(metrics),
        summary(metrics, map_and_path(report), &escape(report.title)),
        escape(&metrics.preset),
        metrics.seed,
    )
}

/// Words for the outcome of a run that ended early or found only part of its frames.
fn map_and_path(report: &Report<'_>) -> &'static str {
    match report.reconstruction.map.is_empty() {
        true => "A camera path, without a map,",
        false => "A map of light and a camera path",
    }
}

/// A sentence on the frames of a sequence that became a map and a path, in words.
fn summary(metrics: &Metrics, made: &str, title: &str) -> String {
    let given = given(metrics);
    let noun = if metrics.unordered { "photograph" } else { "blurred frame" };
    let nouns = format!("{noun}{}", if given == 1 { "" } else { "s" });
    match metrics.tracked {
        tracked if tracked < given => format!(
            "{made} of {tracked} of {given} {nouns} of <b>{title}</b>; no pose was found of the other {}.",
            given - tracked
        ),
        _ if metrics.degraded || !metrics.complete => {
            format!("{made} of {given} {nouns} of <b>{title}</b>.")
        }
        _ => format!(
            "{given} {nouns} of <b>{title}</b> became one sharp map of light and a camera path."
        ),
    }
}

/// Why the result is degraded; empty if it is not.
fn degradation(metrics: &Metrics) -> String {
    if !metrics.degraded {
        return String::new();
    }
    let because = escape(&metrics.degraded_because.join("; "));
    format!("<strong>This result is degraded: {because}.</strong> ")
}

/// PSNR of the pictures taken, beside which that of renders stands.
fn taken(metrics: &Metrics) -> String {
    let Some(taken) = metrics.psnr_taken_db else { return String::new() };
    let all = format!(" The pictures taken have {taken:.1} dB");
    match (metrics.psnr_sharp_over_2px_db, metrics.psnr_taken_over_2px_db) {
        (Some(sharp), Some(taken)) => format!(
            "{all}; of the {} blurred over more than 2 px renders have {sharp:.1}, the pictures \
             taken {taken:.1} dB.",
            metrics.frames_over_2px
        ),
        _ => format!("{all}."),
    }
}

/// The main figures, each with a line of explanation.
pub(super) fn cards(metrics: &Metrics) -> String {
    let mut out = String::new();
    let mut count = 0;
    let mut card = |value: String, unit: &str, name: &str, meaning: &str| {
        count += 1;
        write!(
            out,
            "<div class=\"card\"><dt>{name}</dt><dd><b>{value}</b><small>{unit}</small></dd>\
             <p>{meaning}</p></div>"
        )
        .ok();
    };
    let of_all = format!("of {}", given(metrics));
    let name = if metrics.unordered { "Photographs placed" } else { "Frames tracked" };
    card(metrics.tracked.to_string(), &of_all, name, "The camera's pose was found.");
    if let Some(error) = metrics.ate_rmse_m {
        let meaning = match metrics.ate_scale_aligned {
            false => {
                "Distance of the estimated from the true camera positions (RMSE after rigid \
                 alignment)."
            }
            true => {
                "Distance of the estimated from the true camera positions (RMSE after alignment \
                 with scale, which colour alone does not tell)."
            }
        };
        card(significant(error * 100.0), "cm", "Trajectory error", meaning);
    }
    if let Some(psnr) = metrics.psnr_sharp_db {
        let part = match metrics.sharp_frames < metrics.frames {
            true => format!(" of {} of {} frames", metrics.sharp_frames, metrics.frames),
            false => String::new(),
        };
        let meaning =
            format!("Sharp renders against the true sharp pictures{part}. Higher is better.");
        card(format!("{psnr:.1}"), "dB", "Sharp PSNR", &format!("{meaning}{}", taken(metrics)));
    }
    if let Some(psnr) = metrics.psnr_blurred_db {
        let meaning = "How well blur, exposure and map together predict the pictures taken. \
                       30 dB is a good match.";
        card(format!("{psnr:.1}"), "dB", "Prediction PSNR", meaning);
    }
    if let Some(blur) = metrics.blur_length_px_max {
        let meaning =
            "In the most blurred frame, the streak a point draws while the shutter is open.";
        card(format!("{blur:.1}"), "px", "Longest blur", meaning);
    }
    let seconds = significant(metrics.seconds_per_frame);
    card(seconds, "s", "Time per frame", "The whole run, divided by its frames.");
    if let Some(source) = &metrics.camera_source {
        let focal = format!("Focal length {:.1} px", metrics.focal_length_px);
        let meaning = match metrics.focal_length_assumed_px {
            Some(assumed) => {
                format!("{focal}, from {} ({assumed:.1} px).", escape(source))
            }
            None => format!("{focal}, from {}.", escape(source)),
        };
        let lens = metrics
            .lens_distortion
            .map(|[k1, k2]| format!(" Lens distortion found and removed: k1 {k1:.4}, k2 {k2:.4}."));
        let meaning = meaning + &lens.unwrap_or_default() + &sensor(metrics);
        let view = format!("{:.1}", metrics.horizontal_fov_deg);
        card(view, "degrees", "Field of view", &meaning);
    }
    if metrics.gaussians > 0 {
        let gaussians = thousands(metrics.gaussians);
        card(gaussians, "", "Gaussians", "Soft blobs of light that make up the map.");
    }
    if let Some(correlation) = metrics.log_exposure_correlation {
        let meaning = "Correlation of recovered and true log exposure. 1 is perfect.";
        card(format!("{correlation:.3}"), "", "Exposure", meaning);
    }
    // Rows of four, or of three where four would leave one or two alone.
    let columns = if matches!(count % 4, 1 | 2) { 3 } else { 4 };
    format!("<dl class=\"cards\" style=\"--columns:{columns}\">{out}</dl>")
}

/// Sentences on rows and depth that were not taken at once.
fn sensor(metrics: &Metrics) -> String {
    let rows = rolling_shutter_line(metrics.rolling_shutter_readout_s);
    let depth = depth_registration_line(metrics.depth_delay_s, metrics.depth_shift_px);
    rows.iter()
        .chain(&depth)
        .map(|line| format!(" {}{}.", line[..1].to_uppercase(), &line[1..]))
        .collect()
}

/// Frames of the input; earlier versions counted only those with a pose.
fn given(metrics: &Metrics) -> usize {
    metrics.frames_given.max(metrics.frames)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_and_depth_that_were_not_taken_at_once_are_told() {
        let camera = Some("camera.json".to_owned());
        let plain = Metrics { camera_source: camera, ..Metrics::default() };
        assert!(!cards(&plain).contains("ms"));
        let late = Metrics { rolling_shutter_readout_s: 0.0263, depth_delay_s: -0.0134, ..plain };
        let cards = cards(&late);
        let rows = "camera.json. Rolling shutter: rows read in 26.3 ms. Depth pictures: taken 13.4 ms \
                    before their time stamps, which is corrected.";
        assert!(cards.contains(rows), "{cards}");
    }
}
