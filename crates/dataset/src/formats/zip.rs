//! Zip archives: stored and deflated members, 64-bit sizes included (PKWARE APPNOTE 4.3).

use crate::DatasetError;
use crate::file_part::{FilePart, Packing};
use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Size of the end record without its comment of at most 65535 bytes.
const END_RECORD_BYTES: usize = 22;

/// Largest table of contents [bytes]: that of a million members with short names.
const MAX_TABLE_BYTES: u64 = 64 << 20;

/// Entry of the central directory.
#[derive(Clone, Debug)]
pub(super) struct ZipMember {
    pub(super) name: String,
    method: u16,
    /// CRC-32 of its bytes.
    pub(super) checksum: u32,
    packed: u64,
    /// Length of its bytes.
    pub(super) size: u64,
    header: u64,
}

/// An archive whose central directory is read.
#[derive(Clone, Debug)]
pub(super) struct ZipArchive {
    pub(super) path: PathBuf,
    /// Length of the file [bytes].
    length: u64,
    pub(super) members: Vec<ZipMember>,
}

impl ZipArchive {
    pub(super) fn open(path: &Path) -> Result<Self, DatasetError> {
        let (table, count) = find_directory(path)?;
        let damaged = || {
            let reason = "its table of contents is damaged; copy or write it again";
            DatasetError::file(path, reason)
        };
        if table.end.saturating_sub(table.start) > MAX_TABLE_BYTES {
            let most = MAX_TABLE_BYTES >> 20;
            let reason = format!("its table of contents is longer than {most} MB: unpack it");
            return Err(DatasetError::file(path, reason));
        }
        let table = read_part(path, table)?;
        let (mut members, mut at) = (Vec::new(), 0);
        while at < table.len() {
            let (member, length) = read_member(&table[at..]).ok_or_else(damaged)?;
            members.push(member);
            at += length;
        }
        // Writers that do not know 64-bit sizes count modulo 65536.
        if members.len() as u64 % 0x1_0000 != count % 0x1_0000 {
            return Err(damaged());
        }
        Ok(Self { path: path.to_path_buf(), length: length(path)?, members })
    }

    /// The part of the file that is a member; an error of its whole path where it is cut off, or packed by
    /// another method than `supported` names.
    pub(super) fn part(
        &self,
        member: &ZipMember,
        supported: &str,
    ) -> Result<FilePart, DatasetError> {
        let refuse = |reason: String| DatasetError::file(&self.path.join(&member.name), reason);
        let head = read_part(&self.path, member.header..member.header.saturating_add(30))?;
        let names = u64::from(u16_at(&head, 26)) + u64::from(u16_at(&head, 28));
        let start = member.header + 30 + names;
        let range = start..start.saturating_add(member.packed);
        if range.end > self.length {
            let reason = "cut off: the archive ends within it; copy or write it again";
            return Err(refuse(reason.into()));
        }
        let packing = match member.method {
            0 => Packing::Stored,
            8 => Packing::Deflated { size: member.size },
            _ => {
                let reason = format!("packed by a method that is not supported: {supported}");
                return Err(refuse(reason));
            }
        };
        Ok(FilePart { range, packing })
    }
}

/// Place of the central directory and its number of members.
fn find_directory(path: &Path) -> Result<(Range<u64>, u64), DatasetError> {
    let length = length(path)?;
    if length == 0 {
        return Err(DatasetError::file(path, "cut off: the file is empty; copy or write it again"));
    }
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
