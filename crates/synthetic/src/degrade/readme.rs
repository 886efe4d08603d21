//! The README of a degraded sequence.

use super::{Degradation, DepthDegradation};
use std::ops::Range;

/// Contents of the README of a copy of `name` with `frames` frames.
pub(super) fn readme(name: &str, what: &Degradation, frames: usize) -> String {
    let ranges = |ranges: &[Range<usize>]| {
        let words: Vec<String> = ranges.iter().map(|r| format!("{}..{}", r.start, r.end)).collect();
        if words.is_empty() { "none".into() } else { words.join(", ") }
    };
    let steps = what.exposure_steps.iter();
    let steps: Vec<String> = steps.map(|s| format!("{} stops from {}", s.stops, s.frame)).collect();
    let noise = what.sensor_noise.as_ref();
    let noise = noise.map_or("none".into(), |n| format!("read {}, shot {}", n.read, n.shot));
    let vignetting = what.vignetting;
    let vignetting = vignetting
        .map_or("none".into(), |v| format!("{v} of the light in the corners (vignetting.json)"));
    let object = what.moving_object;
    let object = object.map_or("none".into(), |share| format!("{share} of the picture"));
    // The name of a folder is no Markdown.
    let name = name.replace(char::is_control, " ").replace('<', "&lt;").replace('[', "\\[");
    format!(
        "# {name}, degraded\n\nMade by `i2slam degrade` with seed {}. Frames are counted in the source; \
         source.csv names the source of every frame here.\n\n\
         - size over the source's: {}\n{}- vignetting: {vignetting}\n- sensor noise: {noise}\n- exposure steps: {}\n\
         - dropped by chance: {}, by range: {}\n- covered lens: {}\n- grey: {}\n- frozen: {}\n\
         - shuffled: {}\n- moving object: {object}\n- assumed response: {}\n- frames: {frames}\n",
        what.seed,
        what.scale,
        depth_lines(&what.depth),
        if steps.is_empty() { "none".into() } else { steps.join(", ") },
        what.drop_share,
        ranges(&what.dropped),
        ranges(&what.covered),
        ranges(&what.grey),
        ranges(&what.frozen),
        ranges(&what.shuffled),
        what.response.name(),
    )
}

fn depth_lines(depth: &DepthDegradation) -> String {
    let noise = match &depth.noise {
        Some(noise) => format!("axial {:?}, lateral {} px", noise.axial, noise.lateral),
        None => "none".into(),
    };
    let [right, down] = depth.shift;
    format!(
        "- Kinect-like depth noise: {noise}\n- depth late by {} ms\n- depth in blocks of {} px\n\
         - depth smoothed by {} px\n- factor on depth: {}\n- depth shifted by {right}, {down} px\n\
         - outliers in depth: {}\n",
        depth.delay * 1e3,
        depth.block,
        depth.smoothing,
        depth.factor,
        depth.outliers,
    )
}
