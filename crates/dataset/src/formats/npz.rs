//! numpy archives (`.npz`): zip files of arrays.

use super::deflate::DeflatedBytes;
use super::npy::{ArrayBytes, NpyArray};
use super::zip::{ZipArchive, ZipMember};
use crate::DatasetError;
use crate::file_part::{FilePart, Packing};
use crate::image::MAX_DEFLATE_RATIO;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::Arc;

/// Buffer size for checksums [bytes].
const BUFFER_BYTES: usize = 1 << 18;

/// An archive whose table of contents is read.
#[derive(Clone, Debug)]
pub(crate) struct NpzArchive(ZipArchive);

impl NpzArchive {
    pub(super) fn open(path: &Path) -> Result<Self, DatasetError> {
        ZipArchive::open(path).map(Self)
    }

    /// Opens the member `NAME.npy`, if there is one.
    pub(super) fn array(&self, name: &str) -> Option<Result<NpyArray, DatasetError>> {
        let file = format!("{name}.npy");
        let member = self.0.members.iter().find(|member| member.name == file)?;
        Some(self.read(member))
    }

    /// Names of all members.
    pub(super) fn names(&self) -> Vec<String> {
        self.0.members.iter().map(|member| member.name.clone()).collect()
    }

    fn read(&self, member: &ZipMember) -> Result<NpyArray, DatasetError> {
        let archive = &self.0.path;
        let path = archive.join(&member.name);
        let refuse = |reason: &str| DatasetError::file(&path, reason);
        let part = self.0.part(member, "use np.savez or np.savez_compressed")?;
        let length = member.size;
        let store = match part.packing {
            Packing::Stored => ArrayBytes::File { offset: part.range.start, length },
            Packing::Deflated { .. } => {
                let bytes = Arc::new(DeflatedBytes::new(archive.clone(), part.range.clone()));
                ArrayBytes::Deflated { bytes, length }
            }
        };
        let is_whole = is_whole(archive, member, &store, &part);
        if !is_whole.map_err(|e| DatasetError::read(&path, e))? {
            return Err(refuse("damaged; copy or write it again"));
        }
        let array = NpyArray::from_bytes(path.clone(), archive, store)?;
        if array.has_more_bytes() {
            return Err(refuse("damaged: more bytes than its shape takes; write it again"));
        }
        Ok(array)
    }
}

/// Whether a member has the size and checksum that the table of contents says.
fn is_whole(
    path: &Path,
    member: &ZipMember,
    store: &ArrayBytes,
    part: &FilePart,
) -> io::Result<bool> {
    let packed = part.range.end - part.range.start;
    let found = match store {
        ArrayBytes::Deflated { bytes, .. } => {
            if member.size / MAX_DEFLATE_RATIO > packed {
                return Ok(false);
            }
            checksum(bytes.decoder()?.take(member.size.saturating_add(1)))
        }
        ArrayBytes::File { .. } => {
            let mut file = i2slam_storage::open(path)?;
            file.seek(SeekFrom::Start(part.range.start))?;
            checksum(file.take(packed))
        }
    };
    match found {
        Err(error) if error.kind() == io::ErrorKind::InvalidData => Ok(false),
        found => Ok(found? == (member.size, member.checksum)),
    }
}

/// Number and CRC-32 of the bytes of a stream.
fn checksum(mut stream: impl Read) -> io::Result<(u64, u32)> {
    let (mut count, mut sum) = (0, crc32fast::Hasher::new());
    let mut piece = vec![0; BUFFER_BYTES];
    loop {
        let read = stream.read(&mut piece)?;
        if read == 0 {
            return Ok((count, sum.finalize()));
        }
        count += read as u64;
        sum.update(&piece[..read]);
    }
}
