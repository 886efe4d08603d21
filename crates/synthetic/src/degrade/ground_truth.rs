//! Ground truth of a sequence, copied to its degraded version.

use super::{Degradation, refuse};
use crate::error::SyntheticError;
use crate::write::pose_numbers;
use i2slam_dataset::Sequence;
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

/// Copies poses, and sharp images, radiance and exposures with their new numbers.
pub(super) fn copy_ground_truth(
    dataset: &Path,
    folder: &OutputFolder,
    sequence: &Sequence,
    kept: &[usize],
    what: &Degradation,
) -> Result<(), SyntheticError> {
    write_poses(folder, sequence)?;
    let ends = "groundtruth_shutter.txt";
    if dataset.join(ends).is_file() {
        copy(&dataset.join(ends), folder, ends)?;
    }
    let mut sources = String::from("frame,source,stops,covered\n");
    for (number, &source) in kept.iter().enumerate() {
        let entry = &sequence.entries[source];
        let name = entry.colour.file_name().unwrap_or_default();
        copy_if_present(
            &dataset.join("sharp").join(name),
            folder,
            &format!("sharp/{number:06}.png"),
        )?;
        let radiance = dataset.join(format!("hdr/{source:06}.exr"));
        copy_if_present(&radiance, folder, &format!("hdr/{number:06}.exr"))?;
        let (stops, covered) = (what.stops(source), what.covers(source));
        sources.push_str(&format!("{number},{source},{stops},{}\n", u8::from(covered)));
    }
    folder.write_text("source.csv", &sources)?;
    let table = dataset.join("exposure.csv");
    if table.is_file() {
        let text =
            i2slam_storage::read_text(&table).map_err(|e| SyntheticError::read(&table, e))?;
        folder.write_text("exposure.csv", &renumber_exposures(&text, kept, what))?;
    }
    Ok(())
}

/// Writes true poses in the TUM format.
fn write_poses(folder: &OutputFolder, sequence: &Sequence) -> Result<(), SyntheticError> {
    if let Some(truth) = &sequence.ground_truth {
        return copy(truth, folder, "groundtruth.txt");
    }
    if sequence.poses.is_empty() {
        return Ok(());
    }
    let mut text = String::from("# world_from_camera at the time stamps of the colour pictures\n");
    text.push_str("# timestamp tx ty tz qx qy qz qw\n");
    for pose in &sequence.poses {
        let numbers = pose_numbers(&pose.world_from_camera);
        text.push_str(&format!("{:.6} {numbers}\n", pose.timestamp));
    }
    Ok(folder.write_text("groundtruth.txt", &text)?)
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

/// `exposure.csv` of the kept frames, with columns `frame`, `ev` and `dt` adjusted.
fn renumber_exposures(text: &str, kept: &[usize], what: &Degradation) -> String {
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
    for (number, &source) in kept.iter().enumerate() {
        let Some(row) = row_of(source) else { continue };
        let stops = what.stops(source);
        let cells = row.iter().zip(&names).map(|(cell, name)| {
            let value = cell.parse::<f64>().ok();
            match (*name, value) {
                ("frame", _) => number.to_string(),
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
        let expected = "frame,timestamp,ev,dt\n0,0.0,0.500000,1.414214\n1,0.2,0.000000,1.000000\n";
        assert_eq!(renumber_exposures(text, &[0, 2], &what), expected);
    }
}
