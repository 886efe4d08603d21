//! Ground truth of a sequence, copied to its degraded version.

use super::order::Shown;
use super::{Degradation, refuse};
use crate::error::SyntheticError;
use crate::write::{pose_numbers, write_bytes, write_picture};
use i2slam_dataset::{Sequence, read_colour};
use i2slam_geometry::{StampedPose, interpolate_pose, nearest_stamp};
use i2slam_storage::{OutputFolder, open};
use std::io;
use std::path::Path;

/// An error if the output folder is that of the dataset.
pub(super) fn refuse_same_folder(dataset: &Path, out: &Path) -> Result<(), SyntheticError> {
    match (dataset.canonicalize(), out.canonicalize()) {
        (Ok(from), Ok(to)) if from == to => {
            refuse("output folder", out.display(), "another folder than the dataset's")
        }
        _ => Ok(()),
    }
}

/// Copies poses, and sharp images, radiance and exposures with their new numbers and exposure steps.
/// Pictures of another size than the source's come without sharp images and radiance.
pub(super) fn copy_ground_truth(
    dataset: &Path,
    folder: &OutputFolder,
    sequence: &Sequence,
    order: &[Shown],
    what: &Degradation,
) -> Result<(), SyntheticError> {
    let is_shuffled = order.iter().any(|shown| shown.pose != shown.stamp);
    write_poses(folder, sequence, is_shuffled.then_some(order))?;
    let ends = "groundtruth_shutter.txt";
    if dataset.join(ends).is_file() {
        match is_shuffled {
            false => copy(&dataset.join(ends), folder, ends)?,
            true => {
                let text = read(&dataset.join(ends))?;
                folder.write_text(ends, &reordered_lines(&text, sequence, order))?;
            }
        }
    }
    let mut sources = String::from("frame,source,time_of,stops,covered,grey\n");
    for (number, shown) in order.iter().enumerate() {
        if what.scale == 1.0 {
            copy_pictures(dataset, folder, sequence, what, (*shown, number))?;
        }
        let picture = shown.picture;
        let [covered, grey] = [what.covers(picture), what.is_grey(picture)].map(u8::from);
        let (stamp, stops) = (shown.stamp, what.stops(picture));
        sources.push_str(&format!("{number},{picture},{stamp},{stops},{covered},{grey}\n"));
    }
    folder.write_text("source.csv", &sources)?;
    let table = dataset.join("exposure.csv");
    if table.is_file() {
        let stamps: Vec<f64> =
            order.iter().map(|shown| sequence.entries[shown.stamp].timestamp).collect();
        let text = renumber_exposures(&read(&table)?, order, &stamps, what);
        folder.write_text("exposure.csv", &text)?;
    }
    Ok(())
}

fn read(path: &Path) -> Result<String, SyntheticError> {
    i2slam_storage::read_text(path).map_err(|e| SyntheticError::read(path, e))
}

/// Copies the sharp image, with the exposure of the picture, and the radiance of a frame as those of frame
/// `number`.
fn copy_pictures(
    dataset: &Path,
    folder: &OutputFolder,
    sequence: &Sequence,
    what: &Degradation,
    (shown, number): (Shown, usize),
) -> Result<(), SyntheticError> {
    let source = shown.pose;
    let name = sequence.entries[source].colour.file_name().unwrap_or_default();
    let (sharp, copied) = (dataset.join("sharp").join(name), format!("sharp/{number:06}.png"));
    if what.stops(shown.picture) != 0.0 && sharp.is_file() {
        let exposed = what.exposed(read_colour(&sharp)?, shown.picture);
        write_bytes(folder, &copied, write_picture(&exposed))?;
    } else {
        copy_if_present(&sharp, folder, &copied)?;
    }
    let radiance = dataset.join(format!("hdr/{source:06}.exr"));
    copy_if_present(&radiance, folder, &format!("hdr/{number:06}.exr"))
}

/// Writes true poses in the TUM format; those of an order are the poses of its frames alone.
fn write_poses(
    folder: &OutputFolder,
    sequence: &Sequence,
    order: Option<&[Shown]>,
) -> Result<(), SyntheticError> {
    if let (Some(truth), None) = (&sequence.ground_truth, order) {
        return copy(truth, folder, "groundtruth.txt");
    }
    let mut poses = sequence.true_trajectory()?;
    poses.dedup_by_key(|pose| pose.timestamp);
    if poses.is_empty() {
        return Ok(());
    }
    if let Some(order) = order.filter(|_| poses.len() > 1) {
        let time = |frame: usize| sequence.entries[frame].timestamp;
        let of = |shown: &Shown| {
            let world_from_camera = interpolate_pose(&poses, time(shown.pose))?;
            Some(StampedPose { timestamp: time(shown.stamp), world_from_camera })
        };
        poses = order.iter().filter_map(of).collect();
    }
    let mut text = String::from("# world_from_camera at the time stamps of the colour pictures\n");
    text.push_str("# timestamp tx ty tz qx qy qz qw\n");
    for pose in &poses {
        let numbers = pose_numbers(&pose.world_from_camera);
        text.push_str(&format!("{:.6} {numbers}\n", pose.timestamp));
    }
    Ok(folder.write_text("groundtruth.txt", &text)?)
}

