//! numpy arrays (`.npy`, format versions 1 to 3) in a file or an archive. Opening reads the header
//! only; slices are read on demand.

use super::deflate::DeflatedBytes;
use crate::DatasetError;
use std::path::{Path, PathBuf};
use std::sync::Arc;

const MAGIC: &[u8] = b"\x93NUMPY";

/// Most numbers that are read at once: a keyframe of 11 megapixels, or the poses of 4 million.
const MAX_NUMBERS: usize = 1 << 25;

/// Longest accepted header [bytes].
const MAX_HEADER_BYTES: usize = 1 << 16;

/// Defines the types of numbers by their names in headers.
macro_rules! data_types {
    ($($name:ident($number:ty) = $($descr:literal)|+),+ $(,)?) => {
        /// Type of the stored numbers, little-endian.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub(crate) enum DataType { $($name),+ }

        impl DataType {
            fn parse(descr: &str) -> Option<Self> {
                match descr {
                    $($($descr)|+ => Some(Self::$name),)+
                    _ => None,
                }
            }

            fn size(self) -> usize {
                match self {
                    $(Self::$name => size_of::<$number>()),+
                }
            }

            fn read(self, bytes: &[u8]) -> f64 {
                match self {
                    $(Self::$name => {
                        bytes.try_into().map_or(f64::NAN, |bytes| <$number>::from_le_bytes(bytes) as f64)
                    })+
                }
            }
        }
    };
}
data_types!(
    U8(u8) = "|u1" | "<u1",
    U16(u16) = "<u2",
    I32(i32) = "<i4",
    I64(i64) = "<i8",
    F32(f32) = "<f4",
    F64(f64) = "<f8",
);

/// Location of an array's bytes, header included.
#[derive(Clone, Debug)]
pub(crate) enum ArrayBytes {
    /// `length` bytes of a file from `offset` on.
    File { offset: u64, length: u64 },
    /// `length` bytes that a part of a file inflates to.
    Deflated { bytes: Arc<DeflatedBytes>, length: u64 },
}

/// An array of numbers in C order.
#[derive(Clone, Debug)]
pub(crate) struct NpyArray {
    /// File, with the member's name for an archive; for messages.
    pub(crate) path: PathBuf,
    file: PathBuf,
    bytes: ArrayBytes,
    /// Offset of the numbers in the bytes.
    start: usize,
    pub(crate) shape: Vec<usize>,
    pub(crate) data_type: DataType,
}

impl NpyArray {
    /// Opens an `.npy` file.
    pub(crate) fn open(file: &Path) -> Result<Self, DatasetError> {
        let metadata = i2slam_storage::open(file).and_then(|file| file.metadata());
        let length = metadata.map_err(|e| DatasetError::read(file, e))?.len();
        Self::from_bytes(file.to_path_buf(), file, ArrayBytes::File { offset: 0, length })
    }

    /// Opens an array stored in `file` at `bytes`; `path` names it in messages.
    pub(crate) fn from_bytes(
        path: PathBuf,
        file: &Path,
        bytes: ArrayBytes,
    ) -> Result<Self, DatasetError> {
        let shape = Vec::new();
        let file = file.to_path_buf();
        let mut array = Self { path, file, bytes, start: 0, shape, data_type: DataType::U8 };
        let refuse = |reason: String| DatasetError::file(&array.path, reason);
        let head = array.read_bytes(0, 12.min(array.length()))?;
        if !head.starts_with(MAGIC) {
            return Err(refuse("no array of numpy (.npy)".into()));
        }
        let (from, count) = match head[6..] {
            [1, _, a, b, ..] => (10, usize::from(u16::from_le_bytes([a, b]))),
            [2 | 3, _, a, b, c, d] => (12, u32::from_le_bytes([a, b, c, d]) as usize),
            [] | [1, ..] | [2 | 3, ..] => return Err(refuse("cut off within its header".into())),
            [version, ..] => return Err(refuse(format!("version {version}, expected 1 to 3"))),
        };
        let start = from + count;
        if count > MAX_HEADER_BYTES || start > array.length() {
            return Err(refuse("cut off within its header".into()));
        }
        let header = array.read_bytes(from, count)?;
        let (shape, data_type) = read_header(&String::from_utf8_lossy(&header)).map_err(refuse)?;
        (array.start, array.shape, array.data_type) = (start, shape, data_type);
        array.check_length()?;
        Ok(array)
    }

    fn check_length(&self) -> Result<(), DatasetError> {
        let there = self.length() - self.start;
        let size =
            self.shape.iter().try_fold(self.data_type.size(), |n, &side| n.checked_mul(side));
        match size {
            Some(size) if size <= there => self.check_slice(),
            _ => {
                let reason = format!(
                    "cut off: {there} bytes of numbers, its header says {:?} of {} bytes each; \
                     copy or write it again",
                    self.shape,
                    self.data_type.size()
                );
                Err(DatasetError::file(&self.path, reason))
            }
        }
    }

