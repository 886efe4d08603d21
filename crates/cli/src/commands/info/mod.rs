//! `i2slam info`: describes a sequence before it is run.

mod frames;
mod sequence;

use crate::arguments::{Input, Machine};
use crate::console::{counted, print, print_status};
use crate::failure::{Failure, print_json};
use crate::ground_truth::GroundTruth;
use crate::interrupt;
use crate::progress::Progress;
use crate::result_folder::refuse_results;
use clap::Args;
use frames::PictureStats;
use i2slam::dataset::{DatasetError, Sequence, is_video, is_without_depth};
use i2slam::{Config, PoseSource, RunOptions};
use i2slam_result::FrameFiles;
use sequence::{CameraInfo, SequenceInfo, TimeInfo};
use serde::Serialize;
use std::path::PathBuf;

#[derive(Args, Debug)]
pub(crate) struct Info {
    /// Sequence: a folder in one of the known layouts (docs/datasets.md), a .sens or .r3d file or a video;
    /// or keyframes of another program (docs/import.md)
    pub(crate) dataset: PathBuf,
    /// Preset of the run: the paper's leave out frames that came too soon, and crop borders
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub(crate) preset: String,
    #[command(flatten)]
    pub(crate) input: Input,
    /// Read lists and headers only, without depth, brightness and sharpness
    #[arg(long)]
    pub(crate) quick: bool,
    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,
    #[command(flatten)]
    pub(crate) machine: Machine,
}

/// Everything printed; the JSON object.
#[derive(Serialize)]
struct InfoReport {
    #[serde(flatten)]
    sequence_info: SequenceInfo,
    /// `null` with `--quick`.
    pictures: Option<PictureStats>,
    warnings: Vec<String>,
}

/// Opens the sequence, with depth or else without; `None` if the path held keyframes of another
/// program, which were printed.
fn open(arguments: &Info) -> Result<Option<Sequence>, Failure> {
    let path = &arguments.dataset;
    let config = Config::preset(&arguments.preset)?;
    let options = |poses: PoseSource| {
        arguments.input.open_options(RunOptions::new(config.clone(), poses).open)
    };
    let with_depth = options(PoseSource::with_depth(&config))?;
    let colour_alone = options(PoseSource::colour_alone())?;
    if is_video(path) && is_without_depth(path) {
        return Ok(Some(Sequence::open(path, &colour_alone)?));
    }
    match Sequence::open(path, &with_depth) {
        Ok(sequence) => Ok(Some(sequence)),
        Err(error @ DatasetError::NoCamera { is_video: true, .. }) => {
            let mut sequence = Sequence::open(path, &colour_alone)?;
            sequence.warnings.push(format!(
                "its depth is not described: {error} (--camera, --intrinsics, --fov)"
            ));
            Ok(Some(sequence))
        }
        Err(error) if sequence::print_keyframes(arguments, with_depth, &error)? => Ok(None),
        Err(_) if is_without_depth(path) => Ok(Some(Sequence::open(path, &colour_alone)?)),
        Err(error) => Err(error.into()),
    }
}

pub(crate) fn info(arguments: &Info) -> Result<(), Failure> {
    arguments.machine.use_threads()?;
    refuse_results(&arguments.dataset)?;
    let Some(sequence) = open(arguments)? else { return Ok(()) };
    let truth = GroundTruth::open(&arguments.dataset, &sequence);
    let mut warnings = sequence.warnings.clone();
    warnings.extend(truth.warnings.iter().cloned());
    let sequence_info = SequenceInfo::new(&sequence, &truth);
    let pictures = if arguments.quick {
        None
    } else {
        let progress = Progress::new(sequence.len(), arguments.machine.quiet);
        interrupt::listen();
        let files = FrameFiles::of(&sequence, &arguments.dataset);
        let pictures = PictureStats::new((&sequence, &files), &truth, &progress);
        progress.clear();
        Some(pictures?)
    };
    let report = InfoReport { sequence_info, pictures, warnings };
    if arguments.json {
        return print_json(&report);
    }
    for line in table_lines(&report.sequence_info, report.pictures.as_ref()) {
        print(&line);
    }
    for warning in &report.warnings {
        print_status(&format!("warning: {warning}"));
    }
    Ok(())
}

/// Number of gaps listed.
const MAX_LISTED_GAPS: usize = 3;

/// Number of unreadable or odd frames listed.
const MAX_LISTED_FRAMES: usize = 5;

/// The table, a line each.
fn table_lines(sequence: &SequenceInfo, pictures: Option<&PictureStats>) -> Vec<String> {
    let mut rows = sequence_rows(sequence);
    if let Some(pictures) = pictures {
        rows.extend(picture_rows(pictures));
    }
    rows.into_iter().map(|(label, text)| format!("{label:<18}{text}")).collect()
}

