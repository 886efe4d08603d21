//! Named arrays of `f32` in one file, lossless and self-describing.
//!
//! Layout, little endian: the 8 bytes `I2SLAM\r\n`, format version (`u32`), length of the header
//! (`u32`), the header (JSON: `meta`, and `arrays` with name, rows and columns in order), the
//! arrays one after another (row-major `f32`), and the CRC-32 (ISO-HDLC) of everything before.

use serde::{Deserialize, Serialize};
use std::io::{self, Write};

const MAGIC: &[u8; 8] = b"I2SLAM\r\n";
const VERSION: u32 = 1;
const PREAMBLE: usize = MAGIC.len() + 8;

/// One array: `rows x columns`, row-major.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Array {
    pub(crate) name: String,
    pub(crate) columns: usize,
    pub(crate) values: Vec<f32>,
}

/// Arrays with their description.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Archive<M> {
    pub(crate) meta: M,
    pub(crate) arrays: Vec<Array>,
}

#[derive(Serialize, Deserialize)]
struct Header<M> {
    meta: M,
    arrays: Vec<ArrayHeader>,
}

#[derive(Serialize, Deserialize)]
struct ArrayHeader {
    name: String,
    rows: usize,
    columns: usize,
}

impl<M> Archive<M> {
    /// Takes the values of an array; refuses another number of columns.
    pub(crate) fn take(&mut self, name: &str, columns: usize) -> Result<Vec<f32>, String> {
        let array = self.arrays.iter_mut().find(|a| a.name == name);
        let array = array.ok_or_else(|| format!("has no array \"{name}\""))?;
        if array.columns != columns {
            return Err(format!(
                "array \"{name}\" has {} columns, expected {columns}",
                array.columns
            ));
        }
        Ok(std::mem::take(&mut array.values))
    }
}

/// A writer that computes the CRC-32 of its bytes.
struct ChecksumWriter<'a> {
    out: &'a mut dyn Write,
    sum: crc32fast::Hasher,
}

impl ChecksumWriter<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.sum.update(bytes);
        self.out.write_all(bytes)
    }
}

impl<M: Serialize> Archive<M> {
    pub(crate) fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        let arrays = self.arrays.iter().map(|a| ArrayHeader {
            name: a.name.clone(),
            rows: a.values.len() / a.columns.max(1),
            columns: a.columns,
        });
        let header = Header { meta: &self.meta, arrays: arrays.collect() };
        let header = serde_json::to_vec(&header).map_err(io::Error::other)?;
        let length = u32::try_from(header.len()).map_err(io::Error::other)?;
        let mut checked = ChecksumWriter { out, sum: crc32fast::Hasher::new() };
        checked.write(MAGIC)?;
        checked.write(&VERSION.to_le_bytes())?;
        checked.write(&length.to_le_bytes())?;
        checked.write(&header)?;
        for array in &self.arrays {
            for chunk in array.values.chunks(1 << 14) {
                let bytes: Vec<u8> = chunk.iter().flat_map(|v| v.to_le_bytes()).collect();
                checked.write(&bytes)?;
            }
        }
        let sum = checked.sum.clone().finalize();
        checked.out.write_all(&sum.to_le_bytes())
    }
}

impl<M: for<'de> Deserialize<'de>> Archive<M> {
    /// Reads an archive; the error says what is wrong with the file.
    pub(crate) fn read(bytes: &[u8]) -> Result<Self, String> {
        let header_length = check_preamble(bytes)?;
        let truncated = || "is truncated".to_owned();
        let header = bytes.get(PREAMBLE..PREAMBLE + header_length).ok_or_else(truncated)?;
        let header: Header<M> =
            serde_json::from_slice(header).map_err(|e| format!("has a damaged header ({e})"))?;
        let mut at = PREAMBLE + header_length;
        let mut arrays = Vec::with_capacity(header.arrays.len());
        for a in header.arrays {
            let length = a.rows.checked_mul(a.columns).and_then(|n| n.checked_mul(4));
            let end = length.and_then(|n| at.checked_add(n)).ok_or_else(truncated)?;
            let values = bytes.get(at..end).ok_or_else(truncated)?.chunks_exact(4);
            let values = values.map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
            arrays.push(Array { name: a.name, columns: a.columns, values });
            at = end;
        }
        let stored = bytes.get(at..at + 4).ok_or_else(truncated)?;
        if stored != crc32fast::hash(&bytes[..at]).to_le_bytes() {
            return Err("is damaged (its checksum does not match)".to_owned());
        }
        Ok(Self { meta: header.meta, arrays })
    }
}

/// Checks magic and version; returns the length of the header.
fn check_preamble(bytes: &[u8]) -> Result<usize, String> {
    if !bytes.starts_with(MAGIC) {
        let short = bytes.len() < MAGIC.len() && MAGIC.starts_with(bytes);
        return Err(if short { "is truncated" } else { "is not an i2slam file" }.to_owned());
    }
    let word = |at: usize| {
        let b = bytes.get(at..at + 4).ok_or("is truncated")?;
        Ok::<_, String>(u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
    };
    let version = word(MAGIC.len())?;
    if version != VERSION {
        return Err(format!("has format version {version}; this program reads version {VERSION}"));
    }
    Ok(word(MAGIC.len() + 4)? as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> (Archive<u32>, Vec<u8>) {
        let arrays = vec![
            Array {
                name: "mean".into(),
                columns: 3,
                values: vec![1.0, -2.5, 1e-30, 4.0, f32::MAX, 6.0],
            },
            Array { name: "opacity".into(), columns: 1, values: vec![0.1, 0.2] },
        ];
        let archive = Archive { meta: 7, arrays };
        let mut bytes = Vec::new();
        archive.write(&mut bytes).expect("memory");
        (archive, bytes)
    }

    fn refusal(bytes: &[u8]) -> String {
        Archive::<u32>::read(bytes).expect_err("a damaged file")
    }

    #[test]
    fn reads_back_every_bit() {
        let (archive, bytes) = example();
        assert_eq!(Archive::read(&bytes), Ok(archive));
    }

    #[test]
    fn says_what_is_wrong() {
        let (_, bytes) = example();
        assert!(refusal(b"ply\nformat").contains("not an i2slam file"));
        for length in [0, 5, 10, 14, 30, bytes.len() - 9, bytes.len() - 1] {
            assert!(refusal(&bytes[..length]).contains("truncated"), "{length}");
        }
        let mut flipped = bytes.clone();
        let last = flipped.len() - 6;
        flipped[last] ^= 1;
        assert!(refusal(&flipped).contains("checksum"));
        let mut newer = bytes;
        newer[8] = 9;
        assert!(refusal(&newer).contains("version 9"));
    }

    #[test]
    fn names_a_missing_array() {
        let (mut archive, _) = example();
        assert!(archive.take("rotation", 4).expect_err("missing").contains("rotation"));
        assert!(archive.take("mean", 4).expect_err("columns").contains("3 columns"));
        assert_eq!(archive.take("opacity", 1), Ok(vec![0.1, 0.2]));
    }
}
