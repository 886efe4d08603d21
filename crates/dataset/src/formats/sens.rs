//! ScanNet's `.sens`: calibration, poses and compressed images of a whole sequence in one file.
//!
//! Little-endian, version 4: a header, then for every frame the pose `world_from_camera` (16
//! `f32` in rows), two time stamps [µs], two sizes [bytes], and the two images.

use super::folders::{is_file_of, only_file};
use super::poses::pose_from_matrix;
use super::scannet::{self, border_warning, from_intrinsics, intrinsics_of_matrix};
use super::{DepthEntry, FrameEntry, FrameParts, Layout, Listing, unknown_layout};
use crate::camera::{Calibration, FormatDefaults};
use crate::file_part::FilePart;
use crate::image::{DepthEncoding, MAX_DEFLATE_RATIO, check_pixels};
use crate::{DatasetError, OpenOptions};
use std::fs::File;
use std::io::{BufReader, ErrorKind, Read, Seek};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Plausible median gap between time stamps of a video [s].
const PLAUSIBLE_GAP: std::ops::RangeInclusive<f64> = 1e-3..=1.0;

/// Header and frame index of a `.sens` file.
pub(crate) struct SensFile {
    path: PathBuf,
    header: Header,
    frames: Vec<SensFrame>,
    warnings: Vec<String>,
}

/// Path of the only `.sens` file in a folder.
pub(super) fn find(folder: &Path) -> Option<PathBuf> {
    only_file(folder, is_sens)
}

fn is_sens(path: &Path) -> bool {
    is_file_of(path, "sens")
}

impl SensFile {
    /// Reads the header and the position of every frame.
    pub(super) fn open(path: &Path) -> Result<Self, DatasetError> {
        if !is_sens(path) {
            let is_archive = i2slam_storage::read_range(path, 0..2).is_ok_and(|word| word == b"PK");
            let found = match is_archive {
                true => "an archive: unpack it, or call a recording of Record3D .r3d".into(),
                false => "a file that is no .sens, no .r3d and no video".into(),
            };
            return Err(unknown_layout(path, found, false));
        }
        let mut reader = SensReader::open(path)?;
        let header = reader.header()?;
        let (mut frames, mut warnings) = (Vec::new(), Vec::new());
        for number in 0..header.frames {
            match reader.frame()? {
                Some(frame) => frames.push(frame),
                None => {
                    let all = header.frames;
                    warnings.push(format!("the file ends within frame {number} of {all}"));
                    break;
                }
            }
        }
        if frames.is_empty() {
            return Err(DatasetError::empty(path, "at least one whole frame"));
        }
        header.check_depth(path, &frames)?;
        Ok(Self { path: path.to_path_buf(), header, frames, warnings })
    }

    pub(super) fn defaults(&self) -> FormatDefaults {
        FormatDefaults { depth_scale: self.header.depth_scale, ..scannet::DEFAULTS }
    }

    pub(super) fn calibration(&self) -> Result<Calibration, DatasetError> {
        let colour = intrinsics_of_matrix(&self.header.intrinsic_colour);
        let colour = colour.ok_or_else(|| {
            DatasetError::file(
                &self.path,
                "the intrinsics of the colour camera are no numbers above 0",
            )
        })?;
        let depth = intrinsics_of_matrix(&self.header.intrinsic_depth);
        let source = self.path.display().to_string();
        let found = from_intrinsics(colour, depth, &source, self.defaults());
        Ok(Calibration { size: Some(self.header.colour_size), ..found })
    }

    /// Lists the frames, unthinned: published numbers count frames.
    pub(super) fn list(
        &self,
        options: &OpenOptions,
        frame_rate: f64,
    ) -> Result<Listing, DatasetError> {
        let times = self.times();
        let time = |i: usize| times.as_ref().map_or(i as f64 / frame_rate, |t| t[i].0);
        let depth_time = |i: usize| times.as_ref().map_or(i as f64 / frame_rate, |t| t[i].1);
        let entry = |(index, frame): (usize, &SensFrame)| FrameEntry {
            index,
            image_index: index,
            timestamp: time(index),
            colour: self.path.clone(),
            depth: Some(DepthEntry::of_file(self.path.clone(), depth_time(index))),
            parts: Some(FrameParts {
                colour: FilePart::stored(frame.colour.clone()),
                depth: Some(FilePart::stored(frame.depth.clone())),
                confidence: None,
            }),
        };
        let entries: Vec<FrameEntry> = self.frames.iter().enumerate().map(entry).collect();
        let mut listing = Listing::new(Layout::Sens, entries);
        listing.depth_encoding = self.depth_encoding();
        listing.warnings = self.warnings.clone();
        if times.is_none() {
            let rate = format!("no usable time stamps: {frame_rate} frames a second assumed");
            listing.warnings.push(rate);
        }
        listing.set_poses(|i, _| pose_from_matrix(&self.frames[i].world_from_camera));
        listing.warnings.extend(border_warning(options));
        Ok(listing)
    }

