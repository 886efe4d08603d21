//! Bytes compressed by LZFSE, as Apple's systems do.

use crate::DatasetError;
use lzfse_rust::LzfseRingDecoder;
use std::io::Read;
use std::path::Path;

/// Decompresses the values of a picture, of a kind, a size [px] and so many bytes each.
pub(super) fn decompress_lzfse(
    path: &Path,
    bytes: &[u8],
    (kind, (width, height), value_bytes): (&str, (usize, usize), usize),
) -> Result<Vec<u8>, DatasetError> {
    let length = value_bytes * width * height;
    let mut out = Vec::with_capacity(length);
    let mut decoder = LzfseRingDecoder::default();
    let decoded = decoder.reader_bytes(bytes).take(length as u64 + 1).read_to_end(&mut out);
    let reason = match decoded {
        Ok(_) if out.len() == length => return Ok(out),
        Ok(found) => {
            let found = if found > length { "more".to_owned() } else { found.to_string() };
            format!("{kind} of {found} bytes, expected {length} for {width}x{height} values")
        }
        Err(error) => format!("damaged {kind} (LZFSE: {error})"),
    };
    Err(DatasetError::image(path, reason))
}
