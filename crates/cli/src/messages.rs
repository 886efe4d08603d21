//! Sentences about a run on the terminal: its input, camera, duration and result.

use crate::console::{counted, print_status};
use i2slam::Reconstruction;
use i2slam::dataset::{Layout, Sequence};
use i2slam::run::{CameraEstimate, RuntimeForecast, odometry_size};
use i2slam_result::{Metrics, UnitOfLength, depth_registration_line, rolling_shutter_line};
use i2slam_storage::{Committed, listed};
use std::path::{Path, PathBuf};

/// Longer side below which smaller pictures are not advised [px].
const MIN_ADVISED_SIDE: usize = 240;
/// Duration from which a run is forecast [s].
const MIN_FORECAST: f64 = 60.0;

/// Tells where parts of runs that died are.
pub(super) fn note_saved_parts(parts: &[PathBuf]) {
    for part in parts {
        print_status(&format!("note: what a run that died had found is in {}", part.display()));
    }
}

/// Tells where poses are from, if the result's path was edited after the run.
pub(super) fn note_edited_trajectory(result: &Path, reconstruction: &Reconstruction) {
    if i2slam_result::is_trajectory_edited(result, reconstruction) {
        print_status(&format!(
            "note: {} is not as the run wrote it; poses are those of trajectory_shutter.txt",
            result.join("trajectory.txt").display()
        ));
    }
}

/// Sentence about files of the user that were in the way of a result.
pub(super) fn displaced_files(folder: &Path) -> String {
    format!("files that were in the way of the result are in {}", folder.display())
}

/// Warns of files of the user that were in the way of a result.
pub(super) fn note_displaced(committed: &Committed) {
    if let Some(folder) = &committed.displaced {
        print_status(&format!("warning: {}", displaced_files(folder)));
    }
}

/// Size, duration and camera of a sequence that is reconstructed by colour alone.
pub(super) fn input_lines(sequence: &Sequence) -> Vec<String> {
    let camera = &sequence.camera;
    let mut lines = Vec::new();
    let (width, height) = sequence.recorded_size;
    let duration = match sequence.entries.as_slice() {
        [first, .., last] if !sequence.are_times_assumed => {
            format!(", {:.1} s", last.timestamp - first.timestamp)
        }
        _ => String::new(),
    };
    let reduced = if (camera.width, camera.height) == (width, height) {
        String::new()
    } else {
        let path = match odometry_size(sequence) {
            size if size == (camera.width, camera.height) => String::new(),
            size if size == (width, height) => ", camera path found as recorded".to_owned(),
            (width, height) => format!(", camera path found at {width}x{height}"),
        };
        format!(", worked on at {}x{} (--max-side, --scale){path}", camera.width, camera.height)
    };
    if sequence.layout == Layout::Video || !reduced.is_empty() {
        lines.push(format!(
            "{}: {} {} of {width}x{height} px{duration}{reduced}",
            sequence.name,
            sequence.len(),
            if sequence.are_times_assumed { "pictures" } else { "frames" }
        ));
    }
    let view = camera.horizontal_field_of_view().to_degrees();
    let source = &sequence.camera_source;
    lines.push(if sequence.camera_is_guess {
        format!(
            "camera not given: estimating its focal length from the pictures, beginning with \
             {:.0} px ({source}); --fov or --intrinsics gives it",
            camera.fx
        )
    } else {
        format!("camera: focal length {:.1} px, {view:.1} degrees across, from {source}", camera.fx)
    });
    lines
}

/// The frame rate assumed of pictures without time stamps.
pub(super) fn assumed_rate_line(sequence: &Sequence) -> Option<String> {
    sequence.are_times_assumed.then(|| {
        format!(
            "the pictures have no time stamps: taken as {:.0} a second; {{\"fps\": N}} in a camera.json \
             beside them gives another rate",
            sequence.frame_rate
        )
    })
}

