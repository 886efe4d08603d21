//! Pairing of colour with depth files by name, number or order.

use super::{FrameEntry, Layout, Listing};
use crate::text::counted;
use crate::{DatasetError, DepthPairing};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

const EXTENSIONS: [&str; 3] = ["png", "jpg", "jpeg"];

/// The two files of a frame.
#[derive(Debug, PartialEq)]
pub(super) struct FilePair {
    /// Index among the colour images.
    image_index: usize,
    /// Number in the file names, if they are numbered.
    pub(super) number: Option<u64>,
    pub(super) colour: PathBuf,
    depth: Option<PathBuf>,
}

/// Colour files with their depth files, in order of number or name.
pub(super) struct FilePairs {
    pub(super) pairs: Vec<FilePair>,
    /// Colour images that were dropped: no depth image has their name or number.
    without_depth: usize,
}

impl FilePairs {
    /// Pairs the files of a sequence; `folder` is for the error message.
    pub(super) fn new(
        folder: &Path,
        colour: Vec<PathBuf>,
        depth: Vec<PathBuf>,
        pairing: DepthPairing,
    ) -> Result<Self, DatasetError> {
        let (colour, depth) = (sorted_by_key(colour), sorted_by_key(depth));
        let partners = pair_by_key(&colour, &depth).ok_or_else(|| {
            let reason = format!(
                "{} colour and {} depth images whose names do not match: give the two images of a \
                 frame the same name or the same number",
                colour.len(),
                depth.len()
            );
            DatasetError::file(folder, reason)
        })?;
        let count = colour.len();
        let places = colour.into_iter().zip(partners).enumerate();
        let mut pairs: Vec<FilePair> = places
            .map(|(image_index, ((key, colour), partner))| {
                let depth = partner.map(|partner| depth[partner].1.clone());
                FilePair { image_index, number: key.number(), colour, depth }
            })
            .collect();
        if pairing == DepthPairing::Nearest {
            pairs.retain(|pair| pair.depth.is_some());
        }
        Ok(Self { without_depth: count - pairs.len(), pairs })
    }

    /// Images without depth.
    pub(super) fn colour_only(colour: Vec<PathBuf>) -> Self {
        let files = sorted_by_key(colour).into_iter().enumerate();
        let pair = |(image_index, (key, colour)): (usize, (FileKey, PathBuf))| FilePair {
            image_index,
            number: key.number(),
            colour,
            depth: None,
        };
        Self { pairs: files.map(pair).collect(), without_depth: 0 }
    }

    /// Lists frames at `index / frame_rate` [s].
    pub(super) fn list_by_index(self, layout: Layout, frame_rate: f64) -> Listing {
        self.list(layout, |pair| pair.image_index as f64 / frame_rate)
    }

    /// Lists frames at `number / frame_rate` [s], so that gaps in the numbers are gaps in time.
    pub(super) fn list_by_number(self, layout: Layout, frame_rate: f64) -> Listing {
        let gap = self.gap_warning();
        let number = |pair: &FilePair| pair.number.map_or(pair.image_index as f64, |n| n as f64);
        let mut listing = self.list(layout, |pair| number(pair) / frame_rate);
        listing.warnings.extend(gap);
        listing
    }

    fn list(self, layout: Layout, time: impl Fn(&FilePair) -> f64) -> Listing {
        let pairs = self.pairs.into_iter().enumerate();
        let entries = pairs
            .map(|(index, pair)| {
                let timestamp = time(&pair);
                let FilePair { image_index, colour, depth, .. } = pair;
                FrameEntry::synchronous((index, image_index), timestamp, colour, depth)
            })
            .collect();
        let mut listing = Listing::new(layout, entries);
        listing.drop_without_depth(self.without_depth, "no depth image of that name or number");
        listing
    }

    /// A warning if numbers have gaps, so that indices differ from published frame numbers.
    fn gap_warning(&self) -> Option<String> {
        let numbers: Vec<u64> = self.pairs.iter().filter_map(|pair| pair.number).collect();
        let (first, last) = (numbers.first()?, numbers.last()?);
        let expected = (last - first).saturating_add(1);
        (*first != 0 || expected != numbers.len() as u64).then(|| {
            format!(
                "{} numbered {first} to {last}: published frame numbers are no places in this \
                 stream",
                counted(numbers.len(), "frame")
            )
        })
    }
}

/// True for names of image files.
pub(super) fn has_image_name(path: &Path) -> bool {
    let extension = path.extension().and_then(|e| e.to_str()).map(str::to_lowercase);
    extension.is_some_and(|e| EXTENSIONS.contains(&e.as_str()))
}

/// Image files of a folder whose names (with extension) pass `keep`, sorted.
pub(super) fn list_images(
    folder: &Path,
    keep: impl Fn(&str) -> bool,
) -> Result<Vec<PathBuf>, DatasetError> {
    let listing = std::fs::read_dir(folder).map_err(|e| DatasetError::read(folder, e))?;
    let mut files: Vec<PathBuf> = listing
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| !file_stem(path).starts_with('.'))
        .filter(|path| has_image_name(path))
        .filter(|path| path.file_name().is_some_and(|name| keep(&name.to_string_lossy())))
        .collect();
    if files.is_empty() {
        return Err(DatasetError::empty(folder, "PNG images (colour may be JPEG)"));
    }
    files.sort();
    Ok(files)
}

