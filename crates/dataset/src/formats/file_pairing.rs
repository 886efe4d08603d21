//! Colour and depth files that belong together by name, number or order.

use super::counted;
use crate::{DatasetError, Entry};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

const EXTENSIONS: [&str; 3] = ["png", "jpg", "jpeg"];

/// The two files of a frame.
#[derive(Debug, PartialEq)]
pub(crate) struct Pair {
    /// Place among the colour images.
    place: usize,
    /// The number in the names, if they are numbered.
    pub(crate) number: Option<u64>,
    pub(crate) colour: PathBuf,
    /// `None`: a sequence without depth.
    depth: Option<PathBuf>,
}

/// All pairs, in order of number or name.
pub(crate) struct Pairs {
    pub(crate) pairs: Vec<Pair>,
    /// Colour images without a depth image of that name or number.
    pub(crate) without_depth: usize,
}

impl Pairs {
    /// Pairs the files of a sequence in `folder`, which serves the error message.
    pub(crate) fn of(
        folder: &Path,
        colour: Vec<PathBuf>,
        depth: Vec<PathBuf>,
    ) -> Result<Self, DatasetError> {
        let (colour, depth) = (keyed(colour), keyed(depth));
        let partners = pair(&colour, &depth).ok_or_else(|| DatasetError::NoCommonNames {
            path: folder.to_path_buf(),
            colour: colour.len(),
            depth: depth.len(),
        })?;
        let without_depth = partners.iter().filter(|p| p.is_none()).count();
        let places = colour.into_iter().zip(partners).enumerate();
        let pairs = places.filter_map(|(place, ((key, colour), partner))| {
            let depth = Some(depth[partner?].1.clone());
            Some(Pair { place, number: key.number(), colour, depth })
        });
        Ok(Self { pairs: pairs.collect(), without_depth })
    }

    /// Pictures without depth.
    pub(crate) fn colour_only(colour: Vec<PathBuf>) -> Self {
        let files = keyed(colour).into_iter().enumerate();
        let pair = |(place, (key, colour)): (usize, (Key, PathBuf))| Pair {
            place,
            number: key.number(),
            colour,
            depth: None,
        };
        Self { pairs: files.map(pair).collect(), without_depth: 0 }
    }

    /// Entries `place / frame_rate` apart [s].
    pub(crate) fn by_place(self, frame_rate: f64) -> Vec<Entry> {
        self.entries(|pair| pair.place as f64 / frame_rate)
    }

    /// Entries at `number / frame_rate` [s], so that a gap in the numbers is a gap in time.
    pub(crate) fn by_number(self, frame_rate: f64) -> Vec<Entry> {
        self.entries(|pair| pair.number.map_or(pair.place as f64, |n| n as f64) / frame_rate)
    }

    fn entries(self, time: impl Fn(&Pair) -> f64) -> Vec<Entry> {
        let pairs = self.pairs.into_iter().enumerate();
        pairs
            .map(|(index, pair)| {
                let timestamp = time(&pair);
                let Pair { place, colour, depth, .. } = pair;
                let depth_timestamp = timestamp;
                Entry { index, place, timestamp, depth_timestamp, colour, depth, parts: None }
            })
            .collect()
    }