/// An estimated focal length [px] with its horizontal field of view [degrees] and relative standard
/// deviation, beside the assumed focal length [px].
fn focal_length_line((found, view): (f64, f64), deviation: Option<f64>, assumed: f64) -> String {
    let tangent = (0.5 * view).to_radians().tan() * found / assumed;
    let assumed_view = 2.0 * tangent.atan().to_degrees();
    let deviation = deviation.map(|share| format!(" ± {:.1} %", 100.0 * share));
    format!(
        "camera: focal length {found:.1} px{}, {view:.1} degrees across, estimated from the pictures \
         (assumed {assumed:.1} px, {assumed_view:.1} degrees)",
        deviation.unwrap_or_default(),
    )
}

/// Focal length, lens distortion and rolling shutter as estimated from the pictures.
pub(crate) fn camera_lines(camera: &CameraEstimate) -> Vec<String> {
    let mut lines = Vec::new();
    if camera.is_focal_length_estimated {
        let found = (camera.focal_length, camera.field_of_view);
        let deviation = camera.focal_length_deviation;
        lines.push(focal_length_line(found, deviation, camera.assumed_focal_length));
    }
    if let Some([k1, k2]) = camera.lens.map(|lens| lens.distortion) {
        lines.push(format!("lens distortion: k1 {k1:.4}, k2 {k2:.4} estimated from the pictures"));
    } else if camera.is_distortion_estimated {
        lines.push("lens distortion: not measurable in the pictures, none is assumed".to_owned());
    }
    lines.extend(rolling_shutter_line(camera.rolling_shutter_readout));
    lines.extend(depth_registration_line(camera.depth_delay, camera.depth_shift));
    lines
}

/// The expected duration of a long run, and, where flags can change it, what makes it shorter.
pub(crate) fn forecast_line(forecast: &RuntimeForecast, is_adjustable: bool) -> Option<String> {
    let RuntimeForecast { seconds, frames, keyframes, size: (width, height), .. } = *forecast;
    if seconds <= MIN_FORECAST {
        return None;
    }
    let duration = rounded_duration(seconds);
    if forecast.is_second {
        let found = match forecast.is_unordered {
            true => format!("{keyframes} of {frames} photographs are placed"),
            false => format!("{keyframes} frames are keyframes"),
        };
        return Some(format!("this will take about {duration} in all: {found}"));
    }
    let advice = match is_adjustable {
        true => advice(width.max(height), forecast.is_unordered),
        false => String::new(),
    };
    if forecast.is_unordered {
        return Some(format!(
            "this will take about {duration}: {frames} photographs of {width}x{height} px{advice}"
        ));
    }
    Some(format!(
        "this will take about {duration}: {frames} frames of {width}x{height} px, some {keyframes} \
         keyframes{advice}"
    ))
}

/// Flags that make a run on pictures of this longer side [px] shorter.
fn advice(side: usize, is_unordered: bool) -> String {
    let half = side / 2;
    match (half >= MIN_ADVISED_SIDE, is_unordered) {
        (true, true) => format!("; --max-side {half} would take about half of that"),
        (false, true) => String::new(),
        (true, false) => format!(
            "; --max-side {half} would take about a third of that, --stride N takes every N-th frame, \
             --frames A..B a part"
        ),
        (false, false) => "; --stride N takes every N-th frame, --frames A..B a part".to_owned(),
    }
}

/// A duration in words, as precise as a forecast is.
fn rounded_duration(seconds: f64) -> String {
    match seconds / 60.0 {
        m if m < 1.5 => format!("{:.0} s", 10.0 * (seconds / 10.0).round()),
        m if m < 90.0 => format!("{m:.0} min"),
        m => format!("{:.1} h", m / 60.0),
    }
}