/// Whether a folder holds colour and depth images, recognised by their names.
pub(super) fn holds_both(
    folder: &Path,
    is_colour: impl Fn(&str) -> bool,
    is_depth: impl Fn(&str) -> bool,
) -> bool {
    let (mut colour, mut depth) = (false, false);
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        colour |= is_colour(&name.to_string_lossy());
        depth |= is_depth(&name.to_string_lossy());
        if colour && depth {
            return true;
        }
    }
    false
}

/// File name without extension.
pub(crate) fn file_stem(path: &Path) -> String {
    path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Files sorted by the time stamps in their names; `None` unless all names have one.
pub(super) fn stamped_by_name(files: &[PathBuf]) -> Option<Vec<(f64, PathBuf)>> {
    let stamped: Option<Vec<_>> =
        files.iter().map(|path| Some((parse_stamp(&file_stem(path))?, path.clone()))).collect();
    let mut stamped = stamped?;
    stamped.sort_by(|a, b| a.0.total_cmp(&b.0));
    Some(stamped)
}

/// Time stamp [s] in a name: seconds with a decimal point, or a Unix time of 13, 16 or 19 digits
/// in milli-, micro- or nanoseconds. Shorter whole numbers count frames.
fn parse_stamp(stem: &str) -> Option<f64> {
    if !stem.bytes().all(|b| b.is_ascii_digit() || b == b'.') {
        return None;
    }
    let unit = match (stem.contains('.'), stem.len()) {
        (true, _) => 1.0,
        (false, 13) => 1e3,
        (false, 16) => 1e6,
        (false, 19) => 1e9,
        _ => return None,
    };
    stem.parse::<f64>().ok().map(|value| value / unit)
}

/// Common part of the file names of one frame.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
enum FileKey {
    /// The last number in the name.
    Number(u64),
    /// The whole name.
    Name(String),
}

impl FileKey {
    fn number(&self) -> Option<u64> {
        match self {
            Self::Number(number) => Some(*number),
            Self::Name(_) => None,
        }
    }
}

/// Files sorted by key: the number in the name if these are distinct, else the name.
fn sorted_by_key(files: Vec<PathBuf>) -> Vec<(FileKey, PathBuf)> {
    let numbers: Option<Vec<u64>> =
        files.iter().map(|path| last_number(&file_stem(path))).collect();
    let distinct = |numbers: &Vec<u64>| {
        let mut sorted = numbers.clone();
        sorted.sort_unstable();
        sorted.windows(2).all(|pair| pair[0] != pair[1])
    };
    let keys: Vec<FileKey> = match numbers.filter(distinct) {
        Some(numbers) => numbers.into_iter().map(FileKey::Number).collect(),
        None => files.iter().map(|path| FileKey::Name(file_stem(path))).collect(),
    };
    let mut keyed: Vec<(FileKey, PathBuf)> = keys.into_iter().zip(files).collect();
    keyed.sort();
    keyed
}

/// Last number in a name.
pub(crate) fn last_number(stem: &str) -> Option<u64> {
    let end = stem.rfind(|c: char| c.is_ascii_digit())? + 1;
    let start = stem[..end].rfind(|c: char| !c.is_ascii_digit()).map_or(0, |i| {
        let width = stem[i..].chars().next().map_or(1, char::len_utf8);
        i + width
    });
    stem[start..end].parse().ok()
}

/// Index of the depth file of every colour file: by key, else by order if the counts agree.
fn pair_by_key(
    colour: &[(FileKey, PathBuf)],
    depth: &[(FileKey, PathBuf)],
) -> Option<Vec<Option<usize>>> {
    let places: HashMap<&FileKey, usize> =
        depth.iter().enumerate().map(|(place, (key, _))| (key, place)).collect();
    let partners: Vec<Option<usize>> =
        colour.iter().map(|(key, _)| places.get(key).copied()).collect();
    if partners.iter().any(Option::is_some) {
        Some(partners)
    } else if colour.len() == depth.len() {
        Some((0..colour.len()).map(Some).collect())
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_stamps_in_names_are_parsed() {
        assert_eq!(parse_stamp("1305031237.361618"), Some(1305031237.361618));
        assert_eq!(parse_stamp("1403636579763555584"), Some(1403636579.7635556));
        assert_eq!(parse_stamp("000123"), None);
        assert_eq!(parse_stamp("frame-1.5"), None);
        assert_eq!(parse_stamp("1.2.3"), None);
    }

    #[test]
    fn the_last_number_counts() {
        assert_eq!(last_number("frame-000012.color"), Some(12));
        assert_eq!(last_number("depth7"), Some(7));
        assert_eq!(last_number("é12é"), Some(12));
        assert_eq!(last_number("left"), None);
    }
}
