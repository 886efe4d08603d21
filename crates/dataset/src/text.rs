//! Text files of numbers (`#` starts a comment line), and words for messages.

use crate::DatasetError;
use serde::de::DeserializeOwned;
use std::path::Path;

/// Lines that are neither blank nor comments, with their numbers counted from 1.
pub(crate) fn data_lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines()
        .enumerate()
        .map(|(i, line)| (i + 1, line.trim_start_matches('\u{feff}').trim()))
        .filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
}

/// Reads a whole text file.
pub(crate) fn read_text(path: &Path) -> Result<String, DatasetError> {
    i2slam_storage::read_text(path).map_err(|e| DatasetError::read(path, e))
}

/// Whether a folder has an entry of this name, even one that cannot be read (a link to nothing, a
/// pipe): reading it then says what is wrong, instead of going on as if it were not there.
pub(crate) fn is_present(path: &Path) -> bool {
    path.symlink_metadata().is_ok()
}

/// Largest text of a COLMAP model [bytes]: `images.txt` of 10 000 images with 10 000 points each.
const MAX_MODEL_TEXT: u64 = 4 << 30;

/// Reads a whole text file of a COLMAP model, which may be larger than other text files.
pub(crate) fn read_model_text(path: &Path) -> Result<String, DatasetError> {
    let text = i2slam_storage::read_text_up_to(path, MAX_MODEL_TEXT);
    text.map_err(|e| DatasetError::read(path, e))
}

/// Parses JSON; the reason why it cannot be names key, line and column.
pub(crate) fn deserialize_json<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    let mut json = serde_json::Deserializer::from_str(text);
    let value = serde_path_to_error::deserialize(&mut json).map_err(|error| {
        let key = error.path().to_string();
        // Syntax errors and missing keys of the file itself have no path.
        let at = if key == "." { String::new() } else { format!("{key}: ") };
        format!("{at}{}", error.inner())
    })?;
    json.end().map_err(|error| error.to_string())?;
    Ok(value)
}

/// Parses a finite number; `name` is that of its column, for the error.
pub(crate) fn parse_number(
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

/// Parses the first words as finite numbers, with the names of their columns for the error.
pub(crate) fn parse_numbers<const N: usize>(
    path: &Path,
    line: usize,
    names: [&str; N],
    words: &[&str],
) -> Result<[f64; N], DatasetError> {
    let mut values = [0.0; N];
    for ((value, word), name) in values.iter_mut().zip(words).zip(names) {
        *value = parse_number(path, line, name, word)?;
    }
    Ok(values)
}

/// `1 frame`, `3 frames`: for words with a plural in s.
pub(crate) fn counted(count: usize, word: &str) -> String {
    format!("{count} {word}{}", if count == 1 { "" } else { "s" })
}

/// First names in a folder, for error messages.
pub(crate) fn list_names(folder: &Path) -> String {
    if folder.is_file() {
        return "a file of another kind".into();
    }
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    match names.len() {
        0 => "an empty folder".into(),
        1..=8 => names.join(", "),
        count => format!("{}, ... ({count} in all)", names[..8].join(", ")),
    }
}