    /// An error for more numbers in an entry of the first axis than are read at once.
    fn check_slice(&self) -> Result<(), DatasetError> {
        let count: usize = self.shape.iter().skip(1).product();
        if count <= MAX_NUMBERS {
            return Ok(());
        }
        let reason = format!(
            "shape {:?}: {count} numbers in a frame, expected at most {MAX_NUMBERS}",
            self.shape
        );
        Err(DatasetError::file(&self.path, reason))
    }

    /// Whether there are bytes behind the numbers.
    pub(super) fn has_more_bytes(&self) -> bool {
        let size = self.data_type.size() * self.shape.iter().product::<usize>();
        self.length() > self.start + size
    }

    fn length(&self) -> usize {
        let (ArrayBytes::File { length, .. } | ArrayBytes::Deflated { length, .. }) = &self.bytes;
        usize::try_from(*length).unwrap_or(usize::MAX)
    }

    fn read_bytes(&self, from: usize, count: usize) -> Result<Vec<u8>, DatasetError> {
        let bytes = match &self.bytes {
            ArrayBytes::Deflated { bytes, .. } => bytes.read(from as u64, count),
            ArrayBytes::File { offset, .. } => {
                let from = offset + from as u64;
                i2slam_storage::read_range(&self.file, from..from + count as u64)
            }
        };
        bytes.map_err(|e| DatasetError::read(&self.path, e))
    }

    /// Reads the numbers at one index of the first axis, in C order.
    pub(crate) fn slice(&self, index: usize) -> Result<Vec<f64>, DatasetError> {
        let count: usize = self.shape.iter().skip(1).product();
        self.numbers(index * count, count)
    }

    /// Reads all numbers, in C order.
    pub(crate) fn all(&self) -> Result<Vec<f64>, DatasetError> {
        let count = self.shape.iter().product();
        if count > MAX_NUMBERS {
            let shape = &self.shape;
            let reason = format!("shape {shape:?}, expected at most {MAX_NUMBERS} numbers");
            return Err(DatasetError::file(&self.path, reason));
        }
        self.numbers(0, count)
    }

    /// Reads `count` numbers from `from` on, in C order; the caller knows that so many are there.
    pub(crate) fn numbers(&self, from: usize, count: usize) -> Result<Vec<f64>, DatasetError> {
        let size = self.data_type.size();
        let bytes = self.read_bytes(self.start + from * size, count * size)?;
        Ok(bytes.chunks_exact(size).map(|b| self.data_type.read(b)).collect())
    }
}

/// Parses shape and type of a header `{'descr': '<f4', 'fortran_order': False, 'shape': (3, 4), }`.
fn read_header(text: &str) -> Result<(Vec<usize>, DataType), String> {
    let after = |key: &str| {
        let place = text.find(&format!("'{key}'")).map(|at| at + key.len() + 2);
        let rest = place.and_then(|at| text[at..].trim_start().strip_prefix(':'));
        rest.map(str::trim_start).ok_or_else(|| format!("its header has no {key}"))
    };
    let descr = after("descr")?.trim_start_matches('\'');
    let descr = descr.split('\'').next().unwrap_or_default();
    let data_type = DataType::parse(descr).ok_or_else(|| {
        format!("numbers of type {descr}, expected u1, u2, i4, i8, f4 or f8, little-endian")
    })?;
    let shape = after("shape")?.strip_prefix('(').and_then(|rest| rest.split(')').next());
    let sides = shape.unwrap_or_default().split(',').map(str::trim).filter(|side| !side.is_empty());
    let shape: Result<Vec<usize>, _> = sides.map(str::parse).collect();
    let shape = shape.map_err(|_| "its header has no shape of whole numbers".to_owned())?;
    if after("fortran_order")?.starts_with("True") && shape.len() > 1 {
        return Err("stored in Fortran order, expected C order (np.ascontiguousarray)".into());
    }
    Ok((shape, data_type))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_header_of_a_single_number_is_parsed() {
        let header = "{'descr': '<f8', 'fortran_order': False, 'shape': (), }";
        assert_eq!(read_header(header), Ok((vec![], DataType::F64)));
    }

    #[test]
    fn unsupported_headers_are_refused() {
        for (header, part) in [
            ("{'descr': '>f4', 'fortran_order': False, 'shape': (3,)}", ">f4"),
            ("{'descr': '<f4', 'fortran_order': True, 'shape': (3, 2)}", "Fortran"),
            ("{'descr': '<f4', 'fortran_order': False, 'shape': (3, x)}", "whole numbers"),
            ("{'descr': '<f4', 'shape': (3,)}", "no fortran_order"),
        ] {
            let reason = read_header(header).expect_err("no header");
            assert!(reason.contains(part), "{reason}");
        }
    }
}
