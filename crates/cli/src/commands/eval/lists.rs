//! Lists of frames: published ones, files, and sharp frames found by the pictures themselves.

use super::failed;
use super::reference::Reference;
use super::subject::pictures;
use crate::failure::Failure;
use crate::output::{counted, say};
use crate::picture::read_png;
use i2slam::dataset::{OpenOptions, Sequence};
use i2slam::geometry::Image;
use i2slam_eval::frame_list;
use i2slam_eval::sharpness::{SharpnessRule, laplacian_variance, sharp_frames};
use rayon::prelude::*;
use std::path::Path;
use std::sync::Arc;

/// Names and first lines of the published lists.
pub(super) fn published() -> Vec<String> {
    let line = |(name, text): &(&str, &str)| {
        let about = text.lines().next().unwrap_or_default().trim_start_matches("# ");
        format!("{name:<26}{about}")
    };
    frame_list::PUBLISHED.iter().map(line).collect()
}

/// The frames of a list: its name, its file, or `auto`.
pub(super) fn frames(list: &str, reference: &Reference) -> Result<Vec<usize>, Failure> {
    if list == "auto" {
        return match reference {
            Reference::Dataset { sequence, .. } => sharp_in_sequence(sequence),
            Reference::Folder { .. } => {
                let message = "--list auto needs the dataset as --reference, not pictures";
                Err(Failure::Usage(message.to_owned()))
            }
        };
    }
    let path = Path::new(list);
    let text = match frame_list::published(list) {
        Some(text) if !path.is_file() => text.to_owned(),
        _ if path.is_file() => std::fs::read_to_string(path).map_err(|e| failed(path, e))?,
        _ => {
            let known: Vec<&str> = frame_list::PUBLISHED.iter().map(|(name, _)| *name).collect();
            let known = known.join(", ");
            let message = format!("`{list}` is neither a file nor a published list ({known})");
            return Err(Failure::Usage(message));
        }
    };
    let frames = frame_list::parse(&text);
    let frames = frames.map_err(|n| failed(path, format!("line {n} is no frame number")))?;
    if frames.is_empty() { Err(failed(path, "lists no frame")) } else { Ok(frames) }
}

/// How every list begins that is written here.
const ORIGIN: &str = "# Sharp frames of ";

/// `--write-list`: the sharp frames of a dataset or a folder of pictures.
pub(super) fn write(video: &Path, file: &Path, overwrite: bool) -> Result<(), Failure> {
    if !video.is_dir() {
        let reason = if video.exists() { "is no folder" } else { "no such folder" };
        return Err(failed(video, reason));
    }
    refuse_to_replace(file, overwrite)?;
    let files = pictures(video, "png")?;
    let (count, frames) = if files.is_empty() {
        let sequence = Sequence::open(video, &OpenOptions::default())?;
        (sequence.len(), sharp_in_sequence(&sequence)?)
    } else {
        let (indices, paths): (Vec<_>, Vec<_>) = files.into_iter().unzip();
        (indices.len(), sharp(&indices, |place| read_png(&paths[place]))?)
    };
    let rule = SharpnessRule::default();
    let whole = video.canonicalize().unwrap_or_else(|_| video.to_owned());
    let name = whole.file_name().unwrap_or_default().to_string_lossy();
    let origin = format!(
        "Sharp frames of {name}, {} of {count}. Position in the associated stream, one per line.\n\
         Variance of the Laplacian at least {} times its median over {} frames, and the largest \
         of {} (i2slam {}).",
        frames.len(),
        rule.ratio,
        2 * rule.window + 1,
        2 * rule.apart + 1,
        env!("CARGO_PKG_VERSION"),
    );
    std::fs::write(file, frame_list::write(&origin, &frames)).map_err(|e| failed(file, e))?;
    let (of, file) = (counted(count, "frame"), file.display());
    say(&match frames.len() {
        0 => format!("none of {of} stands out as sharp: {file} lists none"),
        1 => format!("1 of {of} is sharp, listed in {file}"),
        sharp => format!("{sharp} of {of} are sharp, listed in {file}"),
    });
    Ok(())
}

/// A list is replaced where the user says so, another file never.
fn refuse_to_replace(file: &Path, overwrite: bool) -> Result<(), Failure> {
    let shown = file.display();
    let message = match std::fs::read_to_string(file) {
        Err(_) if file.symlink_metadata().is_err() => return Ok(()),
        Ok(text) if text.starts_with(ORIGIN) && overwrite => return Ok(()),
        Ok(text) if text.starts_with(ORIGIN) => {
            "is an earlier list: choose another name, or replace it with --overwrite"
        }
        _ => "is there already, and no list of this program: choose another name",
    };
    Err(Failure::Usage(format!("--write-list {shown} {message}")))
}

fn sharp_in_sequence(sequence: &Sequence) -> Result<Vec<usize>, Failure> {
    let indices: Vec<usize> = sequence.entries.iter().map(|entry| entry.index).collect();
    sharp(&indices, |place| Ok(Arc::unwrap_or_clone(sequence.load(place)?.colour)))
}

fn sharp(
    indices: &[usize],
    picture: impl Fn(usize) -> Result<Image<f32>, Failure> + Sync,
) -> Result<Vec<usize>, Failure> {
    let sharpness = |place: usize| Ok(laplacian_variance(&picture(place)?)?);
    let all: Result<Vec<f64>, Failure> =
        (0..indices.len()).into_par_iter().map(sharpness).collect();
    let places = sharp_frames(&all?, SharpnessRule::default())?;
    Ok(places.into_iter().map(|place| indices[place]).collect())
}