    fn depth_encoding(&self) -> DepthEncoding {
        let (width, height) = self.header.depth_size;
        if self.header.depth_is_compressed {
            DepthEncoding::Zlib { width, height }
        } else {
            DepthEncoding::Raw { width, height }
        }
    }

    /// Time stamps of colour and depth [s] from the first colour image on; `None` unless they
    /// increase by plausible gaps (other writers use other units).
    fn times(&self) -> Option<Vec<(f64, f64)>> {
        let first = self.frames.first()?.stamps.0 as f64;
        let seconds = |stamp: u64| (stamp as f64 - first) * 1e-6;
        let times: Vec<(f64, f64)> =
            self.frames.iter().map(|f| (seconds(f.stamps.0), seconds(f.stamps.1))).collect();
        let mut gaps: Vec<f64> = times.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
        gaps.sort_by(f64::total_cmp);
        let increases = *gaps.first()? > 0.0;
        let together = times.iter().all(|(colour, depth)| (colour - depth).abs() <= 1.0);
        let is_plausible = increases && PLAUSIBLE_GAP.contains(gaps.get(gaps.len() / 2)?);
        is_plausible.then(|| match together {
            true => times,
            false => times.into_iter().map(|(colour, _)| (colour, colour)).collect(),
        })
    }
}

const VERSION: u32 = 4;

/// Colour codes of PNG and JPEG.
const COLOUR_CODES: [i32; 2] = [1, 2];

/// Depth code of raw 16-bit values.
const DEPTH_RAW: i32 = 0;
/// Depth code of deflated values (zlib).
const DEPTH_ZLIB: i32 = 1;

/// Longest accepted sensor name [bytes]; anything longer is a damaged file.
const MAX_NAME_BYTES: u64 = 4096;

/// Properties of all frames.
struct Header {
    /// Row-major 4x4, pixel centres at integers.
    intrinsic_colour: [f64; 16],
    intrinsic_depth: [f64; 16],
    depth_is_compressed: bool,
    /// Width and height [px].
    colour_size: (usize, usize),
    depth_size: (usize, usize),
    /// Depth image value of one metre.
    depth_scale: f64,
    frames: u64,
}

impl Header {
    /// An error if no frame has enough bytes for depth of the size in the header, on whose grid all
    /// frames are delivered.
    fn check_depth(&self, path: &Path, frames: &[SensFrame]) -> Result<(), DatasetError> {
        let (width, height) = self.depth_size;
        let ratio = if self.depth_is_compressed { MAX_DEFLATE_RATIO } else { 1 };
        let needed = 2 * (width * height) as u64 / ratio;
        let longest = frames.iter().map(|frame| frame.depth.end - frame.depth.start).max();
        if longest >= Some(needed) {
            return Ok(());
        }
        let reason = format!(
            "depth images of {width}x{height} px take {needed} bytes or more, and none has as many: \
             damaged?"
        );
        Err(DatasetError::file(path, reason))
    }
}

/// Pose, time stamps and byte ranges of a frame.
struct SensFrame {
    /// Row-major 4x4; not finite where tracking was lost.
    world_from_camera: [f64; 16],
    /// Time stamps of colour and depth [µs].
    stamps: (u64, u64),
    colour: Range<u64>,
    depth: Range<u64>,
}

/// Sequential reader of a `.sens` file.
struct SensReader {
    path: PathBuf,
    file: BufReader<File>,
    /// Length of the file [bytes].
    length: u64,
}

impl SensReader {
    fn open(path: &Path) -> Result<Self, DatasetError> {
        let file = i2slam_storage::open(path).map_err(|e| DatasetError::read(path, e))?;
        let length = file.metadata().map_err(|e| DatasetError::read(path, e))?.len();
        Ok(Self { path: path.to_path_buf(), file: BufReader::new(file), length })
    }

