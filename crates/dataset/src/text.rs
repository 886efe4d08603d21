//! Text tables with time stamps: `timestamp value...`, `#` starts a comment line.

use crate::DatasetError;
use std::path::{Path, PathBuf};

/// The lines that carry data, with their numbers counted from 1.
pub(crate) fn data_lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines()
        .enumerate()
        .map(|(i, line)| (i + 1, line.trim_start_matches('\u{feff}').trim()))
        .filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
}

/// A whole text file.
pub(crate) fn read_text(path: &Path) -> Result<String, DatasetError> {
    std::fs::read_to_string(path).map_err(|e| DatasetError::read(path, e))
}

/// A finite number in a column of a line; anything else is an error that names the place.
pub(crate) fn number(
    path: &Path,
    line: usize,
    name: &str,
    text: &str,
) -> Result<f64, DatasetError> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        Ok(value) => {
            Err(DatasetError::line(path, line, format!("{name} is {value}, expected a number")))
        }
        Err(_) => {
            Err(DatasetError::line(path, line, format!("{name} is '{text}', expected a number")))
        }
    }
}

/// Stamped image files of `rgb.txt` or `depth.txt`, in order of time; paths joined to `folder`.
pub(crate) fn read_image_list(
    path: &Path,
    folder: &Path,
) -> Result<Vec<(f64, PathBuf)>, DatasetError> {
    let text = read_text(path)?;
    let mut images = Vec::new();
    for (line, content) in data_lines(&text) {
        let Some((stamp, file)) = content.split_once(char::is_whitespace) else {
            let reason = format!("'{content}', expected a time stamp and a file name");
            return Err(DatasetError::line(path, line, reason));
        };
        images.push((number(path, line, "time stamp", stamp)?, folder.join(file.trim())));
    }
    if images.is_empty() {
        let expected = "lines with a time stamp and a file name";
        return Err(DatasetError::Empty { path: path.to_path_buf(), expected });
    }
    images.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(images)
}