/// Lines that begin with a time stamp, as those of the frames of an order.
fn reordered_lines(text: &str, sequence: &Sequence, order: &[Shown]) -> String {
    let (comments, lines): (Vec<&str>, Vec<&str>) =
        text.lines().partition(|line| line.trim_start().starts_with('#'));
    let known: Vec<(f64, &str)> = lines
        .iter()
        .filter_map(|line| {
            let (stamp, rest) = line.trim().split_once(char::is_whitespace)?;
            Some((stamp.parse().ok()?, rest))
        })
        .collect();
    let stamps: Vec<f64> = known.iter().map(|(stamp, _)| *stamp).collect();
    let mut out: String = comments.iter().map(|line| format!("{line}\n")).collect();
    let time = |frame: usize| sequence.entries[frame].timestamp;
    for shown in order {
        if let Some(line) = nearest_stamp(&stamps, time(shown.pose), 1e-3) {
            out.push_str(&format!("{:.6} {}\n", time(shown.stamp), known[line].1));
        }
    }
    out
}

fn copy(from: &Path, folder: &OutputFolder, name: &str) -> Result<(), SyntheticError> {
    let mut file = open(from).map_err(|e| SyntheticError::read(from, e))?;
    Ok(folder.write(name, |out| io::copy(&mut file, out).map(drop))?)
}

/// Copies a PNG or EXR file if it exists.
fn copy_if_present(from: &Path, folder: &OutputFolder, name: &str) -> Result<(), SyntheticError> {
    let same_kind = from.extension() == Path::new(name).extension();
    if same_kind && from.is_file() { copy(from, folder, name) } else { Ok(()) }
}

/// `exposure.csv` of the pictures of an order, with columns `frame`, `timestamp`, `ev` and `dt`
/// adjusted; `stamps` are those of the order.
fn renumber_exposures(text: &str, order: &[Shown], stamps: &[f64], what: &Degradation) -> String {
    let mut lines = text.lines();
    let header = lines.next().unwrap_or_default();
    let names: Vec<&str> = header.split(',').map(str::trim).collect();
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').map(str::trim).collect()).collect();
    let frame_column = names.iter().position(|n| *n == "frame");
    let row_of = |source: usize| match frame_column {
        Some(column) => {
            rows.iter().find(|row| row.get(column).and_then(|c| c.parse().ok()) == Some(source))
        }
        None => rows.get(source),
    };
    let mut out = format!("{header}\n");
    for (number, shown) in order.iter().enumerate() {
        let Some(row) = row_of(shown.picture) else { continue };
        let stops = what.stops(shown.picture);
        let cells = row.iter().zip(&names).map(|(cell, name)| {
            let value = cell.parse::<f64>().ok();
            match (*name, value) {
                ("frame", _) => number.to_string(),
                ("timestamp", _) if shown.stamp != shown.picture => {
                    format!("{:.6}", stamps[number])
                }
                ("ev", Some(ev)) => format!("{:.6}", ev + stops),
                ("dt", Some(dt)) => format!("{:.6}", dt * stops.exp2()),
                _ => (*cell).to_owned(),
            }
        });
        out.push_str(&cells.collect::<Vec<_>>().join(","));
        out.push('\n');
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ExposureStep;

    #[test]
    fn exposures_are_renumbered_and_shifted() {
        let text = "frame,timestamp,ev,dt\n0,0.0,0.5,1.414214\n1,0.1,0.0,1.0\n2,0.2,1.0,2.0\n";
        let exposure_steps = vec![ExposureStep { frame: 2, stops: -1.0 }];
        let what = Degradation { exposure_steps, ..Degradation::default() };
        let shown = |stamp, picture| Shown { stamp, picture, pose: stamp };
        let expected = "frame,timestamp,ev,dt\n0,0.0,0.500000,1.414214\n\
                        1,0.100000,0.500000,1.414214\n2,0.2,0.000000,1.000000\n";
        let order = [shown(0, 0), shown(1, 0), shown(2, 2)];
        assert_eq!(renumber_exposures(text, &order, &[0.0, 0.1, 0.2], &what), expected);
    }
}