    /// Reads the header at the start of the file.
    fn header(&mut self) -> Result<Header, DatasetError> {
        let version = u32::from_le_bytes(self.take()?);
        if version != VERSION {
            return Err(self.refuse(format!("version {version}, expected {VERSION}")));
        }
        let name = u64::from_le_bytes(self.take()?);
        if name > MAX_NAME_BYTES {
            return Err(self.refuse("the name of the sensor is too long: damaged?"));
        }
        self.skip(name)?;
        let intrinsic_colour = self.matrix()?;
        let _extrinsic_colour = self.matrix()?;
        let intrinsic_depth = self.matrix()?;
        let _extrinsic_depth = self.matrix()?;
        let colour_code = i32::from_le_bytes(self.take()?);
        let depth_encoding = i32::from_le_bytes(self.take()?);
        let colour_size = self.size()?;
        let depth_size = self.size()?;
        let depth_scale = f64::from(f32::from_le_bytes(self.take()?));
        let frames = u64::from_le_bytes(self.take()?);
        self.check_codes(colour_code, depth_encoding, depth_scale)?;
        Ok(Header {
            intrinsic_colour,
            intrinsic_depth,
            depth_is_compressed: depth_encoding == DEPTH_ZLIB,
            colour_size,
            depth_size,
            depth_scale,
            frames,
        })
    }

    fn check_codes(&self, colour: i32, depth: i32, depth_scale: f64) -> Result<(), DatasetError> {
        if !COLOUR_CODES.contains(&colour) {
            return Err(self.refuse(format!("colour code {colour}, expected PNG or JPEG")));
        }
        if ![DEPTH_RAW, DEPTH_ZLIB].contains(&depth) {
            return Err(self.refuse(format!("depth code {depth}, expected raw (0) or zlib (1)")));
        }
        if !(depth_scale.is_finite() && depth_scale > 0.0) {
            return Err(self.refuse(format!("depth scale {depth_scale}, expected above 0")));
        }
        Ok(())
    }

    /// Reads the next frame; `None` if the file ends within it.
    fn frame(&mut self) -> Result<Option<SensFrame>, DatasetError> {
        let mut bytes = [0; 96];
        match self.file.read_exact(&mut bytes) {
            Err(e) if e.kind() == ErrorKind::UnexpectedEof => return Ok(None),
            read => read.map_err(|e| DatasetError::read(&self.path, e))?,
        }
        let word = |at: usize| {
            let mut word = [0; 8];
            word.copy_from_slice(&bytes[at..at + 8]);
            u64::from_le_bytes(word)
        };
        let world_from_camera = matrix(&bytes);
        let stamps = (word(64), word(72));
        let start = self.file.stream_position().map_err(|e| DatasetError::read(&self.path, e))?;
        let middle = start.checked_add(word(80));
        let end = middle.and_then(|middle| middle.checked_add(word(88)));
        let (Some(middle), Some(end)) = (middle, end.filter(|&end| end <= self.length)) else {
            return Ok(None);
        };
        self.skip(end - start)?;
        Ok(Some(SensFrame { world_from_camera, stamps, colour: start..middle, depth: middle..end }))
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], DatasetError> {
        let mut bytes = [0; N];
        self.file.read_exact(&mut bytes).map_err(|e| DatasetError::read(&self.path, e))?;
        Ok(bytes)
    }

    fn skip(&mut self, bytes: u64) -> Result<(), DatasetError> {
        let Ok(bytes) = i64::try_from(bytes) else {
            return Err(self.refuse("a length that no file has: damaged?"));
        };
        self.file.seek_relative(bytes).map_err(|e| DatasetError::read(&self.path, e))
    }

    fn matrix(&mut self) -> Result<[f64; 16], DatasetError> {
        Ok(matrix(&self.take::<64>()?))
    }

    fn size(&mut self) -> Result<(usize, usize), DatasetError> {
        let sides = [u32::from_le_bytes(self.take()?), u32::from_le_bytes(self.take()?)];
        let (width, height) = (sides[0] as usize, sides[1] as usize);
        if width == 0 || height == 0 {
            return Err(self.refuse(format!("images of {width}x{height} px: damaged?")));
        }
        check_pixels(&self.path, (width, height))?;
        Ok((width, height))
    }

    fn refuse(&self, reason: impl Into<String>) -> DatasetError {
        DatasetError::file(&self.path, reason)
    }
}

/// 16 `f32` at the start of `bytes`.
fn matrix(bytes: &[u8]) -> [f64; 16] {
    let mut out = [0.0; 16];
    for (value, word) in out.iter_mut().zip(bytes.chunks_exact(4)) {
        *value = f64::from(f32::from_le_bytes([word[0], word[1], word[2], word[3]]));
    }
    out
}
