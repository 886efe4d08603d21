//! The bytes of a `.sens` file.

use crate::DatasetError;
use std::fs::File;
use std::io::{BufReader, ErrorKind, Read, Seek};
use std::ops::Range;
use std::path::{Path, PathBuf};

const VERSION: u32 = 4;

/// Codes of colour images that are PNG and JPEG.
const COLOUR_CODES: [i32; 2] = [1, 2];

/// Codes of depth images: as they are, and deflated.
const DEPTH_RAW: i32 = 0;
const DEPTH_ZLIB: i32 = 1;

/// The name of a sensor is not longer than this [bytes].
const MAX_NAME: u64 = 4096;

/// Images are not wider or higher than this [px].
const MAX_SIDE: u32 = 1 << 14;

/// What holds for all frames.
pub(super) struct Header {
    /// 4x4 in rows, pixel centres at integers.
    pub(super) intrinsic_colour: [f64; 16],
    pub(super) intrinsic_depth: [f64; 16],
    pub(super) depth_is_compressed: bool,
    /// Width and height [px].
    pub(super) colour_size: (usize, usize),
    pub(super) depth_size: (usize, usize),
    /// Depth image value of one metre.
    pub(super) depth_scale: f64,
    pub(super) frames: u64,
}

/// What is known of a frame, and where its images lie.
pub(super) struct Frame {
    /// 4x4 in rows; not finite where tracking was lost.
    pub(super) world_from_camera: [f64; 16],
    /// Of colour and depth [µs].
    pub(super) stamps: (u64, u64),
    pub(super) colour: Range<u64>,
    pub(super) depth: Range<u64>,
}

/// A `.sens` file being read from its start.
pub(super) struct Reader {
    path: PathBuf,
    file: BufReader<File>,
    /// Length of the file [bytes].
    length: u64,
}

impl Reader {
    pub(super) fn open(path: &Path) -> Result<Self, DatasetError> {
        let file = File::open(path).map_err(|e| DatasetError::read(path, e))?;
        let length = file.metadata().map_err(|e| DatasetError::read(path, e))?.len();
        Ok(Self { path: path.to_path_buf(), file: BufReader::new(file), length })
    }

    /// The header, at the start of the file.
    pub(super) fn header(&mut self) -> Result<Header, DatasetError> {
        let version = u32::from_le_bytes(self.take()?);
        if version != VERSION {
            return Err(self.refuse(format!("version {version}, expected {VERSION}")));
        }
        let name = u64::from_le_bytes(self.take()?);
        if name > MAX_NAME {
            return Err(self.refuse("the name of the sensor is too long: damaged?"));
        }
        self.skip(name)?;
        let intrinsic_colour = self.matrix()?;
        let _extrinsic_colour = self.matrix()?;
        let intrinsic_depth = self.matrix()?;
        let _extrinsic_depth = self.matrix()?;
        let colour_code = i32::from_le_bytes(self.take()?);
        let depth_code = i32::from_le_bytes(self.take()?);
        let colour_size = self.size()?;
        let depth_size = self.size()?;
        let depth_scale = f64::from(f32::from_le_bytes(self.take()?));
        let frames = u64::from_le_bytes(self.take()?);
        self.check_codes(colour_code, depth_code, depth_scale)?;
        Ok(Header {
            intrinsic_colour,
            intrinsic_depth,
            depth_is_compressed: depth_code == DEPTH_ZLIB,
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

    /// The next frame; `None` where the file ends within it.
    pub(super) fn frame(&mut self) -> Result<Option<Frame>, DatasetError> {
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
        Ok(Some(Frame { world_from_camera, stamps, colour: start..middle, depth: middle..end }))
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
        if sides.iter().any(|side| !(1..=MAX_SIDE).contains(side)) {
            return Err(self.refuse(format!("images of {}x{} px: damaged?", sides[0], sides[1])));
        }
        Ok((sides[0] as usize, sides[1] as usize))
    }

    fn refuse(&self, reason: impl Into<String>) -> DatasetError {
        DatasetError::Metadata { path: self.path.clone(), reason: reason.into() }
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
