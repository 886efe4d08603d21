//! ETH3D SLAM: the TUM layout with the intrinsics in `calibration.txt`.

use crate::DatasetError;
use crate::calibration::{Calibration, Traits};
use crate::distortion::Distortion;
use crate::lists::{data_lines, number, read_text};
use std::path::{Path, PathBuf};

/// The calibration beside the lists, if there is one.
pub(super) fn find(folder: &Path) -> Option<PathBuf> {
    Some(folder.join("calibration.txt")).filter(|path| path.is_file())
}

/// `fx fy cx cy` in one line, pixel centres at integers; the pictures are free of distortion.
pub(super) fn calibration(path: &Path) -> Result<Calibration, DatasetError> {
    let text = read_text(path)?;
    let expected = "the four numbers fx fy cx cy";
    let Some((line, content)) = data_lines(&text).next() else {
        return Err(DatasetError::Empty { path: path.to_path_buf(), expected });
    };
    let words: Vec<&str> = content.split_whitespace().collect();
    let [fx, fy, cx, cy] = words[..] else {
        let reason = format!("{} numbers, expected {expected}", words.len());
        return Err(DatasetError::line(path, line, reason));
    };
    let names = ["fx", "fy", "cx", "cy"];
    let mut k = [0.0; 4];
    for ((value, word), name) in k.iter_mut().zip([fx, fy, cx, cy]).zip(names) {
        *value = number(path, line, name, word)?;
    }
    if k[0] <= 0.0 || k[1] <= 0.0 {
        return Err(DatasetError::line(path, line, "fx and fy must be positive"));
    }
    let source = path.display().to_string();
    Ok(Calibration::from_opencv(k, Distortion::default(), &source, Traits::default()))
}
