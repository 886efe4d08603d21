//! Binary glTF 2.0: buffers with their descriptions, in one file (`.glb`).

use serde_json::{Value, json};
use std::io::{self, Write};

const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_BYTE: u32 = 5121;

const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// Data of a file, one array after another.
#[derive(Default)]
pub(crate) struct Buffers {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Buffers {
    /// Adds rows of floats; returns the number of its accessor.
    pub(crate) fn floats<const N: usize>(&mut self, rows: &[[f32; N]]) -> usize {
        let bytes = rows.iter().flatten().flat_map(|v| v.to_le_bytes());
        self.add(bytes.collect(), ARRAY_BUFFER, accessor(FLOAT, kind(N), rows.len()))
    }

    /// Adds positions, whose extremes a reader wants to know.
    pub(crate) fn positions(&mut self, rows: &[[f32; 3]]) -> usize {
        let extreme = |start: f32, pick: fn(f32, f32) -> f32| -> [f32; 3] {
            std::array::from_fn(|i| rows.iter().fold(start, |best, row| pick(best, row[i])))
        };
        let (least, most) =
            (extreme(f32::INFINITY, f32::min), extreme(f32::NEG_INFINITY, f32::max));
        let place = self.floats(rows);
        self.accessors[place]["min"] = json!(least);
        self.accessors[place]["max"] = json!(most);
        place
    }

    /// Adds rows of four numbers from 0 to 1 in 8 bits.
    pub(crate) fn bytes(&mut self, rows: &[[u8; 4]]) -> usize {
        let mut accessor = accessor(UNSIGNED_BYTE, "VEC4", rows.len());
        accessor["normalized"] = json!(true);
        self.add(rows.concat(), ARRAY_BUFFER, accessor)
    }

    /// Adds rows of four numbers from 0 to 1 in 16 bits.
    pub(crate) fn shorts(&mut self, rows: &[[u16; 4]]) -> usize {
        let mut accessor = accessor(UNSIGNED_SHORT, "VEC4", rows.len());
        accessor["normalized"] = json!(true);
        let bytes = rows.iter().flatten().flat_map(|v| v.to_le_bytes());
        self.add(bytes.collect(), ARRAY_BUFFER, accessor)
    }

    /// Adds numbers of vertices.
    pub(crate) fn indices(&mut self, triangles: &[[u32; 3]]) -> usize {
        let bytes = triangles.iter().flatten().flat_map(|v| v.to_le_bytes());
        let accessor = accessor(UNSIGNED_INT, "SCALAR", 3 * triangles.len());
        self.add(bytes.collect(), ELEMENT_ARRAY_BUFFER, accessor)
    }

    fn add(&mut self, data: Vec<u8>, target: u32, mut accessor: Value) -> usize {
        accessor["bufferView"] = json!(self.views.len());
        self.views.push(json!({
            "buffer": 0,
            "byteOffset": self.bytes.len(),
            "byteLength": data.len(),
            "target": target,
        }));
        self.bytes.extend(data);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    /// Writes the file: these buffers, and what else the description holds. `generator` names who
    /// wrote it.
    ///
    /// # Errors
    /// Those of the system; `InvalidData` beyond 4 GB, which the format does not hold.
    pub(crate) fn write(
        self,
        out: &mut dyn Write,
        generator: &str,
        mut description: Value,
    ) -> io::Result<()> {
        description["asset"] = json!({ "version": "2.0", "generator": generator });
        description["buffers"] = json!([{ "byteLength": self.bytes.len() }]);
        description["bufferViews"] = json!(self.views);
        description["accessors"] = json!(self.accessors);
        let mut text = serde_json::to_vec(&description)?;
        text.resize(text.len().next_multiple_of(4), b' ');
        let length = |bytes: usize| {
            let too_long = "a GLB file holds 4 GB at most: export less of the scene";
            u32::try_from(bytes).map_err(|_| io::Error::new(io::ErrorKind::InvalidData, too_long))
        };
        let total = length(12 + 8 + text.len() + 8 + self.bytes.len())?;
        out.write_all(b"glTF")?;
        out.write_all(&2_u32.to_le_bytes())?;
        out.write_all(&total.to_le_bytes())?;
        for (name, chunk) in [(b"JSON", &text), (b"BIN\0", &self.bytes)] {
            out.write_all(&length(chunk.len())?.to_le_bytes())?;
            out.write_all(name)?;
            out.write_all(chunk)?;
        }
        Ok(())
    }
}

fn accessor(component: u32, kind: &str, count: usize) -> Value {
    json!({ "componentType": component, "type": kind, "count": count })
}

fn kind(columns: usize) -> &'static str {
    match columns {
        1 => "SCALAR",
        2 => "VEC2",
        3 => "VEC3",
        _ => "VEC4",
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// The description and the data of a file.
    pub(crate) fn parts(bytes: &[u8]) -> (Value, Vec<u8>) {
        let word = |at: usize| {
            u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]) as usize
        };
        assert_eq!((&bytes[..4], word(4), word(8)), (&b"glTF"[..], 2, bytes.len()));
        let text = word(12);
        assert_eq!((&bytes[16..20], text % 4), (&b"JSON"[..], 0));
        assert_eq!((&bytes[24 + text..28 + text], word(20 + text) % 4), (&b"BIN\0"[..], 0));
        let data = bytes[28 + text..].to_vec();
        assert_eq!(data.len(), word(20 + text));
        (serde_json::from_slice(&bytes[20..20 + text]).expect("JSON"), data)
    }

    /// Floats of an accessor.
    pub(crate) fn floats(parts: &(Value, Vec<u8>), accessor: usize) -> Vec<f32> {
        let view = parts.0["accessors"][accessor]["bufferView"].as_u64().expect("a number");
        let view = &parts.0["bufferViews"][view as usize];
        let number = |key: &str| view[key].as_u64().expect("a number") as usize;
        let data = &parts.1[number("byteOffset")..][..number("byteLength")];
        data.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
    }

    #[test]
    fn arrays_are_aligned_and_described() {
        let mut buffers = Buffers::default();
        let positions = buffers.positions(&[[1.0, 2.0, 3.0], [-1.0, 5.0, 0.0]]);
        let colours = buffers.shorts(&[[1, 2, 3, 4]]);
        let marks = buffers.bytes(&[[9, 8, 7, 6]]);
        let triangles = buffers.indices(&[[0, 1, 0]]);
        let more = buffers.floats(&[[0.5], [0.25]]);
        let mut bytes = Vec::new();
        buffers.write(&mut bytes, "a test", json!({ "scene": 0 })).expect("memory");
        let parts = parts(&bytes);
        assert_eq!(parts.0["asset"]["generator"], "a test");
        assert_eq!(parts.0["accessors"][positions]["min"], json!([-1.0, 2.0, 0.0]));
        assert_eq!(parts.0["accessors"][positions]["max"], json!([1.0, 5.0, 3.0]));
        assert_eq!(floats(&parts, positions), [1.0, 2.0, 3.0, -1.0, 5.0, 0.0]);
        assert_eq!(floats(&parts, more), [0.5, 0.25]);
        assert_eq!(parts.0["accessors"][triangles]["count"], 3);
        for (accessor, due) in [(colours, 5123), (marks, 5121), (triangles, 5125)] {
            assert_eq!(parts.0["accessors"][accessor]["componentType"], due);
        }
        assert_eq!(parts.0["buffers"][0]["byteLength"], parts.1.len());
    }
}