/// The photographs that have no pose; `None` if all have one.
fn not_placed_line(metrics: &Metrics, files: &[String]) -> Option<String> {
    let missing = metrics.frames_given.saturating_sub(metrics.tracked);
    let named = listed(files);
    (missing > 0).then(|| {
        format!(
            "{missing} of {} have no pose and are not in the map: {named}",
            counted(metrics.frames_given, "photograph"),
        )
    })
}

/// Prints the summary of a run, its last line the path of the report; `not_placed` are the files of frames
/// without a pose.
pub(super) fn print_summary(
    print: fn(&str),
    metrics: &Metrics,
    (map, not_placed): (&str, &[String]),
    folder: &Path,
    is_readout_estimated: bool,
) {
    let unfinished = match (metrics.complete, metrics.degraded) {
        (false, _) => " (ended early)",
        (true, true) => " (degraded)",
        (true, false) => "",
    };
    let (noun, found) =
        if metrics.unordered { ("photograph", "placed") } else { ("frame", "tracked") };
    let frames = counted(metrics.frames_given, noun);
    print(&format!("{} of {frames} {found}{unfinished}, {map}", metrics.tracked));
    if metrics.unordered {
        not_placed_line(metrics, not_placed).iter().for_each(|line| print(line));
    }
    if let Some(error) = metrics.ate_rmse_m {
        let centimetres = error * 100.0;
        let digits = if centimetres < 0.1 { 4 } else { 2 };
        print(&format!(
            "trajectory error {centimetres:.digits$} cm (ATE RMSE over {}{}{})",
            counted(metrics.ate_poses, "pose"),
            match metrics.ate_frames_without_pose {
                0 => String::new(),
                missing => format!(", {} without one", counted(missing, "frame")),
            },
            if metrics.ate_scale_aligned { ", scale aligned" } else { "" }
        ));
    }
    if let Some(psnr) = metrics.psnr_sharp_db {
        let taken = metrics.psnr_taken_db;
        let taken =
            taken.map_or_else(String::new, |db| format!(" (the pictures taken: {db:.2} dB)"));
        let part = match metrics.sharp_frames < metrics.frames {
            true => format!(", of {}", counted(metrics.sharp_frames, "frame")),
            false => String::new(),
        };
        print(&format!("sharp renders {psnr:.2} dB against the true sharp pictures{part}{taken}"));
    }
    if let (Some(sharp), Some(taken)) =
        (metrics.psnr_sharp_over_2px_db, metrics.psnr_taken_over_2px_db)
    {
        let frames = counted(metrics.frames_over_2px, "frame");
        print(&format!(
            "of {frames} blurred over more than 2 px {sharp:.2} dB (the pictures taken: {taken:.2} dB)"
        ));
    }
    match metrics.unit_of_length {
        UnitOfLength::Metre => {}
        UnitOfLength::Keyframes => print("world and unit of length: those of the keyframes given"),
        UnitOfLength::Unknown => {
            print("unit of length: unknown, pictures alone do not tell the scale");
        }
    }
    if let Some(assumed) = metrics.focal_length_assumed_px {
        let found = (metrics.focal_length_px, metrics.horizontal_fov_deg);
        print(&focal_length_line(found, metrics.focal_length_deviation, assumed));
    }
    if let Some([k1, k2]) = metrics.lens_distortion {
        print(&format!(
            "lens distortion: k1 {k1:.4}, k2 {k2:.4}, estimated from the pictures and removed"
        ));
    }
    match rolling_shutter_line(metrics.rolling_shutter_readout_s) {
        Some(line) if metrics.complete => print(&line),
        Some(line) => print(&format!("{line}, as far as it was found")),
        None if is_readout_estimated => {
            print("rolling shutter: none found, rows read at once (0.0 ms)");
        }
        None => {}
    }
    let registration = depth_registration_line(metrics.depth_delay_s, metrics.depth_shift_px);
    registration.iter().for_each(|line| print(line));
    let memory = metrics.peak_memory_bytes.map(|bytes| format!(", {} MB", bytes / 1_000_000));
    print(&format!(
        "{:.2} s per frame, {:.0} s to {}{}",
        metrics.seconds_per_frame,
        metrics.seconds,
        if metrics.complete { "the finished map" } else { "the interrupt" },
        memory.unwrap_or_default()
    ));
    let absolute = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
    print(&format!("results in {}", absolute.display()));
    let report = absolute.join("report.html");
    if report.is_file() {
        print(&report.display().to_string());
    }
}