    /// A warning if the numbers jump: places are then no frame numbers.
    pub(crate) fn gap_warning(&self) -> Option<String> {
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

/// The image files of a folder whose names (with extension) are to be kept, by name.
pub(crate) fn images(
    folder: &Path,
    keep: impl Fn(&str) -> bool,
) -> Result<Vec<PathBuf>, DatasetError> {
    let listing = std::fs::read_dir(folder).map_err(|e| DatasetError::read(folder, e))?;
    let mut files: Vec<PathBuf> = listing
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| !stem(path).starts_with('.'))
        .filter(|path| {
            let extension = path.extension().and_then(|e| e.to_str()).map(str::to_lowercase);
            extension.is_some_and(|e| EXTENSIONS.contains(&e.as_str()))
        })
        .filter(|path| path.file_name().is_some_and(|name| keep(&name.to_string_lossy())))
        .collect();
    if files.is_empty() {
        let expected = "PNG images (colour may be JPEG)";
        return Err(DatasetError::Empty { path: folder.to_path_buf(), expected });
    }
    files.sort();
    Ok(files)
}

/// The name of a file without its extension.
pub(crate) fn stem(path: &Path) -> String {
    path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default()
}

/// All files with the stamps in their names, by time; `None` if one name carries none.
pub(crate) fn stamped(files: &[PathBuf]) -> Option<Vec<(f64, PathBuf)>> {
    let stamped: Option<Vec<_>> =
        files.iter().map(|path| Some((stamp(&stem(path))?, path.clone()))).collect();
    let mut stamped = stamped?;
    stamped.sort_by(|a, b| a.0.total_cmp(&b.0));
    Some(stamped)
}

/// The time [s] in a name: seconds with a decimal point, or a Unix time of 13, 16 or 19 digits
/// in milli-, micro- or nanoseconds. Shorter whole numbers count frames.
fn stamp(stem: &str) -> Option<f64> {
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

/// What two names of one frame have in common.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
enum Key {
    /// The last number in the name.
    Number(u64),
    /// The whole name.
    Name(String),
}

impl Key {
    fn number(&self) -> Option<u64> {
        match self {
            Self::Number(number) => Some(*number),
            Self::Name(_) => None,
        }
    }
}

/// Files under their keys, in order of key: numbers if they tell all files apart, else names.
fn keyed(files: Vec<PathBuf>) -> Vec<(Key, PathBuf)> {
    let numbers: Option<Vec<u64>> = files.iter().map(|path| last_number(&stem(path))).collect();
    let distinct = |numbers: &Vec<u64>| {
        let mut sorted = numbers.clone();
        sorted.sort_unstable();
        sorted.windows(2).all(|pair| pair[0] != pair[1])
    };
    let keys: Vec<Key> = match numbers.filter(distinct) {
        Some(numbers) => numbers.into_iter().map(Key::Number).collect(),
        None => files.iter().map(|path| Key::Name(stem(path))).collect(),
    };
    let mut keyed: Vec<(Key, PathBuf)> = keys.into_iter().zip(files).collect();
    keyed.sort();
    keyed
}

/// The last number in a name.
pub(crate) fn last_number(stem: &str) -> Option<u64> {
    let end = stem.rfind(|c: char| c.is_ascii_digit())? + 1;
    let start = stem[..end].rfind(|c: char| !c.is_ascii_digit()).map_or(0, |i| {
        let width = stem[i..].chars().next().map_or(1, char::len_utf8);
        i + width
    });
    stem[start..end].parse().ok()
}

/// For every colour file the place of its depth file: by key, else by order if the counts agree.
fn pair(colour: &[(Key, PathBuf)], depth: &[(Key, PathBuf)]) -> Option<Vec<Option<usize>>> {
    let places: HashMap<&Key, usize> =
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
    fn names_that_are_times() {
        assert_eq!(stamp("1305031237.361618"), Some(1305031237.361618));
        assert_eq!(stamp("1403636579763555584"), Some(1403636579.7635556));
        assert_eq!(stamp("000123"), None);
        assert_eq!(stamp("frame-1.5"), None);
        assert_eq!(stamp("1.2.3"), None);
    }

    #[test]
    fn the_last_number_counts() {
        assert_eq!(last_number("frame-000012.color"), Some(12));
        assert_eq!(last_number("depth7"), Some(7));
        assert_eq!(last_number("é12é"), Some(12));
        assert_eq!(last_number("left"), None);
    }

    #[test]
    fn numbers_pair_across_different_names() {
        let files = |names: &[&str]| keyed(names.iter().map(PathBuf::from).collect());
        let colour = files(&["frame10.jpg", "frame2.jpg", "frame3.jpg"]);
        let depth = files(&["depth02.png", "depth10.png"]);
        assert_eq!(pair(&colour, &depth), Some(vec![Some(0), None, Some(1)]));
    }
}
