//! Pictures of how far depth pictures are trusted.

use super::keyframe::KeyframePose;
use super::npy::Array;
use crate::decode::{DepthCode, decode_depth};
use crate::layouts::pairs::{last_number, stem};
use crate::{DatasetError, Sequence};
use i2slam_geometry::Image;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// A folder of them: `.npy` arrays `[height, width]` of the variance of depth [m²], or 16-bit grey
/// PNG of the standard deviation on the scale of the depth pictures. As large as these.
#[derive(Clone, Debug)]
pub(super) struct VariancePictures {
    folder: PathBuf,
    by_name: HashMap<String, PathBuf>,
    /// By the last number in the name; none if two files have the same.
    by_number: HashMap<u64, PathBuf>,
    /// Two files with one number, for messages.
    same_number: Option<(PathBuf, PathBuf)>,
}

impl VariancePictures {
    pub(super) fn open(folder: &Path) -> Result<Self, DatasetError> {
        let listing = std::fs::read_dir(folder).map_err(|e| DatasetError::read(folder, e))?;
        let of_interest = |path: &PathBuf| {
            path.extension().is_some_and(|e| ["npy", "png"].iter().any(|end| e == *end))
        };
        let mut files: Vec<PathBuf> =
            listing.flatten().map(|entry| entry.path()).filter(of_interest).collect();
        files.sort();
        if files.is_empty() {
            let expected = ".npy arrays of variance or 16-bit PNG of standard deviation";
            return Err(DatasetError::Empty { path: folder.to_path_buf(), expected });
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
        let name = stem(&file);
        if let Some(number) = last_number(&name)
            && let Some(other) = self.by_number.insert(number, file.clone())
        {
            self.same_number.get_or_insert((other, file.clone()));
        }
        match self.by_name.insert(name, file.clone()) {
            None => Ok(()),
            Some(other) => {
                let reason = format!("{} has the same name, expected one of them", other.display());
                Err(DatasetError::metadata(&file, reason))
            }
        }
    }

    /// The delivered variance [m²] of a keyframe. Depth without a variance above 0 becomes none.
    pub(super) fn load(
        &self,
        sequence: &Sequence,
        pose: &KeyframePose,
        depth: &mut Image<f32>,
    ) -> Result<Image<f32>, DatasetError> {
        let entry = &sequence.entries[pose.position];
        let beside = entry.depth.as_deref().unwrap_or(&entry.colour);
        let file = self.find(beside).or_else(|| self.find(&entry.colour));
        let file = file.ok_or_else(|| {
            let same = self.same_number.as_ref().map_or(String::new(), |(a, b)| {
                format!(" (numbers do not count: {} and {} share one)", a.display(), b.display())
            });
            let beside = beside.display();
            let reason = format!("no variance with the name or number of {beside}{same}");
            DatasetError::image(&self.folder, reason)
        })?;
        let resampler = &sequence.preparation.resampler;
        let (_, size) = resampler.recorded_sizes();
        let mut variance = if file.extension().is_some_and(|e| e == "npy") {
            let recorded = read_array(file, size)?;
            resampler.depth_values(&recorded, |variance| variance)
        } else {
            let recorded = decode_depth(file, None, DepthCode::Png)?;
            check_size(file, (recorded.width, recorded.height), size)?;
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

    /// The file of that name, else of the last number in it.
    fn find(&self, beside: &Path) -> Option<&Path> {
        let name = stem(beside);
        let by_number = || self.by_number.get(&last_number(&name)?);
        self.by_name.get(&name).or_else(by_number).map(PathBuf::as_path)
    }
}

fn read_array(file: &Path, size: (usize, usize)) -> Result<Image<f32>, DatasetError> {
    let array = Array::open(file).map_err(of_one_frame)?;
    let &[height, width] = array.shape.as_slice() else {
        let reason = format!("shape {:?}, expected [height, width]", array.shape);
        return Err(DatasetError::image(file, reason));
    };
    check_size(file, (width, height), size)?;
    let data = array.all()?.into_iter().map(|v| v as f32).collect();
    Ok(Image { width, height, channels: 1, data })
}

/// A broken file of variance concerns the keyframe that it belongs to.
fn of_one_frame(error: DatasetError) -> DatasetError {
    match error {
        DatasetError::Metadata { path, reason } => DatasetError::Image { path, reason },
        other => other,
    }
}

fn check_size(
    path: &Path,
    found: (usize, usize),
    expected: (usize, usize),
) -> Result<(), DatasetError> {
    if found == expected {
        return Ok(());
    }
    let reference = "the depth pictures".to_owned();
    Err(DatasetError::Size { path: path.to_path_buf(), found, expected, reference })
}
