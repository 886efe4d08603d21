//! Recordings of the app Record3D on telephones: a zip archive, `.r3d`, or the folder that it unpacks to.
//!
//! `metadata` is a JSON object; of frame N, `rgbd/N.jpg` is the colour picture, `rgbd/N.depth` has depth as
//! 32-bit floats \[m\], and `rgbd/N.conf` the confidence of every reading, 0 to 2 (LiDAR alone), both
//! compressed by LZFSE. Depth has the field of view of colour in fewer pixels. The telephone's own poses are
//! an estimate, and no ground truth.

use super::file_pairing::file_stem;
use super::folders::{is_file_of, only_file};
use super::zip::ZipArchive;
use super::{DepthEntry, FrameEntry, FrameParts, Layout, Listing};
use crate::camera::{Calibration, DepthGrid, Distortion, FormatDefaults};
use crate::file_part::FilePart;
use crate::image::{DepthEncoding, METRES_AS_INTEGERS, check_pixels};
use crate::text::{counted, deserialize_json, is_present, read_text};
use crate::{DatasetError, OpenOptions};
use i2slam_compute::median;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Largest `metadata` [bytes]: that of an hour at 60 frames a second.
const MAX_METADATA: u64 = 64 << 20;

const METADATA: &str = "metadata";
const FRAMES: &str = "rgbd";

/// A recording whose metadata are read.
pub(crate) struct Recording {
    /// The archive, or the folder.
    path: PathBuf,
    metadata: Metadata,
    /// Files of every frame by its number in the recording.
    frames: BTreeMap<usize, FrameFiles>,
}

/// Fields of `metadata` that are used.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Metadata {
    /// Size of colour [px].
    w: usize,
    h: usize,
    /// Size of depth [px]; that of colour where it is not there.
    dw: Option<usize>,
    dh: Option<usize>,
    fps: Option<f64>,
    /// 3x3 matrix of the first frame in columns [px].
    #[serde(rename = "K")]
    matrix: Option<Vec<f64>>,
    /// `[fx, fy, cx, cy]` of every frame [px], which focus and the stabilisation of the lens change.
    per_frame_intrinsic_coeffs: Option<Vec<Vec<f64>>>,
    /// Time of every frame [s].
    frame_timestamps: Option<Vec<f64>>,
}

/// Place of a file: a member of the archive, or a file of the folder.
#[derive(Clone)]
struct Place {
    path: PathBuf,
    part: Option<FilePart>,
}

#[derive(Default)]
struct FrameFiles {
    colour: Option<Place>,
    depth: Option<Place>,
    confidence: Option<Place>,
}

/// True of an archive, by its name.
pub(super) fn is_archive(path: &Path) -> bool {
    is_file_of(path, "r3d")
}

/// True of a folder that an archive unpacked to.
pub(super) fn is_unpacked(folder: &Path) -> bool {
    is_present(&folder.join(METADATA)) && folder.join(FRAMES).is_dir()
}

/// The only archive in a folder.
pub(super) fn find_archive(folder: &Path) -> Option<PathBuf> {
    only_file(folder, is_archive)
}

impl Recording {
    pub(super) fn open_archive(path: &Path) -> Result<Self, DatasetError> {
        let archive = ZipArchive::open(path)?;
        let part = |member| archive.part(member, "unpack it, and give the folder");
        let metadata = archive.members.iter().find(|member| member.name == METADATA);
        let metadata = metadata.ok_or_else(|| {
            let reason = "no recording of Record3D: it holds no file 'metadata'; export it as .r3d \
                          again";
            DatasetError::file(path, reason)
        })?;
        let inside = path.join(METADATA);
        let bytes = part(metadata)?.read(path, MAX_METADATA);
        let bytes = bytes.map_err(|e| DatasetError::read(&inside, e))?;
        let mut found = Self {
            path: path.to_path_buf(),
            metadata: Metadata::parse(&inside, &String::from_utf8_lossy(&bytes))?,
            frames: BTreeMap::new(),
        };
        for member in &archive.members {
            let Some(name) = member.name.strip_prefix(FRAMES).and_then(|n| n.strip_prefix('/'))
            else {
                continue;
            };
            let place = Place { path: path.to_path_buf(), part: Some(part(member)?) };
            found.add(Path::new(name), place);
        }
        Ok(found)
    }

    pub(super) fn open_folder(path: &Path) -> Result<Self, DatasetError> {
        let file = path.join(METADATA);
        let metadata = Metadata::parse(&file, &read_text(&file)?)?;
        let mut found = Self { path: path.to_path_buf(), metadata, frames: BTreeMap::new() };
        let folder = path.join(FRAMES);
        let files = std::fs::read_dir(&folder).map_err(|e| DatasetError::read(&folder, e))?;
        for file in files.flatten().map(|entry| entry.path()) {
            found.add(&file, Place { path: file.clone(), part: None });
        }
        Ok(found)
    }

    /// Adds a file `N.jpg`, `N.depth` or `N.conf`; others are not used.
    fn add(&mut self, name: &Path, place: Place) {
        let Ok(number) = file_stem(name).parse::<usize>() else { return };
        let frame = self.frames.entry(number).or_default();
        match name.extension().and_then(|extension| extension.to_str()) {
            Some("jpg") => frame.colour = Some(place),
            Some("depth") => frame.depth = Some(place),
            Some("conf") => frame.confidence = Some(place),
            _ => {}
        }
    }

