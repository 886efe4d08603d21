//! Members of a zip archive, as numpy's `.npz` is one: stored or deflated, 64-bit sizes too.
//!
//! The table of contents at the end of the file says where members lie (PKWARE APPNOTE 4.3).

use super::npy::{Array, Store};
use crate::DatasetError;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Size of the end record without its comment, which has at most 65535 bytes.
const END: usize = 22;

/// Files are read for their checksum in pieces of this size [bytes].
const PIECE: usize = 1 << 18;

/// Members that unpack to more than this are refused [bytes].
const MEMORY_LIMIT: u64 = 8 << 30;

/// A member of the archive.
#[derive(Clone, Debug)]
struct Member {
    name: String,
    method: u16,
    checksum: u32,
    packed: u64,
    size: u64,
    header: u64,
}

/// An opened archive.
#[derive(Clone, Debug)]
pub(super) struct Archive {
    path: PathBuf,
    members: Vec<Member>,
}

impl Archive {
    pub(super) fn open(path: &Path) -> Result<Self, DatasetError> {
        let mut file = File::open(path).map_err(|e| DatasetError::read(path, e))?;
        let (place, count) = contents_place(path, &mut file)?;
        let table = read_to_end(path, &mut file, place)?;
        let damaged = || {
            let reason = "its table of contents is damaged; copy or write it again";
            DatasetError::metadata(path, reason)
        };
        let (mut members, mut at) = (Vec::new(), 0);
        for _ in 0..count {
            let (member, length) =
                read_member(&table[at.min(table.len())..]).ok_or_else(damaged)?;
            members.push(member);
            at += length;
        }
        Ok(Self { path: path.to_path_buf(), members })
    }

    /// The array of the member `NAME.npy`, if there is one.
    pub(super) fn array(&self, name: &str) -> Option<Result<Array, DatasetError>> {
        let file = format!("{name}.npy");
        let member = self.members.iter().find(|member| member.name == file)?;
        Some(self.read(member))
    }

    /// The names of all members.
    pub(super) fn names(&self) -> Vec<String> {
        self.members.iter().map(|member| member.name.clone()).collect()
    }

    fn read(&self, member: &Member) -> Result<Array, DatasetError> {
        let path = self.path.join(&member.name);
        let refuse = |reason: &str| DatasetError::metadata(&path, reason);
        let mut file = File::open(&self.path).map_err(|e| DatasetError::read(&path, e))?;
        let length = file.metadata().map_err(|e| DatasetError::read(&path, e))?.len();
        let head = read_part(&path, &mut file, member.header, 30)?;
        let names = u64::from(number16(&head, 26)) + u64::from(number16(&head, 28));
        let offset = member.header + 30 + names;
        if offset.saturating_add(member.packed) > length {
            return Err(refuse("cut off: the archive ends within it; copy or write it again"));
        }
        let damaged = || refuse("damaged; copy or write it again");
        if member.method == 0 {
            let sum = checksum(&mut file, offset, member.packed);
            if member.size != member.packed
                || sum.map_err(|e| DatasetError::read(&path, e))? != member.checksum
            {
                return Err(damaged());
            }
            let store = Store::File { offset, length: member.packed };
            return Array::within(path, &self.path, store);
        }
        if member.method != 8 || member.size > MEMORY_LIMIT {
            let reason = "packed by a method or to a size that is not supported: use np.savez or \
                          np.savez_compressed";
            return Err(refuse(reason));
        }
        let packed = read_part(&path, &mut file, offset, member.packed as usize)?;
        let bytes =
            miniz_oxide::inflate::decompress_to_vec_with_limit(&packed, member.size as usize)
                .map_err(|_| damaged())?;
        if bytes.len() as u64 != member.size || crc32fast::hash(&bytes) != member.checksum {
            return Err(damaged());
        }
        Array::within(path, &self.path, Store::Memory(Arc::new(bytes)))
    }
}

