//! Files with checksums or compression, taken apart and put together again, so that damage reaches
//! what lies behind them.

use miniz_oxide::deflate::{compress_to_vec, compress_to_vec_zlib};
use miniz_oxide::inflate::{decompress_to_vec_with_limit, decompress_to_vec_zlib_with_limit};

const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";
const ZIP_MEMBER: &[u8] = b"PK\x03\x04";
const ARCHIVE: &[u8] = b"I2SLAM\r\n";
const FIELD: &[u8] = b"I2FIELD\n";

/// Largest content of a compressed part [bytes]: seeds are small.
const MAX_CONTENT: usize = 1 << 24;

/// Kind of a file in parts.
#[derive(Clone, Debug, PartialEq)]
enum Kind {
    /// Type and data of every chunk; with the data of pictures inflated, if true.
    Png(bool),
    /// Name and content of every member, with its method.
    Zip(Vec<u16>),
    /// Header and arrays of a `map.i2slam` of Gaussians.
    Archive,
    /// A `map.i2slam` of a hash grid without its checksum.
    Field,
}

/// A file in parts.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Container {
    kind: Kind,
    pub(crate) parts: Vec<Vec<u8>>,
}

impl Container {
    /// Takes a file apart; `None` if it is of no kind that has checksums, or damaged. The pictures of
    /// a PNG are inflated if `inflate`.
    pub(crate) fn split(bytes: &[u8], inflate: bool) -> Option<Self> {
        if bytes.starts_with(PNG) {
            return split_png(&bytes[PNG.len()..], inflate);
        }
        if bytes.starts_with(ZIP_MEMBER) {
            return split_zip(bytes);
        }
        if bytes.starts_with(ARCHIVE) {
            let length = u32_at(bytes, 12)? as usize;
            let end = bytes.len().checked_sub(4)?;
            let header = bytes.get(16..16 + length)?.to_vec();
            let parts = vec![header, bytes.get(16 + length..end)?.to_vec()];
            return Some(Self { kind: Kind::Archive, parts });
        }
        if bytes.starts_with(FIELD) {
            let end = bytes.len().checked_sub(4)?;
            return Some(Self { kind: Kind::Field, parts: vec![bytes.get(12..end)?.to_vec()] });
        }
        None
    }

    /// Puts the parts together, with the checksums that they have now.
    pub(crate) fn join(&self) -> Vec<u8> {
        match &self.kind {
            Kind::Png(inflated) => join_png(&self.parts, *inflated),
            Kind::Zip(methods) => join_zip(&self.parts, methods),
            Kind::Archive => {
                let head = [ARCHIVE, &1_u32.to_le_bytes(), &length(&self.parts[0])].concat();
                with_checksum([head, self.parts.concat()].concat())
            }
            Kind::Field => with_checksum([FIELD, &2_u32.to_le_bytes(), &self.parts[0]].concat()),
        }
    }
}

fn with_checksum(mut bytes: Vec<u8>) -> Vec<u8> {
    let sum = crc32fast::hash(&bytes);
    bytes.extend(sum.to_le_bytes());
    bytes
}

fn length(bytes: &[u8]) -> [u8; 4] {
    (bytes.len() as u32).to_le_bytes()
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    bytes.get(at..at + 2)?.try_into().ok().map(u16::from_le_bytes)
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..at + 4)?.try_into().ok().map(u32::from_le_bytes)
}

fn split_png(mut rest: &[u8], inflate: bool) -> Option<Container> {
    let mut parts = Vec::new();
    while !rest.is_empty() {
        let length = u32::from_be_bytes(rest.get(..4)?.try_into().ok()?) as usize;
        let (kind, data) = (rest.get(4..8)?, rest.get(8..8 + length)?);
        let data = match inflate && kind == b"IDAT" {
            true => decompress_to_vec_zlib_with_limit(data, MAX_CONTENT).ok()?,
            false => data.to_vec(),
        };
        parts.extend([kind.to_vec(), data]);
        rest = rest.get(12 + length..)?;
    }
    (!parts.is_empty()).then_some(Container { kind: Kind::Png(inflate), parts })
}