    pub(super) fn defaults(&self) -> FormatDefaults {
        FormatDefaults {
            depth_scale: METRES_AS_INTEGERS,
            is_scale_assumed: false,
            frame_rate: self.metadata.fps.filter(|fps| fps.is_finite() && *fps > 0.0),
            grid: DepthGrid::ResizedToColour,
            invalid_depth: None,
        }
    }

    /// True if some frame has depth.
    pub(super) fn has_depth(&self) -> bool {
        self.frames.values().any(|files| files.colour.is_some() && files.depth.is_some())
    }

    /// The median camera of all frames; `None` where the metadata have none.
    pub(super) fn calibration(&self) -> Result<Option<Calibration>, DatasetError> {
        let file = self.path.join(METADATA);
        if self.metadata.matrix.is_none() && self.metadata.per_frame_intrinsic_coeffs.is_none() {
            return Ok(None);
        }
        let intrinsics = self.metadata.intrinsics().ok_or_else(|| {
            let reason = "expected intrinsics with fx, fy above 0, in K or perFrameIntrinsicCoeffs";
            DatasetError::file(&file, reason)
        })?;
        let source = file.display().to_string();
        let found =
            Calibration::from_opencv(intrinsics, Distortion::default(), &source, self.defaults());
        Ok(Some(Calibration { size: Some((self.metadata.w, self.metadata.h)), ..found }))
    }

    /// Lists the frames that have a colour picture.
    pub(super) fn list(
        &self,
        options: &OpenOptions,
        frame_rate: f64,
    ) -> Result<Listing, DatasetError> {
        let pictures =
            self.frames.iter().filter_map(|(n, files)| Some((*n, files.colour.as_ref()?)));
        let numbers: Vec<usize> = pictures.clone().map(|(number, _)| number).collect();
        let Some(last) = numbers.last() else {
            return Err(DatasetError::empty(&self.path.join(FRAMES), "pictures 0.jpg, 1.jpg, ..."));
        };
        let times = self.metadata.times(*last);
        let entry = |(index, (number, colour)): (usize, (usize, &Place))| {
            let time = times.map_or(number as f64 / frame_rate, |times| times[number]);
            self.entry((index, number), time, colour)
        };
        let entries: Vec<FrameEntry> = pictures.enumerate().map(entry).collect();
        if !options.colour_only && !self.has_depth() {
            let reason = format!("none of its {} has depth", counted(entries.len(), "picture"));
            return Err(DatasetError::file(&self.path.join(FRAMES), reason));
        }
        let (width, height) = self.metadata.depth_size();
        let mut listing = Listing {
            depth_encoding: DepthEncoding::LzfseMetres { width, height },
            are_times_assumed: times.is_none(),
            ..Listing::new(Layout::Record3d, entries)
        };
        listing.keep_those_with_depth(options, "no depth of that number");
        Ok(listing)
    }

    fn entry(&self, (index, number): (usize, usize), timestamp: f64, colour: &Place) -> FrameEntry {
        let files = &self.frames[&number];
        let depth = files.depth.as_ref().map(|depth| DepthEntry {
            confidence: files.confidence.as_ref().map(|place| place.path.clone()),
            ..DepthEntry::of_file(depth.path.clone(), timestamp)
        });
        let part = |place: &Option<Place>| place.as_ref().and_then(|place| place.part.clone());
        let parts = colour.part.clone().map(|colour| FrameParts {
            colour,
            depth: part(&files.depth),
            confidence: part(&files.confidence),
        });
        let path = colour.path.clone();
        let plain = FrameEntry::synchronous((index, number), timestamp, path, None);
        FrameEntry { depth, parts, ..plain }
    }
}

impl Metadata {
    fn parse(path: &Path, text: &str) -> Result<Self, DatasetError> {
        let found: Self = deserialize_json(text)
            .map_err(|e| DatasetError::file(path, format!("no JSON object of Record3D: {e}")))?;
        let (width, height) = found.depth_size();
        if [found.w, found.h, width, height].contains(&0) {
            return Err(DatasetError::file(path, "w, h, dw and dh must be above 0"));
        }
        check_pixels(path, (width, height))?;
        Ok(found)
    }

    fn depth_size(&self) -> (usize, usize) {
        (self.dw.unwrap_or(self.w), self.dh.unwrap_or(self.h))
    }

    /// `[fx, fy, cx, cy]`, the median of all frames, or else that of the matrix.
    fn intrinsics(&self) -> Option<[f64; 4]> {
        let of_frames = self.per_frame_intrinsic_coeffs.iter().flatten();
        let of_frames: Vec<&Vec<f64>> = of_frames.filter(|frame| frame.len() == 4).collect();
        let median_of = |i: usize| {
            let mut all: Vec<f64> = of_frames.iter().map(|frame| frame[i]).collect();
            median(&mut all)
        };
        let of_matrix = || match self.matrix.as_deref()? {
            [fx, _, _, _, fy, _, cx, cy, _] => Some([*fx, *fy, *cx, *cy]),
            _ => None,
        };
        let found = match [0, 1, 2, 3].map(median_of) {
            [Some(fx), Some(fy), Some(cx), Some(cy)] => [fx, fy, cx, cy],
            _ => of_matrix()?,
        };
        let is_camera = found.iter().all(|v| v.is_finite()) && found[0] > 0.0 && found[1] > 0.0;
        is_camera.then_some(found)
    }

    /// Times of the frames up to the last one, if all of them have one that is later than that before.
    fn times(&self, last: usize) -> Option<&[f64]> {
        let times = self.frame_timestamps.as_deref()?.get(..=last)?;
        let increases = times.windows(2).all(|pair| pair[0] < pair[1]);
        (increases && times.iter().all(|time| time.is_finite())).then_some(times)
    }
}