/// Where the table of contents starts, and how many members it has.
fn contents_place(path: &Path, file: &mut File) -> Result<(u64, u64), DatasetError> {
    let length = file.metadata().map_err(|e| DatasetError::read(path, e))?.len();
    let from = length.saturating_sub((END + 0xffff) as u64);
    let tail = read_to_end(path, file, from)?;
    let cut_off = || {
        let reason = "cut off or no archive: its table of contents is missing at the end; copy or \
                      write it again";
        DatasetError::metadata(path, reason)
    };
    let end = tail.windows(4).rposition(|word| word == b"PK\x05\x06").ok_or_else(cut_off)?;
    let record = tail.get(end..end + END).ok_or_else(cut_off)?;
    let (count, place) = (number16(record, 10), number32(record, 16));
    if count != u16::MAX && place != u32::MAX {
        return Ok((u64::from(place), u64::from(count)));
    }
    let locator = end.checked_sub(20).map(|at| &tail[at..end]).ok_or_else(cut_off)?;
    let record = read_part(path, file, number64(locator, 8), 56)?;
    if &record[..4] != b"PK\x06\x06" {
        return Err(cut_off());
    }
    Ok((number64(&record, 48), number64(&record, 32)))
}

/// A member of the table and the length of its record.
fn read_member(record: &[u8]) -> Option<(Member, usize)> {
    if !record.starts_with(b"PK\x01\x02") || record.len() < 46 {
        return None;
    }
    let [name, extra, comment] = [28, 30, 32].map(|at| usize::from(number16(record, at)));
    let length = 46 + name + extra + comment;
    let text = record.get(46..46 + name)?;
    let wide = wide_numbers(record.get(46 + name..46 + name + extra)?);
    let mut wide = wide.chunks_exact(8);
    let mut wide_or = |narrow: u32| match narrow {
        u32::MAX => wide.next().map(|word| number64(word, 0)),
        narrow => Some(u64::from(narrow)),
    };
    let size = wide_or(number32(record, 24))?;
    let packed = wide_or(number32(record, 20))?;
    let header = wide_or(number32(record, 42))?;
    let name = String::from_utf8_lossy(text).into_owned();
    let (method, checksum) = (number16(record, 10), number32(record, 16));
    Some((Member { name, method, checksum, packed, size, header }, length))
}

/// The 64-bit numbers of a record's extra field.
fn wide_numbers(mut extra: &[u8]) -> &[u8] {
    while extra.len() >= 4 {
        let (kind, length) = (number16(extra, 0), usize::from(number16(extra, 2)));
        let body = extra.get(4..4 + length).unwrap_or_default();
        if kind == 1 {
            return body;
        }
        extra = extra.get(4 + length..).unwrap_or_default();
    }
    &[]
}

/// CRC-32 of a part of a file, read piece by piece; also of what is left if the file is shorter.
fn checksum(file: &mut File, from: u64, count: u64) -> std::io::Result<u32> {
    file.seek(SeekFrom::Start(from))?;
    let mut part = file.take(count);
    let mut sum = crc32fast::Hasher::new();
    let mut piece = vec![0; PIECE];
    loop {
        match part.read(&mut piece)? {
            0 => return Ok(sum.finalize()),
            read => sum.update(&piece[..read]),
        }
    }
}

fn read_part(
    path: &Path,
    file: &mut File,
    from: u64,
    count: usize,
) -> Result<Vec<u8>, DatasetError> {
    let mut bytes = vec![0; count];
    file.seek(SeekFrom::Start(from))
        .and_then(|_| file.read_exact(&mut bytes))
        .map_err(|_| DatasetError::metadata(path, "cut off; copy or write it again"))?;
    Ok(bytes)
}

fn read_to_end(path: &Path, file: &mut File, from: u64) -> Result<Vec<u8>, DatasetError> {
    let mut bytes = Vec::new();
    file.seek(SeekFrom::Start(from))
        .and_then(|_| file.read_to_end(&mut bytes))
        .map_err(|e| DatasetError::read(path, e))?;
    Ok(bytes)
}

/// Little-endian numbers; 0 beyond the end.
fn number64(bytes: &[u8], at: usize) -> u64 {
    let byte = |i: usize| u64::from(bytes.get(at + i).copied().unwrap_or(0)) << (8 * i);
    (0..8).map(byte).sum()
}

fn number32(bytes: &[u8], at: usize) -> u32 {
    number64(bytes, at) as u32
}

fn number16(bytes: &[u8], at: usize) -> u16 {
    number64(bytes, at) as u16
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A record of the table of contents whose sizes and place stand in its extra field.
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