/// A path as a shell reads it as one word.
pub(super) fn quoted(path: &Path) -> String {
    let text = path.display().to_string();
    let is_plain = |c: char| c.is_alphanumeric() || "/._-+,:@%".contains(c);
    match text.chars().all(is_plain) {
        true => text,
        false => format!("'{}'", text.replace('\'', r"'\''")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn focal_lengths_come_with_their_fields_of_view() {
        let line = focal_length_line((320.0, 90.0), Some(0.004), 640.0);
        assert!(line.contains("320.0 px ± 0.4 %, 90.0 degrees across"), "{line}");
        assert!(line.contains("(assumed 640.0 px, 53.1 degrees)"), "{line}");
        assert!(!focal_length_line((320.0, 90.0), None, 320.0).contains('±'));
    }

    #[test]
    fn photographs_without_a_pose_are_named() {
        let metrics = Metrics { frames_given: 12, tracked: 12, ..Metrics::default() };
        assert_eq!(not_placed_line(&metrics, &[]), None);
        let files: Vec<String> = (0..10).map(|i| format!("{i}.jpg")).collect();
        let line = not_placed_line(&Metrics { tracked: 2, ..metrics }, &files).expect("ten");
        assert!(line.starts_with("10 of 12 photographs have no pose"), "{line}");
        assert!(line.contains(": 0.jpg, 1.jpg,") && line.ends_with("7.jpg and 2 more"), "{line}");
    }

    #[test]
    fn paths_with_spaces_are_quoted() {
        assert_eq!(quoted(Path::new("res/a-1.b")), "res/a-1.b");
        assert_eq!(quoted(Path::new("it's mine")), r"'it'\''s mine'");
    }

    #[test]
    fn forecasts_are_rounded_and_come_with_advice() {
        assert_eq!(rounded_duration(63.0), "60 s");
        assert_eq!(rounded_duration(754.0), "13 min");
        assert_eq!(rounded_duration(3.0 * 3600.0), "3.0 h");
        let (frames, keyframes, size) = (300, 62, (480, 640));
        let (is_second, is_unordered) = (false, false);
        let seconds = 600.0;
        let forecast =
            RuntimeForecast { seconds, frames, keyframes, size, is_second, is_unordered };
        let line = forecast_line(&forecast, true).expect("a long run");
        for part in
            ["10 min", "300 frames of 480x640 px", "62 keyframes", "--max-side 320", "--stride"]
        {
            assert!(line.contains(part), "{line}");
        }
        assert!(!forecast_line(&forecast, false).expect("a long run").contains("--"));
        let second = RuntimeForecast { is_second: true, ..forecast };
        let line = forecast_line(&second, true).expect("a long run");
        assert_eq!(line, "this will take about 10 min in all: 62 frames are keyframes");
        assert_eq!(forecast_line(&RuntimeForecast { seconds: 50.0, ..forecast }, true), None);
        assert!(!advice(320, false).contains("--max-side"));
        let photographs = RuntimeForecast { is_unordered: true, ..forecast };
        let line = forecast_line(&photographs, true).expect("a long run");
        assert!(line.contains("300 photographs of 480x640 px; --max-side 320 would"), "{line}");
        assert!(!line.contains("--stride"), "{line}");
        let placed = RuntimeForecast { is_second: true, ..photographs };
        let line = forecast_line(&placed, true).expect("a long run");
        assert_eq!(line, "this will take about 10 min in all: 62 of 300 photographs are placed");
    }
}
