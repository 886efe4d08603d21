//! Ground truth of an evaluation: a folder of pictures or a dataset, and its checksums.

use super::Eval;
use super::estimate::{Estimate, PictureFiles, picture_files};
use crate::console::print_status;
use crate::failure::{Failure, failed};
use crate::ground_truth::GroundTruth;
use crate::image_files::read_png;
use i2slam::Config;
use i2slam::dataset::{OpenOptions, Sequence, is_stream};
use i2slam::geometry::{Image, StampedPose};
use i2slam_result::report::GroundTruthSource;
use i2slam_result::{RunInput, load_metrics};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Ground truth of an evaluation.
pub(super) enum Reference {
    /// PNG and EXR files by frame.
    Folder { path: PathBuf, colour: PictureFiles, radiance: PictureFiles },
    /// A dataset with its ground truth.
    Dataset { path: PathBuf, sequence: Box<Sequence>, truth: Box<GroundTruth> },
}

/// Ground truth of one frame.
pub(super) struct TrueFrame {
    pub(super) colour: Image<f32>,
    /// Metres; only a dataset has it.
    pub(super) depth: Option<Image<f32>>,
}

impl Reference {
    /// Opens a dataset, with the settings of the run, or a folder of pictures.
    pub(super) fn open(path: &Path, estimate: &Estimate) -> Result<Self, Failure> {
        if !path.is_dir() {
            return Self::dataset(path, estimate);
        }
        let (colour, radiance) = (picture_files(path, "png")?, picture_files(path, "exr")?);
        if path.join("rgb.txt").is_file() || (colour.is_empty() && radiance.is_empty()) {
            return Self::dataset(path, estimate);
        }
        Ok(Self::Folder { path: path.to_owned(), colour, radiance })
    }

    /// The dataset that a result folder names, if it names one.
    pub(super) fn recorded(estimate: &Estimate) -> Result<Option<Self>, Failure> {
        let Some(result) = estimate.result() else { return Ok(None) };
        let Some(input) = RunInput::load(result)? else { return Ok(None) };
        let dataset = &input.dataset;
        if !dataset.exists() {
            let reason = match is_stream(dataset) {
                true => "the run was of a stream, which is not kept",
                false => "the dataset of this run is not there any more",
            };
            let reason =
                format!("{reason}: give one as --reference, or a trajectory as --groundtruth");
            return Err(failed(dataset, reason));
        }
        Self::dataset(dataset, estimate).map(Some)
    }

    fn dataset(path: &Path, estimate: &Estimate) -> Result<Self, Failure> {
        let sequence = match estimate.result() {
            Some(result) => open_as_run(path, result)?,
            None => Sequence::open(path, &OpenOptions::default())?,
        };
        let truth = GroundTruth::open(path, &sequence);
        truth.warnings.iter().for_each(|warning| print_status(&format!("warning: {warning}")));
        let (sequence, truth) = (Box::new(sequence), Box::new(truth));
        Ok(Self::Dataset { path: path.to_owned(), sequence, truth })
    }

    pub(super) fn path(&self) -> &Path {
        match self {
            Self::Folder { path, .. } | Self::Dataset { path, .. } => path,
        }
    }

    /// Whether the recorded pictures are used because there are no sharp ones.
    pub(super) fn uses_recorded(&self) -> bool {
        match self {
            Self::Folder { .. } => false,
            Self::Dataset { path, .. } => !path.join("sharp").is_dir(),
        }
    }

    /// Frames with a true picture, ascending.
    pub(super) fn frames(&self) -> Vec<usize> {
        match self {
            Self::Folder { colour, .. } => colour.keys().copied().collect(),
            Self::Dataset { path, sequence, .. } => {
                let sharp = path.join("sharp");
                let known = |colour: &Path| {
                    !sharp.is_dir() || colour.file_name().is_some_and(|n| sharp.join(n).is_file())
                };
                let entries = sequence.entries.iter().filter(|e| known(&e.colour));
                entries.map(|e| e.index).collect()
            }
        }
    }

    /// Time stamps of the frames that the run was given [s]; `None` where they are not known, as where
    /// the run had another number of frames, of a video of this dataset for example.
    pub(super) fn frames_of_run(&self, estimate: &Estimate) -> Result<Option<Vec<f64>>, Failure> {
        let (Self::Dataset { sequence, .. }, Some(result)) = (self, estimate.result()) else {
            return Ok(None);
        };
        let Some(RunInput { options, .. }) = RunInput::load(result)? else { return Ok(None) };
        let chosen = options.frames.unwrap_or(0..usize::MAX);
        let is_given = |index: usize| {
            chosen.contains(&index) && (index - chosen.start).is_multiple_of(options.stride.max(1))
        };
        let given = sequence.entries.iter().filter(|entry| is_given(entry.index));
        let stamps: Vec<f64> = given.map(|entry| entry.timestamp).collect();
        let counted = load_metrics(result).map_or(0, |metrics| metrics.frames_given);
        // Results of earlier versions did not count them.
        Ok(Some(stamps).filter(|stamps| counted == 0 || counted == stamps.len()))
    }

