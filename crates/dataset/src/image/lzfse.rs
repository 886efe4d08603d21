//! Bytes compressed by LZFSE, as Apple's systems do.

use crate::DatasetError;
use lzfse_rust::LzfseRingDecoder;
use std::io::Read;
use std::path::Path;

/// Decompresses exactly `length` bytes.
pub(super) fn decompress_lzfse(
    path: &Path,
    bytes: &[u8],
    length: usize,
) -> Result<Vec<u8>, DatasetError> {
    let mut out = Vec::with_capacity(length);
    let mut decoder = LzfseRingDecoder::default();
    let decoded = decoder.reader_bytes(bytes).take(length as u64 + 1).read_to_end(&mut out);
    match decoded {
        Ok(_) if out.len() == length => Ok(out),
        Ok(found) => {
            let more = if found > length { "more than " } else { "" };
            let reason = format!("damaged: {more}{} bytes, expected {length}", found.min(length));
            Err(DatasetError::image(path, reason))
        }
        Err(error) => Err(DatasetError::image(path, format!("damaged (LZFSE: {error})"))),
    }
}
