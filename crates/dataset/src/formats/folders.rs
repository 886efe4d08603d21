//! The plain layout: a colour folder beside a depth folder, or colour alone.

use super::associated::{Stamped, by_time, ground_truth};
use super::pairs::{Pairs, images, stamped};
use super::{Layout, Listing};
use crate::{DatasetError, Entry, LeftOut, OpenOptions};
use std::path::{Path, PathBuf};

const COLOUR_NAMES: [&str; 5] = ["colour", "color", "rgb", "images", "image"];
const DEPTH_NAMES: [&str; 2] = ["depth", "depths"];

/// How many folders deep pictures are looked for.
const DEEPEST: usize = 4;

/// The folders of the plain layout.
pub(crate) struct Folders {
    colour: PathBuf,
    /// `None`: a sequence without depth.
    depth: Option<PathBuf>,
}

/// The colour and the depth folder, if both are there.
pub(crate) fn find(folder: &Path) -> Option<Folders> {
    let depth = Some(first(folder, &DEPTH_NAMES)?);
    Some(Folders { colour: first(folder, &COLOUR_NAMES)?, depth })
}

/// The colour folder alone, or the folder itself if pictures lie in it.
pub(crate) fn find_colour(folder: &Path) -> Option<Folders> {
    let itself = || images(folder, |_| true).is_ok().then(|| folder.to_path_buf());
    let colour = first(folder, &COLOUR_NAMES).or_else(itself)?;
    Some(Folders { colour, depth: None })
}

fn first(folder: &Path, names: &[&str]) -> Option<PathBuf> {
    names.iter().map(|name| folder.join(name)).find(|path| path.is_dir())
}

/// Lists both folders. Files without a stamp in their name get `place / frame_rate` [s].
pub(crate) fn list(
    folder: &Path,
    folders: &Folders,
    options: &OpenOptions,
    frame_rate: f64,
) -> Result<Listing, DatasetError> {
    let colour = images(&folders.colour, |_| true)?;
    let depth = folders.depth.as_ref().map(|depth| images(depth, |_| true)).transpose()?;
    // Stamps count only if all have them.
    let depth_stamps = depth.as_ref().map(|depth| stamped(depth));
    if let (Some(colour), None | Some(Some(_))) = (stamped(&colour), &depth_stamps) {
        let depth = depth_stamps.flatten();
        return by_time(folder, Layout::Plain, Stamped { colour, depth }, options);
    }
    let pairs = match depth {
        Some(depth) => Pairs::of(folder, colour, depth)?,
        None => Pairs::colour_only(colour),
    };
    let left_out = LeftOut { without_depth: pairs.without_depth, ..LeftOut::default() };
    let mut listing = Listing::new(Layout::Plain, pairs.by_place(frame_rate));
    listing.leave_out_without_depth(left_out.without_depth);
    listing.ground_truth = ground_truth(folder);
    Ok(listing)
}

/// Pictures without depth in a folder and those below it, in order of their paths, `1 / frame_rate`
/// apart [s]; `None` if there is none.
pub(crate) fn below(folder: &Path, frame_rate: f64) -> Option<Listing> {
    let files = tree(folder, DEEPEST);
    let entry = |(index, colour): (usize, PathBuf)| {
        let timestamp = index as f64 / frame_rate;
        let (place, depth_timestamp) = (index, timestamp);
        Entry { index, place, timestamp, depth_timestamp, colour, depth: None, parts: None }
    };
    let entries: Vec<Entry> = files.into_iter().enumerate().map(entry).collect();
    (!entries.is_empty()).then(|| Listing::new(Layout::Plain, entries))
}

fn tree(folder: &Path, deeper: usize) -> Vec<PathBuf> {
    let mut files = images(folder, |_| true).unwrap_or_default();
    let listing = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut folders: Vec<PathBuf> =
        listing.map(|entry| entry.path()).filter(|path| path.is_dir()).collect();
    folders.sort();
    for folder in folders.iter().filter(|_| deeper > 0) {
        files.extend(tree(folder, deeper - 1));
    }
    files
}