type Row = (&'static str, String);

fn sequence_rows(sequence: &SequenceInfo) -> Vec<Row> {
    let (times, camera) = (&sequence.times, &sequence.camera);
    let mut rows = vec![
        ("sequence", sequence.name.clone()),
        ("layout", sequence.layout.clone()),
        ("frames", frames(sequence)),
    ];
    if let Some(transfer) = sequence.high_dynamic_range {
        rows.push(("colours", format!("high dynamic range ({transfer}), converted to BT.709")));
    }
    rows.extend(time_rows(times));
    rows.extend([
        (
            "camera",
            format!(
                "{}x{}, fx {:.2}, fy {:.2}, cx {:.2}, cy {:.2} px (pixel centres at 0.5)",
                camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy
            ),
        ),
        ("camera from", camera_source(camera)),
    ]);
    if camera.recorded != [camera.width, camera.height] {
        let [width, height] = camera.recorded;
        rows.push(("recorded", format!("{width}x{height}")));
    }
    if sequence.frames_with_depth > 0 {
        rows.push(("frames with depth", frames_with_depth(sequence)));
    }
    if let Some(scale) = sequence.depth_scale {
        let assumed = if sequence.is_depth_scale_assumed { ", assumed" } else { "" };
        rows.push(("depth scale", format!("{scale} for one metre{assumed}")));
    }
    rows.push(("truth", truth(sequence)));
    if let Some([first, end]) = sequence.paper_frames {
        rows.push(("the paper uses", format!("--frames {first}..{end}")));
    }
    rows
}

fn time_rows(times: &TimeInfo) -> Vec<Row> {
    let rate = times.frames_per_second;
    if times.are_assumed {
        let none = format!(
            "none recorded: photographs in any order need none, frames of a film count as {rate:.0} a second"
        );
        return vec![("times", none)];
    }
    let (seconds, first) = (times.duration_s, times.first_s);
    vec![
        ("times", format!("{seconds:.2} s from {first:.3}, {rate:.2} frames a second")),
        ("gaps", gaps(times)),
    ]
}

fn camera_source(camera: &CameraInfo) -> String {
    match camera.is_guess {
        false => camera.source.clone(),
        true => format!("{} (a run estimates the focal length from the pictures)", camera.source),
    }
}

fn frames(sequence: &SequenceInfo) -> String {
    let left_out = &sequence.left_out;
    let counts = [
        (left_out.without_depth, "without depth"),
        (left_out.without_pose, "without a true pose"),
        (left_out.too_close, "too close in time"),
    ];
    let words: Vec<String> = counts
        .iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, why)| format!("{count} {why}"))
        .collect();
    let left_out =
        if words.is_empty() { String::new() } else { format!(" (left out: {})", words.join(", ")) };
    format!("{}{left_out}", sequence.frames)
}

fn frames_with_depth(sequence: &SequenceInfo) -> String {
    match sequence.frames_with_depth {
        with if with == sequence.frames => "all".to_owned(),
        with => format!("{with} of {}", sequence.frames),
    }
}

fn gaps(times: &TimeInfo) -> String {
    let apart = if times.colour_to_depth_s > 0.0 {
        format!("; colour and depth up to {:.1} ms apart", 1e3 * times.colour_to_depth_s)
    } else {
        String::new()
    };
    if times.gaps.is_empty() {
        return format!("none{apart}");
    }
    let mut longest: Vec<_> = times.gaps.iter().collect();
    longest.sort_by(|a, b| b.seconds.total_cmp(&a.seconds));
    let named: Vec<String> = longest
        .iter()
        .take(MAX_LISTED_GAPS)
        .map(|gap| format!("{:.3} s after frame {}", gap.seconds, gap.after_frame))
        .collect();
    format!("{}, longest: {}{apart}", times.gaps.len(), named.join(", "))
}

fn truth(sequence: &SequenceInfo) -> String {
    let truth = &sequence.truth;
    if truth.kinds.is_empty() {
        return "none".to_owned();
    }
    let path = truth
        .path_length_m
        .map(|length| format!(" ({}, {length:.2} m)", counted(truth.poses, "pose")));
    format!("{}{}", truth.kinds.join(", "), path.unwrap_or_default())
}

fn percent(share: f64) -> String {
    format!("{:.1} %", 100.0 * share)
}

fn depth(pictures: &PictureStats) -> String {
    pictures.depth.as_ref().map_or("none".to_owned(), |depth| {
        format!(
            "{:.2} to {:.2} m (1 to 99 %), median {:.2} m; {} of pixels, worst frame {}",
            depth.low_m,
            depth.high_m,
            depth.median_m,
            percent(depth.valid_share),
            percent(depth.valid_share_worst)
        )
    })
}

fn picture_rows(pictures: &PictureStats) -> Vec<Row> {
    let (light, sharp) = (&pictures.brightness, &pictures.sharpness);
    let mut rows = vec![
        ("depth", depth(pictures)),
        (
            "brightness",
            format!(
                "{:.3} to {:.3}, median {:.3} of white; {:.2} stops, at most {:.2} between frames",
                light.lowest,
                light.highest,
                light.median,
                light.range_stops,
                light.largest_step_stops
            ),
        ),
        (
            "clipped",
            format!("{} white, {} black", percent(light.white_share), percent(light.black_share)),
        ),
        (
            "sharpness",
            format!(
                "{:.1} to {:.1}, median {:.1} (variance of the Laplacian); {}",
                sharp.lowest,
                sharp.highest,
                sharp.median,
                counted(sharp.sharp_frames.len(), "sharp frame")
            ),
        ),
    ];
    if let Some(stops) = pictures.true_exposure_range_stops {
        rows.push(("true exposure", format!("{stops:.2} stops")));
    }
    rows.extend(listed("unreadable", &pictures.unreadable));
    rows.extend(listed("odd", &pictures.odd));
    rows
}

/// A row for each of the first frames, and one for how many more there are.
fn listed(label: &'static str, frames: &[String]) -> Vec<Row> {
    let mut rows: Vec<Row> =
        frames.iter().take(MAX_LISTED_FRAMES).map(|frame| (label, frame.clone())).collect();
    if frames.len() > MAX_LISTED_FRAMES {
        rows.push((label, format!("and {} more", frames.len() - MAX_LISTED_FRAMES)));
    }
    rows
}
