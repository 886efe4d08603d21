//! Variance of depth images, from files.

use super::source::KeyframePose;
use crate::formats::npy::NpyArray;
use crate::formats::{file_stem, last_number};
use crate::image::{DepthEncoding, ExpectedSize, decode_depth};
use crate::{DatasetError, Sequence};
use i2slam_geometry::Image;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Images that the variance must have the size of, for messages.
const REFERENCE: &str = "the depth pictures";

/// Folder of `.npy` arrays `[height, width]` of the variance of depth [m²], or of 16-bit grey PNG of
/// the standard deviation on the scale of the depth images. Same size as these.
#[derive(Clone, Debug)]
pub(super) struct VarianceImages {
    folder: PathBuf,
    by_name: HashMap<String, PathBuf>,
    /// By the last number in the name; empty if two files share one.
    by_number: HashMap<u64, PathBuf>,
    /// Two files that share a number, for messages.
    same_number: Option<(PathBuf, PathBuf)>,
}

impl VarianceImages {
    pub(super) fn open(folder: &Path) -> Result<Self, DatasetError> {
        let listing = std::fs::read_dir(folder).map_err(|e| DatasetError::read(folder, e))?;
        let is_variance = |path: &PathBuf| {
            path.extension().is_some_and(|e| ["npy", "png"].iter().any(|end| e == *end))
        };
        let mut files: Vec<PathBuf> =
            listing.flatten().map(|entry| entry.path()).filter(is_variance).collect();
        files.sort();
        if files.is_empty() {
            return Err(DatasetError::empty(
                folder,
                ".npy arrays of variance or 16-bit PNG of standard deviation",
            ));
        }
        let mut found = Self {
            folder: folder.to_path_buf(),
            by_name: HashMap::new(),
            by_number: HashMap::new(),
            same_number: None,
        };
        for file in files {
            found.add(file)?;
        }
        if found.same_number.is_some() {
            found.by_number.clear();
        }
        Ok(found)
    }

    fn add(&mut self, file: PathBuf) -> Result<(), DatasetError> {
        let name = file_stem(&file);
        if let Some(number) = last_number(&name)
            && let Some(other) = self.by_number.insert(number, file.clone())
        {
            self.same_number.get_or_insert((other, file.clone()));
        }
        match self.by_name.insert(name, file.clone()) {
            None => Ok(()),
            Some(other) => {
                let reason = format!("{} has the same name, expected one of them", other.display());
                Err(DatasetError::file(&file, reason))
            }
        }
    }

    /// Reads and resamples the variance [m²] of a keyframe. Depth without a positive variance is
    /// removed.
    pub(super) fn load(
        &self,
        sequence: &Sequence,
        pose: &KeyframePose,
        depth: &mut Image<f32>,
    ) -> Result<Image<f32>, DatasetError> {
        let entry = &sequence.entries[pose.position];
        let beside = entry.depth_path().unwrap_or(&entry.colour);
        let file = self.find(beside).or_else(|| self.find(&entry.colour));
        let file = file.ok_or_else(|| {
            let same = self.same_number.as_ref().map_or(String::new(), |(a, b)| {
                format!(" (numbers do not count: {} and {} share one)", a.display(), b.display())
            });
            let beside = beside.display();
            let reason = format!("no variance with the name or number of {beside}{same}");
            DatasetError::image(&self.folder, reason)
        })?;
        let resampler = &sequence.loader.resampler;
        let (_, size) = resampler.recorded_sizes();
        let mut variance = if file.extension().is_some_and(|e| e == "npy") {
            let recorded = read_array(file, size)?;
            resampler.depth_values(&recorded, |variance| variance)
        } else {
            let expected = ExpectedSize { size, reference: REFERENCE };
            let recorded = decode_depth(file, None, DepthEncoding::Png, expected)?;
            let scale = sequence.depth_scale;
            resampler.depth_values(&recorded, |v| (f64::from(v) / scale).powi(2) as f32)
        };
        for (depth, variance) in depth.data.iter_mut().zip(&mut variance.data) {
            if !(variance.is_finite() && *variance > 0.0) {
                (*depth, *variance) = (0.0, 0.0);
            }
        }
        Ok(variance)
    }

    /// Finds the file with the name of another, else with the last number in it.
    fn find(&self, beside: &Path) -> Option<&Path> {
        let name = file_stem(beside);
        let by_number = || self.by_number.get(&last_number(&name)?);
        self.by_name.get(&name).or_else(by_number).map(PathBuf::as_path)
    }
}

fn read_array(file: &Path, size: (usize, usize)) -> Result<Image<f32>, DatasetError> {
    let array = NpyArray::open(file).map_err(as_frame_error)?;
    let &[height, width] = array.shape.as_slice() else {
        let reason = format!("shape {:?}, expected [height, width]", array.shape);
        return Err(DatasetError::image(file, reason));
    };
    DatasetError::check_size(file, (width, height), size, REFERENCE)?;
    let data = array.numbers(0, width * height)?.into_iter().map(|v| v as f32).collect();
    Ok(Image { width, height, channels: 1, data })
}

/// A damaged variance file affects its keyframe only, unlike other metadata.
fn as_frame_error(error: DatasetError) -> DatasetError {
    match error {
        DatasetError::File { path, reason } => DatasetError::Image { path, reason },
        other => other,
    }
}