fn join_png(parts: &[Vec<u8>], inflated: bool) -> Vec<u8> {
    let mut out = PNG.to_vec();
    for chunk in parts.chunks_exact(2) {
        let (kind, data) = (&chunk[0], &chunk[1]);
        let data = match inflated && kind == b"IDAT" {
            true => compress_to_vec_zlib(data, 6),
            false => data.clone(),
        };
        out.extend((data.len() as u32).to_be_bytes());
        let checked = [kind.as_slice(), &data].concat();
        out.extend(&checked);
        out.extend(crc32fast::hash(&checked).to_be_bytes());
    }
    out
}

fn split_zip(bytes: &[u8]) -> Option<Container> {
    let (mut methods, mut parts, mut at) = (Vec::new(), Vec::new(), 0);
    while bytes.get(at..at + 4)? == ZIP_MEMBER {
        let method = u16_at(bytes, at + 8)?;
        let packed = u32_at(bytes, at + 18)? as usize;
        let name_end = at + 30 + usize::from(u16_at(bytes, at + 26)?);
        let data = name_end + usize::from(u16_at(bytes, at + 28)?);
        let packed = bytes.get(data..data + packed)?;
        let content = match method {
            8 => decompress_to_vec_with_limit(packed, MAX_CONTENT).ok()?,
            _ => packed.to_vec(),
        };
        parts.extend([bytes.get(at + 30..name_end)?.to_vec(), content]);
        methods.push(method);
        at = data + packed.len();
    }
    (!parts.is_empty()).then_some(Container { kind: Kind::Zip(methods), parts })
}

/// A zip file of names and contents, stored (method 0) or deflated (8).
pub(crate) fn join_zip(parts: &[Vec<u8>], methods: &[u16]) -> Vec<u8> {
    let (mut out, mut table) = (Vec::new(), Vec::new());
    for (member, method) in parts.chunks_exact(2).zip(methods) {
        let (name, content) = (&member[0], &member[1]);
        let packed = if *method == 8 { compress_to_vec(content, 6) } else { content.clone() };
        let sum = crc32fast::hash(content).to_le_bytes();
        let name_length = (name.len() as u16).to_le_bytes();
        let [low, high] = method.to_le_bytes();
        let record = [&[20, 0, 0, 0, low, high, 0, 0, 0, 0][..], &sum].concat();
        let record = [record, [length(&packed), length(content)].concat()].concat();
        table.extend([b"PK\x01\x02\x14\x03", &record[..], &name_length, &[0; 12]].concat());
        table.extend((out.len() as u32).to_le_bytes());
        table.extend(name);
        out.extend([ZIP_MEMBER, &record, &name_length, &[0; 2], name, &packed].concat());
    }
    let (place, count) = (length(&out), (methods.len() as u16).to_le_bytes());
    let size = length(&table);
    out.extend(table);
    out.extend([b"PK\x05\x06\0\0\0\0", &count[..], &count, &size, &place, &[0; 2]].concat());
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_same(bytes: &[u8]) {
        for inflate in [false, true] {
            let container = Container::split(bytes, inflate).expect("a container");
            assert_eq!(container.join(), bytes);
        }
    }

    #[test]
    fn what_is_joined_unchanged_is_the_file() {
        let members = [b"a.npy".to_vec(), vec![1; 300], b"b.npy".to_vec(), b"2345".to_vec()];
        assert_same(&join_zip(&members, &[8, 0]));
        let header = b"{\"meta\": 7}";
        let archive = [ARCHIVE, &1_u32.to_le_bytes(), &length(header), header, &[9; 40]].concat();
        assert_same(&with_checksum(archive));
        assert_same(&with_checksum([FIELD, &2_u32.to_le_bytes(), &[7; 300]].concat()));
        assert_same(&crate::seeds::picture::colour((16, 12), 3));
        for other in [&b"# a text"[..], PNG, b"PK\x03\x04"] {
            assert_eq!(Container::split(other, true), None);
        }
    }

    #[test]
    fn changed_parts_have_valid_checksums() {
        let png = crate::seeds::picture::colour((16, 12), 3);
        let mut container = Container::split(&png, true).expect("a picture");
        container.parts[1][3] = 15;
        let mut decoder = png::Decoder::new(std::io::Cursor::new(container.join()));
        assert_eq!(decoder.read_header_info().expect("a header").width, 15);
    }
}
