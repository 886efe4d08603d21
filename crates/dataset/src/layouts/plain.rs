//! The plain layout: a colour folder beside a depth folder.

use super::associated::{Stamped, by_time, ground_truth};
use super::pairs::{Pairs, images, stamped};
use super::{Layout, Listing};
use crate::{DatasetError, LeftOut, OpenOptions};
use std::path::{Path, PathBuf};

const COLOUR_NAMES: [&str; 5] = ["colour", "color", "rgb", "images", "image"];
const DEPTH_NAMES: [&str; 2] = ["depth", "depths"];

/// The two folders of the plain layout.
pub(crate) struct Folders {
    colour: PathBuf,
    depth: PathBuf,
}

/// The colour and the depth folder, if both are there.
pub(crate) fn find(folder: &Path) -> Option<Folders> {
    let first =
        |names: &[&str]| names.iter().map(|name| folder.join(name)).find(|path| path.is_dir());
    Some(Folders { colour: first(&COLOUR_NAMES)?, depth: first(&DEPTH_NAMES)? })
}

/// Lists both folders. Files without a stamp in their name get `place / frame_rate` [s].
pub(crate) fn list(
    folder: &Path,
    folders: &Folders,
    options: &OpenOptions,
    frame_rate: f64,
) -> Result<Listing, DatasetError> {
    let (colour, depth) = (images(&folders.colour, |_| true)?, images(&folders.depth, |_| true)?);
    if let (Some(colour), Some(depth)) = (stamped(&colour), stamped(&depth)) {
        return by_time(folder, Layout::Plain, Stamped { colour, depth }, options);
    }
    let pairs = Pairs::of(folder, colour, depth)?;
    let left_out = LeftOut { without_depth: pairs.without_depth, ..LeftOut::default() };
    let mut listing = Listing::new(Layout::Plain, pairs.by_place(frame_rate));
    listing.leave_out_without_depth(left_out.without_depth);
    listing.ground_truth = ground_truth(folder);
    Ok(listing)
}
