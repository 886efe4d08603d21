//! Parts of files, such as the members of an archive.

use std::io;
use std::ops::Range;
use std::path::Path;

/// A part of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FilePart {
    /// Its bytes in the file.
    pub range: Range<u64>,
    /// Their packing.
    pub packing: Packing,
}

/// Packing of a part of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Packing {
    /// As they are.
    Stored,
    /// Deflated (RFC 1951).
    Deflated {
        /// Number of inflated bytes.
        size: u64,
    },
}

impl FilePart {
    /// A part that is not packed.
    pub(crate) fn stored(range: Range<u64>) -> Self {
        Self { range, packing: Packing::Stored }
    }

    /// Number of bytes in the file.
    pub(crate) fn packed_length(&self) -> u64 {
        self.range.end.saturating_sub(self.range.start)
    }

    /// Number of bytes once they are inflated.
    pub(crate) fn length(&self) -> u64 {
        match self.packing {
            Packing::Stored => self.packed_length(),
            Packing::Deflated { size } => size,
        }
    }

    /// Reads and inflates the part, which has at most `limit` bytes.
    ///
    /// # Errors
    /// `InvalidData` if it has more, or if they are damaged.
    pub(crate) fn read(&self, path: &Path, limit: u64) -> io::Result<Vec<u8>> {
        let damaged = || io::Error::new(io::ErrorKind::InvalidData, "damaged");
        if self.length().max(self.packed_length()) > limit {
            return Err(damaged());
        }
        let bytes = i2slam_storage::read_range(path, self.range.clone())?;
        match self.packing {
            Packing::Stored => Ok(bytes),
            Packing::Deflated { size } => {
                let limit = usize::try_from(size).map_err(|_| damaged())?;
                let inflated = miniz_oxide::inflate::decompress_to_vec_with_limit(&bytes, limit);
                inflated.ok().filter(|bytes| bytes.len() == limit).ok_or_else(damaged)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::TemporaryFolder;

    #[test]
    fn parts_are_inflated_up_to_the_size_that_they_claim() {
        let scratch = TemporaryFolder::new("part");
        let bytes: Vec<u8> = (0..9000_u32).map(|i| (i / 40) as u8).collect();
        let packed = miniz_oxide::deflate::compress_to_vec(&bytes, 6);
        let (file, end) = (scratch.join("packed"), 3 + packed.len() as u64);
        std::fs::write(&file, [&[1, 2, 3], packed.as_slice(), &[4; 9]].concat()).expect("room");
        let deflated = |size| FilePart { range: 3..end, packing: Packing::Deflated { size } };
        assert_eq!(deflated(9000).read(&file, 9000).expect("bytes"), bytes);
        assert_eq!(FilePart::stored(0..3).read(&file, 3).expect("bytes"), [1, 2, 3]);
        for (size, limit) in [(9000, 8999), (8999, 9000), (9001, 9001)] {
            let error = deflated(size).read(&file, limit).expect_err("another size");
            assert_eq!(error.kind(), io::ErrorKind::InvalidData);
        }
        assert!(FilePart::stored(0..4).read(&file, 3).is_err(), "more than the limit");
    }
}
