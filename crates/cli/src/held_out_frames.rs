//! Frames that `run --hold-out` names: every N-th, or those of a list.

use crate::failure::{Failure, failed};
use i2slam::dataset::{Sequence, is_video};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Value of `--hold-out`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum HoldOut {
    /// Every N-th frame.
    Every(usize),
    /// The frames that a file lists.
    Listed(PathBuf),
}

/// Parses a number, else the path of a list.
pub(crate) fn parse_hold_out(word: &str) -> Result<HoldOut, String> {
    match word.parse() {
        Ok(every) => Ok(HoldOut::Every(every)),
        Err(_) if Path::new(word).is_file() => Ok(HoldOut::Listed(word.into())),
        Err(_) => Err(format!(
            "neither a whole number N (every N-th frame) nor a file that lists frames: {word}"
        )),
    }
}

/// Numbers of the listed frames of a sequence: a frame number or the file name of a picture on each
/// line, `#` begins a comment.
pub(crate) fn listed_frames(list: &Path, sequence: &Sequence) -> Result<Vec<usize>, Failure> {
    let text = i2slam_storage::read_text(list).map_err(|error| failed(list, error))?;
    // All frames of a video share its file, which names none of them.
    let pictures = sequence.entries.iter().filter(|entry| !is_video(&entry.colour));
    let names: Vec<(&str, usize)> = pictures
        .filter_map(|entry| Some((entry.colour.file_name()?.to_str()?, entry.index)))
        .collect();
    let known = sequence.entries.iter().map(|entry| entry.index).collect();
    frames_of(&text, &names, &known).map_err(|reason| failed(list, reason))
}

fn frames_of(
    text: &str,
    names: &[(&str, usize)],
    known: &BTreeSet<usize>,
) -> Result<Vec<usize>, String> {
    let mut frames = BTreeSet::new();
    for (number, line) in text.lines().enumerate() {
        let entry = line.split('#').next().unwrap_or_default().trim();
        if entry.is_empty() {
            continue;
        }
        let file = Path::new(entry).file_name().and_then(|name| name.to_str());
        let named = names.iter().find(|(name, _)| Some(*name) == file).map(|(_, index)| *index);
        let index = named.or_else(|| entry.parse().ok()).filter(|index| known.contains(index));
        frames.insert(index.ok_or_else(|| unknown(number + 1, entry, known))?);
    }
    match (frames.len(), known.len()) {
        (0, _) => Err("lists no frame to hold out".to_owned()),
        (held_out, all) if held_out == all => {
            Err("lists every frame of this run: a map needs frames".to_owned())
        }
        _ => Ok(frames.into_iter().collect()),
    }
}

fn unknown(line: usize, entry: &str, known: &BTreeSet<usize>) -> String {
    let first = known.first().copied().unwrap_or_default();
    let last = known.last().copied().unwrap_or_default();
    format!(
        "line {line}: `{}` is neither the file name of a picture nor the number of a frame of this \
         run ({first} to {last}, those that --frames and --stride leave)",
        i2slam_storage::shortened(entry)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames(text: &str) -> Result<Vec<usize>, String> {
        let names = [("a.png", 2), ("b.png", 4), ("7.png", 6)];
        frames_of(text, &names, &BTreeSet::from([2, 4, 6]))
    }

    #[test]
    fn frames_are_named_by_number_or_file() {
        assert_eq!(frames("# test views\nimages/b.png\n2 # sharp\n\n2\n"), Ok(vec![2, 4]));
        assert_eq!(frames("7.png"), Ok(vec![6]));
    }

    #[test]
    fn what_names_no_frame_is_told_with_its_line() {
        let message = frames("2\nc.png").unwrap_err();
        assert!(message.starts_with("line 2: `c.png`") && message.contains("2 to 6"), "{message}");
        assert!(frames("3").unwrap_err().starts_with("line 1: `3`"));
        assert_eq!(frames("# none").unwrap_err(), "lists no frame to hold out");
        assert!(frames("2\n4\n6").unwrap_err().contains("every frame"));
    }

    #[test]
    fn a_number_is_every_nth_frame() {
        assert_eq!(parse_hold_out("4"), Ok(HoldOut::Every(4)));
        assert!(parse_hold_out("no-such-file").unwrap_err().contains("no-such-file"));
    }
}
