//! Plain folders: colour beside depth, or colour alone.

use super::file_pairing::{FilePairs, file_stem, list_images, stamped_by_name};
use super::tum::{StampedImages, ground_truth, list_by_time};
use super::{FrameEntry, Layout, Listing};
use crate::text::counted;
use crate::{DatasetError, OpenOptions};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

const COLOUR_NAMES: [&str; 5] = ["colour", "color", "rgb", "images", "image"];
const DEPTH_NAMES: [&str; 2] = ["depth", "depths"];

/// Formats of photographs, of cameras and telephones, that are not read.
const UNREAD_EXTENSIONS: [&str; 13] = [
    "heic", "heif", "avif", "webp", "tif", "tiff", "dng", "cr2", "cr3", "nef", "arw", "orf", "rw2",
];

/// Depth of subfolders searched for images.
const MAX_FOLDER_DEPTH: usize = 4;

/// Image folders of a sequence.
pub(crate) struct ImageFolders {
    colour: PathBuf,
    /// `None`: a sequence without depth.
    depth: Option<PathBuf>,
}

/// The colour and the depth folder, if both are there.
pub(super) fn find(folder: &Path) -> Option<ImageFolders> {
    let depth = Some(first_folder(folder, &DEPTH_NAMES)?);
    Some(ImageFolders { colour: first_folder(folder, &COLOUR_NAMES)?, depth })
}

/// The colour folder alone, or the folder itself if it holds images.
pub(super) fn find_colour(folder: &Path) -> Option<ImageFolders> {
    let itself = || list_images(folder, |_| true).is_ok().then(|| folder.to_path_buf());
    let colour = first_folder(folder, &COLOUR_NAMES).or_else(itself)?;
    Some(ImageFolders { colour, depth: None })
}

fn first_folder(folder: &Path, names: &[&str]) -> Option<PathBuf> {
    names.iter().map(|name| folder.join(name)).find(|path| path.is_dir())
}

/// True of a file with an extension, in small or capital letters.
pub(super) fn is_file_of(path: &Path, extension: &str) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case(extension)) && path.is_file()
}

/// The only file of a kind in a folder.
pub(super) fn only_file(folder: &Path, is_kind: impl Fn(&Path) -> bool) -> Option<PathBuf> {
    let files = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut files = files.map(|entry| entry.path()).filter(|path| is_kind(path));
    let first = files.next()?;
    files.next().is_none().then_some(first)
}

/// Lists both folders. Files without a time stamp in their name get `index / frame_rate` [s].
pub(super) fn list(
    folder: &Path,
    folders: &ImageFolders,
    options: &OpenOptions,
    frame_rate: f64,
) -> Result<Listing, DatasetError> {
    let colour = list_images(&folders.colour, |_| true)?;
    let depth = folders.depth.as_ref().map(|depth| list_images(depth, |_| true)).transpose()?;
    let unread = unread_photographs(&folders.colour).map(|unread| format!("left out {unread}"));
    // Stamps count only if all files have them.
    let depth_stamps = depth.as_ref().map(|depth| stamped_by_name(depth));
    if let (Some(colour), None | Some(Some(_))) = (stamped_by_name(&colour), &depth_stamps) {
        let depth = depth_stamps.flatten();
        let listing =
            list_by_time(folder, Layout::Plain, StampedImages { colour, depth }, options)?;
        return Ok(with_warning(listing, unread));
    }
    let pairs = match depth {
        Some(depth) => FilePairs::new(folder, colour, depth, options.depth_pairing)?,
        None => FilePairs::colour_only(colour),
    };
    let listing = with_warning(pairs.list_by_index(Layout::Plain, frame_rate), unread);
    Ok(Listing { ground_truth: ground_truth(folder), are_times_assumed: true, ..listing })
}

fn with_warning(mut listing: Listing, warning: Option<String>) -> Listing {
    listing.warnings.extend(warning);
    listing
}

/// Images without depth in a folder and its subfolders, in order of their paths, `1 / frame_rate`
/// apart [s]; `None` if there are none.
pub(crate) fn list_images_below(folder: &Path, frame_rate: f64) -> Option<Listing> {
    let files = images_in_tree(folder, MAX_FOLDER_DEPTH);
    let entry = |(index, colour): (usize, PathBuf)| {
        FrameEntry::synchronous((index, index), index as f64 / frame_rate, colour, None)
    };
    let entries: Vec<FrameEntry> = files.into_iter().enumerate().map(entry).collect();
    (!entries.is_empty()).then(|| Listing::new(Layout::Plain, entries))
}

/// Photographs of a folder in formats that are not read, without those that lie beside a picture of the same
/// name, and what to do; `None` if there are none.
pub(super) fn unread_photographs(folder: &Path) -> Option<String> {
    let listing = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let read: BTreeSet<String> =
        list_images(folder, |_| true).into_iter().flatten().map(|path| file_stem(&path)).collect();
    let is_unread = |path: &PathBuf| {
        let extension = path.extension().and_then(|e| e.to_str()).map(str::to_lowercase);
        let stem = file_stem(path);
        let is_format = extension.is_some_and(|e| UNREAD_EXTENSIONS.contains(&e.as_str()));
        is_format && !stem.starts_with('.') && !read.contains(&stem)
    };
    let files: Vec<PathBuf> = listing.map(|entry| entry.path()).filter(is_unread).collect();
    let first = files.iter().min()?;
    Some(format!(
        "{} in a format that is not read ({}): convert to JPEG or PNG",
        counted(files.len(), "photograph"),
        first.display()
    ))
}

fn images_in_tree(folder: &Path, depth: usize) -> Vec<PathBuf> {
    let mut files = list_images(folder, |_| true).unwrap_or_default();
    let listing = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut folders: Vec<PathBuf> =
        listing.map(|entry| entry.path()).filter(|path| path.is_dir()).collect();
    folders.sort();
    for folder in folders.iter().filter(|_| depth > 0) {
        files.extend(images_in_tree(folder, depth - 1));
    }
    files
}
