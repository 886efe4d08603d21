//! numpy archives (`.npz`): zip files with stored or deflated members, 64-bit sizes included
//! (PKWARE APPNOTE 4.3).

use super::deflate::DeflatedBytes;
use super::npy::{ArrayBytes, NpyArray};
use crate::DatasetError;
use crate::image::MAX_DEFLATE_RATIO;
use std::io::{self, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Size of the end record without its comment of at most 65535 bytes.
const END_RECORD_BYTES: usize = 22;

/// Buffer size for checksums [bytes].
const BUFFER_BYTES: usize = 1 << 18;

/// Largest table of contents [bytes]: that of 65535 members with long names.
const MAX_TABLE_BYTES: u64 = 16 << 20;

/// Entry of the central directory.
#[derive(Clone, Debug)]
struct ZipMember {
    name: String,
    method: u16,
    checksum: u32,
    packed: u64,
    size: u64,
    header: u64,
}

/// An archive whose central directory is read.
#[derive(Clone, Debug)]
pub(crate) struct NpzArchive {
    path: PathBuf,
    /// Length of the file [bytes].
    length: u64,
    members: Vec<ZipMember>,
}

impl NpzArchive {
    pub(super) fn open(path: &Path) -> Result<Self, DatasetError> {
        let (table, count) = find_directory(path)?;
        let damaged = || {
            let reason = "its table of contents is damaged; copy or write it again";
            DatasetError::file(path, reason)
        };
        if table.end.saturating_sub(table.start) > MAX_TABLE_BYTES {
            return Err(damaged());
        }
        let table = read_part(path, table)?;
        let (mut members, mut at) = (Vec::new(), 0);
        for _ in 0..count {
            let (member, length) =
                read_member(&table[at.min(table.len())..]).ok_or_else(damaged)?;
            members.push(member);
            at += length;
        }
        Ok(Self { path: path.to_path_buf(), length: length(path)?, members })
    }

    /// Opens the member `NAME.npy`, if there is one.
    pub(super) fn array(&self, name: &str) -> Option<Result<NpyArray, DatasetError>> {
        let file = format!("{name}.npy");
        let member = self.members.iter().find(|member| member.name == file)?;
        Some(self.read(member))
    }

    /// Names of all members.
    pub(super) fn names(&self) -> Vec<String> {
        self.members.iter().map(|member| member.name.clone()).collect()
    }

    fn read(&self, member: &ZipMember) -> Result<NpyArray, DatasetError> {
        let path = self.path.join(&member.name);
        let refuse = |reason: &str| DatasetError::file(&path, reason);
        let head = read_part(&self.path, member.header..member.header.saturating_add(30))?;
        let names = u64::from(u16_at(&head, 26)) + u64::from(u16_at(&head, 28));
        let offset = member.header + 30 + names;
        let part = offset..offset.saturating_add(member.packed);
        if part.end > self.length {
            return Err(refuse("cut off: the archive ends within it; copy or write it again"));
        }
        let length = member.size;
        let store = match member.method {
            0 => ArrayBytes::File { offset, length },
            8 => {
                let bytes = Arc::new(DeflatedBytes::new(self.path.clone(), part.clone()));
                ArrayBytes::Deflated { bytes, length }
            }
            _ => {
                let reason = "packed by a method that is not supported: use np.savez or \
                              np.savez_compressed";
                return Err(refuse(reason));
            }
        };
        let is_whole = is_whole(&self.path, member, &store, &part);
        if !is_whole.map_err(|e| DatasetError::read(&path, e))? {
            return Err(refuse("damaged; copy or write it again"));
        }
        let array = NpyArray::from_bytes(path.clone(), &self.path, store)?;
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
    part: &Range<u64>,
) -> io::Result<bool> {
    let found = match store {
        ArrayBytes::Deflated { bytes, .. } => {
            if member.size / MAX_DEFLATE_RATIO > member.packed {
                return Ok(false);
            }
            checksum(bytes.decoder()?.take(member.size.saturating_add(1)))
        }
        ArrayBytes::File { .. } => {
            let mut file = i2slam_storage::open(path)?;
            file.seek(SeekFrom::Start(part.start))?;
            checksum(file.take(member.packed))
        }
    };
    match found {
        Err(error) if error.kind() == io::ErrorKind::InvalidData => Ok(false),
        found => Ok(found? == (member.size, member.checksum)),
    }
}

/// Place of the central directory and its number of members.
fn find_directory(path: &Path) -> Result<(Range<u64>, u64), DatasetError> {
    let length = length(path)?;
    let from = length.saturating_sub((END_RECORD_BYTES + 0xffff) as u64);
    let tail = read_part(path, from..length)?;
    let cut_off = || {
        let reason = "cut off or no archive: its table of contents is missing at the end; copy or \
                      write it again";
        DatasetError::file(path, reason)
    };
    let end = tail.windows(4).rposition(|word| word == b"PK\x05\x06").ok_or_else(cut_off)?;
    let record = tail.get(end..end + END_RECORD_BYTES).ok_or_else(cut_off)?;
    let (count, size, place) = (u16_at(record, 10), u32_at(record, 12), u32_at(record, 16));
    if count != u16::MAX && place != u32::MAX {
        let place = u64::from(place);
        return Ok((place..place + u64::from(size), u64::from(count)));
    }
    let locator = end.checked_sub(20).map(|at| &tail[at..end]).ok_or_else(cut_off)?;
    let wide = u64_at(locator, 8);
    let record = read_part(path, wide..wide.saturating_add(56))?;
    if &record[..4] != b"PK\x06\x06" {
        return Err(cut_off());
    }
    let (count, size, place) = (u64_at(&record, 32), u64_at(&record, 40), u64_at(&record, 48));
    Ok((place..place.saturating_add(size), count))
}

fn length(path: &Path) -> Result<u64, DatasetError> {
    let metadata = i2slam_storage::open(path).and_then(|file| file.metadata());
    metadata.map(|data| data.len()).map_err(|e| DatasetError::read(path, e))
}

/// Parses a member of the central directory; also the length of its record.
fn read_member(record: &[u8]) -> Option<(ZipMember, usize)> {
    if !record.starts_with(b"PK\x01\x02") || record.len() < 46 {
        return None;
    }
    let [name, extra, comment] = [28, 30, 32].map(|at| usize::from(u16_at(record, at)));
    let length = 46 + name + extra + comment;
    let text = record.get(46..46 + name)?;
    let wide = zip64_numbers(record.get(46 + name..46 + name + extra)?);
    let mut wide = wide.chunks_exact(8);
    let mut wide_or = |narrow: u32| match narrow {
        u32::MAX => wide.next().map(|word| u64_at(word, 0)),
        narrow => Some(u64::from(narrow)),
    };
    let size = wide_or(u32_at(record, 24))?;
    let packed = wide_or(u32_at(record, 20))?;
    let header = wide_or(u32_at(record, 42))?;
    let name = String::from_utf8_lossy(text).into_owned();
    let (method, checksum) = (u16_at(record, 10), u32_at(record, 16));
    Some((ZipMember { name, method, checksum, packed, size, header }, length))
}

/// The zip64 part of a record's extra field.
fn zip64_numbers(mut extra: &[u8]) -> &[u8] {
    while extra.len() >= 4 {
        let (kind, length) = (u16_at(extra, 0), usize::from(u16_at(extra, 2)));
        let body = extra.get(4..4 + length).unwrap_or_default();
        if kind == 1 {
            return body;
        }
        extra = extra.get(4 + length..).unwrap_or_default();
    }
    &[]
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

fn read_part(path: &Path, part: Range<u64>) -> Result<Vec<u8>, DatasetError> {
    i2slam_storage::read_range(path, part).map_err(|e| match e.kind() {
        io::ErrorKind::UnexpectedEof => DatasetError::file(path, "cut off; copy or write it again"),
        _ => DatasetError::read(path, e),
    })
}

/// Little-endian number; bytes beyond the end count as 0.
fn u64_at(bytes: &[u8], at: usize) -> u64 {
    let byte = |i: usize| u64::from(bytes.get(at + i).copied().unwrap_or(0)) << (8 * i);
    (0..8).map(byte).sum()
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u64_at(bytes, at) as u32
}

fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u64_at(bytes, at) as u16
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A directory record with sizes and offset in its zip64 extra field.
    fn wide_record(size: u64, packed: u64, header: u64) -> Vec<u8> {
        let mut record = vec![0; 46];
        record[..4].copy_from_slice(b"PK\x01\x02");
        for at in [20, 24, 42] {
            record[at..at + 4].copy_from_slice(&u32::MAX.to_le_bytes());
        }
        (record[28], record[30]) = (5, 34);
        record.extend(b"a.npy");
        record.extend([9, 0, 2, 0, 7, 7]);
        record.extend([1, 0, 24, 0]);
        record.extend([size, packed, header].map(u64::to_le_bytes).concat());
        record
    }

    #[test]
    fn sizes_beyond_four_gigabytes_are_read() {
        let record = wide_record(5 << 32, 4 << 32, 3 << 32);
        let (member, length) = read_member(&record).expect("a member");
        assert_eq!((member.name.as_str(), length), ("a.npy", record.len()));
        assert_eq!((member.size, member.packed, member.header), (5 << 32, 4 << 32, 3 << 32));
        assert!(read_member(&record[..60]).is_none());
    }
}