    /// Ground truth of one of [`frames`](Self::frames).
    pub(super) fn load(&self, index: usize) -> Result<TrueFrame, Failure> {
        match self {
            Self::Folder { path, colour, .. } => {
                let file = colour.get(&index);
                let file = file.ok_or_else(|| failed(path, format!("has no frame {index}")))?;
                Ok(TrueFrame { colour: read_png(file)?, depth: None })
            }
            Self::Dataset { path, sequence, truth } => {
                let place = sequence.entries.binary_search_by_key(&index, |entry| entry.index);
                let place = place.map_err(|_| failed(path, format!("has no frame {index}")))?;
                let taken = sequence.load(place)?;
                let sharp = path.join("sharp");
                let colour = if sharp.is_dir() {
                    let picture = truth.sharp(place);
                    picture.ok_or_else(|| failed(&sharp, format!("frame {index} is unreadable")))?
                } else {
                    Arc::unwrap_or_clone(taken.colour)
                };
                let depth = taken.depth.map(|depth| Arc::unwrap_or_clone(depth.image));
                Ok(TrueFrame { colour, depth })
            }
        }
    }

    /// The file of a frame's true radiance.
    pub(super) fn radiance(&self, index: usize) -> Option<PathBuf> {
        match self {
            Self::Folder { radiance, .. } => radiance.get(&index).cloned(),
            Self::Dataset { truth, .. } => truth.radiance(index),
        }
    }

    /// The true trajectory that a dataset has.
    pub(super) fn trajectory(&self) -> Option<&[StampedPose]> {
        match self {
            Self::Dataset { truth, .. } if !truth.trajectory.is_empty() => Some(&truth.trajectory),
            _ => None,
        }
    }
}

/// Opens a dataset as the run did, but all of its frames, so that `auto` selects the same sharp
/// ones whichever part was run.
fn open_as_run(path: &Path, result: &Path) -> Result<Sequence, Failure> {
    let Some(input) = RunInput::load(result)? else { return open_as_rendered(path, result) };
    let options = OpenOptions { frames: None, stride: 1, ..input.options };
    // A run on colour alone can be evaluated with depth all the same.
    let with_depth = OpenOptions { colour_only: false, ..options.clone() };
    let sequence = Sequence::open(path, &with_depth).or_else(|_| Sequence::open(path, &options))?;
    let width = render_width(&result.join("camera.json"));
    let fits = width.is_none_or(|width| width == sequence.camera.width);
    // Another copy of the pictures may have another size.
    if fits { Ok(sequence) } else { open_as_rendered(path, result) }
}

/// Opens a dataset with the settings of a run at the size of its renders.
fn open_as_rendered(path: &Path, result: &Path) -> Result<Sequence, Failure> {
    let mut options = OpenOptions::default();
    let settings = result.join("config.toml");
    if settings.is_file() {
        let config = Config::from_stored_file(&settings)?;
        options.crop_border = config.input.crop_border;
        options.minimum_gap = config.input.minimum_gap;
        options.depth_pairing = config.depth_pairing();
    }
    let sequence = Sequence::open(path, &options)?;
    match render_width(&result.join("camera.json")) {
        Some(width) if width < sequence.camera.width => {
            options.scale = width as f64 / sequence.camera.width as f64;
            Ok(Sequence::open(path, &options)?)
        }
        _ => Ok(sequence),
    }
}

/// Width of the renders [px].
fn render_width(camera: &Path) -> Option<usize> {
    let text = i2slam_storage::read_text(camera).ok()?;
    let camera: serde_json::Value = serde_json::from_str(&text).ok()?;
    camera.get("width")?.as_u64().map(|width| width as usize)
}

/// Source of the true trajectory: a file, or the dataset.
pub(super) fn trajectory_source(
    arguments: &Eval,
    reference: Option<&Reference>,
    truth: &[StampedPose],
) -> Option<GroundTruthSource> {
    let path = arguments.groundtruth.as_deref().or(reference.map(Reference::path))?;
    let mut sum = crc32fast::Hasher::new();
    for pose in truth {
        let (q, t) = (pose.world_from_camera.rotation, pose.world_from_camera.translation);
        let numbers = [pose.timestamp, t.x, t.y, t.z, q.w, q.v.x, q.v.y, q.v.z];
        numbers.iter().for_each(|number| sum.update(&number.to_le_bytes()));
    }
    Some(truth_source(path, truth.len(), sum.finalize()))
}

/// Source of the true pictures, with the checksum of all evaluated ones.
pub(super) fn picture_source(reference: &Reference, checksums: &[u32]) -> GroundTruthSource {
    let mut sum = crc32fast::Hasher::new();
    checksums.iter().for_each(|one| sum.update(&one.to_le_bytes()));
    truth_source(reference.path(), checksums.len(), sum.finalize())
}

/// CRC-32 of a picture's values.
pub(super) fn checksum(picture: &Image<f32>) -> u32 {
    let mut sum = crc32fast::Hasher::new();
    for values in picture.data.chunks(1 << 12) {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        sum.update(&bytes);
    }
    sum.finalize()
}

fn truth_source(path: &Path, count: usize, crc32: u32) -> GroundTruthSource {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    GroundTruthSource { path, count, crc32: format!("{crc32:08x}") }
}

/// Ground truth from elsewhere than the dataset that the run read, and that dataset.
pub(super) fn foreign_ground_truth(
    arguments: &Eval,
    estimate: &Estimate,
    reference: Option<&Reference>,
) -> Result<Option<(Vec<PathBuf>, PathBuf)>, Failure> {
    let Some(result) = estimate.result() else { return Ok(None) };
    let Some(input) = RunInput::load(result)? else { return Ok(None) };
    let whole = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let read = whole(&input.dataset);
    let truths = arguments.groundtruth.iter().map(PathBuf::as_path);
    let truths = truths.chain(reference.map(Reference::path)).map(whole);
    let others: Vec<PathBuf> = truths.filter(|truth| !truth.starts_with(&read)).collect();
    Ok((!others.is_empty()).then_some((others, input.dataset)))
}
